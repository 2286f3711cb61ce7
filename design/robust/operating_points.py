"""Evaluation of a controller on full plants: every operating point, loss and latency, exactly.

`design.py` proposes a controller from reduced plants and Padé models; this module evaluates it on full plants
with exact latency, by the roots of the characteristic equation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, TypeAlias

import control
import numpy as np

from ..certificates.closed_loop import effort, loss_criterion
from ..certificates.large_loop import SWING_HZ, WELL_DAMPED, LargePlant
from ..delay.curves import delayed_loop, rightmost_roots
from ..delay.signal_conditions import Condition
from ..linear.matrices import decays
from ..modes.modes import Mode

#: a plant of either kind: full and dense without reference angle, speeds in rad/s; or sparse blocks
JudgedPlant: TypeAlias = control.StateSpace | LargePlant
#: frequencies in which a root counts as the inter-area one where modes have no names, Hz
INTER_AREA_HZ = (0.3, 0.9)


@dataclass(frozen=True)
class FamilyRow:
    """One operating point under one condition; a damping ratio of 1 if no oscillatory root is in the band.

    For a `LargePlant` the inter-area modes are tracked from the open loop, because local ones lie in their
    band, and `rightmost` covers oscillations only.
    """

    point: str
    condition: str
    stable: bool
    rightmost: float  #: 1/s
    worst_swing: float
    inter_area: float


@dataclass(frozen=True)
class FamilyCertificate:
    """The results of a controller over a family; `violations` is empty if it meets all requirements."""

    rows: tuple[FamilyRow, ...]
    worst_swing: float
    inter_area: float
    effort: float  #: pu per rad/s, largest over the operating points, every signal there at once
    fastest_pole: float  #: of the controller, rad/s
    violations: tuple[str, ...]
    order: int = 0  #: states of the controller, those of its washout counted
    #: lost signals -> largest loop gain of the rest over real s >= 0 and all points; above 1 it is unstable
    loss_criterion: Mapping[str, float] = field(default_factory=dict)
    #: mean pull on the voltage (pu) after the fault of the specification; None where it names no fault
    drive: float | None = None
    #: what follows from `drive` for synchronism: "kept", "lost", "uncertain", "not judged"
    predicted: str = "not judged"
    faults: tuple[
        Mapping[str, Any], ...
    ] = ()  #: the runs of that fault, one for each operating point and loss
    #: what the acceptance of the specification found; None: it was not run
    acceptance: Mapping[str, Any] | None = None
    #: what the signals from other machines are worth (`SignalWorth.as_dict`); None: not measured
    worth: Mapping[str, Any] | None = None
    not_covered: str = ""  #: in words: what it says nothing of
    #: each mode of the open loops with what is left of it (`ModeChange`), nothing lost; None: not asked for
    modes: tuple[Mapping[str, Any], ...] | None = None
    #: how much later, larger or smaller each signal may come (`SignalMargin`), the least of all points; None:
    #: not looked at
    margins: tuple[Mapping[str, Any], ...] | None = None

    @property
    def passed(self) -> bool:
        """Whether no requirement is violated."""
        return not self.violations

    def as_dict(self) -> dict[str, Any]:
        """Return the record as JSON values."""
        record = asdict(self)
        for name in ("modes", "margins"):
            if record[name] is None:
                del record[name]
        return {**record, "passed": self.passed}


def judge_family(
    plants: Mapping[str, JudgedPlant],
    K: control.StateSpace,
    conditions: Sequence[Condition],
    *,
    worst_swing: float = 0.0,
    inter_area: float = 0.0,
    effort_cap: float = float("inf"),
    fastest_pole: float = float("inf"),
    targets: Mapping[str, tuple[float, float]] | None = None,
    at: Mapping[str, tuple[float, float]] | None = None,
    bands_hz: Mapping[str, tuple[float, float]] | None = None,
    progress: Callable[[float], object] = lambda share: None,
) -> FamilyCertificate:
    """Return the results of `K` on every plant under every condition, and the violated requirements.

    Parameters
    ----------
    plants : operating point -> full plant without reference angle, speeds in rad/s, or a large one as blocks.
    K : inputs named by signal (rad/s), outputs by actuator (pu), u = +K y.
    worst_swing, inter_area : required damping ratios of every row.
    targets : condition, or kind of it ("all", "late", "lost", "scaled"), -> both, for its rows instead.
    at : operating point -> both, for all its rows instead.
    effort_cap, fastest_pole : pu per rad/s, rad/s.
    bands_hz : operating point -> where its inter-area modes are (`inter_area_band`); default `INTER_AREA_HZ`.
    progress : called with the completed share of the rows.
    """
    bands = dict.fromkeys(plants, INTER_AREA_HZ) | dict(bands_hz or {})
    rows: list[FamilyRow] = []
    for point, plant in plants.items():
        for c in conditions:
            progress(len(rows) / (len(plants) * len(conditions)))
            rows.append(family_row(point, plant, K, c, bands[point]))
    worst = min(row.worst_swing for row in rows)
    inter = min(row.inter_area for row in rows)
    # the gain from noise on the signals exists only for a stable loop; an unstable row is named anyway
    steady = {row.point for row in rows if row.condition == conditions[0].name and row.stable}
    largest = max((_effort(plants[p], K) for p in steady), default=float("nan"))
    fastest = float(np.abs(np.linalg.eigvals(np.asarray(K.A))).max(initial=0.0))
    requested = (
        ("effort", largest, largest <= effort_cap, f"<= {effort_cap:g}"),
        ("fastest pole", fastest, fastest <= fastest_pole, f"<= {fastest_pole:g} rad/s"),
    )
    violations = (
        *(f"{row.point}, {row.condition}: unstable" for row in rows if not row.stable),
        *_short_at(rows, conditions, (worst_swing, inter_area), targets or {}, at),
        *(
            f"{name} is {value:.4g}, required {own_requested}"
            for name, value, satisfied, own_requested in requested
            if not satisfied
        ),
    )
    progress(1.0)
    return FamilyCertificate(
        tuple(rows),
        worst,
        inter,
        largest,
        fastest,
        violations,
        int(K.nstates),
        _loss_criteria(plants, K, conditions),
    )


def _effort(plant: JudgedPlant, K: control.StateSpace) -> float:
    return plant.effort(K) if isinstance(plant, LargePlant) else effort(plant, K)


def _short_at(
    rows: Sequence[FamilyRow],
    conditions: Sequence[Condition],
    required: tuple[float, float],
    targets: Mapping[str, tuple[float, float]],
    at: Mapping[str, tuple[float, float]] | None,
) -> Iterator[str]:
    """Yield the violations of the requirements: those of `at` at its points, elsewhere the common ones."""
    at = at or {}
    yield from _short_of([row for row in rows if row.point not in at], conditions, required, targets)
    for point, own_ask in at.items():
        own = [row for row in rows if row.point == point]
        yield from (f"{point}: {text}" for text in _short_of(own, conditions, own_ask, {}))


def _short_of(
    rows: Sequence[FamilyRow],
    conditions: Sequence[Condition],
    required: tuple[float, float],
    targets: Mapping[str, tuple[float, float]],
) -> Iterator[str]:
    """Yield the violations of the target of each kind of condition, or of the common requirements."""
    under = {c.name: next((k for k in (c.name, c.kind) if k in targets), "") for c in conditions}
    for kind in dict.fromkeys(under.values()):
        selected = [row for row in rows if under[row.condition] == kind]
        if not selected:
            continue
        where = f" under {kind}" if kind in {c.name for c in conditions} else f" with signals {kind}"
        where = where if kind else ""
        requested = targets.get(kind, required)
        for name, of, least in zip(
            ("worst swing", "inter-area"), ("worst_swing", "inter_area"), requested, strict=True
        ):
            value = min(float(getattr(row, of)) for row in selected)
            if not value >= least:
                yield f"{name} damping{where} is {value:.4g}, required {_required(selected, of, least)}"


def _required(rows: Sequence[FamilyRow], of: str, least_allowed: float) -> str:
    """Return the required damping ratio, the number of rows that violate it, and the worst one."""
    short = [row for row in rows if not getattr(row, of) >= least_allowed]
    if not short:
        return f">= {least_allowed:g}"
    least = min(short, key=lambda row: float(getattr(row, of)))
    count = f"{len(short)} of {len(rows)} conditions"
    return f">= {least_allowed:g}: violated in {count}, worst at {least.point}, {least.condition}"


def _loss_criteria(
    plants: Mapping[str, JudgedPlant], K: control.StateSpace, conditions: Sequence[Condition]
) -> dict[str, float]:
    """Return lost signals -> the loss criterion of the rest, the largest over all plants."""
    lost = {" and ".join(c.lost): c.lost for c in conditions if c.lost}
    retained = {name: [s for s in K.input_labels if s not in missing] for name, missing in lost.items()}

    def gain(plant: JudgedPlant, rest: Sequence[str]) -> float:
        if isinstance(plant, LargePlant):
            return plant.loss_criterion(K, rest)
        return loss_criterion(plant, K, rest)

    return {name: max(gain(plant, rest) for plant in plants.values()) for name, rest in retained.items()}


def inter_area_band(modes: Mapping[str, Mode] | None) -> tuple[float, float]:
    """Return the frequencies (Hz) in which a closed loop's roots count as inter-area ones.

    From half the slowest such mode of the open loop to between its fastest and the slowest local one;
    `INTER_AREA_HZ` if no mode has that name.
    """
    result = {name: mode.frequency_hz for name, mode in (modes or {}).items()}
    between = [hertz for name, hertz in result.items() if name.startswith("inter-area")]
    local = [hertz for name, hertz in result.items() if name.startswith("local")]
    if not between:
        return INTER_AREA_HZ
    above = [hertz for hertz in local if hertz > max(between)]
    top = float(np.sqrt(max(between) * min(above))) if above else 1.5 * max(between)
    return 0.5 * min(between), top


def family_row(
    point: str,
    plant: JudgedPlant,
    K: control.StateSpace,
    condition: Condition,
    inter_area_hz: tuple[float, float],
) -> FamilyRow:
    """Return the results of `K` on one plant under one condition; parameters as in `judge_family`."""
    if isinstance(plant, LargePlant):
        facts = plant.facts(K, condition)
        return FamilyRow(point, condition.name, **asdict(facts))
    loop = delayed_loop(plant, K, condition.latency_s_of, lost=condition.lost, scale_of=condition.scale_of)
    # roots left of this line are better damped than WELL_DAMPED at the lower end of the inter-area band
    roots = rightmost_roots(loop, right_of=-2.5)
    rightmost = float(roots.real.max())
    return FamilyRow(
        point,
        condition.name,
        decays(roots),
        rightmost,
        _least_damping(roots, SWING_HZ),
        _least_damping(roots, inter_area_hz),
    )


def _least_damping(roots: np.ndarray[Any, Any], band_hz: tuple[float, float]) -> float:
    hertz = np.abs(roots.imag) / (2.0 * np.pi)
    damping = -roots.real / np.maximum(np.abs(roots), 1e-12)
    swings = damping[(hertz >= band_hz[0]) & (hertz <= band_hz[1]) & (damping < WELL_DAMPED)]
    return float(swings.min()) if swings.size else 1.0
