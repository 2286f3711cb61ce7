"""What a run of a power system is judged by: which signal, which window, which mode is which."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from interarea.design.delay.loop_modes import LoopModes
from interarea.models.case.events import instants
from interarea.models.case.tables import swing_name

from ..master.instances import FmuParticipant
from ..master.master import Master
from ..scenario.scenario import Scenario
from ..trajectory import Trajectory
from . import metrics as m
from .accumulators import Samples

if TYPE_CHECKING:
    from interarea.models.case.case import Case

Array = npt.NDArray[np.float64]
_BAND_HZ = (0.1, 3.0)  # electromechanical modes
_SAMPLE_S = 0.05  # spacing of the fit: 20 samples a second carry modes up to 3 Hz well
# Of the strongest mode's amplitude: below, harmonics and what the fit makes of the delay's many poles begin
# (0.02 with 300 ms on all signals, and a damping ratio of 0.5 where the mode's is 0.31).
_LEAST_STRENGTH = 5e-2
_LEAST_PURITY = (
    0.6  # share of the motion in the shape that gives the name: harmonics are mixtures near a half
)
_HARMONIC = 0.03  # of the frequency of a sum of two modes
_NEAR = 0.35  # of a fitted pole to the root it is of, over the root's size
_LEAST_WINDOW_S = 4.0
_SKIP_S = 0.25  # after the last disturbance: fast, well damped modes die out


@dataclass(frozen=True)
class Swing:
    """The speed difference that a run is judged by: machine `ahead` less machine `behind`.

    behind : "" where there is one machine only. source : who says that it is these.
    """

    ahead: str
    behind: str
    source: str

    @property
    def name(self) -> str:
        """Such as ``dw24`` for G2 less G4, or ``dw_G1_G10``."""
        return swing_name(self.ahead, self.behind) if self.behind else f"dw_{self.ahead}"

    @property
    def text(self) -> str:
        """What the signal is and who says so."""
        less = f" less that of {self.behind}" if self.behind else ""
        return f"speed of {self.ahead}{less} ({self.source})"

    def of(self, trajectory: Trajectory) -> Array:
        """Return the signal (points,), pu."""
        ahead = trajectory[f"plant.{self.ahead}_dw"]
        return ahead - trajectory[f"plant.{self.behind}_dw"] if self.behind else ahead


def disturbance_end_s(scenario: Scenario) -> float:
    """Return when the last event started or ended, s (0 without events; what relays do is not counted)."""
    times = [t for e in scenario.event for t in instants(e)]
    return max((t for t in times if t < scenario.stop_s), default=0.0)


def fit_window(scenario: Scenario) -> tuple[float, float]:
    """Return the window of the ring-down: from just after the last disturbance to a change of a channel.

    An outage that starts later than 4 s after the disturbance ends the window; one that starts sooner starts
    it anew, since the system then still swings.
    """
    start = disturbance_end_s(scenario)
    later = sorted(t for t in scenario.event_times_s if t > start)
    for change in later:
        if change - start >= _LEAST_WINDOW_S:
            return start + _SKIP_S, change
        start = change
    return start + _SKIP_S, scenario.stop_s


def ring_down_of(
    trajectory: Trajectory,
    case: Case,
    window_s: tuple[float, float],
    step_s: float,
    roots: LoopModes | None = None,
    robust: bool = True,
) -> tuple[dict[str, m.RingDownMode], m.RingDown]:
    """Fit the machines' speeds (their common motion taken out) in a window; return named modes and the fit.

    Where the matrix pencil misses by more than `m.GOOD_FIT`, as where packets make the response ring
    irregularly, variable projection goes on from its strongest modes, or from `roots`, if `robust`.

    Names: of the root that is nearest. Without roots by shape: a mode whose motion is mostly between the
    means of the areas is ``inter-area``, one mostly inside area k is ``local area k``; of each the
    strongest. Mixtures have no name, and nothing has where the fit is poor.
    """
    samples = samples_of(case, window_s, step_s)
    samples.add(trajectory.time_s, [trajectory[c] for c in speeds_of(case)])
    return fitted_modes(samples, case, window_s, roots, robust)


def speeds_of(case: Case) -> list[str]:
    """Return the columns of the machines' speeds."""
    return [f"plant.{g.name}_dw" for g in case.machines]


def samples_of(case: Case, window_s: tuple[float, float], step_s: float) -> Samples:
    """Return what takes the samples of the machines' speeds that a ring-down is fitted to."""
    spacing = max(1, round(_SAMPLE_S / step_s)) * step_s
    start = float(np.ceil(window_s[0] / step_s - 1e-9) * step_s)
    return Samples(len(case.machines), start, window_s[1], spacing)


