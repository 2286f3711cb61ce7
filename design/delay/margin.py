"""Exact delay margins by loop crossing: where the loop, cut at the delayed signals, has gain one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import schur
from scipy.optimize import brentq, minimize_scalar

from ..linear.matrices import decays
from .characteristic_roots import DelayedLoop, DelayError, rightmost_roots

Matrix = NDArray[np.float64]
ComplexMatrix = NDArray[np.complex128]

_HALF = np.geomspace(0.02, 50.0, 14)
_SPREAD = np.concatenate([-_HALF, [0.0], _HALF])  # of frequencies around a resonance, in its half widths


@dataclass(frozen=True)
class DelayMargin:
    """First contact with the stability limit.

    Attributes
    ----------
    margin_s : smallest destabilising common latency, s; infinite if none up to `searched_s`.
    frequency_rad : where the roots touch the axis, rad/s; nan without a contact.
    crossings : (latency s, frequency rad/s) of all first contacts of each crossing frequency, sorted.
    """

    margin_s: float
    frequency_rad: float
    crossings: tuple[tuple[float, float], ...]
    searched_s: float


def delay_margin_of(loop: DelayedLoop, signals: tuple[str, ...], *, upto_s: float = 10.0) -> DelayMargin:
    r"""Exact delay margin of a loop for a common latency of `signals`, by loop crossing.

    Cut the loop at the moving signals; with the others closed, :math:`L(j\omega)` is what comes back. A root
    lies on the axis at latency tau exactly when an eigenvalue :math:`\mu` of :math:`L(j\omega)` is
    :math:`e^{j\omega\tau}`: so :math:`|\mu(\omega_c)| = 1` and
    :math:`\tau = (\arg \mu \bmod 2\pi)/\omega_c`. The smallest one is the margin: below it no root
    touches the axis. Crossings are bracketed on a grid that resolves every resonance of the cut and
    of the closed loop and refined to rounding.

    Raises
    ------
    DelayError : the loop is not stable at latency 0 of `signals`.
    """
    moving = [ch for ch in loop.balanced().channels if ch.name in signals]
    others = replace(
        loop.balanced(), channels=tuple(c for c in loop.balanced().channels if c.name not in signals)
    )
    start = rightmost_roots(loop.at(dict.fromkeys(signals, 0.0)), right_of=0.0, least=1)
    if not decays(start[0]):
        raise DelayError(
            f"the loop is not stable without latency: rightmost root {start[0]:.4g}; it has no delay margin"
        )
    if not moving:
        return DelayMargin(float("inf"), float("nan"), (), upto_s)
    Bs, Cs = np.column_stack([ch.b for ch in moving]), np.vstack([ch.c for ch in moving])

    def sizes(omega: float) -> tuple[Matrix, ComplexMatrix]:
        mu = np.linalg.eigvals(Cs @ np.linalg.solve(others.characteristic(1j * omega)[0], Bs)).astype(complex)
        order = np.argsort(-np.abs(mu))
        return np.abs(mu)[order], mu[order]

    poles = np.concatenate([np.linalg.eigvals(M) for M in (others.undelayed(), loop.undelayed())])
    highest = 3.0 * max(10.0, float(np.max(np.abs(poles))))
    grid = resonance_grid(poles, min(1e-3, 0.1 / max(upto_s, 1.0)), highest)
    table = _sizes_on(grid, others, Bs, Cs)
    names: set[tuple[float, float]] = set()
    for branch in range(table.shape[1]):

        def excess(omega: float, branch: int = branch) -> float:
            return float(sizes(omega)[0][branch]) - 1.0

        for w in unit_crossings(excess, grid, table[:, branch] - 1.0):
            angle = float(np.angle(sizes(w)[1][branch])) % (2.0 * np.pi)
            names.add((angle / w, w))
    crossings = tuple(sorted(c for c in names if c[0] <= upto_s))
    if not crossings:
        return DelayMargin(float("inf"), float("nan"), (), upto_s)
    return DelayMargin(crossings[0][0], crossings[0][1], crossings, upto_s)


def _sizes_on(grid: Matrix, others: DelayedLoop, Bs: Matrix, Cs: Matrix) -> Matrix:
    """Sizes (len(grid), k) of the eigenvalues of the cut loop, largest first, from one Schur form.

    The plant's response between the cut's and the closed signals' ends is taken first, at all frequencies
    together; the closed signals with their latencies are then a small equation at each.
    """
    B = np.column_stack([Bs, *(ch.b for ch in others.channels)])
    C = np.vstack([Cs, *(ch.c for ch in others.channels)])
    T, U = schur(others.A0, output="complex")
    x = np.empty((len(T), grid.size, B.shape[1]), dtype=complex)
    right = (U.conj().T @ B)[:, None, :]
    for i in reversed(range(len(T))):
        x[i] = (right[i] + np.tensordot(T[i, i + 1 :], x[i + 1 :], 1)) / (1j * grid - T[i, i])[:, None]
    G = np.moveaxis(np.tensordot(C @ U, x, 1), 1, 0)
    k = Bs.shape[1]
    late = np.array([ch.latency_s for ch in others.channels])
    returned = G[:, k:, k:] * np.exp(-1j * grid[:, None] * late)[:, None, :]
    inside = np.linalg.solve(np.eye(late.size) - returned, G[:, k:, :k])
    cut = G[:, :k, :k] + (G[:, :k, k:] * np.exp(-1j * grid[:, None] * late)[:, None, :]) @ inside
    return np.sort(np.abs(np.linalg.eigvals(cut)), axis=1)[:, ::-1]


def resonance_grid(poles: ComplexMatrix, lowest: float, highest: float) -> Matrix:
    """Return frequencies from `lowest` to `highest` (rad/s) that resolve the resonances of `poles` (1/s)."""
    around = (poles.imag[:, None] + np.abs(poles.real)[:, None] * _SPREAD).ravel()
    grid = np.concatenate([np.geomspace(lowest, highest, 600), around, np.arange(0.05, 40.0, 0.05)])
    return np.unique(grid[(grid >= lowest) & (grid <= highest)])


def unit_crossings(f: Callable[[float], float], grid: Matrix, values: Matrix) -> list[float]:
    """Zeros of f between grid points, peaks that rise above zero between them included."""
    zeros = []
    for k in range(grid.size - 1):
        if values[k] == 0.0:
            zeros.append(float(grid[k]))
        elif values[k] * values[k + 1] < 0.0:
            zeros.append(brentq(f, grid[k], grid[k + 1], xtol=1e-14, rtol=1e-14))
    for k in range(1, grid.size - 1):
        if -0.2 < values[k] < 0.0 and values[k] >= max(values[k - 1], values[k + 1]):
            peak = minimize_scalar(
                lambda w: -f(w), bounds=(grid[k - 1], grid[k + 1]), method="bounded", options={"xatol": 1e-12}
            )
            if -peak.fun > 0.0:
                zeros += [
                    brentq(f, grid[k - 1], peak.x, xtol=1e-14, rtol=1e-14),
                    brentq(f, peak.x, grid[k + 1], xtol=1e-14, rtol=1e-14),
                ]
    return zeros
