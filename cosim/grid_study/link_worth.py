"""Value of a remote signal in a grid: own signal, own area and other area, designed on equal terms.

Order, effort and conditions are the same; a signal of another machine is late, the own signal is not. Every
design with more signals also starts from the own-signal design, which replaces it if the search ends below:
an unused link does no harm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import control
import numpy as np

from interarea.design.certificates.large_loop import WELL_DAMPED
from interarea.design.controllers.controller import Controller
from interarea.design.delay.signal_conditions import Condition
from interarea.design.linear.linearise import select
from interarea.design.modes.loop_points import LoopSet
from interarea.design.robust.operating_points import FamilyCertificate, inter_area_band, judge_family
from interarea.design.robust.signal_worth import own_alone
from interarea.design.robust.smoothed_objective import BandOffsets
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash
from interarea.models.case.case import Case

from ..designs.design_tables import FaultPlace
from ..designs.family import FamilyPlant
from ..designs.fault_runs import FaultRun, FaultRuns, longest_stable
from ..designs.first_swing import FaultTable, after_clearing
from ..designs.short_designs import STATES, short_controller
from ..designs.worth import common_rises
from .proposal import LIMIT_PU
from .weak_modes import WeakModes

OWN, AREA, AFAR = SIGNALS = ("own machine", "own area", "other area")
LATENCIES_MS = (0, 100, 200, 300, 500)
CLEARED_MS = (0, 200)  #: latencies at which clearing times are searched
OWN_STARTS = 8  #: first guesses of the own-signal rival, which everything else is compared with
_LONGEST_CYCLES, _RESOLUTION_CYCLES, _FAULT_S, _STOP_S = 30.0, 0.15, 1.0, 8.0


@dataclass(frozen=True)
class LoopTerms:
    """Bounds of the loops. effort : largest output over signal, pu per rad/s; None: that of the grid's
    choices. near : signals besides the own machines' speeds that are neither late nor lost.
    """

    effort: float | None = None
    limit_pu: float = LIMIT_PU  #: of each output
    near: tuple[str, ...] = ()
    starts: int | None = (
        None  #: first guesses of a search; None: two, `OWN_STARTS` without a controller to start from
    )

    def guesses(self, own: Controller | None) -> int:
        """Return how many first guesses a search has that starts from `own` too."""
        return self.starts or (OWN_STARTS if own is None else 2)


LOOP_TERMS = LoopTerms()


@dataclass(frozen=True)
class LinkRow:
    """Results of a set of loops with some signals at one latency, the least over all operating points.

    there, late : least damping ratio of the inter-area modes, nothing late and other machines' signals late.
    lost : the least with one of those lost and the rest late; None where there is none. worst_swing : of all
    swings, nothing lost. common_rise_pu : mean answer to the common rise of speed after a fault; None: no
    fault with a trip. clearing_cycles : mean change against no control; None: not searched.
    """

    actuators: tuple[str, ...]
    signals: str  #: one of `SIGNALS`
    sees: Mapping[str, tuple[str, ...]]
    latency_ms: int
    there: float
    late: float
    lost: float | None
    lost_stable: bool
    worst_swing: float
    effort: float  #: pu per rad/s
    common_rise_pu: float | None = None
    clearing_cycles: float | None = None

    @property
    def least(self) -> float:
        """What its design holds up, the less of `there` and `late`; from `WELL_DAMPED` on no root is seen."""
        return min(self.there, self.late, WELL_DAMPED)


def signals_of_set(weak: WeakModes, chosen: LoopSet) -> tuple[dict[str, Any], dict[str, str]]:
    """Return each of `SIGNALS` -> actuator -> speeds that it sees; and those that cannot be, with the reason.

    Beside its own machine's speed an actuator sees one more: of the own area's machines that which swings
    most in the weakest mode, of the others' that which swings most against its own. A device at a bus has no
    machine: it sees the two that swing most against each other, both from afar. Machines at other actuators
    are passed over: their speeds are late to one and at once to another.
    """
    shape = weak.weakest.shape
    sees: dict[str, dict[str, tuple[str, ...]]] = {name: {} for name in SIGNALS}
    missing: dict[str, str] = {}
    at = {actuator.removesuffix("_vs") for actuator in chosen.actuators}
    free = [machine for machine in shape if machine not in at]
    for actuator in chosen.actuators:
        own = actuator.removesuffix("_vs")
        if own in shape:
            sees[OWN][actuator] = (f"{own}_dw",)
        else:
            reason = f"{actuator} is a device at a bus, without a signal of its own machine"
            missing |= {OWN: reason, AREA: reason}
            own = max(shape, key=lambda m: abs(shape[m]))
        for signals, machine in _partners(weak, own, free).items():
            if machine:
                sees[signals][actuator] = (f"{own}_dw", f"{machine}_dw")
            else:
                where = "of" if signals == AREA else "outside"
                missing.setdefault(
                    signals, f"no machine {where} the area of {own} that has no loop of the set"
                )
    return {name: seen for name, seen in sees.items() if name not in missing}, missing


def _partners(weak: WeakModes, own: str, free: Sequence[str]) -> dict[str, str]:
    """Return the machines of the own area and of another whose speed is added, empty if none is free."""
    shape, areas = weak.weakest.shape, weak.case.areas
    near = [m for m in free if m != own and areas[m] == areas[own]]
    far = [m for m in free if areas[m] != areas[own]]
    return {
        AREA: max(near, key=lambda m: abs(shape[m]), default=""),
        AFAR: min(far, key=lambda m: float((shape[m] * np.conj(shape[own])).real), default=""),
    }


class LinkDesigns:
    """Designs and judges the signals of one grid; every row is found again in the cache.

    points : operating points, the grid as it is first. offsets : what the search asks of damping, by
    frequency. faults : those after which the answer to the common rise and the clearing times are looked at.
    """

    def __init__(
        self,
        weak: WeakModes,
        points: Mapping[str, Case],
        offsets: BandOffsets,
        faults: Sequence[FaultPlace],
        cache: Path,
    ) -> None:
        self.weak, self.faults, self.cache = weak, tuple(faults), cache
        self.case: Case = weak.case
        self._offsets = offsets
        self._plants = {name: FamilyPlant.of(case, (), (), cache) for name, case in points.items()}
        self.plants = {point: plant.judged for point, plant in self._plants.items()}  #: full, to judge by
        self._of = (
            content_hash({n: c.hash for n, c in points.items()}, asdict(offsets)),
            code_hash(__name__),
        )

    def designed(
        self,
        sees: Mapping[str, tuple[str, ...]],
        latency_ms: int = 0,
        own: Controller | None = None,
        terms: LoopTerms = LOOP_TERMS,
    ) -> Controller:
        """Return a controller of loops that see so much (`signals_of_set`), searched from `own` too."""
        effort = self.weak.choices.effort if terms.effort is None else terms.effort
        known = None if own is None else own.as_dict()
        key = content_hash(*self._of, dict(sees), latency_ms, effort, known, asdict(terms))

        def compute() -> dict[str, Any]:
            return self._designed(sees, latency_ms, replace(terms, effort=effort), own).as_dict()

        return Controller.from_dict(cached_json(self.cache, "link-design", key, compute))

    def best_own(self, sees: Mapping[str, tuple[str, ...]], controllers: Sequence[Controller]) -> Controller:
        """Return the best controller of own signals alone: those of `controllers`, other signals masked."""
        signals = _speeds(sees)
        masked = [select(own_alone(one.system), signals) for one in controllers]
        return self.best(sees, 0, [Controller("link", K, LIMIT_PU) for K in masked])

    def best(
        self,
        sees: Mapping[str, tuple[str, ...]],
        latency_ms: int,
        controllers: Sequence[Controller],
        terms: LoopTerms = LOOP_TERMS,
    ) -> Controller:
        """Return the one that reaches most with these signals so late; where several do, the first."""
        conditions = _conditions(sees, latency_ms, terms.near)
        known = [one.as_dict() for one in controllers]
        key = content_hash(*self._of, dict(sees), latency_ms, list(terms.near), known)

        def compute() -> dict[str, int]:
            reached = [_reached(self._judge(one.system, conditions)) for one in controllers]
            return {"place": int(np.argmax(reached))}

        place = int(cached_json(self.cache, "link-best", key, compute)["place"])
        return controllers[place]

    def row(
        self,
        signals: str,
        sees: Mapping[str, tuple[str, ...]],
        latency_ms: int,
        controller: Controller,
        own: Controller | None = None,
        terms: LoopTerms = LOOP_TERMS,
    ) -> LinkRow:
        """Return what a controller reaches, or `own` where that is better with the other signals unused.

        signals : one of `SIGNALS`.
        """
        own_system = None if own is None else _seeing(own.system, _speeds(sees))
        faults = [fault.model_dump(mode="json") for fault in self.faults]
        known = None if own is None else own.as_dict()
        key = content_hash(
            *self._of, controller.as_dict(), known, dict(sees), latency_ms, faults, asdict(terms)
        )

        def compute() -> dict[str, Any]:
            candidates = [controller.system, *([] if own_system is None else [own_system])]
            conditions = _conditions(sees, latency_ms, terms.near)
            best = max(candidates, key=lambda K: _reached(self._judge(K, conditions)))
            row = self._judged_row(best, sees, latency_ms, terms.near)
            if self.faults and latency_ms in CLEARED_MS:
                taken = Controller("link", best, terms.limit_pu)
                late = dict.fromkeys(_from_others(sees, terms.near), 1e-3 * latency_ms)
                row["clearing_cycles"] = self._clearing_change(taken, late)
            return row

        row = cached_json(self.cache, "link-row", key, compute)
        return LinkRow(tuple(sees), signals, dict(sees), latency_ms, **row)

    def _designed(
        self, sees: Mapping[str, tuple[str, ...]], latency_ms: int, terms: LoopTerms, own: Controller | None
    ) -> Controller:
        """Return the best of the search, the own-signal controller and none at all.

        Without `own` it is the rival of all others, and its search has more first guesses.
        """
        actuators, signals = tuple(sees), _speeds(sees)
        plants = {
            point: replace(plant, signals=signals, actuators=actuators)
            for point, plant in self._plants.items()
        }
        conditions = _conditions(sees, latency_ms, terms.near)
        assert terms.effort is not None
        candidates, start = [_none(signals, actuators)], None
        if own is not None and own.system.nstates == STATES * len(sees):
            start = _seeing(own.system, signals)
            candidates.append(start)
        for offsets in (self._offsets, self._steady()):
            searched = short_controller(
                plants,
                dict(sees),
                conditions,
                offsets=offsets,
                effort=terms.effort,
                start=start,
                starts=terms.guesses(own),
            )
            if searched is not None and np.isfinite(_reached(self._judge(searched, conditions))):
                candidates.append(searched)
                break
        best = max(candidates, key=lambda K: _reached(self._judge(K, conditions)))
        return Controller("link", best, terms.limit_pu)

    def _steady(self) -> BandOffsets:
        """Return offsets that leave no slow root unstable where little inter-area damping is reached."""
        weakest = self.weak.weakest
        slower = abs(weakest.eigenvalue.imag)
        nodes = zip(self._offsets.omega, self._offsets.offset, strict=True)
        targets = tuple(max(value, -weakest.damping_ratio) if at < slower else value for at, value in nodes)
        return replace(self._offsets, offset=targets)

    def _judge(self, K: control.StateSpace, conditions: Sequence[Condition]) -> FamilyCertificate:
        bands = {point: inter_area_band(plant.modes) for point, plant in self._plants.items()}
        return judge_family(self.plants, K, conditions, bands_hz=bands)

    def from_others(self, sees: Mapping[str, tuple[str, ...]], terms: LoopTerms) -> tuple[str, ...]:
        """Return the signals of a set that come over a link."""
        return _from_others(sees, terms.near)

    def effort(self, K: control.StateSpace) -> float:
        """Return the largest gain of a loop from noise on its signals, nothing lost; inf: not stable."""
        judged = self._judge(K, [Condition("N")])
        return judged.effort if all(row.stable for row in judged.rows) else float("inf")

    def worst_lost(
        self,
        K: control.StateSpace,
        sees: Mapping[str, tuple[str, ...]],
        latency_ms: int,
        terms: LoopTerms,
    ) -> str | None:
        """Return the signal whose loss leaves least, the rest late; an unstable loop is the least."""
        losses = _losses(sees, latency_ms, terms.near)
        if not losses:
            return None
        rows = self._judge(K, losses).rows
        worst = min(rows, key=lambda row: (row.stable, row.inter_area))
        return next(one.lost[0] for one in losses if one.name == worst.condition)

    def _judged_row(
        self,
        K: control.StateSpace,
        sees: Mapping[str, tuple[str, ...]],
        latency_ms: int,
        near: tuple[str, ...],
    ) -> dict[str, Any]:
        """Return the numbers of a row, clearing time apart."""
        conditions, losses = _conditions(sees, latency_ms, near), _losses(sees, latency_ms, near)
        judged = self._judge(K, [*conditions, *losses])
        names = [condition.name for condition in conditions]
        least = {name: min(row.inter_area for row in judged.rows if row.condition == name) for name in names}
        steady = [row for row in judged.rows if row.condition in names]
        lost = [row for row in judged.rows if row.condition not in names]
        return {
            "there": least[names[0]],
            "late": least[names[-1]],
            "lost": min((row.inter_area for row in lost), default=None),
            "lost_stable": all(row.stable for row in lost),
            "worst_swing": min(row.worst_swing for row in steady),
            "effort": judged.effort,
            "common_rise_pu": self._common_rise(K, sees),
        }

    def _common_rise(self, K: control.StateSpace, sees: Mapping[str, tuple[str, ...]]) -> float | None:
        """Return the mean answer to the common rise after the first fault with a trip, of speeds alone."""
        tripped = next((fault for fault in self.faults if fault.trip), None)
        if tripped is None or not all(signal.endswith("_dw") for signal in _speeds(sees)):
            return None
        fault = FaultTable(bus=tripped.bus, branch=str(tripped.trip))
        return common_rises([self.case], fault, {"": K}, self.cache)[""]

    def _clearing_change(self, controller: Controller, late: Mapping[str, float]) -> float | None:
        """Return the mean change of the clearing times against no control, cycles; late : signal -> s."""
        if not controller.system.nstates:
            return 0.0
        without = self._clearing(None, {})
        controlled = self._clearing(controller, late)
        return float(np.mean([b - a for a, b in zip(without, controlled, strict=True)]))

    def _clearing(self, controller: Controller | None, latency_s_of: Mapping[str, float]) -> list[float]:
        """Return the clearing time of each fault, cycles; at most `_LONGEST_CYCLES`."""
        known = None if controller is None else controller.as_dict()
        faults = [fault.model_dump(mode="json") for fault in self.faults]
        key = content_hash(self.case.hash, known, dict(latency_s_of), faults, code_hash(__name__))

        def compute() -> list[float]:
            with FaultRuns(self.case, self.cache) as runs:

                def are_stable(cycles: Mapping[int, float]) -> dict[int, bool]:
                    candidates = [
                        self._run(self.faults[k], n, controller, latency_s_of) for k, n in cycles.items()
                    ]
                    return {
                        k: angle < np.pi
                        for k, angle in zip(cycles, runs.largest_angles(candidates), strict=True)
                    }

                places = range(len(self.faults))
                longest = longest_stable(places, are_stable, 1.0, _LONGEST_CYCLES, _RESOLUTION_CYCLES)
            return [longest[k] for k in places]

        return list(cached_json(self.cache, "link-clearing", key, compute))

    def _run(
        self,
        fault: FaultPlace,
        cycles: float,
        controller: Controller | None,
        latency_s_of: Mapping[str, float],
    ) -> FaultRun:
        clear_s = _FAULT_S + cycles / self.case.frequency_hz
        events = after_clearing(self.case, fault.bus, fault.trip, _FAULT_S, clear_s)
        return FaultRun(events, _STOP_S, controller, latency_s_of)


def _speeds(sees: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(signal for seen in sees.values() for signal in seen))


def _from_others(sees: Mapping[str, tuple[str, ...]], near: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the signals that come over a link: those of no machine that an actuator is at, `near` apart.

    >>> _from_others({"G2_vs": ("G2_dw", "G3_dw"), "G4_vs": ("G4_dw", "G1_dw")})
    ('G3_dw', 'G1_dw')
    """
    at = {*near, *(f"{actuator.removesuffix('_vs')}_dw" for actuator in sees)}
    return tuple(signal for signal in _speeds(sees) if signal not in at)


