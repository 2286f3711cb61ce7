"""Nesterov-Todd scaling of one Hermitian block, and step lengths in its scaled space.

S > 0 is kept as a matrix, Z = Fz Fz^H > 0 as a factor. With S = Ls Ls^H and the singular
values Fz^H Ls = U D V^H,

    Ri = D^-1/2 U^H Fz^H,   Ri S Ri^H = Ri^-H Z Ri^-1 = D,   G = Ri^H Ri,   G S G = Z,

so that both matrices become the same diagonal D without solving a triangular system.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.linalg
from scipy.linalg import lapack

from ..problem import Matrix
from .operators import Vector


def hermitian(M: Matrix) -> Matrix:
    """Return the Hermitian part of M."""
    H: Matrix = M + M.conj().T
    H *= 0.5
    return H


def cholesky(M: Matrix) -> Matrix | None:
    """Return lower L with M = L L^H, or None where M is not numerically positive definite."""
    potrf = lapack.zpotrf if M.dtype == np.complex128 else lapack.dpotrf
    L, info = potrf(M, lower=1, clean=1)
    return L if info == 0 and np.isfinite(L[-1, -1]) else None


def distance(L: Matrix, change: Matrix) -> float:
    """Return the Frobenius norm of L^-1 change L^-H: how far `change` moves L L^H, relative to it."""
    half = scipy.linalg.solve_triangular(L, change, lower=True, check_finite=False)
    whole = scipy.linalg.solve_triangular(L, half.conj().T, lower=True, check_finite=False)
    return float(np.linalg.norm(whole))


class Scaling:
    """The scaling Ri, D of a pair S = Ls Ls^H, Z = Fz Fz^H."""

    def __init__(self, Ls: Matrix, Fz: Matrix) -> None:
        U, D, _ = np.linalg.svd(Fz.conj().T @ Ls)
        self.D: Vector = np.maximum(D, D[0] * 1e-16 + 1e-300)
        root = np.sqrt(self.D)
        self.Ri: Matrix = (U / root).conj().T @ Fz.conj().T
        self.G: Matrix = hermitian(self.Ri.conj().T @ self.Ri)
        self._inverse_roots: Vector = 1.0 / root
        self._weights: Vector = 2.0 / (self.D[:, None] + self.D[None, :])

    def scale(self, dS: Matrix) -> Matrix:
        """Return Ri dS Ri^H."""
        return hermitian(self.Ri @ dS @ self.Ri.conj().T)

    def unscale(self, dz: Matrix) -> Matrix:
        """Return Ri^H dz Ri."""
        return hermitian(self.Ri.conj().T @ dz @ self.Ri)

    def target(self, centre: float, cross: Matrix | None) -> Matrix:
        """Return K = D \\ (centre I - D^2 - cross), with (D \\ M)_ij = 2 M_ij / (d_i + d_j)."""
        K: Matrix = np.diag(centre / self.D - self.D).astype(self.Ri.dtype)
        if cross is not None:
            K -= cross * self._weights
        return K

    def product(self, ds: Matrix, dz: Matrix) -> float:
        """Return <D + ds, D + dz>."""
        diagonal = float(self.D @ self.D + self.D @ (np.diagonal(ds) + np.diagonal(dz)).real)
        return diagonal + inner(ds, dz)

    def centring(self, ds: Matrix, dz: Matrix, centre: float) -> Matrix:
        """Return D \\ T, with T moving the eigenvalues of sym((D + ds)(D + dz)) towards [.3, 3] centre."""
        one, other = ds.copy(), dz.copy()
        diagonal = np.diag_indices_from(one)
        one[diagonal] += self.D
        other[diagonal] += self.D
        values, vectors = np.linalg.eigh(hermitian(one @ other))
        moves = np.maximum(np.clip(values, 0.3 * centre, 3.0 * centre) - values, -3.0 * centre)
        corrected: Matrix = ((vectors * moves) @ vectors.conj().T) * self._weights
        return corrected

    def longest_step(self, direction: Matrix) -> float:
        """Return the largest a with D + a direction >= 0 (inf where there is no end)."""
        scaled = direction * self._inverse_roots[:, None] * self._inverse_roots[None, :]
        if not np.all(np.isfinite(scaled)):
            return 0.0
        lowest = float(np.linalg.eigvalsh(scaled)[0])
        return -1.0 / lowest if lowest < 0.0 else float("inf")

    def updated_factor(self, step: float, dz: Matrix) -> Matrix | None:
        """Return the factor of Z + step dZ, or None where it is not positive definite."""
        moved = step * dz
        moved[np.diag_indices_from(moved)] += self.D
        L = cholesky(moved)
        return None if L is None else self.Ri.conj().T @ L


def inner(A: npt.ArrayLike, B: npt.ArrayLike) -> float:
    """Return Re trace(A^H B)."""
    return float(np.vdot(np.asarray(A), np.asarray(B)).real)
