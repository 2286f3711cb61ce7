r"""A grid of any size with a controller around it whose signals are late: all its modes, exactly.

With :math:`G(s) = C (s - A)^{-1} B` of the plant and :math:`M(s) = K(s)\, \mathrm{diag}(e^{-s\tau_i})` the
modes are the zeros of

.. math:: \det N(s)\, \det(I - M(s) G(s)),

whose poles are those of the devices and of K: latency brings none, so that the argument principle counts as
exactly as without a controller. A search needs a matrix: there the latencies are Padé models, accurate in the
band; Newton's method on :math:`T(s) v = (s - A - B M(s) C) v = 0` then makes each mode exact.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import control
import numpy as np
import numpy.typing as npt

from ..linear.resolvent import BESIDE, POLISHED, Shifted
from ..linear.sparse_plant import SparsePlant
from ..modes.modes import ModeError
from ..reduction.gramians import matrices
from ..reduction.low_rank import input_columns, output_rows
from .curves import pade

Matrix = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

_ORDER, _TURNS = 6, 2.0  # of a Padé model, and |s tau| up to which it is right to 1e-8 or so
_SECTIONS = 200  # of Padé models at most, all signals together
_STEPS = 12  # of Newton's method


class LatePlant:
    """A sparse plant, u = K y around it, each signal late by its latency; a `Loop` of `all_modes`.

    Parameters
    ----------
    controller : inputs named by speed (``G2_dw``, rad/s), outputs by input of the plant (``G4_vs``, pu).
    latency_s : signal -> latency, 0 where none is given. omega_b : rated speed, rad/s.
    high_hz : frequency up to which modes are searched for.

    Raises
    ------
    ModeError : latencies below 0, or of a signal that the controller does not read.
    ReductionError : signals and actuators that the plant does not have.
    """

    def __init__(
        self,
        plant: SparsePlant,
        controller: control.StateSpace,
        latency_s: Mapping[str, float],
        *,
        omega_b: float,
        high_hz: float,
    ) -> None:
        signals = list(controller.input_labels)
        for name, latency in latency_s.items():
            if name not in signals or not 0.0 <= latency < np.inf:
                raise ModeError(
                    f"latency of {name} = {latency:g} s, wanted: 0 or more, of {', '.join(signals)}"
                )
        if not 0.0 < high_hz < np.inf:
            raise ModeError(f"modes up to {high_hz:g} Hz, wanted: over 0 and finite")
        self.plant = plant
        self.latency_s = np.array([latency_s.get(name, 0.0) for name in signals])
        self._B = input_columns(plant, list(controller.output_labels))
        self._C = omega_b * output_rows(plant, {name: {name: 1.0} for name in signals})
        self._K = matrices(controller)
        self._sections = np.ceil(2.0 * np.pi * high_hz * self.latency_s / _TURNS)
        if not self._sections.sum() <= _SECTIONS:
            raise ModeError(
                f"signals {self.latency_s.max():g} s late and modes up to {high_hz:g} Hz: too many phase "
                "turns for the search; reduce the band or the latency"
            )

    @cached_property
    def _M(self) -> tuple[Matrix, Matrix, Matrix, Matrix]:
        """The controller behind Padé models in a row, as many as each latency needs."""
        A, B, C, D = self._K
        for k, (latency, sections) in enumerate(zip(self.latency_s, self._sections.astype(int), strict=True)):
            for _ in range(sections):
                a, b, c, d = matrices(pade(latency / sections, _ORDER))
                n, p = len(A), len(a)
                unit = np.zeros((1, B.shape[1]))
                unit[0, k] = 1.0
                # the section's output takes the signal's place, its input is the signal
                A = np.block([[A, B[:, k : k + 1] @ c], [np.zeros((p, n)), a]])
                C = np.hstack([C, D[:, k : k + 1] @ c])
                B = np.vstack([np.where(unit > 0.0, B * d, B), b @ unit])
                D = np.where(unit > 0.0, D * d, D)
        return A, B, C, D

    @property
    def nstates(self) -> int:
        """States of the plant, of the controller and of the Padé models."""
        return self.plant.nstates + len(self._M[0])

    @property
    def poles(self) -> ComplexArray:
        """Poles of the function that is counted: of devices and controller."""
        return np.concatenate([self.plant.device_poles, np.linalg.eigvals(self._K[0]).astype(complex)])

    def times(self, x: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the matrix of the search times x (nstates,)."""
        A, B, C, D = self._M
        n = self.plant.nstates
        y = self._C @ x[:n]
        moved = self.plant.times(x[:n]) + self._B @ (D @ y + C @ x[n:])
        return np.concatenate([moved, A @ x[n:] + B @ y])

    def shifted(self, s: complex) -> ShiftedLoop:
        """Return (s - matrix)^-1."""
        return ShiftedLoop(self, s)

    def logarithm(self, s: complex) -> complex:
        """Return log det N(s) det(I - M(s) G(s))."""
        open_loop = Shifted(self.plant, s)
        M, _ = self._exact(s)
        gain = self._C @ open_loop.solve(self._B)
        return open_loop.network.logarithm() + complex(np.log(np.linalg.det(np.eye(len(M)) - M @ gain)))

    def exact(
        self, value: complex, right: ComplexArray, left: ComplexArray
    ) -> tuple[complex, ComplexArray, ComplexArray, float]:
        """Return mode, vectors (n,) with left' T' right = 1, and |T v| / (|lambda| |v|), latencies exact."""
        n = self.plant.nstates
        x, y, s = right[:n], left[:n], value
        for _ in range(_STEPS):
            open_loop = Shifted(self.plant, s * (1.0 + 1e-9) + 1e-10)
            x, y = self._towards(open_loop, x), self._towards_left(open_loop, y)
            rest, slope = self._rest(s, x, y)
            move = complex((y @ rest) / slope)
            s -= move
            if abs(move) <= 1e-13 * abs(s):
                break
        rest, slope = self._rest(s, x, y)
        if not np.linalg.norm(rest) <= POLISHED * abs(s):
            x = x - self._solve(Shifted(self.plant, s * (1.0 + BESIDE)), rest)
            x /= np.linalg.norm(x)
            rest, slope = self._rest(s, x, y)
        return s, x, y / slope, float(np.linalg.norm(rest) / (abs(s) * np.linalg.norm(x)))

    def _rest(self, s: complex, x: ComplexArray, y: ComplexArray) -> tuple[ComplexArray, complex]:
        """T(s) x and y' T'(s) x."""
        M, dM = self._exact(s)
        rest = s * x - self.plant.times(x) - self._B @ (M @ (self._C @ x))
        return np.asarray(rest), complex(y @ x - (y @ self._B) @ dM @ (self._C @ x))

    def _towards(self, open_loop: Shifted, x: ComplexArray) -> ComplexArray:
        """T^-1 T' x, of size 1."""
        _, dM = self._exact(open_loop.s)
        x = self._solve(open_loop, x - self._B @ (dM @ (self._C @ x)))
        return np.asarray(x / np.linalg.norm(x))

    def _solve(self, open_loop: Shifted, b: ComplexArray) -> ComplexArray:
        """T^-1 b by the open loop's resolvent."""
        M, _ = self._exact(open_loop.s)
        reach, free = open_loop.solve(self._B), open_loop.solve(b)
        u = np.linalg.solve(np.eye(len(M)) - M @ (self._C @ reach), M @ (self._C @ free))
        return np.asarray(free + reach @ u)

    def _towards_left(self, open_loop: Shifted, y: ComplexArray) -> ComplexArray:
        M, dM = self._exact(open_loop.s)
        seen = open_loop.solve_left(self._C.T)
        free = open_loop.solve_left(y - self._C.T @ (dM.T @ (self._B.T @ y)))
        v = np.linalg.solve(np.eye(M.shape[1]) - M.T @ (self._B.T @ seen), M.T @ (self._B.T @ free))
        y = free + seen @ v
        return np.asarray(y / np.linalg.norm(y))

    def _exact(self, s: complex) -> tuple[ComplexArray, ComplexArray]:
        """M(s) (actuators, signals) and its derivative."""
        A, B, C, D = self._K
        inner = np.linalg.solve(s * np.eye(len(A)) - A, np.hstack([B, np.eye(len(A))]))
        K, dK = C @ inner[:, : B.shape[1]] + D, -C @ inner[:, B.shape[1] :] @ inner[:, : B.shape[1]]
        late = np.exp(-s * self.latency_s)
        dM = dK * late - K * late * self.latency_s
        return np.asarray(K * late, dtype=complex), np.asarray(dM, dtype=complex)


