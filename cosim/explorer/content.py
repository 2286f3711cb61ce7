"""What a page knows about its grid, as JSON values: names, places, controllers, events, how it starts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from interarea.design.controllers.controller import Controller
from interarea.design.linear.linearise import LinearisationError
from interarea.models.blocks.channel import SIGNAL_FAULT
from interarea.models.blocks.plant import event_parameters, shortest_time_s
from interarea.models.blocks.plant_variables import EVENT_CODES
from interarea.models.case.case import Case
from interarea.models.case.events import event_of, slot_count
from interarea.models.errors import CaseError
from interarea.models.grid.network import load_power

from ..results.largest_deviation import parts_of, with_angles
from ..run.swing_signal import swing_of
from ..scenario.channels import BernoulliLoss, GilbertElliottLoss
from ..scenario.scenario import Scenario
from ..scenario.signal_faults import SWAP, SignalFault, wrong_kinds
from .layout import bus_positions
from .linear import modal
from .models import SLOTS, step_s
from .subject import Subject

Array = np.ndarray[Any, Any]

VERSION = 1  #: of the address that a page understands
#: Longest steps while a slider moves: over the fastest pole, of the classical method (stable up to 2.78) and
#: of `web/drawn_step.h` (up to 12); s.
_COARSE, _DRAWN, _COARSEST_S = 2.55, 11.5, 0.02
PULSES = {"vref_pulse", "pm_pulse"}
#: what an address may set beside the start value, in the units of the labels; of a channel by the key's end
RANGES: dict[str, tuple[float, float]] = {
    "g": (0.0, 3.0),
    "l": (0.01, 0.3),
    "sz": (-30.0, 30.0),
    "tc": (10.0, 600.0),
    "latency": (0.0, 1000.0),
    "loss": (0.0, 90.0),
    "burst": (1.0, 20.0),
    "jitter": (0.0, 200.0),
    "interval": (0.0, 200.0),
    "hold": (0.0, 2000.0),
}
#: kinds of a wrong signal that a page leaves out: one needs a concentrator, one a whole number of packets
_LEFT_OUT = (SWAP, "replay")
_SIZES = {"size", "rate_per_s", "rms", "amplitude"}  #: keys of a kind in the unit of the signal


def content_of(subject: Subject) -> dict[str, Any]:
    """Return all that a page shows and moves, besides the records and their references.

    Raises
    ------
    ScenarioError : more events than a page can set.
    """
    scenario, case = subject.scenario, subject.case
    poles = np.linalg.eigvals(subject.linear(subject.points[0]).A)
    wrong = _wrong(case, poles)
    names = with_angles(case)
    return {
        "version": VERSION,
        "name": scenario.name,
        "title": scenario.title,
        "case": {
            "name": case.name,
            "title": case.title,
            "reference": scenario.case,
            "frequency": case.frequency_hz,
            "base": case.base_mva,
        },
        "stop": scenario.stop_s,
        "step": step_s(scenario),
        "solver": _solver(subject, poles),
        "machines": [{"name": m.name, "area": m.area, "bus": m.bus} for m in case.machines],
        "islands": [[names[k] for k in rows] for rows in parts_of(case, names)],
        "buses": _buses(case),
        "branches": [
            {"name": b.name, "ends": [b.from_bus, b.to_bus], "kind": b.kind, "closed": b.in_service}
            for b in case.branches
        ],
        "tie": None if case.tie is None else {"branches": list(case.tie.branches)},
        "swing": _swing(subject),
        "channels": [
            {"name": name, "signal": signal, "table": dict(table), "kinds": _kinds(signal, table, wrong)}
            for name, (signal, table) in subject.channels.items()
        ],
        "wrong": wrong,
        "controllers": [_controller(subject, name) for name in subject.controllers],
        "points": [_point(subject, k) for k in range(len(subject.points))],
        "events": _events(subject),
        "ceilings": _ceilings(subject),
        "plant": dict(scenario.plant),
        "start": state_of(subject),
        "ranges": {**RANGES, **dict.fromkeys(("lost", "back", "since"), (0.0, scenario.stop_s))},
    }


def _wrong(case: Case, poles: Array) -> dict[str, dict[str, Any]]:
    """What can be wrong with a speed: table of `signal_faults` (kind, size, detail), code in the FMU."""
    swings = [s for s in poles if 0.1 <= s.imag / (2.0 * np.pi) <= 2.5]
    weakest_hz = max(swings, key=lambda s: s.real / abs(s)).imag / (2.0 * np.pi) if swings else 0.5
    codes = {kind: number for kind, number, _ in SIGNAL_FAULT.items}
    kinds: dict[str, dict[str, Any]] = {}
    for words, table in wrong_kinds(case.frequency_hz, weakest_hz).items():
        if table["kind"] not in _LEFT_OUT:
            fault: Any = TypeAdapter(SignalFault).validate_python({**table, "start_s": 0.0})
            kinds[words] = {"table": table, "code": codes[fault.kind], "packets": fault.packets}
    return kinds


def _kinds(signal: str, table: Mapping[str, Any], wrong: Mapping[str, Any]) -> list[str]:
    """What a page can make wrong with a signal; first what the scenario has."""
    faults = table.get("signal_faults", ())
    if len(faults) > 1:  # the page sets one
        return ["given"]
    fits = [words for words, w in wrong.items() if signal.endswith("_dw") or _SIZES.isdisjoint(w["table"])]
    return [*(["given"] if faults else []), "none", *fits]


def _solver(subject: Subject, poles: Array) -> dict[str, float]:
    """Longest steps, s: of an exact run; while a slider moves where limiters switch (fast) and elsewhere."""
    exact = subject.case.solver_step_s or max(min(0.001, shortest_time_s(subject.point)), 1e-6)
    fastest = float(np.max(np.abs(poles), initial=1e-3))
    fast, drawn = (max(exact, min(reach / fastest, _COARSEST_S)) for reach in (_COARSE, _DRAWN))
    return {"exact": exact, "fast": fast, "drawn": drawn}


def _buses(case: Case) -> list[dict[str, Any]]:
    places = bus_positions(case)
    loaded = {row.bus for row in case.loads}
    return [
        {
            "number": bus.number,
            "area": bus.area,
            "x": round(places[bus.number][0], 4),
            "y": round(places[bus.number][1], 4),
            "load": bus.number in loaded,
        }
        for bus in case.buses
    ]


def _swing(subject: Subject) -> dict[str, Any]:
    """The speed difference that a run is judged by, as `interarea run` has it."""
    swing = swing_of(subject.case, subject.cache, subject.scenario.swing)
    if not swing.behind:
        return {"label": f"Speed of {swing.ahead}", "weights": {swing.ahead: 1.0}}
    return {
        "label": f"Speed of {swing.ahead} less {swing.behind}",
        "weights": {swing.ahead: 1.0, swing.behind: -1.0},
    }


def _controller(subject: Subject, name: str) -> dict[str, Any]:
    controller = subject.controllers[name]
    values: dict[str, Any] = {
        "key": name,
        "name": controller.name,
        "inputs": list(controller.inputs),
        "outputs": list(controller.outputs),
        "limit": controller.limit_pu,
    }
    if not isinstance(controller, Controller):
        return values | {"bank": [member.name for member in controller.members], "modal": None}
    K = controller.system
    # as Controller.block: speeds in pu at the FMU, rad/s in the design
    scale = [subject.case.omega_b if u.endswith("_dw") else 1.0 for u in controller.inputs]
    return values | {
        "order": controller.order,
        "C": K.C.tolist(),
        "D": K.D.tolist(),
        "scale": scale,
        "modal": _or_why(lambda: modal(K, controller.inputs, controller.outputs)),
    }


def _point(subject: Subject, number: int) -> dict[str, Any]:
    point = subject.points[number]
    actuators = sorted({u for controller in subject.controllers.values() for u in controller.outputs})
    signals = sorted({s for s, _ in subject.channels.values()})
    speeds = [f"{m.name}_dw" for m in point.case.machines]
    outputs = list(dict.fromkeys([*speeds, *signals]))
    loads = {row.name: load_power(point.case, row) for row in point.case.loads}
    return {
        "label": point.label,
        "changes": dict(point.changes),
        "loads": {name: [z.real, z.imag] for name, z in loads.items()},
        "outputs": outputs,
        "actuators": actuators,
        "modal": _or_why(lambda: modal(subject.linear(point), actuators, outputs)),
    }


def _or_why(make: Any) -> dict[str, Any]:
    """The modal form, or why there is none: a page without eigenvalues is still a page."""
    try:
        values: dict[str, Any] = make()
    except LinearisationError as error:
        return {"why": str(error)}
    return values


def _events(subject: Subject) -> dict[str, Any]:
    """For every kind of event of the page: where it can happen, and the number of that place in the plant."""
    case = subject.case
    if case.events:
        from ..errors import ScenarioError

        raise ScenarioError(f"{case.name}: the case has events, such as relays; allowed on a page: none")

    def targets(tables: list[dict[str, Any]]) -> list[dict[str, Any]]:
        places = []
        for table in tables:
            key = next(k for k in ("machine", "bus", "branch", "load") if k in table)
            try:
                values = event_parameters(case, [event_of(table, where="event")])
            except CaseError:
                continue  # such as a load step where no load is
            places.append({"name": table[key], "target": values["event[1].target"]})
        return places

    span = {"start_s": 1.0, "end_s": 1.2}
    return {
        "codes": EVENT_CODES,
        "nudge": targets(
            [{"kind": "vref_pulse", "machine": m.name, "size_pu": 0.1, **span} for m in case.machines]
        ),
        "power": targets(
            [{"kind": "pm_pulse", "machine": m.name, "size_pu": 0.1, **span} for m in case.machines]
        ),
        "fault": targets([{"kind": "bus_fault", "bus": b.number, **span} for b in case.buses]),
        "trip": targets(
            [{"kind": "branch_trip", "branch": b.name, "start_s": 1.0} for b in case.branches if b.in_service]
        ),
        "load": targets(
            [{"kind": "load_step", "load": q.name, "size_pu": 0.1, "start_s": 1.0} for q in case.loads]
        ),
        "given": _preset_events(subject),
    }


def _preset_events(subject: Subject) -> dict[str, Any]:
    """The scenario's own events: as parameters of the plant, and as tables for the saved scenario."""
    from ..errors import ScenarioError

    events = subject.scenario.event
    if slot_count(events) > SLOTS:
        raise ScenarioError(
            f"{subject.scenario.name}: {len(events)} events, allowed on a page: {SLOTS}; remove some"
        )
    return {
        "parameters": {f"plant.{k}": v for k, v in event_parameters(subject.case, events).items()},
        "tables": [e.model_dump(exclude_none=True) for e in events],
    }


