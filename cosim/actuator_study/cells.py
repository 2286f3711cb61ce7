"""What an actuator reaches with its own signal, and with remote ones at a latency: a controller, judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import control

from interarea.design.certificates.signal_margins import ALL, signal_margins
from interarea.design.controllers.controller import Controller
from interarea.design.delay.signal_conditions import Condition
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash
from interarea.models.case.case import Case

from ..designs.design_tables import FaultPlace
from ..designs.fault_loops import FaultLoops
from ..designs.fault_runs import FaultRun, FaultRuns
from ..designs.first_swing import after_clearing
from ..grid_study.link_worth import AFAR, OWN, LinkDesigns, LoopTerms
from .installed import Installed

REMOTE = "remote"
LATENCIES_MS = (0, 300, 100, 200, 50, 150, 250)  #: of remote signals, in the order in which there is time
CLEAR_MS = (200, 400, 600)  #: how long the faults at each place last
#: first guesses of a search: own signals, which are compared with; remote ones; and remote ones that start
#: from the controller of another latency too
OWN_STARTS, STARTS, WARM_STARTS = 8, 2, 1
_FAULT_S, _LOST_S, _STOP_S = 1.0, 1.5, 15.0
_NONE = Controller("none", control.ss([], [], [], []))  #: the loop without control


@dataclass(frozen=True)
class Cell:
    """An actuator, signals and a latency, the least of all operating points.

    there, late, lost, worst_swing, clearing_cycles : as of `LinkRow`. worst_lost : the signal whose loss
    leaves least. effort_share : of the largest gain that it may have. delay_margin_ms : of its signals
    together, own wired ones apart; None: none up to 10 s. survived : of so many `faults` those after which
    the grid keeps synchronism and the swing dies out; survived_lost : with the signal lost that leaves
    fewest.
    """

    kind: str
    actuator: str
    signals: str  #: "own" or "remote"
    sees: tuple[str, ...]
    latency_ms: int
    there: float
    late: float
    lost: float | None
    lost_stable: bool
    worst_lost: str | None
    worst_swing: float
    effort: float
    effort_share: float
    delay_margin_ms: float | None
    faults: int
    survived: int
    survived_lost: int | None
    clearing_cycles: float | None
    controller: Mapping[str, Any]

    @property
    def least(self) -> float:
        """What its design holds up."""
        return min(self.there, self.late)


class ActuatorCells:
    """Designs and judges the cells of one grid; each is found again in the cache.

    places : of faults, those of `designs` and the same without a trip. family : place and how long, ms.
    """

    def __init__(self, designs: LinkDesigns, cache: Path) -> None:
        self.designs, self.cache = designs, cache
        self.case: Case = designs.case
        tripped = designs.faults
        cleared = (FaultPlace(bus=fault.bus) for fault in tripped if fault.trip)
        self.places: tuple[FaultPlace, ...] = (*tripped, *cleared)
        self.family = tuple((fault, ms) for fault in self.places for ms in CLEAR_MS)

    def without_control(self) -> int:
        """Return how many faults of the family the grid survives by itself."""
        return self._survived(None, {}, ("",))[0]

    def cell(self, one: Installed, signals: str, latency_ms: int, near_to: Cell | None = None) -> Cell:
        """Return one cell. near_to : of the same actuator and signals, where the search starts from too."""
        sees = {one.actuator: one.sees[signals]}
        first = OWN_STARTS if signals == "own" else STARTS
        terms = one.terms(signals, first if near_to is None else WARM_STARTS)
        start = None if near_to is None else Controller.from_dict(near_to.controller)
        K = self._within(self.designs.designed(sees, latency_ms, start, terms), terms.effort)
        return self._judged(one, signals, latency_ms, K, terms)

    def own_again(self, one: Installed, own: Cell, remote: Sequence[Cell]) -> Cell:
        """Return the own-signal cell of the best controller: that of `own`, or a remote one's part of it."""
        signals = one.sees["own"]
        if not remote or not set(signals) <= set(one.sees[REMOTE]):
            return own
        candidates = [Controller.from_dict(cell.controller) for cell in (own, *remote)]
        best = self.designs.best_own({one.actuator: signals}, candidates)
        terms = one.terms("own", OWN_STARTS)
        K = self._within(replace(best, limit_pu=one.full), terms.effort)
        again = self._judged(one, "own", 0, K, terms)
        return again if again.least > own.least else own

    def remote_again(self, one: Installed, cell: Cell, others: Sequence[Cell]) -> Cell:
        """Return a remote cell of the best controller: its own, or one designed for another latency."""
        sees, terms = {one.actuator: one.sees[REMOTE]}, one.terms(REMOTE, STARTS)
        candidates = [Controller.from_dict(each.controller) for each in (cell, *others)]
        best = self.designs.best(sees, cell.latency_ms, candidates, terms)
        return cell if best is candidates[0] else self._judged(one, REMOTE, cell.latency_ms, best, terms)

    def _judged(self, one: Installed, signals: str, latency_ms: int, K: Controller, terms: LoopTerms) -> Cell:
        sees = {one.actuator: one.sees[signals]}
        row = self.designs.row(OWN if signals == "own" else AFAR, sees, latency_ms, K, None, terms)
        remote = self.designs.from_others(sees, terms)
        late = dict.fromkeys(remote, 1e-3 * latency_ms)
        survived = self._survived(K, late, ("", *remote))
        worst = self.designs.worst_lost(K.system, sees, latency_ms, terms)
        known = asdict(row)
        return Cell(
            one.kind,
            one.actuator,
            signals,
            one.sees[signals],
            latency_ms,
            **{k: known[k] for k in ("there", "late", "lost", "lost_stable", "worst_swing", "effort")},
            worst_lost=worst,
            effort_share=row.effort / (terms.effort or 1.0),
            delay_margin_ms=self._delay_margin(K, remote or one.sees[signals]),
            faults=len(self.family),
            survived=survived[0],
            survived_lost=min(survived[1:], default=None),
            clearing_cycles=row.clearing_cycles,
            controller=K.as_dict(),
        )

    def _within(self, controller: Controller, cap: float | None) -> Controller:
        """Return a controller with less gain where the search left its effort above the cap."""
        K, low, high = controller.system, 0.0, 1.0
        if cap is None or not K.nstates or self.designs.effort(K) <= cap:
            return controller
        while high - low > 1e-3:
            middle = 0.5 * (low + high)
            within = self.designs.effort(controller.scaled(middle).system) <= cap
            low, high = (middle, high) if within else (low, middle)
        return controller.scaled(low)

    def _delay_margin(self, controller: Controller, signals: Sequence[str]) -> float | None:
        """Return the least latency (ms) of these signals together that is unstable at any operating point."""
        if not controller.system.nstates:
            return None
        margins = {m.signal: m.delay for m in signal_margins(self.designs.plants, controller.system)}
        contact = margins[ALL if len(signals) > 1 else signals[0]]
        return None if contact is None else 1e3 * contact.value

    def _survived(
        self, controller: Controller | None, late: Mapping[str, float], losses: Sequence[str]
    ) -> list[int]:
        """Return for each lost signal ("": none) how many faults of the family are survived.

        A run is as long as its linear loop asks for (`FaultRuns.outcomes_to_end`).
        """
        if controller is not None and not controller.system.nstates:
            controller, late = None, {}
        losses = losses if controller is not None else losses[:1]
        known = None if controller is None else controller.as_dict()
        family = [(fault.model_dump(mode="json"), ms) for fault, ms in self.family]
        key = content_hash(
            self.case.hash, known, dict(late), list(losses), family, _STOP_S, code_hash(__name__)
        )

        def compute() -> list[int]:
            runs = [
                self._run(fault, ms, controller, late, lost) for lost in losses for fault, ms in self.family
            ]
            loops = FaultLoops(self.case, controller or _NONE, self.cache)
            ends = [
                loops.end(fault.trip, Condition("late", (lost,) if lost else (), late))
                for lost in losses
                for fault, _ in self.family
            ]
            with FaultRuns(self.case, self.cache) as there:
                outcomes, _ = there.outcomes_to_end(runs, ends, _LOST_S)
            each = len(self.family)
            return [
                sum(o.synchronous and o.stable for o in outcomes[k * each : (k + 1) * each])
                for k in range(len(losses))
            ]

        return [int(n) for n in cached_json(self.cache, "actuator-faults", key, compute)]

    def _run(
        self,
        fault: FaultPlace,
        clear_ms: int,
        controller: Controller | None,
        late: Mapping[str, float],
        lost: str,
    ) -> FaultRun:
        clear_s = _FAULT_S + 1e-3 * clear_ms
        events = after_clearing(self.case, fault.bus, fault.trip, _FAULT_S, clear_s)
        return FaultRun(events, _STOP_S, controller, dict(late), {lost: _LOST_S} if lost else {})


def started_from(cells: Sequence[Cell], kind: str, latency_ms: int) -> Cell | None:
    """Return the cell of remote signals with the nearest latency, None where there is none."""
    those = [c for c in cells if c.kind == kind and c.signals == REMOTE]
    return min(those, key=lambda c: abs(c.latency_ms - latency_ms), default=None)


def without_matrices(cell: Cell) -> dict[str, Any]:
    """Return a cell as JSON values, its controller apart."""
    return {k: v for k, v in asdict(replace(cell, controller={})).items() if k != "controller"}
