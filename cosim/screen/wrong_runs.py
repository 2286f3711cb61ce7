"""Runs with one measured signal wrong but flagged as valid: kinds and disturbances."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.design.robust.signal_worth import own_signals
from interarea.models.case.case import Case
from interarea.models.detector_defaults import INTERVAL_S

from ..designs.design_file import DesignTable
from ..designs.design_tables import FaultPlace
from ..designs.fault_runs import FaultRuns, Outcome
from ..errors import ScenarioError
from ..results.verdict import LOST, SETTLED, STABLE
from ..scenario.signal_faults import SWAP
from ..trajectory import Trajectory

Judged: TypeAlias = Controller | ControllerBank
START_S, WRONG_S, STOP_S = 1.0, 1.5, 20.0  #: disturbance; the signal is wrong from then on; end of the run
LONG_S = 60.0  #: end of a run that has not settled by `STOP_S`, and of those without control
LONGEST_S = 120.0  #: the same where a signal was isolated: frequency and washouts settle slowly
REMOTE_S, WITNESS_S = 0.1, 0.05  #: latency; a signal of an actuator's own machine comes at once
REST, PULSE, FAULT, TRIP = DISTURBANCES = ("rest", "pulse", "bus fault", "tie trip")
LEAST_SIGNALS = 4  #: that are compared: with the wrong one left out three agree


@dataclass(frozen=True)
class WrongRun:
    """One run. latency_s_of : signal -> latency, s, those of the controller and witnesses.

    wrong : signal and its table of `signal_faults` without start (of a swap `other` is a name); None: all
        are right. detector : table of a scenario; None: none.

    All signals of a run with swapped signals pass through one concentrator, because a channel has only one
    signal.
    """

    case: str
    controller: Judged | None
    latency_s_of: Mapping[str, float]
    events: Sequence[Mapping[str, Any]]
    wrong: tuple[str, Mapping[str, Any]] | None = None
    detector: Mapping[str, Any] | None = None
    stop_s: float = STOP_S
    interval_s: float = INTERVAL_S

    def document(self) -> dict[str, Any]:
        """Return the run as a scenario, without case and controller, which are passed as objects."""
        document: dict[str, Any] = {"case": self.case, "stop_s": self.stop_s, "event": list(self.events)}
        if self.controller is None:
            return document
        tables = {s: self._signal_table(s, t) for s, t in self.latency_s_of.items()}
        if self.wrong is not None and self.wrong[1]["kind"] == SWAP:
            signals = list(tables.values())
            wait_s = max(self.latency_s_of.values())
            line = {"signals": signals, "reporting_interval_s": self.interval_s, "wait_s": wait_s}
            document["concentrators"] = {"pdc": line}
        else:
            document["channels"] = {
                f"from_{s}": {**table, "reporting_interval_s": self.interval_s} for s, table in tables.items()
            }
        return document if self.detector is None else {**document, "detector": dict(self.detector)}

    def _signal_table(self, signal: str, latency_s: float) -> dict[str, Any]:
        table: dict[str, Any] = {"signal": signal, "latency_s": latency_s}
        if self.wrong is not None and self.wrong[0] == signal:
            fault = {**self.wrong[1], "start_s": WRONG_S}
            if fault["kind"] == SWAP:
                fault["other"] = 1 + list(self.latency_s_of).index(fault["other"])
            table["signal_faults"] = [fault]
        return table


@dataclass(frozen=True)
class Signals:
    """Speeds that a controller uses and a detector can compare, and witnesses.

    latency_s_of : speed among the controller's inputs -> latency, s. witnesses : speeds that it does not use.
    """

    latency_s_of: Mapping[str, float]
    witnesses: Mapping[str, float] = field(default_factory=dict)

    @property
    def all(self) -> dict[str, float]:
        """Both."""
        return {**self.latency_s_of, **self.witnesses}


def signals_of(case: Case, controller: Judged, compared: Sequence[str] = ()) -> Signals:
    """Return the speeds that a controller uses, and witnesses: the largest machines of each area in turn.

    compared : signals of the detector's design; the witnesses are those that the controller does not use.

    Raises
    ------
    ScenarioError : a controller that uses no speed; a detector that does not compare one of its speeds.
    """
    speeds = [f"{m.name}_dw" for m in case.machines]
    own = {s for names in own_signals(controller.outputs, controller.inputs).values() for s in names}
    latency_s_of = {s: 0.0 if s in own else REMOTE_S for s in controller.inputs if s in speeds}
    if not latency_s_of:
        raise ScenarioError(
            f"{controller.name}: its inputs are {', '.join(controller.inputs)}, allowed: a controller with "
            f"the speed of a machine of {case.name} among its signals"
        )
    if compared:
        return Signals(latency_s_of, _witnesses(controller.name, latency_s_of, compared))
    others = _by_area(case, [s for s in speeds if s not in latency_s_of])
    return Signals(
        latency_s_of, dict.fromkeys(others[: max(0, LEAST_SIGNALS - len(latency_s_of))], WITNESS_S)
    )


def _witnesses(name: str, latency_s_of: Mapping[str, float], compared: Sequence[str]) -> dict[str, float]:
    """Return what a detector compares besides `latency_s_of`."""
    missing = [s for s in latency_s_of if s not in compared]
    if missing:
        raise ScenarioError(
            f"{name}: the detector has {', '.join(compared)} but not {', '.join(missing)}, allowed: one "
            "designed for all speeds of the controller"
        )
    return {s: WITNESS_S for s in compared if s not in latency_s_of}


def _by_area(case: Case, signals: Sequence[str]) -> list[str]:
    """Return speeds, those of the largest machine of each area first, then of the next."""
    area_of = {bus.number: bus.area for bus in case.buses}
    ranked: dict[object, list[str]] = {}
    for m in sorted(case.machines, key=lambda m: -m.base_mva):
        if f"{m.name}_dw" in signals:
            ranked.setdefault(area_of[m.bus], []).append(f"{m.name}_dw")
    return [s for k in range(len(signals)) for names in ranked.values() for s in names[k : k + 1]]


def disturbances_of(case: Case, place: FaultPlace) -> dict[str, list[dict[str, Any]]]:
    """Return name -> events: nothing; a pulse; a fault of 8 cycles; a trip.

    The pulse acts on the voltage of the largest regulating machine, or on power if none regulates.
    """
    regulating = [m for m in case.machines if m.exciter.kind != "constant"]
    largest = max(regulating or case.machines, key=lambda m: m.base_mva).name
    end_s = round(START_S + 8.0 / case.frequency_hz, 9)
    kind = "vref_pulse" if regulating else "pm_pulse"
    pulse = {"kind": kind, "machine": largest, "size_pu": 0.05, "start_s": START_S, "end_s": 1.3}
    fault = {"kind": "bus_fault", "bus": place.bus, "start_s": START_S, "end_s": end_s}
    disturbances: dict[str, list[dict[str, Any]]] = {REST: [], PULSE: [pulse], FAULT: [fault]}
    if place.trip is not None:
        disturbances[TRIP] = [{"kind": "branch_trip", "branch": place.trip, "start_s": START_S}]
    return disturbances


def fault_place(table: DesignTable) -> FaultPlace:
    """Return the place of a design's faults: the first of its acceptance with a trip, else its own.

    Raises
    ------
    ScenarioError : a design without any fault.
    """
    places = () if table.acceptance is None else table.acceptance.fault
    for place in (*(p for p in places if p.trip is not None), *places):
        return place
    if table.fault is None:
        raise ScenarioError(
            f"--wrong-signals: the design {table.name} has no fault, allowed: one with [fault] or "
            "[acceptance], given by --spec"
        )
    return FaultPlace(bus=table.fault.bus, trip=table.fault.branch)


def to_the_end(
    runs: FaultRuns, part: Sequence[WrongRun]
) -> Iterator[tuple[int, WrongRun, Outcome, Trajectory]]:
    """Yield place, run, verdict and results; a run that has not settled by `STOP_S` is run to `LONG_S`.

    One that does not decay there, and of which a signal was isolated, is run to `LONGEST_S`: what is judged
    is the loop without the signal.
    """
    again: dict[int, WrongRun] = {}
    for k, (outcome, data) in enumerate(runs.judged(part, [None] * len(part))):
        if outcome.verdict is None or outcome.verdict.name in (SETTLED, LOST):
            yield k, part[k], outcome, data
        else:
            again[k] = replace(part[k], stop_s=LONG_S)
    late: dict[int, WrongRun] = {}
    longer = runs.judged(list(again.values()), [None] * len(again))
    for (k, run), (outcome, data) in zip(again.items(), longer, strict=True):
        swings = outcome.verdict is not None and outcome.verdict.name not in (*STABLE, LOST)
        if swings and _isolates(run, data):
            late[k] = replace(run, stop_s=LONGEST_S)
        else:
            yield k, run, outcome, data
    longest = runs.judged(list(late.values()), [None] * len(late))
    for (k, run), (outcome, data) in zip(late.items(), longest, strict=True):
        yield k, run, outcome, data


def _isolates(run: WrongRun, data: Trajectory) -> bool:
    """Whether a signal was isolated, or all of them were withheld, at any time."""
    signals = () if run.detector is None else run.latency_s_of
    return any((data[f"detector.{s}_reason"] > 0).any() for s in signals)
