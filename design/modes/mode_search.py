"""Eigenpairs of a large matrix in a region, by rational Krylov spaces and inverse iteration."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ..linear.resolvent import Loop
from .mode_count import RIGHT, Rectangle, Region

ComplexArray = npt.NDArray[np.complex128]

_STATES_A_CELL = 300
_MOST_STEPS, _STEPS_AT_ONCE = 60, 30
_CANCELLED = 0.2  # of a step's size: what is left when less is made orthogonal once more
_SETTLED = 1e-5  # relative error of an eigenvalue that a cell may claim
_GROWTH = 0.1  # 1/s: how far right of the axis the first search looks
_EQUAL = 1e-7  # relative: nearer eigenvalues are copies, or one found twice
_NEW = 1e-3  # share of a vector outside those of known pairs of its eigenvalue: below it none of its own
_SMALLEST_CELL = 0.05  # rad/s, from corner to corner
_CLOSE = 0.5  # 1/s, with half the frequency: eigenpairs that a deflated cell leaves out


@dataclass(eq=False)  # two of one value are two
class Pair:
    """An eigenvalue, 1/s, its vectors with left' right = 1, and |A v - lambda v| / (|lambda| |v|)."""

    value: complex
    right: ComplexArray
    left: ComplexArray
    residual: float


@dataclass(frozen=True)
class _Cell:
    """A rectangle of the plane: where to look, as far as to its corners."""

    real: tuple[float, float]
    imag: tuple[float, float]

    @property
    def centre(self) -> complex:
        return complex(sum(self.real) / 2.0, sum(self.imag) / 2.0)

    @property
    def reach(self) -> float:
        return 0.5 * float(np.hypot(self.real[1] - self.real[0], self.imag[1] - self.imag[0]))

    def within(self, centre: complex, radius: float) -> bool:
        """Whether a disc contains the whole cell."""
        corners = (complex(x, y) - centre for x in self.real for y in self.imag)
        return all(abs(corner) <= radius for corner in corners)

    def halves(self) -> tuple[_Cell, _Cell]:
        """Cut across the longer side."""
        x, y, z = self.real, self.imag, self.centre
        if y[1] - y[0] > x[1] - x[0]:
            return _Cell(x, (y[0], z.imag)), _Cell(x, (z.imag, y[1]))
        return _Cell((x[0], z.real), y), _Cell((z.real, x[1]), y)


def _cells(region: Region, count: int) -> list[_Cell]:
    """About so many cells of equal area, nearly square, over a region as far as the first search looks."""
    (low, high), slope = region.band, region.slope
    area = (high - low) * (0.5 * slope * (low + high) + _GROWTH) / count
    cells, y = [], low
    while y < high:
        width = slope * y + _GROWTH
        columns = max(1, round(width / np.sqrt(area)))
        top = min(high, y + area * columns / width)
        if high - top < 0.3 * (top - y):
            top = high
        x = np.linspace(-slope * top, _GROWTH, columns + 1)
        cells += [_Cell(sides, (y, top)) for sides in itertools.pairwise(x.tolist())]
        y = top
    return cells


