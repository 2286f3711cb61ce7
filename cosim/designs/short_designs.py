"""Short designs of sets of loops: an estimate of the damping of each before a complete design."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import pi
from pathlib import Path

import control

from interarea.design.delay.signal_conditions import Condition, condition_of_many
from interarea.design.errors import InfeasibleDesign, UncertifiedDesign
from interarea.design.linear.linearise import remove_reference
from interarea.design.modes.loop_points import LoopSet
from interarea.design.robust.design import design_robust
from interarea.design.robust.operating_points import inter_area_band, judge_family
from interarea.design.robust.signal_worth import PAYS, own_signals
from interarea.design.robust.smoothed_objective import BandOffsets
from interarea.design.robust.spec import RobustSpec
from interarea.design.robust.stages import Stage
from interarea.models.case.case import Case, CaseError
from interarea.models.case.tables import swing_name

from ..run.artefacts import linear_plant, sparse_linear_plant
from .family import DENSE_STATES, FamilyPlant

#: of every signal in the second condition of a short design, s
LATENCY_S = 0.15
STATES = 4  # of each loop
_CAP = 0.6  # pu per rad/s


@dataclass(frozen=True)
class ShortDesign:
    """A set of loops, and its least inter-area damping ratio with no signal and with all signals late.

    damping : 0 if no stable controller was found, or not all of its modes are known. own : of loops that use
    only their own machine's speed, at least that without control.
    """

    chosen: LoopSet
    damping: float
    own: float

    @property
    def sentence(self) -> str:
        """Value of the remote signals in these loops, as a sentence."""
        message = (
            f"inter-area {self.damping:.3f} against {self.own:.3f} with the own machines' speeds alone; "
            "clearing times not searched"
        )
        if self.damping - self.own >= PAYS:
            return f"the link adds {self.damping - self.own:.3f}, {message}"
        return f"a local stabilizer performs as well: do not build this link; {message}"


def short_designs(
    case: Case,
    sets: Sequence[LoopSet],
    cache: Path,
    *,
    latency_s: float = LATENCY_S,
    done: Callable[[int], None] = lambda _: None,
) -> tuple[ShortDesign, ...]:
    """Make a short design for each set, with equal effort; return them in their order.

    Each loop has four states and uses its own machine's speed and those of its signal. Conditions: no signal
    late, and all `latency_s` late; two first guesses; evaluated on the full plant with exact latency. done :
    called with the number completed.

    Raises
    ------
    CaseError : a signal that is no speed of a machine, or parts that no branch connects. ReductionError : a
    large grid that no small model describes.
    """
    for one in sets:
        _signals_of(one, case)
    blocks = sparse_linear_plant(case, cache)
    small = remove_reference(linear_plant(case, cache)) if blocks.nstates <= DENSE_STATES else None
    designs = []
    for k, one in enumerate(sets):
        sees = _signals_of(one, case)
        signals = tuple(dict.fromkeys(s for seen in sees.values() for s in seen))
        plant = FamilyPlant(case, signals, tuple(sees), blocks, small)
        alone = {a: own for a, own in own_signals(tuple(sees), signals).items() if own}  # no SVC's
        reached = rival = _reached(plant, sees, latency_s)
        if alone != sees:
            near = tuple(s for seen in alone.values() for s in seen)
            own = FamilyPlant(case, near, tuple(alone), blocks, small)
            rival = _reached(own, alone, latency_s) if alone else 0.0
        designs.append(ShortDesign(one, reached, max(rival, _uncontrolled(plant))))
        done(k + 1)
    return tuple(designs)


def _uncontrolled(plant: FamilyPlant) -> float:
    """Return the least inter-area damping without control, which a rival that does nothing has."""
    modes = (plant.modes or {}).items()
    return min((mode.damping_ratio for name, mode in modes if name.startswith("inter-area")), default=0.0)


def _signals_of(chosen: LoopSet, case: Case) -> dict[str, tuple[str, ...]]:
    """Return actuator -> its own speed and those of its best signal."""
    machines, signals = [m.name for m in case.machines], {}
    speeds = {f"{name}_dw": {name} for name in machines}
    speeds |= {swing_name(a, b): {a, b} for a in machines for b in machines if a != b}
    for actuator, signal in chosen.loops.items():
        if signal not in speeds:
            raise CaseError(
                f"{case.name}: short designs see speeds of machines, not {signal!r}; rank with speeds alone "
                "(--signals speed)"
            )
        seen = speeds[signal] | {actuator.removesuffix("_vs")}
        signals[actuator] = tuple(f"{name}_dw" for name in machines if name in seen)
    return signals


def _reached(plant: FamilyPlant, sees: dict[str, tuple[str, ...]], latency_s: float) -> float:
    codes = ("N", f"s{round(1e3 * latency_s)}")
    conditions = tuple(condition_of_many(code, plant.signals) for code in codes)
    band_hz = inter_area_band(plant.modes)
    system = short_controller({"base": plant}, sees, conditions, offsets=_offsets(band_hz), effort=_CAP)
    if system is None:
        return 0.0
    try:
        judged = judge_family({"base": plant.judged}, system, conditions, bands_hz={"base": band_hz})
    except UncertifiedDesign:
        return 0.0
    return float(judged.inter_area)


def short_controller(
    plants: Mapping[str, FamilyPlant],
    sees: Mapping[str, tuple[str, ...]],
    conditions: Sequence[Condition],
    *,
    offsets: BandOffsets,
    effort: float,
    start: control.StateSpace | None = None,
    starts: int = 2,
) -> control.StateSpace | None:
    """Make a short design of loops with four states each; None: no stable controller was found.

    plants : operating point -> plant with all signals and actuators. sees : actuator -> its signals. effort :
    pu per rad/s at most, under the first condition. start : a controller of that size as an additional start
    of the search.
    """
    first = next(iter(plants.values()))
    spec = RobustSpec(
        signals=first.signals,
        actuators=tuple(sees),
        conditions=tuple(conditions),
        sees={a: (signal_names, STATES) for a, signal_names in sees.items()},
        effort_cap=((0.05, effort), (300.0, effort)),
        effort_under=(conditions[0].name,),
        offsets=offsets,
        plant_order=36,
        pade_order=2,
        starts=starts,
        stages=(Stage(rho=(80.0,), steps=12),),
        start=start,
    )
    searched = {point: plant.searched for point, plant in plants.items()}
    try:
        return design_robust(searched, spec, first.case.omega_b).system
    except (InfeasibleDesign, UncertifiedDesign):
        return None


def _offsets(band_hz: tuple[float, float]) -> BandOffsets:
    """Ask nothing extra of inter-area modes, of others what they mostly have already."""
    low, high = (2.0 * pi * hertz for hertz in band_hz)
    places = (
        0.0,
        0.1 * low,
        0.28 * low,
        0.55 * low,
        low,
        high,
        1.13 * high,
        2.3 * high,
        3.1 * high,
        5.8 * high,
    )
    return BandOffsets(places, (0, 0, -0.12, -0.12, 0, 0, -0.17, -0.17, -0.25, -0.4))
