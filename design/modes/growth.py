r"""Stability verdict on the whole spectrum of a plant, before any mode is named.

The error of a computed eigenvalue follows from its condition,

.. math:: |\delta \lambda_k| \approx \varepsilon \, \|A\| \, \frac{\|w_k\| \|v_k\|}{|w_k^T v_k|},

with :math:`A` balanced. The two eigenvalues at 0 of a common angle and a common speed form a Jordan block:
rounding splits them to :math:`\pm\sqrt{\varepsilon}`, and their condition grows accordingly. Neither counts
as growth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import eig, matrix_balance

from ..linear.matrices import ZERO_EIGENVALUE
from ..linear.resolvent import Loop, OpenLoop
from ..linear.sparse_plant import SparsePlant
from .mode_count import SLOWEST, OnTheLine, all_that_grows, count_modes
from .mode_search import Search

Matrix = npt.NDArray[np.float64]
ComplexMatrix = npt.NDArray[np.complex128]

WHOLE = 400  #: states up to which all eigenvalues of a grid are computed in a fraction of a second
_ACCURACY = 2000.0 * float(np.finfo(float).eps)  # of A and its eigenvalues, relative to its norm
_DENSE = 3000  # states up to which they are computed where something grows
_TAKE_PART = 3  # states named of each
_RESIDUAL = 1e-9
_CENTRES = (0.01, 0.1, 1.0, 10.0, *(complex(0.3, w) for w in (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)))  # 1/s


@dataclass(frozen=True)
class Growing:
    """A growing eigenvalue, 1/s, imaginary part 0 or above; dominant states with their participation."""

    eigenvalue: complex
    states: Mapping[str, float]

    @property
    def text(self) -> str:
        """Eigenvalue, frequency or doubling time, and participating states."""
        z = self.eigenvalue
        doubled = f"doubles in {np.log(2.0) / z.real:.3g} s"
        value, kind = f"{z.real:+.4g}", f"real, {doubled}"
        if z.imag:
            value += f" ± {z.imag:.4f}j"
            kind = f"{z.imag / (2.0 * np.pi):.4f} Hz, damping ratio {-z.real / abs(z):.4f}, {doubled}"
        return f"{value} 1/s ({kind}; {', '.join(f'{s} {share:.3f}' for s, share in self.states.items())})"


@dataclass(frozen=True)
class Growth:
    """The verdict.

    Attributes
    ----------
    growing : fastest first; one of each pair.
    counted : growing eigenvalues, both of each pair; more than in `growing` if some were not located.
    states : number of all eigenvalues; of a loop with delays, of the model without them.
    slowest : 1/s; slower growth is not distinguished from 0.
    """

    growing: tuple[Growing, ...]
    counted: int
    states: int
    slowest: float

    @property
    def stable(self) -> bool:
        """Whether no eigenvalue grows."""
        return self.counted == 0

    @property
    def text(self) -> str:
        """The verdict as one line."""
        if self.stable:
            return f"stable: of {self.states} eigenvalues none grows faster than {self.slowest:.1e} 1/s"
        verb = "grows" if self.counted == 1 else "grow"
        message = f"UNSTABLE: {self.counted} of {self.states} eigenvalues {verb}"
        missing = self.counted - _times(self.growing)
        listed = [one.text for one in self.growing]
        if missing > 0:
            listed.append(f"{missing} more were counted but not computed")
        return f"{message}: {'; '.join(listed)}"

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict as JSON values."""
        return {
            "stable": self.stable,
            "counted": self.counted,
            "states": self.states,
            "slowest": self.slowest,
            "growing": [
                {"eigenvalue": [one.eigenvalue.real, one.eigenvalue.imag], "participation": dict(one.states)}
                for one in self.growing
            ],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Growth:
        """Return the verdict of `as_dict`."""
        growing = tuple(Growing(complex(*g["eigenvalue"]), g["participation"]) for g in data["growing"])
        return cls(growing, data["counted"], data["states"], data["slowest"])


def growth_of_spectrum(
    A: Matrix, labels: Sequence[str], values: ComplexMatrix, left: ComplexMatrix, right: ComplexMatrix
) -> Growth:
    """Return the verdict on all eigenvalues of A (n, n), 1/s; left : w as columns with w^T A = lambda w^T."""
    n = len(values)
    if n == 0:
        return Growth((), 0, 0, ZERO_EIGENVALUE)
    error = _errors(A, left, right)
    grows = np.flatnonzero(values.real > error)
    order = grows[np.argsort(-values.real[grows], kind="stable")]
    return Growth(
        tuple(_growing(values[k], left[:, k], right[:, k], labels) for k in order if values[k].imag >= 0.0),
        len(grows),
        n,
        float(np.min(error)),
    )


def growth_of(A: Matrix, labels: Sequence[str]) -> Growth:
    """Return the verdict on all eigenvalues of A (n, n), 1/s; labels : names of its states."""
    if not len(A):
        return Growth((), 0, 0, ZERO_EIGENVALUE)
    values, left, right = eig(np.asarray(A, dtype=float), left=True, right=True)
    return growth_of_spectrum(A, labels, np.asarray(values, dtype=complex), left.conj(), right)


def growth_of_plant(plant: SparsePlant, loop: Loop | None = None, known: Sequence[complex] = ()) -> Growth:
    """Return the verdict on a grid of any size.

    Up to `WHOLE` states all eigenvalues are computed. Above that, and with a controller, those that grow
    faster than `SLOWEST` are counted by the argument principle, and located if there are any.

    Parameters
    ----------
    loop : the plant with a controller around it; default none.
    known : modes already computed, imaginary part 0 or above; they make the count fast.
    """
    if loop is None and plant.nstates <= WHOLE:
        return growth_of(plant.state_matrix(), plant.states)
    around = loop or OpenLoop(plant)
    region = all_that_grows(around)
    try:
        counted = count_modes(around, region, known).modes
    except OnTheLine:
        counted = -1
    if counted == 0:
        return Growth((), 0, around.nstates, SLOWEST)
    if loop is None and plant.nstates <= _DENSE:
        return growth_of(plant.state_matrix(), plant.states)
    search = Search(around, region, _RESIDUAL)
    for centre in (*(z for z in known if z.real > 0.0), *_CENTRES):
        if _times(growing := _modes_that_grow(search, plant.states)) == counted:
            break
        search.about(complex(centre))
    growing = _modes_that_grow(search, plant.states)
    return Growth(growing, max(counted, _times(growing), 1), around.nstates, SLOWEST)


def _modes_that_grow(search: Search, labels: Sequence[str]) -> tuple[Growing, ...]:
    """What a search has found that grows, exact for a loop with delays, fastest first."""
    result: list[Growing] = []
    for pair in search.pairs:
        value, right, left, residual = search.loop.exact(pair.value, pair.right, pair.left)
        value = value.conjugate() if value.imag < 0.0 else value
        new = all(abs(value - one.eigenvalue) > 1e-7 * (1.0 + abs(value)) for one in result)
        if residual <= _RESIDUAL and value.real > SLOWEST and new:
            result.append(_growing(value, left, right, labels))
    return tuple(sorted(result, key=lambda one: -one.eigenvalue.real))


def _times(growing: Sequence[Growing]) -> int:
    """Eigenvalues, both of each pair."""
    return sum(2 if one.eigenvalue.imag else 1 for one in growing)


def _growing(value: complex, left: ComplexMatrix, right: ComplexMatrix, labels: Sequence[str]) -> Growing:
    part = np.abs(left * right)[: len(labels)]
    share = part / max(float(part.sum()), 1e-300)
    most = np.argsort(-share, kind="stable")[:_TAKE_PART]
    value = complex(value)
    if abs(value.imag) <= 1e-9 * abs(value):
        value = complex(value.real)
    return Growing(value, {labels[k]: float(share[k]) for k in most})


def _errors(A: Matrix, left: ComplexMatrix, right: ComplexMatrix) -> Matrix:
    """How far each computed eigenvalue may be from one of A, 1/s (n,)."""
    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    norm = float(np.linalg.norm(balanced))
    v, w = right / scale[:, None], left * scale[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        size = np.linalg.norm(w, axis=0) * np.linalg.norm(v, axis=0)
        condition = size / np.abs(np.sum(w * v, axis=0))
        error = _ACCURACY * norm * condition
    # of a Jordan block of two it is the root, of whatever condition its halves seem to have
    most = np.sqrt(_ACCURACY * max(norm, 1.0))
    return np.asarray(
        np.clip(np.nan_to_num(error, nan=most, posinf=most), ZERO_EIGENVALUE, max(most, ZERO_EIGENVALUE))
    )
