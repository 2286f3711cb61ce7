"""Solve x = g(x) by fixed-point sweeps that learn (Broyden's first method started from the plain sweep).

The first correction is the plain sweep x <- g(x): waveform relaxation. Each
later one updates an approximate inverse Jacobian of r(x) = g(x) - x by one
rank, in several dimensions what Aitken's process is in one: contracting
loops converge faster, loops with gain above one converge at all. For an
affine g of n unknowns it is exact after at most 2 n sweeps.
"""

from __future__ import annotations


class Broyden:
    """Corrections for n unknowns. Plain loops over doubles, so a kernel can repeat them to the bit."""

    def __init__(self, n: int) -> None:
        self._n = n
        self._inverse = [
            [1.0 if i == j else 0.0 for j in range(n)] for i in range(n)
        ]  # of minus the Jacobian
        self._residual: list[float] | None = None
        self._step: list[float] = []

    def correct(self, x: list[float], residual: list[float]) -> list[float]:
        """Return the next x given r(x) = g(x) - x at the present one."""
        n, inverse = self._n, self._inverse
        if self._residual is not None:
            change = [self._residual[i] - residual[i] for i in range(n)]
            predicted = [0.0] * n
            for i in range(n):
                total = 0.0
                for j in range(n):
                    total += inverse[i][j] * change[j]
                predicted[i] = total
            denominator = 0.0
            for i in range(n):
                denominator += self._step[i] * predicted[i]
            if denominator != 0.0:
                row = [0.0] * n
                for j in range(n):
                    total = 0.0
                    for i in range(n):
                        total += self._step[i] * inverse[i][j]
                    row[j] = total
                for i in range(n):
                    factor = (self._step[i] - predicted[i]) / denominator
                    for j in range(n):
                        inverse[i][j] += factor * row[j]
        step = [0.0] * n
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += inverse[i][j] * residual[j]
            step[i] = total
        self._residual, self._step = list(residual), step
        return [x[i] + step[i] for i in range(n)]