def _conditions(
    sees: Mapping[str, tuple[str, ...]], latency_ms: int, near: Sequence[str] = ()
) -> list[Condition]:
    """Return what a design holds: nothing late, and other machines' signals late."""
    late = dict.fromkeys(_from_others(sees, near), 1e-3 * latency_ms)
    now = Condition("N")
    return [now, Condition("late", (), late)] if late and latency_ms else [now]


def _losses(
    sees: Mapping[str, tuple[str, ...]], latency_ms: int, near: Sequence[str] = ()
) -> list[Condition]:
    """Return the loss of each signal of another machine, the rest late."""
    others = _from_others(sees, near)
    return [
        Condition(f"L:{lost}", (lost,), {s: 1e-3 * latency_ms for s in others if s != lost and latency_ms})
        for lost in others
    ]


def _reached(judged: FamilyCertificate) -> float:
    return judged.inter_area if all(row.stable for row in judged.rows) else -np.inf


def _none(signals: Sequence[str], actuators: Sequence[str]) -> control.StateSpace:
    nothing = np.zeros((len(actuators), len(signals)))
    return control.ss([], [], [], nothing, inputs=list(signals), outputs=list(actuators))


def _seeing(K: control.StateSpace, signals: Sequence[str]) -> control.StateSpace:
    """Return `K` with more inputs, which it does not use."""
    place = [list(signals).index(name) for name in K.input_labels]
    B, D = np.zeros((K.nstates, len(signals))), np.zeros((K.noutputs, len(signals)))
    B[:, place], D[:, place] = np.asarray(K.B), np.asarray(K.D)
    return control.ss(K.A, B, K.C, D, inputs=list(signals), outputs=list(K.output_labels))
