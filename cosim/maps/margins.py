"""Margins in latency and loss at the points of a sweep: certified on the linear loop, and simulated."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import control
import pandas as pd

from interarea.design.controllers.bank import ControllerBank
from interarea.design.delay.curves import DelayError, delay_margin
from interarea.design.linear.linearise import linearise, remove_reference, speeds_in_rad
from interarea.fmu_build.open.plant import open_plant

from ..sweep.front import cores
from ..sweep.plan import SweepPlan
from ..sweep.point import point_of
from ..sweep.prepare import prepare
from ..sweep.rows import Row
from ..sweep.runner import Runner
from ..sweep.spec import Sweep
from ..sweep.values import Parameter, Search, Value
from ..sweep.workers.pool import local_outcomes
from .page_data import kind_of

MARGIN_TOLERANCE_S, LOSS_TOLERANCE = 1e-3, 1e-2
_SEARCHED_S = 2.0  #: longest latency that is looked at
_MOST_MARGINS = 12


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


def margins_of(
    plan: SweepPlan,
    rows: pd.DataFrame,
    runner: Runner,
    *,
    workers: int | None = None,
    progress: Callable[[float], object] | None = None,
) -> list[Margin]:
    """Return margins in latency and in loss for the combinations of case, operating point and controller.

    Simulated ones are bisections by co-simulation (1 ms, 1 % of loss), other parameters at their smallest
    values; a parameter that the sweep itself searched is taken from its rows.

    runner : whose cache and scratch folder are used. workers : processes that search side by side; default
        one for each core. progress : called with the share that is done.
    """
    sweep, margins = plan.sweep, list[Margin]()
    names = [name for name in sweep.parameters if kind_of(sweep, name) in ("latency", "loss")]
    for k, name in enumerate(names):

        def tell(share: float, k: int = k) -> None:
            if progress is not None:
                progress((k + share) / len(names))

        if sweep.searched is not None and sweep.searched[0] == name:
            ended = rows[rows.status == "ok"].head(_MOST_MARGINS).to_dict("records")
            edges = [(sweep.values(int(row["run"])), {str(k): v for k, v in row.items()}) for row in ended]
            high = sweep.searched[1].high
        else:
            high = max(_SEARCHED_S, float(rows[name].max())) if kind_of(sweep, name) == "latency" else 1.0
            edges = _searched(plan, name, high, runner, workers, tell)
        margins += [_margin(plan, runner, name, values, high, row) for values, row in edges]
    return margins


def _searched(
    plan: SweepPlan,
    name: str,
    high: float,
    runner: Runner,
    workers: int | None,
    tell: Callable[[float], object],
) -> list[tuple[dict[str, Value], Row]]:
    """Search the edge of stability in a parameter at each corner: a sweep of its own, with its workers.

    Returns values of the other parameters and the row of each search.
    """
    corners = _corners(plan.sweep, name)
    tolerance = MARGIN_TOLERANCE_S if kind_of(plan.sweep, name) == "latency" else LOSS_TOLERANCE
    search = Search(low=0.0, high=high, tolerance=tolerance, scan=21)
    there = plan.sweep.parameters
    table = {
        other: Parameter(path=p.path, bisect=search)
        if other == name
        else Parameter(path=p.path, values=tuple(_choices(plan.sweep, other)))
        for other, p in there.items()
    }
    sweep = plan.sweep.model_copy(update={"parameters": table, "samples": None})
    sweep = Sweep.model_validate({k: getattr(sweep, k) for k in Sweep.model_fields})
    runs = {_key(sweep.values(run)): run for run in range(sweep.size)}
    todo = [runs[_key(values)] for values in corners]
    prepare(plan, runner.cache)
    rows: dict[int, Row] = {}
    for outcomes in local_outcomes(
        replace(plan, sweep=sweep),
        todo,
        cache=runner.cache,
        scratch=runner.scratch / "searches",
        workers=min(workers or cores(), len(todo)),
        task=1,
    ):
        rows |= {int(outcome.row["run"]): outcome.row for outcome in outcomes}
        tell(len(rows) / len(todo))
    return [(values, rows[run]) for values, run in zip(corners, todo, strict=True)]


def _key(values: Mapping[str, Value]) -> str:
    return repr(sorted(values.items()))


def _corners(sweep: Sweep, name: str) -> list[dict[str, Value]]:
    """Return the points at which a margin is computed: every case, operating point and controller."""
    choices = {other: _choices(sweep, other) for other in sweep.parameters if other != name}
    return [dict(zip(choices, values, strict=True)) for values in product(*choices.values())][:_MOST_MARGINS]


def _choices(sweep: Sweep, name: str) -> Sequence[Value]:
    """Return the values that a parameter has where margins in another one are computed."""
    p = sweep.parameters[name]
    if p.sampled or p.bisect is not None:
        return [p.probes()[0]]
    if sweep.paths(name)[0][0] in ("case", "controller"):
        return [p.grid_value(k) for k in range(min(p.size, _MOST_MARGINS))]
    listed = [p.grid_value(k) for k in range(p.size)]
    return [min(listed) if all(isinstance(v, int | float) for v in listed) else listed[0]]  # type: ignore[type-var]


def _margin(
    plan: SweepPlan, runner: Runner, name: str, values: Mapping[str, Value], high: float, row: Row
) -> Margin:
    """Return the margin that the row of a search holds, in latency with the certified one beside it."""
    if row["status"] != "ok":
        return Margin(name, dict(values), None, None, None, high, str(row["reason"]))
    certified, note = None, ""
    if kind_of(plan.sweep, name) == "latency":
        try:
            certified = certified_margin(plan.sweep, runner, name, values, high)
        except (DelayError, ValueError) as error:
            note = " ".join(str(error).split())
    return Margin(
        name, dict(values), certified, _number(row[name]), _number(row[f"{name}_unstable"]), high, note
    )


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
        raise ValueError("no controller, so no loop with latency")
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
