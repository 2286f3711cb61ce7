r"""Number of modes within a region, by the argument principle on the small network matrix.

.. math:: \frac{1}{2\pi} \oint d \arg \det N(s) = \text{modes} - \text{device poles within}

Known modes and device poles near the boundary are divided out first: the phase of the rest changes slowly
unless one is missing, so few steps suffice. A step is accepted if the change of log det agrees with its
derivative at both ends; halving until phases are close could miss a turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from interarea.models.errors import InterareaError

from ..linear.resolvent import Loop

ComplexArray = npt.NDArray[np.complex128]

RIGHT = 2.0  #: 1/s, growth faster than any swing's
_NEAR = 0.6  # 1/s: poles and modes so near the edge are divided out
_AGREES = 0.25  # between the change of log det and the trapezium of its derivative
_BEND = 3.0  # of the derivative over a step, times the step: two zeros beside its middle would give 8 or more
_FIRST, _LONGER = 0.2, 3.0  # 1/s; how much longer the next step may be
_SHIFT = 1e-6  # for the derivative of log det
_SHORTEST = 1e-7  # of a step: a mode lies on the line
_MOVE = 1e-3  # of a line that a mode lies on, relative
SLOWEST = 1e-4  #: 1/s: what grows more slowly is at rest, as the rotation of all rotors
_BEYOND = 100.0  # times the fastest pole: there the logarithm has settled


class OnTheLine(InterareaError):
    """A mode or pole lies on the boundary of the region, near the frequency or damping of `side`."""

    def __init__(self, side: str) -> None:
        super().__init__(side)
        self.side = side


@dataclass(frozen=True)
class Region:
    """Modes of frequencies within a band whose damping ratio is below a limit, growth up to `RIGHT`.

    band : rad/s; below : damping ratio, under 1; moved : changes because of modes on its boundary.
    """

    band: tuple[float, float]
    below: float
    moved: tuple[str, ...] = ()
    halves = 1  # `sides` are all of its edge

    @property
    def slope(self) -> float:
        """Decay over frequency on the line of damping."""
        return float(self.below / np.sqrt(1.0 - self.below**2))

    def holds(self, s: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return which of s lie within."""
        z = np.asarray(s, dtype=complex)
        inside = (self.band[0] < z.imag) & (z.imag < self.band[1])
        return np.asarray(inside & (-self.slope * z.imag < z.real) & (z.real < RIGHT))

    def sides(self) -> list[tuple[str, complex, complex]]:
        """The edge counter-clockwise: name, from, to."""
        low, high = self.band
        corners = [
            complex(-self.slope * low, low),
            complex(RIGHT, low),
            complex(RIGHT, high),
            complex(-self.slope * high, high),
        ]
        names = ("low", "right", "high", "below")
        return [(name, corners[k], corners[(k + 1) % 4]) for k, name in enumerate(names)]

    def aside(self, side: str) -> Region:
        """Return the region with one side moved outwards a little, with a note in `moved`."""
        hz = 2.0 * np.pi
        low, high = self.band
        if side == "below":
            below = self.below + _MOVE * (1.0 - self.below)
            message = f"damping ratio {self.below:.6g} moved to {below:.6g}"
            return replace(self, below=below, moved=(*self.moved, f"{message}: a mode lies on that line"))
        ends = (low * (1.0 - _MOVE), high) if side == "low" else (low, high * (1.0 + _MOVE))
        k = 0 if side == "low" else 1
        message = f"band edge {self.band[k] / hz:.6g} Hz moved to {ends[k] / hz:.6g} Hz"
        return replace(self, band=ends, moved=(*self.moved, f"{message}: a mode lies on that line"))

    def clear_of(self, modes: Sequence[complex]) -> Region:
        """Return the region with every side moved on which one of `modes` lies."""
        region = self
        for _ in range(10):
            z = np.asarray(modes, dtype=complex)
            size = np.maximum(np.abs(z), 1e-12)
            near = 1e-6
            if np.any(np.abs(z.real + region.slope * z.imag) < near * size):
                region = region.aside("below")
            elif np.any(np.abs(z.imag - region.band[0]) < near * size):
                region = region.aside("low")
            elif np.any(np.abs(z.imag - region.band[1]) < near * size):
                region = region.aside("high")
            else:
                break
        return region


