"""A controller judged on full plants: every operating point under every loss and latency, exactly.

What `robust.py` proposes from reduced plants and Padé models is decided here: full
plants, exact latency, roots of the characteristic equation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import control
import numpy as np

from ..certificates.closed_loop import effort, loss_criterion
from ..delay.curves import delayed_loop, rightmost_roots
from ..delay.signal_conditions import Condition

#: frequencies in which a root counts as a swing, and as the inter-area one, Hz
SWING_HZ = (0.1, 2.5)
INTER_AREA_HZ = (0.3, 0.9)
#: roots damped better than this are filters and the latency's own chain of roots, not swings
WELL_DAMPED = 0.6


@dataclass(frozen=True)
class FamilyRow:
    """One operating point under one condition; a damping ratio of 1 where no root swings in the band."""

    point: str
    condition: str
    stable: bool
    rightmost: float  #: 1/s
    worst_swing: float
    inter_area: float


@dataclass(frozen=True)
class FamilyCertificate:
    """What a controller holds over a family; `violations` is empty when it holds what was asked."""

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

    @property
    def passed(self) -> bool:
        """Whether nothing that was asked is violated."""
        return not self.violations

    def as_dict(self) -> dict[str, Any]:
        """Return the record as JSON values."""
        return {**asdict(self), "passed": self.passed}


def judge_family(
    plants: Mapping[str, control.StateSpace],
    K: control.StateSpace,
    conditions: Sequence[Condition],
    *,
    worst_swing: float = 0.0,
    inter_area: float = 0.0,
    effort_cap: float = float("inf"),
    fastest_pole: float = float("inf"),
) -> FamilyCertificate:
    """Return what `K` does on every plant under every condition, and where it misses what is asked.

    Parameters
    ----------
    plants : operating point -> full plant without reference angle, speeds in rad/s.
    K : inputs named by signal (rad/s), outputs by actuator (pu), u = +K y.
    worst_swing, inter_area : damping ratios asked of every row.
    effort_cap, fastest_pole : pu per rad/s, rad/s.
    """
    rows = tuple(_row(point, plant, K, c) for point, plant in plants.items() for c in conditions)
    worst = min(row.worst_swing for row in rows)
    inter = min(row.inter_area for row in rows)
    # the gain from noise on the signals exists only for a stable loop; an unstable row is named anyway
    steady = {row.point for row in rows if row.condition == conditions[0].name and row.stable}
    largest = max((effort(plants[p], K) for p in steady), default=float("nan"))
    poles = np.linalg.eigvals(np.asarray(K.A))
    fastest = float(np.abs(poles).max()) if poles.size else 0.0
    violations = [f"{row.point}, {row.condition}: unstable" for row in rows if not row.stable]
    asked = (
        ("worst swing damping", worst, worst >= worst_swing, f">= {worst_swing:g}"),
        ("inter-area damping", inter, inter >= inter_area, f">= {inter_area:g}"),
        ("effort", largest, largest <= effort_cap, f"<= {effort_cap:g}"),
        ("fastest pole", fastest, fastest <= fastest_pole, f"<= {fastest_pole:g} rad/s"),
    )
    violations += [
        f"{name} is {value:.4g}, asked {wanted}" for name, value, held, wanted in asked if not held
    ]
    lost = {" and ".join(c.lost): c.lost for c in conditions if c.lost}
    criterion = {name: _worst_loss(plants, K, gone) for name, gone in lost.items()}
    return FamilyCertificate(
        rows, worst, inter, largest, fastest, tuple(violations), int(K.nstates), criterion
    )


def _worst_loss(
    plants: Mapping[str, control.StateSpace], K: control.StateSpace, gone: Sequence[str]
) -> float:
    """Return the largest criterion over the plants when the signals `gone` are lost."""
    left = [s for s in K.input_labels if s not in gone]
    return max(loss_criterion(plant, K, left) for plant in plants.values())


def _row(point: str, plant: control.StateSpace, K: control.StateSpace, condition: Condition) -> FamilyRow:
    loop = delayed_loop(plant, K, condition.latency_s_of, lost=condition.lost)
    # roots left of this line are better damped than WELL_DAMPED at the lower end of the inter-area band
    roots = rightmost_roots(loop, right_of=-2.5)
    rightmost = float(roots.real.max())
    return FamilyRow(
        point,
        condition.name,
        bool(rightmost < 0.0),
        rightmost,
        _least_damping(roots, SWING_HZ),
        _least_damping(roots, INTER_AREA_HZ),
    )


def _least_damping(roots: np.ndarray[Any, Any], band_hz: tuple[float, float]) -> float:
    hertz = np.abs(roots.imag) / (2.0 * np.pi)
    damping = -roots.real / np.maximum(np.abs(roots), 1e-12)
    swings = damping[(hertz >= band_hz[0]) & (hertz <= band_hz[1]) & (damping < WELL_DAMPED)]
    return float(swings.min()) if swings.size else 1.0
