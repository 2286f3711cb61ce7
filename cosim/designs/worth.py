"""Whether a controller's remote signals pay: comparison with an own-signal rival, designed on equal terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import control
import numpy as np

from interarea.design.controllers.controller import Controller, plain
from interarea.design.delay.signal_conditions import Condition
from interarea.design.reduction.gramians import matrices
from interarea.design.robust.operating_points import FamilyCertificate, inter_area_band
from interarea.design.robust.signal_worth import (
    OWN_MASKED,
    OWN_RIVAL,
    SignalWorth,
    WorthRow,
    own_alone,
    own_signals,
    signal_worth,
    states_of,
)
from interarea.models.case.case import Case

from ..errors import ScenarioError
from .acceptance import Trial, settings_of
from .design_file import DesignTable, run_design, specification_of
from .design_tables import PartTable
from .family import FamilyPlant, family_cases, family_plants
from .fault_loops import ControllerOrBank
from .first_swing import FaultTable, mean_outputs, uncontrolled_speeds

#: key of a controller's design record under which its rival stands
RECORD = "own_signal_rival"
_STARTS = 3  # of the rival of a design that goes on from another controller

Progress = Callable[[str, float, str], object]


def rival_table(table: DesignTable) -> DesignTable:
    """Return the design of the best controller that uses only signals of its actuators' machines.

    Order, effort, points, search and limits are unchanged. Losses, scales and the latency of the remote
    signal alone are not among its conditions, which is to the rival's advantage.

    Raises
    ------
    ScenarioError : no signal is remote, or an actuator's machine has no signal in the set.
    """
    orders = {part.actuator: part.order for part in table.part} or dict.fromkeys(table.actuators, table.order)
    own = _own_of(table)
    renamed = {code: _without_losses(code) for code in table.conditions}
    left_out = {"remote", "local", "actuator", "part", "order", "start_from", "guard", "gain_of"}
    keys = table.model_dump(exclude=left_out, exclude_unset=True)
    keys |= {
        "name": f"{table.name}_own",
        "part": [PartTable(actuator=a, signals=s, order=orders[a]) for a, s in own.items()],
        "conditions": tuple(dict.fromkeys(renamed.values())),
        "effort_under": tuple(dict.fromkeys(renamed[c] for c in table.effort_under)),
        "starts": max(table.starts, 1 if table.start_from is None else _STARTS),
    }
    renamed_away = set(table.conditions) - set(keys["conditions"])
    keys["target"] = [t for t in keys.get("target", ()) if t["under"] not in renamed_away]
    for stage in keys.get("stage", ()):
        stage["conditions"] = tuple(dict.fromkeys(renamed[c] for c in stage.get("conditions", ())))
    seen = {s for selected in own.values() for s in selected}
    if table.guard is not None:
        keys["guard"] = table.guard.of(seen)
    rival = DesignTable.model_validate(keys)
    rival._grid = table._grid
    return rival


def _own_of(table: DesignTable) -> dict[str, tuple[str, ...]]:
    """Return actuator -> the signals of its own machine; ScenarioError if they permit no rival."""
    sees = {part.actuator: part.signals for part in table.part}
    sees = sees or dict.fromkeys(table.actuators, table.signals)
    own = {a: own_signals([a], selected)[a] for a, selected in sees.items()}
    if all(set(own[a]) == set(sees[a]) for a in sees):
        raise ScenarioError(
            f"design {table.name}: uses no signal of another machine, so the link has no worth to compute"
        )
    for actuator, signals in own.items():
        if not signals:
            raise ScenarioError(
                f"design {table.name}: no own-signal rival, {actuator} has no signal of its own machine "
                f"among {', '.join(sees[actuator])}; "
                + (
                    f"add one of its own, such as {actuator.removesuffix('_vs')}_dw"
                    if actuator.endswith("_vs")
                    else "a device at a bus has none, so omit the worth (--no-worth)"
                )
            )
    return own


def _without_losses(code: str) -> str:
    """Return a condition's code less losses, scales and what concerns the signals from afar.

    >>> _without_losses("L+s100"), _without_losses("s200+L:G5_dw"), _without_losses("ns150")
    ('s100', 's200', 'N')
    """
    return "+".join(part for part in code.split("+") if part[0] == "s") or "N"


def design_rival(
    table: DesignTable,
    controller: Controller,
    cache: Path,
    *,
    progress: Progress = lambda step, share, text: None,
) -> Controller:
    """Design the rival of a controller that matches the design of `table`.

    A design that starts from a controller has stages only for that. The search for its rival therefore also
    starts from `controller` with only its own signals. Raises as `rival_table` and `run_design`.
    """
    rival = rival_table(table)
    start = None if table.start_from is None else _own_start(rival, controller)
    return run_design(rival, cache, start=start, progress=progress).controller


def _own_start(rival: DesignTable, controller: Controller) -> control.StateSpace | None:
    """Return a controller with its own signals alone, its states in the rival's order, washouts last.

    None where it has not the states of the rival's parts.
    """
    spec = rival.spec()
    K = own_alone(controller.system)
    orders = {part.actuator: part.order for part in rival.part}
    filters = int(spec.washout_s > 0.0)
    states, washouts = [], []
    for actuator in spec.actuators:
        of_output = states_of(K, list(K.output_labels).index(actuator))
        if len(of_output) != orders[actuator]:
            return None
        states += of_output[: orders[actuator] - filters]
        washouts += of_output[orders[actuator] - filters :]
    order = states + washouts
    signals = [list(K.input_labels).index(name) for name in spec.signals]
    rows = [list(K.output_labels).index(name) for name in spec.actuators]
    A, B, C, D = matrices(K)
    return control.ss(
        A[np.ix_(order, order)], B[np.ix_(order, signals)], C[np.ix_(rows, order)], D[np.ix_(rows, signals)],
        inputs=list(spec.signals), outputs=list(spec.actuators),
    )  # fmt: skip


def rival_on_record(controller: Controller) -> Controller | None:
    """Return the rival in a controller's record. Raises ControllerError if the entry is not a controller."""
    record = controller.design.get(RECORD)
    return None if record is None else Controller.from_dict(record)


