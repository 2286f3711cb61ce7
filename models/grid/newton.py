"""Newton's method for power flows in polar form, with the exact sparse Jacobian."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import splu

_ROUNDING = 1e-14  #: of the powers that cancel in a mismatch, relative to the largest admittance

ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.int_]


@dataclass(frozen=True)
class Iterate:
    """The best voltages of Newton's method.

    voltages, off : (buses,) pu; `off` is the power into the network minus the scheduled one.
    mismatch_pu : largest `off` in P at free angles and in Q at free magnitudes.
    """

    voltages: ComplexArray
    off: ComplexArray
    iteration: int
    mismatch_pu: float
    converged: bool

    def at_bus(self, free_angle: IntArray, free_magnitude: IntArray) -> npt.NDArray[np.float64]:
        """Return the mismatch at each bus, (buses,): the larger of P and Q where they are scheduled."""
        size = np.zeros(len(self.off))
        size[free_angle] = np.abs(self.off.real[free_angle])
        size[free_magnitude] = np.maximum(size[free_magnitude], np.abs(self.off.imag[free_magnitude]))
        return size


def newton(
    Y: Any,
    start: npt.ArrayLike,
    scheduled: npt.ArrayLike,
    free_angle: IntArray,
    free_magnitude: IntArray,
    *,
    current: npt.ArrayLike | float = 0.0,
    tolerance_pu: float = 1e-10,
    most: int = 40,
) -> Iterate | None:
    r"""Solve :math:`V \circ (YV)^* = S_0 + S_1 |V|` for V at the scheduled positions, from `start`.

    With :math:`S = V \circ (YV)^*` the step uses

    .. math::
        \partial S/\partial\theta = j\,\mathrm{diag}(V)\,(\mathrm{diag}(I) - Y\,\mathrm{diag}(V))^*, \qquad
        \partial S/\partial|V| = \mathrm{diag}(V)\,(Y\,\mathrm{diag}(\hat V))^* + \mathrm{diag}(I^*\hat V).

    Y : sparse (n, n). start : (n,) voltages. scheduled : (n,) constant power S0 into the network, pu.
    free_angle, free_magnitude : positions whose P, Q are scheduled. current : (n,) S1, proportional to the
    voltage magnitude (constant current). Steps are halved up to four times while the mismatch grows. Returns
    None if the start is not finite. After convergence it continues while the mismatch falls. Branches of very
    small impedance raise the tolerance to the rounding error of their currents.
    """
    Y = sparse.csr_matrix(Y)
    tolerance_pu = max(tolerance_pu, _ROUNDING * float(np.max(np.abs(Y.data), initial=0.0)))
    V = np.asarray(start, dtype=complex)
    magnitude, angle = np.abs(V), np.angle(V)
    fixed = np.asarray(scheduled, dtype=complex)
    linear = np.broadcast_to(np.asarray(current, dtype=complex), fixed.shape)

    def residual(magnitude: Any, angle: Any) -> tuple[ComplexArray, ComplexArray, Any, float]:
        V = magnitude * np.exp(1j * angle)
        off = V * np.conj(Y @ V) - fixed - linear * magnitude
        values = np.concatenate([off.real[free_angle], off.imag[free_magnitude]])
        return V, off, values, float(np.max(np.abs(values), initial=0.0))

    with np.errstate(all="ignore"):
        V, off, values, worst = residual(magnitude, angle)
        if not np.isfinite(worst):
            return None
        best = Iterate(V, off, 0, worst, worst <= tolerance_pu)
        for iteration in range(1, most + 1):
            if worst == 0.0:
                break
            try:
                step = splu(_jacobian(Y, V, linear, free_angle, free_magnitude)).solve(values)
            except RuntimeError:  # exactly singular
                break
            share = 1.0
            for _ in range(5):
                new_angle, new_magnitude = angle.copy(), magnitude.copy()
                new_angle[free_angle] -= share * step[: len(free_angle)]
                new_magnitude[free_magnitude] -= share * step[len(free_angle) :]
                trial = residual(new_magnitude, new_angle)
                if np.isfinite(trial[3]) and (trial[3] < 2.0 * worst or best.converged):
                    break
                share *= 0.5
            angle, magnitude = new_angle, new_magnitude
            V, off, values, worst = trial
            if not np.isfinite(worst):
                break
            if best.converged and worst > 0.5 * best.mismatch_pu:
                break  # rounding keeps it from getting better
            if worst < best.mismatch_pu:
                best = Iterate(V, off, iteration, worst, worst <= tolerance_pu)
    return best


def _jacobian(Y: Any, V: ComplexArray, linear: Any, free_angle: IntArray, free_magnitude: IntArray) -> Any:
    current = Y @ V
    unit = V / np.abs(V)
    around = sparse.diags(V)
    by_angle = (1j * around @ (sparse.diags(current) - Y @ around).conj()).tocsr()
    by_magnitude = (
        around @ (Y @ sparse.diags(unit)).conj() + sparse.diags(np.conj(current) * unit - linear)
    ).tocsr()
    n = len(V)
    at_angle, at_magnitude = np.full(n, -1), np.full(n, -1)
    at_angle[free_angle] = np.arange(len(free_angle))
    at_magnitude[free_magnitude] = len(free_angle) + np.arange(len(free_magnitude))
    # entry by entry: of small matrices the slicing and stacking of scipy is most of the time
    rows, columns, values = [], [], []
    for derivatives, at_column in ((by_angle, at_angle), (by_magnitude, at_magnitude)):
        row = np.repeat(np.arange(n), np.diff(derivatives.indptr))
        column = at_column[derivatives.indices]
        for part, at_row in ((derivatives.data.real, at_angle), (derivatives.data.imag, at_magnitude)):
            inside = (at_row[row] >= 0) & (column >= 0)
            rows.append(at_row[row][inside])
            columns.append(column[inside])
            values.append(part[inside])
    size = len(free_angle) + len(free_magnitude)
    where = (np.concatenate(rows), np.concatenate(columns))
    return sparse.csc_matrix((np.concatenate(values), where), shape=(size, size))