@dataclass(frozen=True)
class Rectangle:
    """Eigenvalues slower than `top`, rad/s, and between two real parts, 1/s; real ones and pairs.

    Its boundary is the upper half of a rectangle, closed by the real axis; the lower half mirrors it.
    """

    left: float
    right: float
    top: float
    halves = 2  # `sides` are one of two halves of its edge

    def holds(self, s: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return which of s lie within, conjugates too."""
        z = np.asarray(s, dtype=complex)
        return np.asarray((np.abs(z.imag) < self.top) & (self.left < z.real) & (z.real < self.right))

    def sides(self) -> list[tuple[str, complex, complex]]:
        """The upper half of the edge counter-clockwise: name, from, to."""
        corners = [
            complex(self.right),
            complex(self.right, self.top),
            complex(self.left, self.top),
            complex(self.left),
        ]
        return [(name, corners[k], corners[k + 1]) for k, name in enumerate(("right", "top", "left"))]


def all_that_grows(loop: Loop) -> Rectangle:
    """Return the region of growth faster than `SLOWEST`, a hundred times as large as the fastest pole."""
    far = _BEYOND * float(np.abs(loop.poles).max(initial=1.0))
    return Rectangle(SLOWEST, far, far)


@dataclass(frozen=True)
class Count:
    """Number of modes within a region, and number of points at which N(s) was factored."""

    modes: int
    factorisations: int


def count_modes(loop: Loop, region: Region | Rectangle, known: Sequence[complex]) -> Count:
    """Count the modes within `region`.

    known : modes inside or near the region, imaginary part 0 or above; they make the count fast.

    Raises
    ------
    OnTheLine : a mode lies on the boundary.
    """
    poles, modes = loop.poles, np.asarray(known, dtype=complex)
    inner_poles = int(np.sum(region.holds(poles)))
    if region.halves == 2:  # both of a pair are divided out, so that what is left is as symmetric
        modes = np.concatenate([modes, modes[modes.imag > 0.0].conj()])
    poles, modes = (z[_from_edge(z, region) < _NEAR] for z in (poles, modes))
    edge = _Edge(loop, poles, modes)
    rotated = region.halves * sum(edge.turn(*side) for side in region.sides())
    divided = int(np.sum(region.holds(modes))) - int(np.sum(region.holds(poles)))
    return Count(round(rotated / (2.0 * np.pi)) + divided + inner_poles, edge.points)


def _from_edge(z: ComplexArray, region: Region | Rectangle) -> npt.NDArray[np.float64]:
    """Distance of points from the edge of the region."""
    distance = np.full(len(z), np.inf)
    if region.halves == 2:
        z = z.real + 1j * np.abs(z.imag)
    for _, a, b in region.sides():
        along = np.clip(((z - a) * np.conj(b - a)).real / abs(b - a) ** 2, 0.0, 1.0)
        distance = np.minimum(distance, np.abs(z - a - along * (b - a)))
    return distance


class _Edge:
    """Log det without the poles and modes that are known, and its derivative."""

    def __init__(self, loop: Loop, poles: ComplexArray, modes: ComplexArray) -> None:
        self._loop, self._poles, self._modes = loop, poles, modes
        self.points = 0
        self._last: tuple[complex, tuple[complex, complex]] | None = None

    def at(self, s: complex) -> tuple[complex, complex]:
        """Return log and its derivative; the corner of two sides is asked for twice."""
        if self._last is not None and self._last[0] == s:
            return self._last[1]
        h = _SHIFT * (1.0 + abs(s)) * 1j
        one, two = (self._divided(z) for z in (s - h, s + h))
        slope = complex((two - one).real, _wrapped((two - one).imag)) / (2.0 * h)
        result = one + slope * h, slope
        self._last = s, result
        return result

    def _divided(self, s: complex) -> complex:
        """Log det; many poles and modes at one place would turn it by whole turns within the shift."""
        self.points += 1
        with np.errstate(divide="ignore"):
            known = np.sum(np.log(s - self._poles)) - np.sum(np.log(s - self._modes))
        return complex(self._loop.logarithm(s) + known)

    def turn(self, side: str, start: complex, end: complex) -> float:
        """Return the change of phase from `start` to `end`, rad."""
        length, direction = abs(end - start), (end - start) / abs(end - start)
        (value, slope), done, total = self.at(start), 0.0, 0.0
        step = min(length, _FIRST)
        while done < length:
            step = min(step, length - done)
            if not step > _SHORTEST and not length - done <= _SHORTEST:
                raise OnTheLine(side)
            there = end if done + step >= length else start + direction * (done + step)
            new, new_slope = self.at(there)
            expected = 0.5 * step * direction * (slope + new_slope)
            change = complex((new - value).real, expected.imag + _wrapped((new - value).imag - expected.imag))
            # of the trapezium's error and of the bend, third and second order in the step
            off, bend = abs(change - expected) / _AGREES, abs(new_slope - slope) * step / _BEND
            fits = 0.8 / max(off ** (1.0 / 3.0), bend**0.5, 0.1)
            if off <= 1.0 and bend <= 1.0:
                total, done, value, slope = total + change.imag, done + step, new, new_slope
                step *= min(fits, _LONGER)
            else:
                step *= fits if 0.1 < fits < 0.7 else 0.5
        return total


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)
