r"""Stabilizers at single machines, tuned by residue phase: the reference without any remote signal.

A small gain K from a machine's own speed to its exciter moves a mode by :math:`R K(\lambda)`, R the residue.
The structure is that of the stabilizer `speed` of a case file, a washout and equal lead-lags
[Kundur1994, sec. 12.5]; its phase at the mode makes the product real and negative.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import asdict, dataclass, replace
from math import ceil
from pathlib import Path
from typing import Any

import control
import numpy as np

from interarea.design.controllers.controller import Controller
from interarea.design.delay.signal_conditions import Condition
from interarea.design.modes.modes import Mode
from interarea.design.robust.operating_points import family_row, inter_area_band
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash
from interarea.models.errors import InterareaError

from ..designs.design_file import DesignTable, certify, design_of, judged_by
from ..designs.family import FamilyPlant, at_point
from .choices import WEAK
from .clock import Clock
from .faults import TIME_OVER, falls_short, judged_with_faults
from .weak_modes import WeakModes

MOST = 6  #: machines that get one
#: machines that a target gets in its first turn, both tried: with one, its loss leaves the mode as it was
FOR_TARGET = (1, 2)
#: operating points of a design at which gains are chosen: the grid as it is and its worst outage
JUDGED_POINTS = 2
#: s; without governors a grid's speed goes on rising after a fault, which behind 10 s holds an output at its
#: limit (New England); its phase at the mode is made up for by the lead-lags
WASHOUT_S = 3.0
#: degrees that one lead-lag makes up at most, and that a machine may need in all
STAGE_DEG, MOST_DEG = 55.0, 150.0
MOST_GAIN = 50.0  #: pu per pu of speed: what field stabilizers are set to at most [Kundur1994, sec. 12.5]
#: damping ratio that each is to add to its mode to first order, tried for all together
ADDED = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3)
FACTORS = (0.5, 2.0, 0.7, 1.4)  #: on the gain of one of them at a time, after that
STAGE = "local stabilizers"  #: of `clock.ENDS`
_UNSTABLE = (-np.inf, -np.inf)


@dataclass(frozen=True)
class Stabilizer:
    """A stabilizer of the kind `speed`: K s Tw/(1 + s Tw) ((1 + s T1)/(1 + s T2))^stages."""

    machine: str
    mode: str  #: which it is tuned for
    K: float  #: pu per pu of speed
    T1: float  #: s
    T2: float  #: s
    stages: int

    def response(self, s: complex) -> complex:
        """Return the gain at a complex frequency, pu per pu."""
        lead = (1.0 + s * self.T1) / (1.0 + s * self.T2)
        return complex(self.K * s * WASHOUT_S / (1.0 + s * WASHOUT_S) * lead**self.stages)


def tuned_for(mode: Mode, machine: str, residue: complex) -> Stabilizer | None:
    """Return the stabilizer of a machine that moves a mode horizontally to the left; None: too much phase.

    residue : of the mode from the machine's exciter to its speed, 1/s. The gain is the one that adds a
    damping ratio of 1, to first order.
    """
    s = mode.eigenvalue
    missing_deg = _lead_deg(residue * s * WASHOUT_S / (1.0 + s * WASHOUT_S))
    if not abs(missing_deg) <= MOST_DEG:
        return None
    stages = max(ceil(abs(missing_deg) / STAGE_DEG), 1)
    lead_deg = 0.0
    for _ in range(6):  # a stage's lead at s is not quite that at the mode's frequency
        lead_deg += missing_deg
        sine = np.sin(np.radians(lead_deg / stages))
        ratio = float((1.0 + sine) / (1.0 - sine))
        T2 = 1.0 / (abs(s) * ratio**0.5)
        one = Stabilizer(machine, mode.name, 1.0, ratio * T2, T2, stages)
        missing_deg = _lead_deg(residue * one.response(s))
    return replace(one, K=abs(s) / abs(residue * one.response(s)))


def _lead_deg(move: complex) -> float:
    """Return by how much a move of a mode has to be turned to be real and negative."""
    return float(np.degrees(np.angle(-1.0 / move)))


def tuned_stabilizers(weak: WeakModes, for_target: int = 1) -> list[Stabilizer]:
    """Return a stabilizer for each weak mode in turn, the least damped first, until `MOST` have one.

    for_target : machines for each target of the study in its first turn. Each is at the machine without a
    stabilizer that needs the least gain, at most `MOST_GAIN` for the least damping that is tried.
    """
    modes = sorted((*weak.targets, *weak.others), key=lambda m: m.damping_ratio)
    modes = [m for m in modes if m.damping_ratio < WEAK]
    aimed = {m.name for m in weak.targets}
    first = [m for m in modes for _ in range(for_target if m.name in aimed else 1)]
    chosen: dict[str, Stabilizer] = {}
    for mode in (*first, *(mode for _ in range(MOST - 1) for mode in modes)):
        best = _least_gain(weak, mode, chosen) if len(chosen) < MOST else None
        if best is not None:
            chosen[best.machine] = best
    return list(chosen.values())


def _least_gain(weak: WeakModes, mode: Mode, taken: Container[str]) -> Stabilizer | None:
    """Return the stabilizer of a mode that needs the least gain, at a machine that is not `taken`."""
    plant = weak.plant
    rows: list[Stabilizer] = []
    for k, machine in enumerate(plant.machines):
        if machine in taken or f"{machine}_vs" not in plant.inputs:
            continue
        b = plant.Bu[:, [plant.inputs.index(f"{machine}_vs")]].toarray()[:, 0]
        residue = complex((mode.left @ b) * mode.right[plant.speed[k]])
        one = tuned_for(mode, machine, residue) if residue else None
        if one is not None and one.K * ADDED[0] <= MOST_GAIN:
            rows.append(one)
    return min(rows, key=lambda one: one.K, default=None)


def as_controller(
    stabilizers: Sequence[Stabilizer], omega_b: float, name: str, limit_pu: float
) -> Controller:
    """Return stabilizers as one controller, each from its machine's speed (rad/s) to its exciter (pu)."""
    parts = []
    for one in stabilizers:
        lead = control.tf([one.T1, 1.0], [one.T2, 1.0])
        washout = control.tf([one.K / omega_b * WASHOUT_S, 0.0], [WASHOUT_S, 1.0])
        system = control.ss(washout)
        for _ in range(one.stages):
            system = control.ss(lead) * system
        parts.append(system)
    whole = control.append(*parts)
    labelled = control.ss(
        whole.A,
        whole.B,
        whole.C,
        whole.D,
        inputs=[f"{one.machine}_dw" for one in stabilizers],
        outputs=[f"{one.machine}_vs" for one in stabilizers],
        name=name,
    )
    facts = {"method": "residue phase", "local": [asdict(one) for one in stabilizers]}
    return Controller(name, labelled, limit_pu, facts)


