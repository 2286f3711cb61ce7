"""Numbers that say how a run went, each with the window and the method it was taken by.

Ring-down damping: after the last disturbance the signals are sums of decaying
oscillations. The matrix pencil (`pencil`) finds their poles from uniformly
sampled windows of several signals at once. Modes are distinguished by shape, not
by position.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np
import numpy.typing as npt

from . import matrix_pencil as pencil
from .accumulators import Samples, Settling, Squares
from .verdict import Verdict

Array = npt.NDArray[np.float64]
METRICS = (
    "least", "stable", "damping", "frequency", "settling_time", "peak", "energy", "effort", "packets",
    "fit_error",
)  # fmt: skip
SYNCHRONISM = "synchronism"  #: of a run with a fault, where it is asked for: `Excursion`
_FEW_MODES = 6
RING_DOWN = "ring_down"  #: wanted beside them in a single run: its ring-down, to compare with the roots
GOOD_FIT = 0.02  #: largest misfit over the largest signal with which a fit still names modes


@dataclass(frozen=True)
class RingDownMode:
    """One decaying oscillation: pole in rad/s, amplitude of each signal at the start of the window."""

    pole: complex
    amplitudes: tuple[complex, ...]

    @property
    def frequency_hz(self) -> float:
        return abs(self.pole.imag) / (2.0 * np.pi)

    @property
    def damping_ratio(self) -> float:
        return float(-self.pole.real / abs(self.pole))


@dataclass(frozen=True)
class RingDown:
    """Modes found in a window, strongest first; `error` is the largest misfit over the largest signal."""

    modes: tuple[RingDownMode, ...]
    window_s: tuple[float, float]
    error: float
    method: str = "matrix pencil"

    @property
    def good(self) -> bool:
        """Whether it describes the signals well enough for its modes to have names."""
        return self.error <= GOOD_FIT


@dataclass(frozen=True)
class Metrics:
    """What a run reached. `methods` says for each number its window and method.

    least_damping_ratio : of everything that swings; negative where something grows. least_frequency_hz : of
        that swing. least_mode : its name; "" for one that controller or latency brought in, or none.
    verdict : what the run came to, and what that was judged by.
    damping_ratio, frequency_hz : mode -> of its root in the closed loop where that is known, else of the
        ring-down; `methods` says which. ring_down : mode -> damping ratio by the ring-down alone, where its
        fit is good to 2 %.
    settling_time_s : from the last event to where the signal stays within 2 % of its peak; None: it does not.
    signal : the speed difference that all of these are of (`ringdown.Swing`).
    peak_pu : largest |signal|. energy_pu2s : integral of its square. effort_pu2s : of the controls.
    What was not asked for is None.
    """

    signal: str
    least_damping_ratio: float | None
    least_frequency_hz: float | None
    least_mode: str
    verdict: Verdict | None
    damping_ratio: Mapping[str, float]
    frequency_hz: Mapping[str, float]
    ring_down: Mapping[str, float]
    settling_time_s: float | None
    peak_pu: float | None
    energy_pu2s: float | None
    effort_pu2s: float | None
    fit_error: float | None
    methods: Mapping[str, str] = field(default_factory=dict)

    @property
    def stable(self) -> bool | None:
        """Whether the verdict is a success: settled, or settling slowly. None where it was not asked for."""
        return None if self.verdict is None else self.verdict.stable

    def as_dict(self) -> dict[str, object]:
        """Return plain types, for JSON."""
        plain = {k: dict(v) if isinstance(v, Mapping) else v for k, v in asdict(self).items()}
        return plain | {"stable": self.stable, f"peak_{self.signal}_pu": self.peak_pu}


def uniform(
    time_s: Array, signals: Sequence[Array], start_s: float, stop_s: float, step_s: float
) -> tuple[Array, Array]:
    """Return a window of `signals`, each (points,), on a uniform grid: times, values (times, signals).

    Grid points of a run are on the grid already; extra points at events are left out, and only where a grid
    point is missing is it interpolated (straight line).
    """
    samples = Samples(len(signals), start_s, stop_s, step_s)
    samples.add(time_s, signals)
    return samples.time_s, samples.values


def ring_down(
    time_s: Array, values: Array, *, rank_tolerance: float = 1e-4, max_order: int = 24, share: float = 0.4
) -> RingDown:
    """Fit decaying oscillations to uniformly sampled signals by the matrix pencil.

    Parameters
    ----------
    time_s : (points,) uniform. values : (points, signals), each in its own unit.
    rank_tolerance : singular values below this times the largest are noise.
    max_order : most poles. share : pencil parameter over the number of points.

    Raises
    ------
    ValueError : fewer than 10 points, or no uniform grid.
    """
    values = np.asarray(values, dtype=np.float64).reshape(len(time_s), -1)
    n = len(values)
    if not n >= 10:
        raise ValueError(f"ring_down: {n} points are too few; at least 10 are needed")
    steps = np.diff(time_s)
    step = (time_s[-1] - time_s[0]) / (n - 1)
    if not np.max(np.abs(steps - step)) <= 1e-6 * abs(step):
        raise ValueError("ring_down: the times are not uniform; use `uniform` first")
    window = (float(time_s[0]), float(time_s[-1]))
    scale = np.max(np.abs(values), axis=0)
    used = scale > 0.0
    if not np.any(used):
        return RingDown((), window, 0.0)
    data = values[:, used] / scale[used]
    basis = pencil.signal_space(data, n - int(share * n), rank_tolerance, max_order)
    poles = pencil.poles_of(basis, step)
    amplitudes, misfit = pencil.amplitudes_of(time_s, values, poles)
    per_unit = np.where(used, scale, 1.0)
    strength = np.max(np.abs(amplitudes) / per_unit, axis=1)
    swings = np.flatnonzero((poles.imag > 1e-6) & (poles.imag < 0.9 * np.pi / step))
    modes = [
        RingDownMode(complex(poles[k]), tuple(amplitudes[k].tolist()))
        for k in sorted(swings.tolist(), key=lambda k: -strength[k])
    ]
    return RingDown(tuple(modes), window, float(np.max(np.abs(misfit) / per_unit)))


def robust_ring_down(
    time_s: Array, values: Array, first: RingDown, starts: Sequence[complex] = ()
) -> RingDown:
    """Fit few modes by variable projection with a robust loss, where a matrix pencil fits badly.

    first : what the pencil found; the result is the better of the two. starts : poles to go on from, rad/s;
        default the strongest of `first`.
    """
    poles = np.array(list(starts) or [mode.pole for mode in first.modes[:_FEW_MODES]], dtype=complex)
    scale = np.max(np.abs(values), axis=0)
    used = scale > 0.0
    if not poles.size or not np.any(used):
        return first
    refined = pencil.refined(time_s, values[:, used] / np.max(scale), poles)
    amplitudes, misfit = pencil.amplitudes_of(time_s, values, refined)
    error = float(np.max(np.abs(misfit) / np.where(used, scale, 1.0)))
    strength = np.max(np.abs(amplitudes), axis=1)
    modes = tuple(
        RingDownMode(complex(refined[k]), tuple(amplitudes[k].tolist()))
        for k in np.argsort(-strength)
        if refined[k].imag > 1e-6
    )
    return RingDown(modes, first.window_s, error, "variable projection")


def settling_time_s(time_s: Array, signal: Array, start_s: float, *, band: float = 0.02) -> float | None:
    """Return how long after `start_s` |signal| last exceeds `band` of its peak; None: it still does.

    The last crossing is found on the straight line between samples.
    """
    settling = Settling(start_s, band)
    settling.add(time_s, signal)
    return settling.time_s


def energy(time_s: Array, signal: Array, start_s: float = 0.0) -> float:
    """Return the integral of signal^2 from `start_s` to the end (trapezoids)."""
    squares = Squares(start_s)
    squares.add(time_s, signal)
    return squares.total
