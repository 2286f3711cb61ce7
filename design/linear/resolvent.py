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
        self._inverse = np.linalg.inv(s * np.eye(plant.A.shape[1]) - plant.A)
        self.network = Network(plant.elimination, plant.bus, plant.C @ (self._inverse @ plant.B))

    def solve(self, b: npt.NDArray[Any]) -> ComplexArray:
        """Return x = (s - A)^-1 b, (n, ...)."""
        p, R = self.plant, self._inverse
        xk = times(R, p.spread(b))
        V = self.network.at_devices(times(p.C, xk))
        return np.asarray(p.gathered(xk + times(R, times(p.B, V))))

    def solve_left(self, c: npt.NDArray[Any]) -> ComplexArray:
        """Return y = (s - A)^-T c, (n, ...)."""
        p, R = self.plant, self._inverse
        Rt = np.swapaxes(R, 1, 2)
        yk = times(Rt, p.spread(c))
        V = self.network.at_devices(times(np.swapaxes(p.B, 1, 2), yk), transposed=True)
        return np.asarray(p.gathered(yk + times(Rt, times(np.swapaxes(p.C, 1, 2), V))))


def network_logarithm(plant: SparsePlant, s: complex) -> complex:
    """Return log det N(s), its imaginary part up to multiples of 2 pi."""
    T, F, H = plant.triangular
    X = np.zeros(F.shape, dtype=complex)
    for i in range(T.shape[1] - 1, -1, -1):  # (s - T) X = F, all devices at once
        inner = (T[:, i : i + 1, i + 1 :] @ X[:, i + 1 :])[:, 0]
        X[:, i] = (F[:, i] + inner) / (s - T[:, i, i])[:, None]
    return Network(plant.elimination, plant.bus, H @ X).logarithm()
