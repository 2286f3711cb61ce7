"""The matrix pencil: poles and amplitudes of decaying oscillations in sampled signals (Hua and Sarkar 1990).

The windows of the signals side by side are a Hankel matrix H, whose left singular vectors span what the
oscillations span; shifting that space by one sample has the poles as eigenvalues. The space is found from
H H^T, which takes no product of matrices: along a diagonal each entry follows from the one before it.

`refined` goes on from such poles where signals ring irregularly: variable projection with a robust loss. A
matrix pencil takes every jolt that a lost packet gives for part of a mode. There the number of modes is
given; their poles alone are varied, the amplitudes follow by least squares (Golub and Pereyra 1973), and
a misfit counts by its size, not its square, once it is larger than most (soft L1).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
_MOST_SECONDS_LEFT = 12.0  # 1/s: decay and growth that a window can show
_SPREAD = 1.4826  # of a normal distribution over its median deviation
_LEAST_SQUARED = 1e-6  #: rank tolerance down to which the squared Hankel matrix is exact enough
_FEW = 96  #: columns up to which a factor of low rank is quicker than all eigenvectors


def windows_product(data: Array, rows: int) -> Array:
    """Return H H^T in the upper triangle of a (rows, rows) array; below the diagonal it means nothing.

    data : (points, signals). H has, for each signal, all windows of `rows` points as columns. Entry
    (i + 1, j + 1) is entry (i, j) without the products that leave the window and with those that enter it.
    """
    n, columns = rows, len(data) - rows + 1
    flat = np.zeros(n * (n + 1))
    diagonals = flat.reshape(n, n + 1)  # [i, d] is entry (i, i + d) of the same memory read as n x n
    for x in data.T:
        diagonals[0, :n] += np.correlate(x, x[:columns], "valid")
    leave, enter = data[: n - 1], data[columns:]
    change = flat[n + 1 :].reshape(n - 1, n + 1).ravel()[: (n - 1) * n].reshape(n - 1, n)
    np.matmul(np.hstack([enter, leave]), np.hstack([enter, -leave]).T, out=change[:, : n - 1])
    np.cumsum(diagonals, axis=0, out=diagonals)
    return flat[: n * n].reshape(n, n)


def signal_space(data: Array, rows: int, rank_tolerance: float, max_order: int) -> Array:
    """Return the left singular vectors of the Hankel matrix of `data` above the tolerance, (rows, order).

    order : at least 1, at most `max_order`. The spectrum falls fast: a pivoted Cholesky factor of H H^T has
    few columns, and the singular vectors are taken of that.
    """
    if rank_tolerance < _LEAST_SQUARED:  # squaring the matrix would drown what is that small
        windows = np.lib.stride_tricks.sliding_window_view(data, rows, axis=0)
        left, sigma, _ = np.linalg.svd(windows.transpose(2, 1, 0).reshape(rows, -1), full_matrices=False)
        return np.asarray(left[:, : _order(sigma, rank_tolerance, max_order)])
    product = windows_product(data, rows)
    floor = 16.0 * np.finfo(float).eps * float(np.max(np.diagonal(product)))
    factor, pivots, rank, _ = lapack.dpstrf(product.T, tol=floor, lower=1)
    if not 0 < rank <= _FEW:
        values, vectors = np.linalg.eigh(product.T, UPLO="L")
        sigma = np.sqrt(np.maximum(values[::-1], 0.0))
        return np.asarray(vectors[:, ::-1][:, : _order(sigma, rank_tolerance, max_order)])
    columns = np.empty((rows, rank))
    columns[pivots - 1] = np.tril(factor[:, :rank])
    basis, triangle = np.linalg.qr(columns)
    left, sigma, _ = np.linalg.svd(triangle)
    return np.asarray(basis @ left[:, : _order(sigma, rank_tolerance, max_order)])


def _order(sigma: Array, rank_tolerance: float, max_order: int) -> int:
    return max(1, min(int(np.sum(sigma > rank_tolerance * sigma[0])), max_order))


def shift_of(basis: Array) -> Array:
    """Return the matrix that shifts an orthonormal basis by one row, by least squares."""
    last = basis[-1]
    rest = 1.0 - float(last @ last)
    if rest > 1e-8:  # the inverse of basis[:-1]^T basis[:-1] = I - last last^T in closed form
        product = basis[:-1].T @ basis[1:]
        return np.asarray(product + np.outer(last, last @ product) / rest)
    return np.asarray(np.linalg.lstsq(basis[:-1], basis[1:], rcond=None)[0])


def poles_of(basis: Array, step_s: float) -> npt.NDArray[np.complex128]:
    """Return the poles in rad/s that a signal space holds, of each conjugate pair the upper one."""
    discrete = np.linalg.eigvals(shift_of(basis)).astype(complex)
    return np.asarray(np.log(discrete[(np.abs(discrete) > 1e-6) & (discrete.imag >= 0.0)]) / step_s)


def amplitudes_of(
    time_s: Array, values: Array, poles: npt.NDArray[np.complex128]
) -> tuple[npt.NDArray[np.complex128], Array]:
    """Return the complex amplitude of each pole in each signal, (poles, signals), and the misfit.

    values : (points, signals), taken as sums of Re(amplitude exp(pole (t - t_0))), by least squares.
    """
    powers = np.exp(np.outer(time_s - time_s[0], poles))
    swings = np.flatnonzero(poles.imag != 0.0)
    basis = np.hstack([powers.real, -powers.imag[:, swings]])
    orthogonal, triangle = np.linalg.qr(basis)
    parts: Any = np.linalg.lstsq(triangle, orthogonal.T @ values, rcond=None)[0]
    amplitudes = parts[: len(poles)].astype(complex)
    amplitudes[swings] += 1j * parts[len(poles) :]
    return amplitudes, values - basis @ parts


def refined(time_s: Array, values: Array, poles: ComplexArray) -> ComplexArray:
    """Return poles near `poles` (upper halves of pairs, rad/s) with which the signals are fitted best.

    values : (points, signals), each of like size.
    """
    from scipy.optimize import least_squares  # takes .3 s; most runs need no refining

    if not poles.size:
        return poles
    swinging = poles.imag > 0.0
    largest = 0.95 * np.pi / (time_s[1] - time_s[0])

    def poles_at(x: Array) -> ComplexArray:
        result = x[: poles.size].astype(complex)
        result[swinging] += 1j * x[poles.size :]
        return result

    def misfit(x: Array) -> Array:
        return np.asarray(amplitudes_of(time_s, values, poles_at(x))[1].ravel())

    low = np.concatenate([np.full(poles.size, -_MOST_SECONDS_LEFT), np.full(int(swinging.sum()), 1e-3)])
    high = np.concatenate([np.full(poles.size, 3.0), np.full(int(swinging.sum()), largest)])
    start = np.clip(np.concatenate([poles.real, poles.imag[swinging]]), low + 1e-6, high - 1e-6)
    scale = _SPREAD * float(np.median(np.abs(misfit(start))))
    if not scale > 0.0:
        return poles
    fit = least_squares(
        misfit, start, bounds=(low, high), loss="soft_l1", f_scale=scale, x_scale="jac", max_nfev=60
    )
    return poles_at(fit.x)