def local_rival(
    weak: WeakModes,
    wide: DesignTable,
    cache: Path,
    clock: Clock,
    *,
    progress: Callable[[float], object] = lambda share: None,
) -> Controller | None:
    """Return local stabilizers, evaluated like the wide-area loop with nothing late; None if none is
    possible.

    wide : the design of the wide-area loop; its operating points, faults and requirements are used.
    """
    sets = [units for n in FOR_TARGET if (units := tuned_stabilizers(weak, n))]
    sets = [units for k, units in enumerate(sets) if units not in sets[:k]]
    if not sets:
        return None
    name = f"{wide.name}_local"
    points = [point.model_dump(mode="json") for point in wide.point]
    key = content_hash(
        weak.case.hash, [[asdict(one) for one in units] for units in sets], points, code_hash(__name__)
    )

    def tuned() -> list[dict[str, Any]]:
        return [asdict(one) for one in _with_gains(weak, wide, sets, clock, cache)]

    stabilizers = [Stabilizer(**one) for one in cached_json(cache, "grid-local", key, tuned)]
    table = _table(wide, stabilizers, name)
    progress(0.3)
    controller = as_controller(stabilizers, weak.case.omega_b, name, wide.limit_pu)
    judged_by_key = content_hash(
        table.grid.hash, table.model_dump(mode="json"), controller.as_dict(), code_hash(certify.__module__)
    )

    def compute() -> dict[str, Any]:
        return judged_by(table, controller, certify(table, controller, cache)).as_dict()

    judged = Controller.from_dict(cached_json(cache, "grid-local-certificate", judged_by_key, compute))
    progress(0.5)
    return judged_with_faults(
        table, judged, cache, clock, stage=STAGE, progress=lambda share: progress(0.5 + 0.5 * share)
    )