def fitted_modes(
    samples: Samples, case: Case, window_s: tuple[float, float], roots: LoopModes | None, robust: bool
) -> tuple[dict[str, m.RingDownMode], m.RingDown]:
    """Return what `ring_down_of` does, of the samples of the speeds."""
    time, values = samples.time_s, samples.values
    if len(time) < 10:
        return {}, m.RingDown((), window_s, 0.0)
    values = values - values.mean(axis=1, keepdims=True)
    fit = m.ring_down(time, values)
    if robust and not fit.good:
        fit = m.robust_ring_down(time, values, fit, [] if roots is None else _starts(roots))
    inside = _within_band(fit)
    if not inside or not fit.good:
        return {}, fit
    if roots is not None:
        return _nearest_named(inside, roots), fit
    shapes = np.array([mode.amplitudes for mode in inside])
    named: dict[str, m.RingDownMode] = {}
    for mode, (name, purity) in zip(inside, _names(shapes, [g.area for g in case.machines]), strict=True):
        if purity >= _LEAST_PURITY:
            named.setdefault(name, mode)
    return named, fit


def _starts(roots: LoopModes) -> list[complex]:
    return [z for z in dict.fromkeys([*roots.roots, *roots.named.values()]) if z.imag > 0.0]


def _within_band(fit: m.RingDown) -> list[m.RingDownMode]:
    """Modes of the band that are no faint trace of a stronger one, strongest first."""
    inside = [mode for mode in fit.modes if _BAND_HZ[0] <= mode.frequency_hz <= _BAND_HZ[1]]
    if not inside:
        return []
    sizes = np.max(np.abs([mode.amplitudes for mode in inside]), axis=1)
    strongest = np.maximum.accumulate(sizes)
    return [mode for k, mode in enumerate(inside) if sizes[k] >= _LEAST_STRENGTH * strongest[k]]


def _is_harmonic(mode: m.RingDownMode, stronger: list[m.RingDownMode]) -> bool:
    """Whether a mode has the frequency of a sum of two stronger ones, as the square of a large swing has."""
    sums = [a.pole.imag + b.pole.imag for a in stronger for b in stronger]
    return any(abs(mode.pole.imag - w) <= _HARMONIC * w for w in sums)


def _nearest_named(modes: list[m.RingDownMode], roots: LoopModes) -> dict[str, m.RingDownMode]:
    """Name fitted modes by the roots nearest to them, each root once; those far from all have no name."""
    unnamed = [z for z in roots.roots if not roots.name_of(z)]
    targets = [*roots.named.items(), *(("", z) for z in unnamed)]
    pairs = sorted(
        (abs(mode.pole - z) / abs(z), k, j)
        for k, mode in enumerate(modes)
        for j, (_, z) in enumerate(targets)
    )
    named: dict[str, m.RingDownMode] = {}
    used_modes: set[int] = set()
    used_roots: set[int] = set()
    for distance, k, j in pairs:
        if distance <= _NEAR and k not in used_modes and j not in used_roots:
            used_modes.add(k)
            used_roots.add(j)
            if targets[j][0]:
                named[targets[j][0]] = modes[k]
    return named


def _names(shapes: npt.NDArray[np.complex128], areas: Sequence[int]) -> list[tuple[str, float]]:
    """Return the name of each shape, (modes, machines), and the share of the motion that the name covers."""
    count = shapes.shape[1]
    rest = shapes - shapes.sum(axis=1, keepdims=True) / count
    between = np.zeros(len(shapes))
    inside = {}
    for area in sorted(set(areas)):
        part = rest[:, [k for k, a in enumerate(areas) if a == area]]
        mean = part.sum(axis=1, keepdims=True) / part.shape[1]
        between += part.shape[1] * np.abs(mean[:, 0]) ** 2
        inside[area] = np.sum(np.abs(part - mean) ** 2, axis=1)
    total = between + sum(inside.values())
    local = np.array(list(inside.values()))
    largest = np.argmax(local, axis=0)
    names = []
    for k, all_motion in enumerate(total):
        own = local[largest[k], k]
        name = "inter-area" if between[k] >= own else f"local area {list(inside)[largest[k]]}"
        # a shape that is nothing at all swings nowhere: its share is none
        names.append((name, float(max(between[k], own) / all_motion) if all_motion > 0.0 else 0.0))
    return names


def control_limit_pu(master: Master) -> float | None:
    """Bound of the magnitude of the control signals; None where the controller tells none."""
    controller = master.participants.get("controller")
    if not isinstance(controller, FmuParticipant) or "limit" not in controller.file.variables:
        return None
    return controller.value_of("limit")


def least_of_fit(
    fit: m.RingDown, named: Mapping[str, m.RingDownMode]
) -> tuple[float | None, float | None, str]:
    """Return the least damped of the modes of a fit: damping ratio, Hz, name; Nones where there is none."""
    strong = _within_band(fit)
    own = [one for k, one in enumerate(strong) if one in named.values() or not _is_harmonic(one, strong[:k])]
    if not own:
        return None, None, ""
    mode = min(own, key=lambda mode: mode.damping_ratio)
    return mode.damping_ratio, mode.frequency_hz, next((n for n, one in named.items() if one is mode), "")


def hertz(pole: complex) -> float:
    """Return the frequency of a pole in rad/s."""
    return abs(pole.imag) / (2.0 * np.pi)
