r"""Contribution of a controller to the first swing after a fault, to first order, with its gradient.

Eigenvalues do not show it. The run *without* control gives the sensitivity :math:`s_a(t)` of the first peak
angle to each actuator (degrees per pu and second), and the signals y(t) of the controller, with latency and
losses. With :math:`u = K y`

.. math:: P = \sum_a \int s_a(t)\, L \tanh(u_a(t) / L)\, dt

is the contribution within a limit of +-L, in degrees. Required is :math:`P \le m` in every case, by the
penalty :math:`\sum \max(0, (P - m) / 10)^2`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Gains = tuple[Array, Array, Array, Array]

#: excess at which a case costs 1, degrees
SCALE_DEG = 10.0


@dataclass(frozen=True)
class SwingCase:
    """One fault without control, as input of a controller: uniform samples, the first at equilibrium."""

    name: str
    signals: Array  #: (t, p) what arrives at the controller, rad/s; zero where it is lost
    sensitivity: Array  #: (t, m) degrees of the first peak per pu and second


@dataclass(frozen=True)
class SwingPenalty:
    """The penalty over cases of one length and step; each may contribute `margin_deg`."""

    cases: Sequence[SwingCase]
    step_s: float
    limit_pu: float
    margin_deg: float

    def __call__(self, K: Gains) -> tuple[float, Array, Array, Array, Array]:
        """Return the penalty and its gradient over A, B, C and D of the controller."""
        y, s = self._stacked
        x, z, u = self._states(K, y)
        excess = np.maximum(0.0, self._shifts(s, u) - self.margin_deg) / SCALE_DEG
        value = float((excess**2).sum())
        if value == 0.0:
            return (0.0, *(np.zeros_like(M) for M in K))  # type: ignore[return-value]
        passed = 1.0 / np.cosh(np.clip(u / self.limit_pu, -50.0, 50.0)) ** 2
        q = (2.0 * excess / SCALE_DEG)[None, :, None] * s * passed * self.step_s
        return (value, *self._adjoint(K, y, x, z, q))

    def shifts_deg(self, K: Gains) -> Array:
        """Return P of every case, degrees."""
        y, s = self._stacked
        return self._shifts(s, self._states(K, y)[2])

    @property
    def _stacked(self) -> tuple[Array, Array]:
        """Signals (t, k, p) and sensitivities (t, k, m) of all k cases."""
        return (
            np.array([case.signals for case in self.cases]).transpose(1, 0, 2),
            np.array([case.sensitivity for case in self.cases]).transpose(1, 0, 2),
        )

    def _shifts(self, s: Array, u: Array) -> Array:
        """Trapezoidal sum over the samples, whose ends are where nothing acts yet or any more."""
        through = self.limit_pu * np.tanh(u / self.limit_pu)
        return np.asarray(self.step_s * (s * through).sum(axis=(0, 2)))

    def _states(self, K: Gains, y: Array) -> tuple[Array, Array, Array]:
        """Return states (t, k, n), their sums over each step solved by the trapezoidal rule, and outputs."""
        A, B, C, D = K
        n, h = A.shape[0], self.step_s
        back = np.linalg.inv(np.eye(n) - 0.5 * h * A)
        forward = (back @ (np.eye(n) + 0.5 * h * A)).T
        middle = 0.5 * (y[1:] + y[:-1])
        driven = h * middle @ (back @ B).T
        x = np.zeros((y.shape[0], y.shape[1], n))
        for k in range(driven.shape[0]):
            x[k + 1] = x[k] @ forward + driven[k]
        return x, middle, x @ C.T + y @ D.T

    def _adjoint(
        self, K: Gains, y: Array, x: Array, middle: Array, q: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return the gradient of a function of u whose derivative is `q` (t, k, m).

        p_k = (I - hA/2)^-T (C' q_k + (I + hA/2)' p_k+1), backwards from the last sample.
        """
        A, _, C, _ = K
        n, h = A.shape[0], self.step_s
        back = np.linalg.inv(np.eye(n) - 0.5 * h * A)
        onward = back @ (np.eye(n) + 0.5 * h * A)
        p = np.zeros_like(x)
        ahead = np.zeros(x.shape[1:])
        for k in range(x.shape[0] - 1, 0, -1):
            # d/dx_k of all that comes later, then through the solve that gave x_k
            direct = q[k] @ C + ahead
            p[k] = direct @ back
            ahead = direct @ onward
        later = p[1:]
        sums = x[1:] + x[:-1]
        dA = 0.5 * h * np.einsum("tki,tkj->ij", later, sums)
        dB = h * np.einsum("tki,tkj->ij", later, middle)
        dC = np.einsum("tki,tkj->ij", q, x)
        dD = np.einsum("tki,tkj->ij", q, y)
        return dA, dB, dC, dD