def which_to_build(
    wide: Controller, local: Controller | None, required: tuple[float, float], installed: Sequence[str] = ()
) -> str:
    """Return the recommendation what to build, as a sentence.

    required : inter-area damping, and damping of every swing. installed : machines with a stabilizer of
    `local` in the grid for which `wide` is designed.
    """
    if local is None:
        return "no local stabilizer can be tuned by residue phase: use the wide-area loop"
    machines = ", ".join(name.removesuffix("_dw") for name in local.inputs)
    there = f"local stabilizers at {machines} reach {_reached(local)}"
    afar = f"the wide-area loop reaches {_reached(wide)}"
    if _passed(local) or (_only_time(local) and not _passed(wide)):
        adds = (wide.certificate or {})["inter_area"] - (local.certificate or {})["inter_area"]
        compared = f"would add {adds:.3f}" if adds >= 0.0 else f"alone reaches {-adds:.3f} less"
        not_run = "" if _passed(local) else f"; not verified within the time limit: {_missed(local)}"
        return (
            "local stabilizers are sufficient, a wide-area link is not needed: those at "
            f"{machines} reach {_reached(local)} with any one of them out of service; "
            f"the wide-area loop {compared} inter-area damping{not_run}"
        )
    if installed:
        return _both(wide, local, required, there, installed)
    if _passed(wide):
        return f"build the wide-area loop: {afar}; {there} and violate {_missed(local)}"
    wide_first = _nearness(wide, required) >= _nearness(local, required)
    closer = "wide-area loop is" if wide_first else "local stabilizers are"
    return (
        f"neither meets all requirements; the {closer} closer: {afar} and violates {_missed(wide)}; "
        f"{there} and violate {_missed(local)}"
    )


def _both(
    wide: Controller, local: Controller, required: tuple[float, float], there: str, installed: Sequence[str]
) -> str:
    both = f"a wide-area loop and those at {', '.join(installed)} reach {_reached(wide)}"
    if _passed(wide):
        return f"build both: {there} and violate {_missed(local)}; {both} and meet all requirements"
    alone = (
        ""
        if _nearness(wide, required) >= _nearness(local, required)
        else "; the stabilizers alone are closer"
    )
    missed = f"{there} and violate {_missed(local)}; {both} and violate {_missed(wide)}"
    return f"not all requirements are met{alone}: {missed}"


def _passed(controller: Controller) -> bool:
    return bool((controller.certificate or {})["passed"])


def _only_time(controller: Controller) -> bool:
    """Whether all violations of a controller are faults that were not run."""
    return all(line.endswith(TIME_OVER) for line in (controller.certificate or {})["violations"])


def _missed(controller: Controller) -> str:
    violations = (controller.certificate or {})["violations"]
    return f"{len(violations)} requirement{'s' if len(violations) > 1 else ''} (first: {violations[0]})"


def _reached(controller: Controller) -> str:
    certificate = controller.certificate or {}
    least = f"{certificate['inter_area']:.3f} (inter-area) and {certificate['worst_swing']:.3f} (worst swing)"
    return f"damping ratios of {least}"


def _nearness(controller: Controller, required: tuple[float, float]) -> tuple[int, int, float]:
    """Return the order of merit of a controller: unstable loops, failed faults, missing damping."""
    certificate = controller.certificate or {}
    unstable, short = falls_short(certificate, *required)
    faults = certificate["acceptance"] or {}
    return -unstable, -sum(len(faults.get(kind, ())) for kind in ("lost", "standing", "unstable")), short


