"""Design file derived from the grid alone, each choice by a rule and with its reason.

Modes, loops, signals, operating points, conditions, requirements and allowed losses of damping follow from
the grid. The result is a design as a user would write it (`designs.design_file`), and can be edited.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any

import numpy as np

from interarea.design.errors import InfeasibleDesign
from interarea.design.modes.loop_points import LoopSet
from interarea.design.modes.modes import Mode
from interarea.design.robust.operating_points import inter_area_band
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash
from interarea.models.case.write_toml import toml_text
from interarea.models.errors import CaseError

from ..designs.design_file import DesignTable, design_of
from ..designs.design_tables import AcceptanceTable, FaultPlace, PointTable
from ..designs.family import DENSE_STATES, at_point
from ..designs.short_designs import LATENCY_S, ShortDesign, short_designs
from ..designs.swing_sensitivity import STEP_S, first_swing
from .choices import ENOUGH, WEAK
from .clock import GUESS, SEARCH, Clock
from .operating_points import (
    TriedPoint,
    chosen_points,
    keeping_what_is_there,
    tried_points,
)
from .weak_modes import SETS, WeakModes, in_words

STEPS = ("loops", "operating points")  #: of `find`

#: damping ratio that another actuator must add: less is within what short designs differ by
WORTH_AN_ACTUATOR = 0.02
LIMIT_PU = 0.05  #: of each output, as field installations limit stabilizers [IEEE421.5-2016]
PLANT_ORDER = 40  #: of the models of the search; the certificate takes the full plants
#: rows of a certificate of a large grid, seconds each: as many operating points as fit, two at least
LARGE_ROWS = 80
RUNS = 60  #: at one operating point, each fault with nothing lost and each signal lost: as many faults as fit
#: rad/s and s: at this common rise the limit is 0; of .3 and .6, tried on the two areas, .3 did less harm.
#: Without governors a grid's speed goes on rising (New England: .03 rad/s each second, a minute long): behind
#: a washout of 10 s that would hold the limit shut, and let go of it while the run is judged
GUARD = {"threshold": 0.3, "washout_s": 3.0}
#: (rad/s, damping): slow roots are asked more than their stability, or the common speed runs away where a
#: signal is lost (New England, `designs/design_new_england.toml`)
_SLOW = ((0.0, 0.1), (0.15, 0.1), (0.3, 0.0), (0.5, -0.1))
#: share of the lower end of the inter-area band from where its damping is asked for
_RISE = 0.6
#: (rad/s, damping) above the swings: modes of exciters and networks
_ABOVE = ((20.0, -0.25), (30.0, -0.4))
_LOCAL_TO = 16.0  # rad/s: 2.5 Hz
_NEAR = 0.05  # relative distance of frequencies that share a node


@dataclass(frozen=True)
class Findings:
    """Analysis of a grid before a design: short designs of sets of loops, and operating points tried."""

    weak: WeakModes
    loops: tuple[ShortDesign, ...]
    points: tuple[TriedPoint, ...]

    @property
    def sets(self) -> tuple[ShortDesign, ...]:
        """Sets of loops in the order of the trials.

        First the smallest set to which another actuator adds too little, then the best of each larger size.
        """
        best = min(max(design.damping for design in self.loops), ENOUGH)
        good = [d for d in self.loops if d.damping >= best - WORTH_AN_ACTUATOR]
        fewest = min(len(d.chosen.actuators) for d in good)
        larger = range(fewest, max(len(d.chosen.actuators) for d in self.loops) + 1)
        of_size = [[d for d in self.loops if len(d.chosen.actuators) == k] for k in larger]
        return tuple(max(rows, key=lambda d: d.damping) for rows in of_size if rows)


@dataclass(frozen=True)
class Proposal:
    """A design, the set of loops it is for, and the reason of each choice."""

    table: DesignTable
    findings: Findings
    taken: ShortDesign
    reasons: tuple[str, ...]

    @property
    def left_out(self) -> tuple[TriedPoint, ...]:
        """Operating points that exist but are not in the design; they test its controller."""
        names = {point.name for point in self.table.point}
        return tuple(row for row in self.findings.points if not row.problem and row.point.name not in names)

    def text(self) -> str:
        """Return the design file, with the reasons as comments."""
        keys = self.table.model_dump(mode="json", exclude_unset=True, exclude_none=True)
        head = "".join(f"# {line}\n" for line in self.reasons)
        return head + toml_text(keys)


def find(
    weak: WeakModes,
    cache: Path,
    clock: Clock,
    *,
    progress: Callable[[str, float], object] = lambda step, share: None,
) -> Findings:
    """Make short designs of sets of loops and try operating points, within the time.

    progress : called with one of `STEPS` and its completed share.

    Raises
    ------
    ModeError : no actuator reaches the weak modes. InfeasibleDesign : no short design is stable.
    """
    loops, points = STEPS
    designs = _short_designs(weak, cache, clock, lambda share: progress(loops, share))
    if not max(design.damping for design in designs) > 0.0:
        raise InfeasibleDesign(
            "no short design of any set of loops keeps the grid stable; name actuators and signals in a "
            "design file",
            constraint="loops",
        )
    candidates = tried_points(weak, cache, clock, progress=lambda share: progress(points, share))
    return Findings(weak, designs, candidates)


def propose(
    findings: Findings,
    taken: ShortDesign,
    cache: Path,
    clock: Clock,
    *,
    name: str = "",
    case: str = "",
    also: Sequence[str] = (),
) -> Proposal:
    """Return a design for one set of loops.

    clock : limits the time of its search. name : of the controller, default that of the case. case : its name
    in the design file. also : additional operating points among those tried.
    """
    weak, candidates, choices = findings.weak, findings.points, findings.weak.choices
    parts = {a: _signals(weak, a, s) for a, s in taken.chosen.loops.items()}
    signals = tuple(dict.fromkeys(s for seen in parts.values() for s in seen))
    conditions = _conditions(signals, choices.latencies_ms)
    chosen = _points(findings, len(conditions), also)
    names = {point.name for point in chosen}
    acceptance = acceptance_of(weak, candidates, chosen, RUNS // (1 + len(signals)))
    guard = _guard(weak, acceptance, parts, cache)
    least = [_least_of_all(row) for row in candidates if row.point.name in names]
    least.append(min(m.damping_ratio for m in weak.all_modes.modes))
    worst_swing = round(max(min(least) - choices.given_away, 0.0), 4)
    chosen = keeping_what_is_there(weak, chosen, candidates, worst_swing)
    keys: dict[str, Any] = {
        "name": name or re.sub("^(?=[^A-Za-z_])|[^A-Za-z0-9_]+", "_", weak.case.name),
        "case": case or weak.case.name,
        "conditions": conditions,
        "slowest_pole": 0.3,
        "fastest_pole": 60.0,
        "effort_cap": [[0.05, choices.effort], [300.0, choices.effort]],
        "effort_under": ["N"],
        "offset": offset_of(weak, candidates, names, min(taken.damping, ENOUGH)),
        "plant_order": PLANT_ORDER,
        "pade_order": 3,
        "limit_pu": LIMIT_PU,
        "starts": 2,
        "seed": 1,
        "ask": {
            "inter_area": round(weak.required_damping, 4),
            "worst_swing": worst_swing,
            "given_away": choices.given_away,
            "effort": round(1.15 * choices.effort, 3),
            "fastest_pole": 66.0,
        },
        "acceptance": acceptance.model_dump(mode="json", exclude_unset=True),
        "part": [{"actuator": a, "signals": list(s), "order": choices.order} for a, s in parts.items()],
        "stage": [
            {"points": ["base"], "rho": [60.0, 150.0], "steps": 25, "longest_s": clock.seconds(GUESS)},
            {"rho": [150.0, 600.0], "steps": 30, "longest_s": clock.seconds(SEARCH)},
        ],
        "point": [point.model_dump(mode="json", exclude_unset=True) for point in chosen],
    }
    if guard:
        keys["guard"] = guard
    table = design_of(keys, where=f"the design made for {weak.case.name}")
    table._grid = weak.case
    return Proposal(table, findings, taken, (*_reasons(findings, taken, names), *_raised_points(chosen)))


def _points(findings: Findings, conditions: int, also: Sequence[str]) -> tuple[PointTable, ...]:
    """Return the operating points of a design: as many as a large grid can have, and those named."""
    chosen = chosen_points(findings.points)
    if findings.weak.plant.nstates > DENSE_STATES:
        chosen = chosen[: max(LARGE_ROWS // conditions, 2)]
    more = [row.point for row in findings.points if row.point.name in also and row.point not in chosen]
    return (*chosen, *more)


def _short_designs(
    weak: WeakModes, cache: Path, clock: Clock, progress: Callable[[float], object]
) -> tuple[ShortDesign, ...]:
    """Design the best sets of each size shortly, those with few actuators first."""
    sets = weak.sets
    designs: list[ShortDesign] = []
    for k, one in enumerate(sorted(sets, key=lambda each: sets.index(each) % SETS)):
        progress(k / len(sets))
        if designs and clock.over("loops"):
            clock.leave(f"a short design of the loops at {', '.join(one.actuators)}")
            continue

        def compute(one: LoopSet = one) -> tuple[float, float]:
            (row,) = short_designs(weak.case, [one], cache, latency_s=LATENCY_S)
            return row.damping, row.own

        loops = dict(one.loops)
        key = content_hash(weak.case.hash, loops, LATENCY_S, code_hash(short_designs.__module__))
        designs.append(ShortDesign(one, *cached_json(cache, "grid-loops", key, compute)))
    return tuple(sorted(designs, key=lambda design: len(design.chosen.actuators)))


def _signals(weak: WeakModes, actuator: str, signal: str) -> tuple[str, ...]:
    """Return what an actuator sees: its own speed, and those that swing against it most, weakest mode.

    A device at a bus has no speed; it takes that of the machine that swings most.
    """
    shape = weak.weakest.shape
    own = actuator.removesuffix("_vs")
    if own not in shape:
        own = max(shape, key=lambda m: abs(shape[m]))
    against = sorted(
        (m for m in shape if m != own), key=lambda m: float((shape[m] * np.conj(shape[own])).real)
    )
    first = [m for m in against if f"_{m}" in f"_{signal.removeprefix('dw_')}"] if "_" in signal else []
    others = dict.fromkeys([*first, *against])
    return tuple(f"{m}_dw" for m in [own, *list(others)[: weak.choices.signals - 1]])


def _conditions(signals: Sequence[str], latencies_ms: Sequence[int]) -> list[str]:
    """Nothing lost and each signal lost, at once and with all of them late."""
    lost = ["", *(f"L:{name}" for name in signals)]
    rows = [code or "N" for code in lost]
    for late in latencies_ms:
        rows += [f"s{late}" + (f"+{code}" if code else "") for code in lost]
    return rows


def offset_of(
    weak: WeakModes, tried: Sequence[TriedPoint], names: set[str], reached: float
) -> list[list[float]]:
    """Return damping offsets: most for the inter-area band, present damping of local modes, less elsewhere.

    reached : expected inter-area damping ratio: where it is reached, no mode becomes weak.
    """
    low, high = (2.0 * pi * hz for hz in inter_area_band({m.name: m for m in weak.all_modes.modes}))
    modes = [*weak.all_modes.modes, *(m for row in tried if row.point.name in names for m in row.modes)]
    local = _local_nodes([m for m in modes if high < abs(m.eigenvalue.imag) < _LOCAL_TO], weak, reached)
    nodes = [[at, value] for at, value in _SLOW if at < _RISE * low]
    nodes += [[_RISE * low, -0.1], [low, 0.0], [high, 0.0]]
    nodes += [[at, value] for at, value in local if at > 1.03 * high]
    last = nodes[-1][1]
    nodes += [[_LOCAL_TO, last]] + [[at, min(value, last)] for at, value in _ABOVE]
    return [[round(at, 3), round(value, 4)] for at, value in nodes]


def _local_nodes(modes: Sequence[Mode], weak: WeakModes, reached: float) -> list[list[float]]:
    """Return (rad/s, damping) of local modes by frequency; near ones share the lower value.

    Weak ones keep what they have where the inter-area damping is as wanted, others are not weak where it is
    `reached`.
    """
    nodes: list[list[float]] = []
    for mode in sorted(modes, key=lambda m: abs(m.eigenvalue.imag)):
        counted_on = weak.required_damping if mode.damping_ratio < WEAK else reached
        at = abs(mode.eigenvalue.imag)
        value = min(min(mode.damping_ratio, WEAK) - weak.choices.given_away - counted_on, 0.0)
        if nodes and at < (1.0 + _NEAR) * nodes[-1][0]:
            nodes[-1][1] = min(nodes[-1][1], value)
        else:
            nodes.append([at, value])
    return nodes


def _least_of_all(row: TriedPoint) -> float:
    return min((mode.damping_ratio for mode in row.modes), default=1.0)


def acceptance_of(
    weak: WeakModes, tried: Sequence[TriedPoint], points: Sequence[PointTable], most: int
) -> AcceptanceTable:
    """Return `most` faults at the branches whose power swings most, each cleared by the trip of that branch.

    A branch whose trip splits the grid at some operating point is skipped.
    """
    ends = {branch.name: branch.from_bus for branch in weak.case.branches}
    faults: list[FaultPlace] = []
    for name in (row.point.out[0] for row in tried if row.point.out and not row.problem):
        known = {fault.bus for fault in faults}
        if (
            len(faults) < min(max(most, 1), weak.choices.faults)
            and ends[name] not in known
            and _whole_without(weak, points, name)
        ):
            faults.append(FaultPlace(bus=ends[name], trip=name))
    if not faults:
        faults = [FaultPlace(bus=weak.case.machines[0].bus)]
    cycles = round(weak.choices.clear_s * weak.case.frequency_hz, 1)
    return AcceptanceTable(fault=tuple(faults), latency_s=(0.15,), clear_cycles=cycles)


def _whole_without(weak: WeakModes, points: Sequence[PointTable], branch: str) -> bool:
    try:
        for point in points:
            at_point(weak.case, point.model_copy(update={"out": (*point.out, branch)}))
    except CaseError:
        return False
    return True


def _guard(
    weak: WeakModes,
    acceptance: AcceptanceTable,
    parts: Mapping[str, Sequence[str]],
    cache: Path,
) -> dict[str, Any]:
    """Limit that side of an exciter's output that adds to the first swing, by pulses without control."""
    total = {actuator: 0.0 for actuator in parts if actuator.endswith("_vs")}
    for fault in acceptance.fault if total else ():
        swing = first_swing(weak.case, fault, acceptance, list(total), cache)
        if swing is None:
            continue
        for actuator in total:
            total[actuator] += STEP_S * float(swing.sensitivity[actuator].sum())
    sides = {a: float(np.sign(value)) for a, value in total.items() if value}
    if not sides:
        return {}
    watched = {a: parts[a][0] for a in sides}
    return {"watched": watched, "sides": sides, **GUARD}