def with_rival(controller: Controller, rival: Controller) -> Controller:
    """Return `controller` with its rival, without the rival's certificate, in its record."""
    record = {**replace(rival, certificate=None).as_dict(), "design": {}}
    return replace(controller, design={**controller.design, RECORD: plain(record)})


def worth(
    table: DesignTable,
    controller: Controller,
    cache: Path,
    *,
    rival: Controller | None = None,
    clearing: bool = False,
    progress: Callable[[float], object] = lambda share: None,
) -> SignalWorth:
    """Return the value of the signals of `controller` on the family of a design.

    rival : default that of its record. clearing : clearing times of the design's acceptance too (minutes);
        else those that the same design left in the controller's record.
    """
    cycles = {} if rival is not None else _recorded_cycles(table, controller)
    rival = rival if rival is not None else rival_on_record(controller)
    plants = family_plants(table, cache)
    K = controller.system
    linear = signal_worth(
        {name: plant.judged for name, plant in plants.items()},
        K,
        table.family(),
        None if rival is None else rival.system,
        bands_hz={name: inter_area_band(plant.modes) for name, plant in plants.items()},
        remark=_remark(table) if rival is None else "",
    )
    progress(0.3)
    rises = _common_rises(
        table, {"": K, OWN_MASKED: own_alone(K)} | ({} if rival is None else {OWN_RIVAL: rival.system}), cache
    )
    progress(0.5)
    if clearing and table.acceptance is not None:
        cycles = {"": clearing_change(table, controller, cache)}
        if rival is not None:
            cycles[OWN_RIVAL] = clearing_change(table, rival, cache)
    progress(1.0)

    def filled(row: WorthRow, key: str) -> WorthRow:
        return replace(row, common_rise=rises.get(key))

    return replace(
        linear,
        whole=filled(linear.whole, ""),
        masked=tuple(filled(row, row.name) for row in linear.masked),
        rival=None if linear.rival is None else filled(linear.rival, OWN_RIVAL),
    ).with_clearing(cycles.get(""), cycles.get(OWN_RIVAL))


def _recorded_cycles(table: DesignTable, controller: Controller) -> dict[str, float | None]:
    """Return the clearing times in a record, of controller and rival, where the design `table` found them."""
    recorded = (controller.certificate or {}).get("worth")
    if not recorded or not recorded.get("rival") or specification_of(controller) != table:
        return {}
    return {"": recorded["whole"]["clearing_cycles"], OWN_RIVAL: recorded["rival"]["clearing_cycles"]}


def worth_at(
    case: Case, controller: Controller, cache: Path, *, latency_s_of: Mapping[str, float] | None = None
) -> SignalWorth:
    """Return the value of the signals of `controller` at one operating point, at these latencies (s).

    Clearing times are those of its record, the mean over its design, if that is for this grid.
    """
    K = controller.system
    plant = FamilyPlant.of(case, controller.inputs, controller.outputs, cache)
    late = {name: s for name, s in (latency_s_of or {}).items() if name in controller.inputs}
    rival = rival_on_record(controller)
    linear = signal_worth(
        {case.name: plant.judged},
        K,
        [Condition("as here", (), late)],
        None if rival is None else rival.system,
        bands_hz={case.name: inter_area_band(plant.modes)},
    )
    own = specification_of(controller)
    cycles = _recorded_cycles(own, controller) if own is not None and own.case == case.name else {}
    return linear.with_clearing(cycles.get(""), cycles.get(OWN_RIVAL))


