"""(s - A)^-1 and det N(s) of a sparse plant, and what a search for modes and their count ask for."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from .sparse_network import Network
from .sparse_plant import SparsePlant

ComplexArray = npt.NDArray[np.complex128]

#: residual above which a mode takes a step of residual inverse iteration, with a shift so much beside it
POLISHED, BESIDE = 1e-10, 1e-5


class Resolvent(Protocol):
    """(s - A)^-1 at one s."""

    def solve(self, b: npt.NDArray[Any]) -> ComplexArray:
        """Return (s - A)^-1 b."""

    def solve_left(self, c: npt.NDArray[Any]) -> ComplexArray:
        """Return (s - A)^-T c."""


class Loop(Protocol):
    """A system of which all modes are wanted.

    nstates : of the matrix that is searched. poles : of exp(logarithm). logarithm : its zeros are the modes.
    """

    @property
    def nstates(self) -> int: ...

    @property
    def poles(self) -> ComplexArray: ...

    def times(self, x: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return A x."""

    def shifted(self, s: complex) -> Resolvent:
        """Return (s - A)^-1."""

    def logarithm(self, s: complex) -> complex:
        """Return the logarithm of the determinant, its imaginary part up to multiples of 2 pi."""

    def exact(
        self, value: complex, right: ComplexArray, left: ComplexArray
    ) -> tuple[complex, ComplexArray, ComplexArray, float]:
        """Return mode, vectors of the plant's states and residual for a mode of the matrix searched."""


class OpenLoop:
    """A plant without a controller, in the coordinates of its devices' modes."""

    def __init__(self, plant: SparsePlant) -> None:
        self.plant, self.nstates = plant, plant.nstates

    @property
    def poles(self) -> ComplexArray:
        """Poles of det N(s)."""
        return self.plant.device_poles

    def times(self, x: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return A x."""
        modal = self.plant.modal
        return np.asarray(modal.times(x) + modal.B @ self.plant.at_rest.solve(modal.C @ x))

    def shifted(self, s: complex) -> ModalShifted:
        """Return (s - A)^-1."""
        return ModalShifted(self.plant, s)

    def logarithm(self, s: complex) -> complex:
        """Return log det N(s)."""
        return network_logarithm(self.plant, s)

    def exact(
        self, value: complex, right: ComplexArray, left: ComplexArray
    ) -> tuple[complex, ComplexArray, ComplexArray, float]:
        """Return the mode with vectors of the plant's states and |A v - lambda v| / (|lambda| |v|)."""
        right, left = self.plant.modal.X @ right, self.plant.modal.inverseT @ left
        rest = value * right - self.plant.times(right)
        if not np.linalg.norm(rest) <= POLISHED * abs(value) * np.linalg.norm(right):
            right = right - Shifted(self.plant, value * (1.0 + BESIDE)).solve(rest)
            rest = value * right - self.plant.times(right)
        size = float(np.linalg.norm(right))
        return value, right / size, left * size, float(np.linalg.norm(rest) / (abs(value) * size))


class ModalShifted:
    """The plant at one s in the coordinates of its devices' modes: (s - A)^-1, its transpose and N(s)."""

    def __init__(self, plant: SparsePlant, s: complex) -> None:
        self._modal = plant.modal
        self._devices = plant.modal.at(s)
        self.network = Network(plant.elimination, self._devices.network)

    def solve(self, b: npt.NDArray[Any]) -> ComplexArray:
        """Return x = (s - A)^-1 b, (n, ...)."""
        modal, devices = self._modal, self._devices
        y = devices.times(b)
        return y + devices.times(modal.B @ self.network.solve(modal.C @ y))

    def solve_left(self, c: npt.NDArray[Any]) -> ComplexArray:
        """Return y = (s - A)^-T c, (n, ...)."""
        modal, devices = self._modal, self._devices
        y = devices.times(c, transposed=True)
        V = self.network.solve(modal.BT @ y, transposed=True)
        return y + devices.times(modal.CT @ V, transposed=True)


class Shifted:
    """The plant at one s: (s - A)^-1, its transpose and N(s)."""

    def __init__(self, plant: SparsePlant, s: complex) -> None:
        self.s, self._modal = s, plant.modal
        self._inside = ModalShifted(plant, s)
        self.network = self._inside.network

    def solve(self, b: npt.NDArray[Any]) -> ComplexArray:
        """Return x = (s - A)^-1 b, (n, ...)."""
        return np.asarray(self._modal.X @ self._inside.solve(self._modal.inverse @ b))

    def solve_left(self, c: npt.NDArray[Any]) -> ComplexArray:
        """Return y = (s - A)^-T c, (n, ...)."""
        return np.asarray(self._modal.inverseT @ self._inside.solve_left(self._modal.XT @ c))


def network_logarithm(plant: SparsePlant, s: complex) -> complex:
    """Return log det N(s), its imaginary part up to multiples of 2 pi."""
    return Network(plant.elimination, plant.modal.at(s).network).logarithm()
