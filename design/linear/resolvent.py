"""(s - A)^-1 and det N(s) of a sparse plant."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .sparse_network import Network, times
from .sparse_plant import SparsePlant

ComplexArray = npt.NDArray[np.complex128]


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
