"""Eigenvalues over a parameter: the modes at every value, each tracked to the next by continuity.

Each mode is extrapolated linearly from its last two values and assigned to the nearest mode, all together
(assignment of least total distance). If two assignments are nearly equal, the step is halved.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]
Spectrum = Callable[[float], Mapping[str, complex]]
MOST_HALVINGS = 5
_CLEAR = 2.0  #: times as far as the nearest another mode must be


@dataclass(frozen=True)
class Locus:
    """Modes over a parameter.

    values : (n,) of the parameter, rising or falling. modes : name -> (n,) eigenvalues in 1/s, nan where the
    mode is outside the region.
    """

    key: str
    values: NDArray[np.float64]
    modes: Mapping[str, Complex]

    def rows(self) -> list[dict[str, float | str]]:
        """Return a row for each mode and value: eigenvalue (1/s), frequency (Hz), damping ratio."""
        return [
            {
                "parameter": float(value),
                "mode": name,
                "real_per_s": float(z.real),
                "imag_per_s": float(z.imag),
                "frequency_hz": float(z.imag / (2.0 * np.pi)),
                "damping_ratio": float(-z.real / abs(z)),
            }
            for name, track in self.modes.items()
            for value, z in zip(self.values, track, strict=True)
            if np.isfinite(z)
        ]


def follow(spectrum: Spectrum, values: Sequence[float], *, key: str = "parameter") -> Locus:
    """Return the modes at `values` (n >= 2), tracked from the first to the last.

    spectrum : name -> eigenvalue (1/s) of the modes at a value of the parameter; names may differ between
    values.

    >>> modes = lambda p: {"a": -0.1 + 1j * (1 + p), "b": -0.3 + 1j * (2 - p)}  # they pass each other
    >>> locus = follow(modes, [0.0, 0.25, 0.5, 0.75, 1.0])
    >>> [(name, complex(track[-1])) for name, track in locus.modes.items()]
    [('a', (-0.1+2j)), ('b', (-0.3+1j))]

    Raises
    ------
    ValueError : fewer than two values, or not monotonic.
    """
    steps = np.diff(values)
    if len(values) < 2 or not (np.all(steps > 0.0) or np.all(steps < 0.0)):
        raise ValueError(f"{key}: {len(values)} values, wanted: at least two, rising or falling")
    first = spectrum(values[0])
    tracks = {name: [(values[0], complex(z))] for name, z in first.items()}
    for before, value in pairwise(values):
        _step(spectrum, tracks, before, value, MOST_HALVINGS)
    at = np.array(values, dtype=float)
    modes = {}
    for name, track in tracks.items():
        known = dict(track)
        modes[name] = np.array([known.get(value, complex(np.nan, np.nan)) for value in values])
    return Locus(key, at, modes)


_Tracks = dict[str, list[tuple[float, complex]]]


def _step(
    spectrum: Callable[[float], Mapping[str, complex]],
    tracks: _Tracks,
    before: float,
    value: float,
    left: int,
) -> None:
    """Continue the tracks that are there at `before` to `value`; other modes begin tracks."""
    alive = [name for name, track in tracks.items() if track[-1][0] == before]
    ahead = spectrum(value)
    there = np.array(list(ahead.values()), dtype=complex)
    expected = np.array([_predicted(tracks[name], value) for name in alive], dtype=complex)
    distance = np.abs(expected[:, None] - there[None, :])
    pairs = _assigned(distance)
    if left and not _clear(distance, pairs):
        middle = 0.5 * (before + value)
        _step(spectrum, tracks, before, middle, left - 1)
        _step(spectrum, tracks, middle, value, left - 1)
        return
    for track, mode in pairs:
        tracks[alive[track]].append((value, complex(there[mode])))
    taken = {mode for _, mode in pairs}
    for k, name in enumerate(ahead):
        if k not in taken:
            tracks[_free(name, tracks)] = [(value, complex(there[k]))]


def _predicted(track: list[tuple[float, complex]], value: float) -> complex:
    if len(track) < 2:
        return track[-1][1]
    (p0, z0), (p1, z1) = track[-2:]
    return z1 + (z1 - z0) * ((value - p1) / (p1 - p0))


def _assigned(distance: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Pairs of least total distance."""
    if not distance.size:
        return []
    from scipy.optimize import linear_sum_assignment

    return [(int(i), int(j)) for i, j in zip(*linear_sum_assignment(distance), strict=True)]


def _clear(distance: NDArray[np.float64], pairs: Sequence[tuple[int, int]]) -> bool:
    """Whether each mode's partner is far nearer than any other."""
    for i, j in pairs:
        others = np.delete(distance[i], j)
        if others.size and not others.min() >= _CLEAR * distance[i, j]:
            return False
    return True


def _free(name: str, tracks: _Tracks) -> str:
    k, free = 1, name
    while free in tracks:
        k += 1
        free = f"{name} ({k})"
    return free