def _table(wide: DesignTable, stabilizers: Sequence[Stabilizer], name: str) -> DesignTable:
    """Return the design of a wide-area loop with the own signals of stabilizers in the place of its loops."""
    signals = [f"{one.machine}_dw" for one in stabilizers]
    acceptance = None if wide.acceptance is None else wide.acceptance.model_copy(update={"latency_s": (0.0,)})
    keys: dict[str, Any] = {
        "name": name,
        "case": wide.case,
        "conditions": ["N", *(f"L:{signal}" for signal in signals)],
        "limit_pu": wide.limit_pu,
        "ask": wide.ask.model_dump(include={"inter_area", "worst_swing", "given_away"}),
        "part": [
            {"actuator": f"{one.machine}_vs", "signals": [f"{one.machine}_dw"], "order": one.stages + 1}
            for one in stabilizers
        ],
        "point": [point.model_dump(mode="json", exclude_unset=True) for point in wide.point],
    }
    if acceptance is not None:
        keys["acceptance"] = acceptance.model_dump(mode="json", exclude_unset=True)
    table = design_of(keys, where=f"local stabilizers of {wide.name}")
    table._grid = wide.grid
    return table


def _with_gains(
    weak: WeakModes, wide: DesignTable, sets: Sequence[Sequence[Stabilizer]], clock: Clock, cache: Path
) -> list[Stabilizer]:
    """Return the set with the gains that damp the grid best: a common factor first, then each gain."""
    judges = [_damping_of_gains(weak, _table(wide, units, "tried"), units, cache) for units in sets]
    units, reached, best, value = sets[0], judges[0], [0.0] * len(sets[0]), _UNSTABLE
    for candidates, judge, added in (
        (*row, added) for row in zip(sets, judges, strict=True) for added in ADDED
    ):
        gains = [min(added * one.K, MOST_GAIN) for one in candidates]
        if (there := judge(gains, value)) > value:
            units, reached, best, value = candidates, judge, gains, there
    for factor, k in ((factor, k) for factor in FACTORS for k in range(len(units))):
        if clock.over(STAGE):
            clock.leave("gains of single local stabilizers")
            break
        gains = [min(factor * K, MOST_GAIN) if j == k else K for j, K in enumerate(best)]
        if (there := reached(gains, value)) > value:
            best, value = gains, there
    return [replace(one, K=K) for one, K in zip(units, best, strict=True)]


def _damping_of_gains(
    weak: WeakModes, table: DesignTable, units: Sequence[Stabilizer], cache: Path
) -> Callable[[Sequence[float], tuple[float, float]], tuple[float, float]]:
    """Return what gains are judged by: what they miss of what is asked, then what they damp up to `WEAK`.

    Of each the worst of what is there with all of them and with each out, at the first points of `table`.
    The second argument is a value to surpass: what cannot any more is not computed further.
    """
    points = table.point[:JUDGED_POINTS]
    cases = {point.name: at_point(weak.case, point) for point in points}
    plants = {n: FamilyPlant.of(c, table.signals, table.actuators, cache) for n, c in cases.items()}
    bands = {name: inter_area_band(plant.modes) for name, plant in plants.items()}
    conditions = [Condition("N"), *(Condition(f"L:{signal}", (signal,)) for signal in table.signals)]
    order = [(name, condition) for name in plants for condition in conditions]  # the last decisive one first
    required = (table.ask.inter_area, table.ask.worst_swing)

    def reached(gains: Sequence[float], least: tuple[float, float]) -> tuple[float, float]:
        ones = [replace(one, K=K) for one, K in zip(units, gains, strict=True)]
        K = as_controller(ones, weak.case.omega_b, "tried", 1.0).system
        value, worst = (np.inf, np.inf), (np.inf, np.inf)
        for name, condition in list(order):
            try:
                row = family_row(name, plants[name].judged, K, condition, bands[name])
            except InterareaError:  # a loop of which not all modes are known
                return _UNSTABLE
            worst = (min(worst[0], row.inter_area), min(worst[1], row.worst_swing))
            missed = sum(min(there - needed, 0.0) for there, needed in zip(worst, required, strict=True))
            value = (missed, sum(min(there, WEAK) for there in worst)) if row.stable else _UNSTABLE
            if not value > least:
                order.remove((name, condition))
                order.insert(0, (name, condition))
                break
        return value

    return reached