def _ceilings(subject: Subject) -> dict[str, Any] | None:
    """The exciters that have no limits and could have: names of their parameters, and the least that leaves
    the operating point alone."""
    machines = [m for m in subject.case.machines if m.exciter.kind in ("static", "static_tgr")]
    free = [m.name for m in machines if getattr(m.exciter, "Efd_max", None) is None]
    if not free or len(free) != len(machines) or any("Efd_" in name for name in subject.scenario.plant):
        return None
    voltages = [s.start for s in subject.point.states if s.name.endswith(".Efd")]
    return {"machines": free, "least": float(np.ceil(max(voltages, default=3.0) + 1.0))}


def state_of(subject: Subject) -> dict[str, Any]:
    """Return the state of the page that is the scenario: in the units of its labels; what it lacks is nothing
    special."""
    scenario = subject.scenario
    state: dict[str, Any] = {"k": scenario.controller, "g": scenario.controller_gain, **_event_state(subject)}
    if scenario.controller_limit_pu is not None:
        state["l"] = scenario.controller_limit_pu
    for k, (name, channel) in enumerate(scenario.channels.items()):
        values = {
            "latency": _ms(channel.latency_s),
            "jitter": _ms(channel.jitter_s),
            "interval": _ms(channel.reporting_interval_s),
            "seed": k if channel.seed is None else channel.seed,  # nothing is random yet
            "on_loss": channel.on_loss,
            "hold": _ms(channel.hold_s),
        }
        if channel.outages_s:
            values["lost"], values["back"] = channel.outages_s[0]
        if isinstance(channel.loss, BernoulliLoss):
            values["loss"] = _percent(channel.loss.rate)
        elif isinstance(channel.loss, GilbertElliottLoss):
            chances = channel.loss.good_to_bad, channel.loss.bad_to_good
            bad = chances[0] / sum(chances)
            values["loss"] = _percent(bad * channel.loss.loss_bad + (1.0 - bad) * channel.loss.loss_good)
            values["burst"] = 1.0 / channel.loss.bad_to_good
        state |= {f"{name}.{key}": value for key, value in values.items()}
    return state


def _ms(seconds: float) -> float:
    return float(f"{1000.0 * seconds:.12g}")


def _percent(share: float) -> float:
    return float(f"{100.0 * share:.12g}")


def _event_state(subject: Subject) -> dict[str, Any]:
    """The scenario's events as the page's own kinds where they are one of these, else as given."""
    scenario: Scenario = subject.scenario
    events = list(scenario.event)
    if not events:
        return {"ev": "nothing"}
    first = events[0]
    state: dict[str, Any] = {"at": first.start_s}
    if len(events) == 1 and first.kind in PULSES:
        kind = "nudge" if first.kind == "vref_pulse" else "power"
        return state | {"ev": kind, kind: first.machine, "sz": _percent(first.size_pu), "end": first.end_s}
    return state | {"ev": "given"}
