"""What the rows of a sweep say: maps, shares of stable runs, worst runs, margins certified and simulated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import control
import numpy as np
import numpy.typing as npt
import pandas as pd

from interarea.design.controllers.bank import ControllerBank
from interarea.design.delay.curves import DelayError, delay_margin
from interarea.design.linear.linearise import linearise, remove_reference, speeds_in_rad
from interarea.fmu_build.open.plant import open_plant

from ..sweep.point import point_of
from ..sweep.runner import Runner
from ..sweep.spec import Sweep
from ..sweep.values import Search, Value

Array = npt.NDArray[np.float64]
MARGIN_TOLERANCE_S, LOSS_TOLERANCE = 1e-3, 1e-2
_SEARCHED_S = 2.0  #: longest latency that is looked at
_MOST_MARGINS = 12
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
    found = [
        n
        for n, p in sweep.parameters.items()
        if p.bisect is None
        and kind_of(sweep, n) in order
        and pd.api.types.is_numeric_dtype(rows[n])
        and rows[n].nunique() > 1
    ]
    return sorted(found, key=lambda n: order[kind_of(sweep, n)])


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


@dataclass(frozen=True)
class Margin:
    """Where stability ends in latency or loss at one point, certified (linear, exact) and simulated.

    certified : None where there is no certificate (loss), infinite when none up to `searched`.
    stable, unstable : ends of the simulated bracket; unstable None: stable up to `searched`.
    """

    name: str
    values: Mapping[str, Value]
    certified: float | None
    stable: float | None
    unstable: float | None
    searched: float
    note: str = ""

    @property
    def is_known(self) -> bool:
        """Whether there is anything to draw: a simulated or a certified margin."""
        return self.stable is not None or bool(self.certified)


def margins_of(sweep: Sweep, rows: pd.DataFrame, runner: Runner) -> list[Margin]:
    """Return margins in latency and in loss for the combinations of case, operating point and controller.

    Simulated ones are bisections by co-simulation (1 ms, 1 % of loss), other parameters at their smallest
    values; a parameter that the sweep itself searched is taken from its rows.
    """
    found: list[Margin] = []
    searched = sweep.searched
    for name in sweep.parameters:
        kind = kind_of(sweep, name)
        if kind not in ("latency", "loss"):
            continue
        if searched is not None and searched[0] == name:
            for row in rows[rows.status == "ok"].head(_MOST_MARGINS).to_dict("records"):
                values = sweep.values(int(row["run"]))
                edge = (_number(row[name]), _number(row[f"{name}_unstable"]))
                found.append(_margin(sweep, runner, name, kind, values, searched[1].high, edge))
            continue
        top = float(rows[name].max())
        for values in _corners(sweep, name):
            high = max(_SEARCHED_S, top) if kind == "latency" else 1.0
            tolerance = MARGIN_TOLERANCE_S if kind == "latency" else LOSS_TOLERANCE
            search = Search(low=0.0, high=high, tolerance=tolerance, scan=21)
            try:
                good, bad, _ = runner.edge(values, name, search)
                found.append(_margin(sweep, runner, name, kind, values, high, (good, bad)))
            except (ValueError, RuntimeError) as error:
                text = " ".join(str(error).split())
                found.append(Margin(name, values, None, None, None, high, text))
    return found


def _corners(sweep: Sweep, name: str) -> list[dict[str, Value]]:
    """Return the points at which a margin is computed: every case, operating point and controller."""
    choices: dict[str, Sequence[Value]] = {}
    for other, p in sweep.parameters.items():
        if other == name:
            continue
        if p.sampled or p.bisect is not None:
            choices[other] = [p.probes()[0]]
        elif sweep.paths(other)[0][0] in ("case", "controller"):
            choices[other] = [p.grid_value(k) for k in range(min(p.size, _MOST_MARGINS))]
        else:
            listed = [p.grid_value(k) for k in range(p.size)]
            choices[other] = [min(listed) if all(isinstance(v, int | float) for v in listed) else listed[0]]  # type: ignore[type-var]
    return [dict(zip(choices, some, strict=True)) for some in product(*choices.values())][:_MOST_MARGINS]


def _margin(
    sweep: Sweep,
    runner: Runner,
    name: str,
    kind: str,
    values: Mapping[str, Value],
    high: float,
    edge: tuple[float | None, float | None],
) -> Margin:
    certified, note = None, ""
    if kind == "latency":
        try:
            certified = certified_margin(sweep, runner, name, values, high)
        except (DelayError, ValueError) as error:
            note = " ".join(str(error).split())
    return Margin(name, dict(values), certified, edge[0], edge[1], high, note)


def certified_margin(
    sweep: Sweep, runner: Runner, name: str, values: Mapping[str, Value], upto_s: float
) -> float:
    """Return the exact delay margin of the linear loop in a latency parameter, s; infinite if none.

    Channels that the parameter does not set keep their latency; packets and losses are not part of it.

    Raises
    ------
    DelayError : unstable without latency. ValueError : no controller.
    """
    search = sweep.parameters[name].bisect
    start = {**values, name: 0.0 if search is None else search.low}
    point = point_of(sweep, start)
    controller = runner.plan.controller(point.change.case, point.scenario.controller)
    if isinstance(controller, ControllerBank):
        raise ValueError("a bank has no single certified margin: see its switching certificate")
    if controller is None:
        raise ValueError("there is no controller, so no loop that latency could upset")
    case, path = runner.plant_of(start)
    with open_plant(path) as plant:
        system = speeds_in_rad(remove_reference(linearise(plant)), case.omega_b)
    channels = point.scenario.channels
    moving = [channels[words[1]].signal for words in sweep.paths(name) if words[0] == "channels"]
    used = [s for s in moving if s in controller.inputs]
    if not used:
        raise ValueError("the controller does not read the signals of these channels")
    latencies = {c.signal: c.latency_s for c in channels.values()}
    fixed = {s: v for s, v in latencies.items() if s not in moving and s in controller.inputs}
    K = controller.system if point.gain == 1.0 else _scaled(controller.system, point.gain)
    return float(delay_margin(system, K, used, latency_s_of=fixed, upto_s=upto_s).margin_s)


def _scaled(K: control.StateSpace, gain: float) -> control.StateSpace:
    return control.ss(
        K.A, K.B, gain * K.C, gain * K.D, inputs=list(K.input_labels), outputs=list(K.output_labels)
    )


def _number(value: Any) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