class ShiftedLoop:
    """(s - matrix)^-1 of a loop with Padé models, by the open loop's resolvent and one small solution."""

    def __init__(self, loop: LatePlant, s: complex) -> None:
        self._loop, self._n = loop, loop.plant.nstates
        A, B, C, D = loop._M
        self._open = Shifted(loop.plant, s)
        self._inner = np.linalg.inv(s * np.eye(len(A)) - A)
        self._gain = C @ self._inner @ B + D
        self._reach, self._seen = self._open.solve(loop._B), self._open.solve_left(loop._C.T)
        m, p = self._gain.shape
        self._out = np.linalg.inv(np.eye(m) - self._gain @ (loop._C @ self._reach))
        self._back = np.linalg.inv(np.eye(p) - self._gain.T @ (loop._B.T @ self._seen))

    def solve(self, b: npt.NDArray[Any]) -> ComplexArray:
        """Return (s - matrix)^-1 b."""
        _, B, C, _ = self._loop._M
        free, inner = self._open.solve(b[: self._n]), self._inner @ b[self._n :]
        u = self._out @ (self._gain @ (self._loop._C @ free) + C @ inner)
        x = free + self._reach @ u
        return np.concatenate([x, inner + self._inner @ (B @ (self._loop._C @ x))])

    def solve_left(self, c: npt.NDArray[Any]) -> ComplexArray:
        """Return (s - matrix)^-T c."""
        _, B, C, _ = self._loop._M
        free, inner = self._open.solve_left(c[: self._n]), self._inner.T @ c[self._n :]
        v = self._back @ (self._gain.T @ (self._loop._B.T @ free) + B.T @ inner)
        y = free + self._seen @ v
        return np.concatenate([y, inner + self._inner.T @ (C.T @ (self._loop._B.T @ y))])