def has_rival(table: DesignTable) -> bool:
    """Whether the design has a remote signal, and every actuator a signal of its own machine."""
    return not _remark(table)


def _remark(table: DesignTable) -> str:
    try:
        rival_table(table)
    except ScenarioError as error:
        return str(error)
    return ""


def certified_worth(
    table: DesignTable,
    controller: Controller,
    certified: FamilyCertificate,
    cache: Path,
    *,
    progress: Callable[[float], object] = lambda share: None,
) -> FamilyCertificate:
    """Return a certificate with the value of the signals; with clearing times if it searched them."""
    searched = certified.acceptance is not None
    measured = worth(table, controller, cache, clearing=searched, progress=progress)
    return replace(certified, worth=plain(measured.as_dict()))


def with_worth(table: DesignTable, controller: Controller, cache: Path) -> Controller:
    """Return a controller with the value of its signals in its certificate."""
    measured = worth(table, controller, cache)
    record = {**(controller.certificate or {}), "worth": plain(measured.as_dict())}
    return replace(controller, certificate=record)


def _common_rises(
    table: DesignTable, systems: Mapping[str, control.StateSpace], cache: Path
) -> dict[str, float | None]:
    """Return the largest mean answer (pu) to the speeds of the uncontrolled fault, 0.5 to 2 s after it.

    Over all points where the design has a fault of its own, else after the first of its acceptance at the
    first point; None where there is neither, or signals are not speeds.
    """
    fault, cases = table.fault, family_cases(table)
    if fault is None:
        tripped = [f for f in (() if table.acceptance is None else table.acceptance.fault) if f.trip]
        if not tripped:
            return dict.fromkeys(systems)
        fault = FaultTable(bus=tripped[0].bus, branch=str(tripped[0].trip))
        cases = dict(list(cases.items())[:1])
    if not all(name.endswith("_dw") for name in table.signals):
        return dict.fromkeys(systems)
    return dict(common_rises(list(cases.values()), fault, systems, cache))


def common_rises(
    cases: Sequence[Case], fault: FaultTable, systems: Mapping[str, control.StateSpace], cache: Path
) -> dict[str, float]:
    """Return the largest mean response (pu) of controllers to the speeds of an uncontrolled fault.

    From 0.5 to 2 s after the fault, over all cases; every input is a machine's speed, rad/s.
    """
    largest = dict.fromkeys(systems, 0.0)
    for case in cases:
        time_s, speeds = uncontrolled_speeds(case, fault, cache)
        in_rad = {name: case.omega_b * values for name, values in speeds.items()}
        for name, K in systems.items():
            mean = float(np.abs(mean_outputs(K, time_s, in_rad, (), fault)).max(initial=0.0))
            largest[name] = max(mean, largest[name])
    return largest


def clearing_change(table: DesignTable, controller: ControllerOrBank, cache: Path) -> float | None:
    """Return the mean change of the clearing times relative to no control, cycles, with no signal lost.

    Over the points and faults of the acceptance at its first latency; ceilings and loads of the case.
    """
    requested = table.acceptance
    assert requested is not None
    changes: list[float] = []
    for point, case in requested.looked_at(family_cases(table)).items():
        pairs = [
            (alone, controlled[0])
            for alone, controlled in settings_of(requested, point, None, controller.inputs)
        ]
        with Trial(case, controller, requested, cache) as trial:
            cycles = trial.clearing_cycles([t for a, k in pairs for t in ((a, False), (k, True))])
        both = [(cycles[alone, False], cycles[controlled, True]) for alone, controlled in pairs]
        changes += [b - a for a, b in both if a is not None and b is not None]
    return float(np.mean(changes)) if changes else None


HEADER = ("signals", "stable", "inter-area", "worst swing", "effort", "common rise (pu)", "clearing (cycles)")


def table_rows(result: Mapping[str, Any]) -> Sequence[tuple[str, ...]]:
    """Return the rows of the table of a worth, as `SignalWorth.as_dict` gives it."""

    def number(value: float | None, digits: str) -> str:
        return "-" if value is None or not np.isfinite(value) else format(value, digits)

    rival = result["rival"]
    rows = [result["open_loop"], result["whole"], *result["masked"], *([] if rival is None else [rival])]
    return [
        (
            row["name"],
            "yes" if row["stable"] else "NO",
            number(row["inter_area"], ".3f"),
            number(row["worst_swing"], ".3f"),
            number(row["effort"], ".3f"),
            number(row["common_rise"], ".3f"),
            number(row["clearing_cycles"], "+.1f"),
        )
        for row in rows
    ]