def _reasons(findings: Findings, taken: ShortDesign, names: set[str]) -> tuple[str, ...]:
    """Return the reason of each choice, one line each."""
    weak, candidates = findings.weak, findings.points
    lines = [f"Generated for {weak.case.name} from the grid's data; edit any number as needed."]
    lines += ["Targets: " + ", ".join(in_words(m) for m in weak.targets) + "."]
    if weak.others:
        lines.append(
            f"Weak modes that are not inter-area and no targets (use stabilizers at their machines): "
            f"{', '.join(in_words(m) for m in weak.others)}."
        )
    lines += [
        f"Loops at {', '.join(d.chosen.actuators)}: a short design reaches {d.damping:.3f} ({d.sentence})."
        for d in findings.loops
    ]
    first = findings.sets[0]
    why = (
        f"the fewest actuators within {WORTH_AN_ACTUATOR:g} of the best damping ratio, or of {ENOUGH:g}"
        if taken is first
        else f"because a design for {', '.join(first.chosen.actuators)} violates a requirement"
    )
    lines.append(f"Selected: {', '.join(taken.chosen.actuators)}, {why}.")
    for row in candidates:
        if not row.problem:
            state = f"inter-area damping {row.least:.3f}, eigenvalue change {100.0 * row.moved:.0f} %"
            lines.append(f"Point {row.point.name}: {state}{'; selected' if row.point.name in names else ''}.")
    if missing := [row.point.name for row in candidates if row.problem]:
        lines.append(f"Rejected points (no power flow, islands or unstable): {', '.join(missing)}.")
    least = min([weak.weakest.damping_ratio, *(r.least for r in candidates if r.point.name in names)])
    lines.append(
        f"Required: inter-area damping {weak.required_damping:.3f} (without control {least:.3f} at the worst "
        "point); "
        f"no mode may lose more than {weak.choices.given_away:g} of its damping ratio without control."
    )
    return tuple(lines)


def _raised_points(points: Sequence[PointTable]) -> tuple[str, ...]:
    raised = [f"{point.name} {point.ask[1]:.3f}" for point in points if point.ask is not None]
    if not raised:
        return ()
    return (f"Required where the stabilizers already reach more inter-area damping: {', '.join(raised)}.",)
