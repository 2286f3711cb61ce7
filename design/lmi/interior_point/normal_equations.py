"""The normal equations H dy = right of an interior-point step: one factor, then conjugate gradients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import blas, lapack

from ..problem import Matrix, Problem
from .operators import AffineMap, Vector
from .schur import SchurComplement

#: Added to the diagonal of H, relative, until its Cholesky factor exists.
_SHIFTS = (0.0, 1e-15, 1e-13, 1e-11, 1e-9, 1e-7)


class NormalEquations:
    """H = F*(G F(.) G) with its Cholesky factor.

    Solutions are refined by conjugate gradients: on H, and once `careful` on the operator
    F*(G F(.) G) itself. On regular problems both agree; where the optimum is approached only by
    growing variables, the rounding in forming H would keep F*(Z) away from c.
    """

    def __init__(self, problem: Problem, affine: AffineMap) -> None:
        self._affine = affine
        self._schur = SchurComplement(problem, affine)
        self._factored = np.empty_like(self._schur.H)
        self.careful = False
        self.used = np.ones(affine.m, bool)  #: coordinates that some block contains

    def factor(self, roots: Sequence[Matrix], metrics: Sequence[Matrix]) -> bool:
        """Form and factor H for Ri_k and G_k; False where it has no factor even with the largest shift."""
        self._roots = roots
        H = self._schur.form(roots, metrics)
        diagonal = H.ravel()[:: self._affine.m + 1]
        diagonal[~self.used] = 1.0
        if not np.all(np.isfinite(diagonal)) or np.any(diagonal <= 0.0):
            return False
        self._weights = 1.0 / np.sqrt(diagonal)
        for shift in _SHIFTS:
            np.copyto(self._factored, H)
            self._factored.ravel()[:: self._affine.m + 1] *= 1.0 + shift
            _, info = lapack.dpotrf(self._factored.T, lower=1, clean=0, overwrite_a=1)
            if info == 0:
                return True
        return False

    def _apply(self, x: Vector) -> Vector:
        product: Vector
        if not self.careful:
            product = blas.dsymv(1.0, self._schur.H.T, x, lower=1)
            return product
        moved = zip(self._roots, self._affine.apply(x), strict=True)
        product = self._affine.adjoint([R.conj().T @ (R @ F @ R.conj().T) @ R for R, F in moved])
        product[~self.used] = x[~self.used]
        return product

    def _precondition(self, r: Vector) -> Vector:
        half = blas.dtrsv(self._factored.T, r, lower=1)
        x: Vector = blas.dtrsv(self._factored.T, half, lower=1, trans=1, overwrite_x=1)
        return x

    def solve(self, right: Vector, accuracy: float = 1e-12) -> Vector:
        """Solve H dy = right by a few conjugate-gradient steps, preconditioned by the factor.

        `accuracy` is relative, in the norm that scales H to a unit diagonal.
        """
        x = self._precondition(right)
        r = right - self._apply(x)
        requested = accuracy * float(np.linalg.norm(right * self._weights))
        p, last = r, 0.0
        for _ in range(15 if self.careful else 3):
            if not float(np.linalg.norm(r * self._weights)) > requested:
                break
            z = self._precondition(r)
            rz = float(r @ z)
            p = z + (rz / last) * p if last else z
            q = self._apply(p)
            curvature = float(p @ q)
            if not (rz > 0.0 and curvature > 0.0 and np.isfinite(rz) and np.isfinite(curvature)):
                break
            step = rz / curvature
            x, r, last = x + step * p, r - step * q, rz
        return x