@dataclass
class Search:
    """Searches the eigenpairs of a loop within a region, and stores them."""

    loop: Loop
    region: Region | Rectangle
    tolerance: float
    pairs: list[Pair] = field(default_factory=list)
    beside: list[complex] = field(default_factory=list)  #: eigenvalues out of the region, about right
    factorisations: int = 0
    _cells: list[_Cell] = field(default_factory=list)
    _random: np.random.Generator = field(default_factory=lambda: np.random.default_rng(7))

    def about(self, centre: complex) -> None:
        """Search once around a point, with known pairs deflated."""
        sides = (centre.real - 1e-3, centre.real + 1e-3), (centre.imag - 1e-3, centre.imag + 1e-3)
        self._keep(self._ritz(_Cell(*sides), _MOST_STEPS, deflated=True)[0])

    def everywhere(self, region: Region) -> None:
        """Search once in every cell of a region; parts not covered are searched in smaller cells."""
        todo = _cells(region, max(1, round(self.loop.nstates / _STATES_A_CELL)))
        discs: list[tuple[complex, float]] = []
        while todo:
            cell = todo.pop()
            left_out = cell.real[1] < -region.slope * cell.imag[1]
            if left_out or any(cell.within(*disc) for disc in discs):
                continue
            result, reached = self._ritz(cell, _MOST_STEPS, deflated=False)
            self._keep(result)
            discs.append((cell.centre, reached))
            if reached >= cell.reach or 2.0 * cell.reach < _SMALLEST_CELL:
                self._cells.append(cell)
            else:
                todo += cell.halves()

    def again(self) -> bool:
        """Search once more with known pairs deflated, also right of the axis; return whether any was
        found."""
        before = len(self.pairs)
        right = [_Cell((_GROWTH, RIGHT), cell.imag) for cell in self._cells]
        for cell in [*self._cells, *right]:
            self._keep(self._ritz(cell, 2 * _STEPS_AT_ONCE, deflated=True)[0])
        return len(self.pairs) > before

    def _ritz(
        self, cell: _Cell, most: int, *, deflated: bool
    ) -> tuple[list[tuple[complex, ComplexArray]], float]:
        """Settled Ritz pairs about the centre of a cell, and how far from it all are settled."""
        n = self.loop.nstates
        near = [p for p in self.pairs if abs(p.value - cell.centre) < cell.reach + _CLOSE] if deflated else []
        shifted = self.loop.shifted(cell.centre)
        self.factorisations += 1
        most = min(most, n - len(near))
        Q = np.zeros((most + 1, n), dtype=complex)
        H = np.zeros((most + 1, most), dtype=complex)
        start = _without(self._random.standard_normal(n) + 0j, near)
        Q[0] = start / np.linalg.norm(start)
        for k in range(most):
            w = _without(shifted.solve(Q[k]), near)
            size = np.inf
            while (left := float(np.linalg.norm(w))) < _CANCELLED * size:  # once is not orthogonal enough
                size = left
                h = np.conj(Q[: k + 1] @ np.conj(w))
                w -= h @ Q[: k + 1]
                H[: k + 1, k] += h
            H[k + 1, k] = left
            ended = bool(abs(H[k + 1, k]) <= 1e-13 * np.linalg.norm(H[: k + 1, k]))
            if not ended:
                Q[k + 1] = w / H[k + 1, k]
            if ended or k + 1 == most or (k + 1) % _STEPS_AT_ONCE == 0:
                values, vectors, reached = _settled(H[: k + 2, : k + 1], cell.centre, ended)
                if ended or reached >= cell.reach:
                    break
        return list(zip(values.tolist(), vectors.T @ Q[: len(vectors)], strict=True)), reached

    def _keep(self, result: Sequence[tuple[complex, ComplexArray]]) -> None:
        """Refine what lies within the region, or just beside it, and is not known yet."""
        for value, vector in result:
            if not self.region.holds(value + 1e-4 * abs(value) * np.array([0, 1, 1j, -1j])).any():
                if all(abs(value - z) > 1e-4 * (1.0 + abs(z)) for z in self.beside):
                    self.beside.append(complex(value))
                continue
            copies = [p for p in self.pairs if abs(p.value - value) < 1e-5 * (1.0 + abs(value))]
            pair = self._refined(value, vector, copies)
            # it may settle beside that, on an eigenvalue which known pairs have: then not on their vectors
            while pair is not None and (others := self._of_equal_value(pair, copies)):
                copies = [*copies, *others]
                pair = self._refined(pair.value, pair.right, copies)
            if pair is not None:
                self.pairs.append(pair)

    def _of_equal_value(self, pair: Pair, copies: list[Pair]) -> list[Pair]:
        """Return the known pairs of its eigenvalue that are none of `copies`."""
        near = _EQUAL * (1.0 + abs(pair.value))
        return [p for p in self.pairs if abs(p.value - pair.value) < near and p not in copies]

    def _refined(self, value: complex, vector: ComplexArray, copies: list[Pair]) -> Pair | None:
        """Inverse iteration from both sides; None where it does not settle or `copies` span the vector."""
        right = _without(vector, copies)
        if not np.linalg.norm(right) >= _NEW * np.linalg.norm(vector):
            return None
        right /= np.linalg.norm(right)
        left = _without_left(self._random.standard_normal(len(right)) + 0j, copies)
        for _ in range(4):
            shifted = self.loop.shifted(value * (1.0 + 1e-9) + 1e-10)
            self.factorisations += 1
            for _ in range(2):
                right = _without(shifted.solve(right), copies)
                left = _without_left(shifted.solve_left(left), copies)
                right, left = right / np.linalg.norm(right), left / np.linalg.norm(left)
            moved = self.loop.times(right)
            scale = left @ right
            if not abs(scale) > 1e-14:
                return None
            before, value = value, complex((left @ moved) / scale)
            residual = float(np.linalg.norm(moved - value * right) / abs(value))
            if residual <= 0.1 * self.tolerance or (
                residual <= self.tolerance and abs(value - before) < 1e-9
            ):
                break
        if not residual <= self.tolerance:
            return None
        return Pair(value, right, left / scale, residual)


def _settled(H: ComplexArray, centre: complex, ended: bool) -> tuple[ComplexArray, ComplexArray, float]:
    """Settled eigenvalues of A, their vectors in the basis, and the radius within which all are settled."""
    k = H.shape[1]
    mu, Y = np.linalg.eig(H[:k])
    ok = np.abs(mu) > 1e-12 * np.max(np.abs(mu))
    mu, Y = mu[ok], Y[:, ok]
    values = centre - 1.0 / mu
    error = np.zeros(len(mu)) if ended else np.abs(H[k, k - 1] * Y[k - 1]) / np.abs(mu) ** 2
    good = error <= _SETTLED * np.abs(values)
    distance = np.abs(values - centre)
    reached = np.inf if ended else float(np.min(distance[~good], initial=np.max(distance[good], initial=0.0)))
    inside = good & (distance <= reached)
    return values[inside], Y[:, inside], reached


def _without(x: npt.NDArray[Any], pairs: Sequence[Pair]) -> ComplexArray:
    """Take the parts of known right vectors out of x."""
    for _ in range(2 if pairs else 0):
        V, W = np.array([p.right for p in pairs]), np.array([p.left for p in pairs])
        x = x - (W @ x) @ V
    return np.asarray(x, dtype=complex)


def _without_left(y: npt.NDArray[Any], pairs: Sequence[Pair]) -> ComplexArray:
    for _ in range(2 if pairs else 0):
        V, W = np.array([p.right for p in pairs]), np.array([p.left for p in pairs])
        y = y - (V @ y) @ W
    return np.asarray(y, dtype=complex)
