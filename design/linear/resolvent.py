"""(s - A)^-1 and det N(s) of a sparse plant, and what a search for modes and their count ask for."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from .sparse_network import Network, times
from .sparse_plant import SparsePlant

ComplexArray = npt.NDArray[np.complex128]


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
    """A plant without a controller: what is searched is what it is."""

    def __init__(self, plant: SparsePlant) -> None:
        self.plant, self.nstates, self.times = plant, plant.nstates, plant.times

    @cached_property
    def poles(self) -> ComplexArray:
        """Poles of det N(s)."""
        return self.plant.device_poles

    def shifted(self, s: complex) -> Shifted:
        """Return (s - A)^-1."""
        return Shifted(self.plant, s)

    def logarithm(self, s: complex) -> complex:
        """Return log det N(s)."""
        return network_logarithm(self.plant, s)

    def exact(
        self, value: complex, right: ComplexArray, left: ComplexArray
    ) -> tuple[complex, ComplexArray, ComplexArray, float]:
        """Return the mode as it is, with |A v - lambda v| / (|lambda| |v|)."""
        rest = np.linalg.norm(self.times(right) - value * right)
        return value, right, left, float(rest / (abs(value) * np.linalg.norm(right)))


class Shifted:
    """The plant at one s: (s - A)^-1, its transpose and N(s)."""

    def __init__(self, plant: SparsePlant, s: complex) -> None:
        self.plant, self.s = plant, s
        modal = plant.modal
        self._devices = modal.at(s)
        self.network = Network(plant.elimination, modal.C @ self._devices.times(modal.B))

    def solve(self, b: npt.NDArray[Any]) -> ComplexArray:
        """Return x = (s - A)^-1 b, (n, ...)."""
        p, modal, devices = self.plant, self.plant.modal, self._devices
        y = times(modal.inverse, p.spread(b))
        V = self.network.at_devices(times(modal.C, devices.times(y)))
        return np.asarray(p.gathered(times(modal.X, devices.times(y + times(modal.B, V)))))

    def solve_left(self, c: npt.NDArray[Any]) -> ComplexArray:
        """Return y = (s - A)^-T c, (n, ...)."""
        p, modal, devices = self.plant, self.plant.modal, self._devices
        X, inverse, B, C = (np.swapaxes(M, 1, 2) for M in (modal.X, modal.inverse, modal.B, modal.C))
        y = times(X, p.spread(c))
        V = self.network.at_devices(times(B, devices.times(y, transposed=True)), transposed=True)
        return np.asarray(p.gathered(times(inverse, devices.times(y + times(C, V), transposed=True))))


def network_logarithm(plant: SparsePlant, s: complex) -> complex:
    """Return log det N(s), its imaginary part up to multiples of 2 pi."""
    return Shifted(plant, s).network.logarithm()
