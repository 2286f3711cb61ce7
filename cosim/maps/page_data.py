"""What the rows of a sweep say: maps, shares of stable runs, worst runs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from ..sweep.spec import Sweep

Array = npt.NDArray[np.float64]
_LEAST_PAIRS = 4


@dataclass(frozen=True)
class Map:
    """Values of two parameters and, for each pair, what the runs there did.

    x, y : sorted values. stable : (y, x) share of stable runs among those that ended; nan without any.
    damping : (y, x) least damping ratio of all that swings among stable runs; nan where none is.
    """

    x_name: str
    y_name: str
    x: Array
    y: Array
    stable: Array
    damping: Array
    runs: Array


def kind_of(sweep: Sweep, name: str) -> str:
    """Return what a parameter is: latency, loss, tie, controller, case, seed or other."""
    words = sweep.paths(name)[0]
    if words[-1] == "latency_s":
        return "latency"
    if "loss" in words:
        return "loss"
    if words == ("case", "tie_flow_mw"):
        return "tie"
    return words[0] if words in (("controller",), ("case",), ("seed",)) else "other"


def numeric(sweep: Sweep, rows: pd.DataFrame) -> list[str]:
    """Return the parameters with at least two numbers, latency, loss and tie flow first."""
    order = {"latency": 0, "loss": 1, "tie": 2, "other": 3}
    names = [
        n
        for n, p in sweep.parameters.items()
        if p.bisect is None
        and kind_of(sweep, n) in order
        and pd.api.types.is_numeric_dtype(rows[n])
        and rows[n].nunique() > 1
    ]
    return sorted(names, key=lambda n: order[kind_of(sweep, n)])


def pairs_of(sweep: Sweep, rows: pd.DataFrame) -> list[tuple[str, str]]:
    """Return the pairs of parameters worth a map: latency with loss, latency with tie flow, then others."""
    names = numeric(sweep, rows)
    return [(a, b) for k, a in enumerate(names) for b in names[k + 1 :]][:_LEAST_PAIRS]


def facets_of(sweep: Sweep, rows: pd.DataFrame) -> tuple[str, list[Any]]:
    """Return the parameter that splits maps (controllers, else cases, else other words) and its values."""
    words = [
        n
        for n in sweep.parameters
        if not pd.api.types.is_numeric_dtype(rows[n]) and 1 < rows[n].nunique() <= 6
    ]
    words.sort(key=lambda n: {"controller": 0, "case": 1}.get(kind_of(sweep, n), 2))
    return (words[0], sorted(rows[words[0]].unique())) if words else ("", [None])


def map_of(rows: pd.DataFrame, x_name: str, y_name: str) -> Map:
    """Return the map of two grid parameters over all rows, other parameters pooled."""
    x, y = (np.array(sorted(rows[n].unique()), dtype=float) for n in (x_name, y_name))
    stable, damping, count = (np.full((len(y), len(x)), np.nan) for _ in range(3))
    place_x, place_y = ({v: k for k, v in enumerate(values)} for values in (x, y))
    for (a, b), group in rows.groupby([x_name, y_name]):
        j, i = place_y[b], place_x[a]
        count[j, i] = len(group)
        ended = group[group.status == "ok"]
        if "stable" in ended and len(ended):
            stable[j, i] = float(ended["stable"].astype(float).mean())
        least = least_damping(ended)
        damping[j, i] = math.nan if least is None else least
    return Map(x_name, y_name, x, y, stable, damping, count)


def least_damping(rows: pd.DataFrame) -> float | None:
    """Return the least damping ratio of all that swings among stable runs (others are no ring-down)."""
    good = settled(rows)
    if "damping_least" not in good or not good["damping_least"].notna().any():
        return None
    return float(good["damping_least"].min())


def settled(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of runs that ended, and ended stable where that was asked for."""
    good = rows[rows.status == "ok"]
    return good[good["stable"].fillna(False).astype(bool)] if "stable" in good else good


def is_grid(rows: pd.DataFrame, x_name: str, y_name: str) -> bool:
    """Whether most pairs of values are there, so that cells can be drawn; else the runs are points."""
    cells = rows[x_name].nunique() * rows[y_name].nunique()
    return cells <= 4.0 * len(rows.groupby([x_name, y_name]))


def worst_runs(rows: pd.DataFrame, count: int) -> list[int]:
    """Return runs, worst first: unstable ones by their peak, then by least damping."""
    ended = rows[rows.status == "ok"].copy()
    if "stable" not in ended or ended.empty:
        return []
    unstable = ended[ended["stable"] == False]  # noqa: E712  (a column, with nulls)
    stable = ended[ended["stable"] == True]  # noqa: E712
    if "peak_pu" in ended:
        unstable = unstable.sort_values("peak_pu", ascending=False, kind="stable")
    if "damping_least" in ended:
        stable = stable.sort_values("damping_least", na_position="last", kind="stable")
    return [int(r) for r in [*unstable.run, *stable.run][:count]]
