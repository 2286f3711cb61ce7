"""One run of the interior-point iteration: directions, step lengths, stopping, what it proves."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..problem import Matrix, Problem, Solution
from .normal_equations import NormalEquations
from .operators import AffineMap, Vector
from .scaling import Scaling, cholesky, distance, inner

#: An infeasibility certificate must exclude every y whose entries stay below this size.
_LEAST_RADIUS = 1e8


@dataclass(frozen=True)
class Progress:
    """One iteration, as a `callback` receives it; returning True from the callback stops the engine."""

    iteration: int
    objective: float  #: c'y
    gap: float  #: <S, Z> / (1 + |c'y|)
    primal_residual: float  #: ||C + F(y) - S|| relative to its start; 0 once y is strictly feasible
    dual_residual: float  #: sum |c - F*(Z)|_i |y_i| / (1 + |c'y|)
    step: tuple[float, float]  #: primal and dual step lengths


@dataclass(frozen=True)
class _Point:
    """Where an iteration begins."""

    Z: list[Matrix]
    gradient: Vector  #: F*(Z)
    rp: Vector  #: c - F*(Z)
    Rd: list[Matrix]  #: C + F(y) - S
    objective: float  #: c'y
    complementarity: float  #: <S, Z>

    @property
    def scale(self) -> float:
        return 1.0 + abs(self.objective)


class Iteration:
    """The interior-point iteration on one problem, from y = 0 or from a strictly feasible `start`."""

    def __init__(
        self,
        problem: Problem,
        tolerance: float,
        max_iterations: int,
        callback: Callable[[Progress], bool | None] | None,
        start: Vector | None = None,
    ) -> None:
        self.started = time.perf_counter()
        self.problem, self.tolerance, self.max_iterations = problem, tolerance, max_iterations
        self.callback = callback
        self.affine = AffineMap(problem)
        self.normal = NormalEquations(problem, self.affine)
        self.C, self.c = self.affine.constants, self.affine.cost
        self.degree = float(sum(self.affine.sizes))
        # Further centrality correctors pay where a factor costs much more than a solve.
        self.correctors = 2 if self.affine.m > 1000 else 0
        self._start()
        if start is not None:
            self.y = start
            self._use_exact()

    def _start(self) -> None:
        """Start at y = 0, S = eta I, and Z next to the least multipliers with F*(Z) = c."""
        norms = self.affine.column_norms()
        self.used = self.normal.used = sum((n > 0.0 for n in norms), np.zeros(self.affine.m, bool))
        self.y = np.zeros(self.affine.m)
        self.S: list[Matrix] = []
        self.Ls: list[Matrix] = []
        for C, size, column in zip(self.C, self.affine.sizes, norms, strict=True):
            eta = max(10.0, np.sqrt(size), float(column.max(initial=0.0)), float(np.linalg.norm(C)))
            self.S.append(eta * np.eye(size, dtype=C.dtype))
            self.Ls.append(np.sqrt(eta) * np.eye(size, dtype=C.dtype))
        self.stopped, self.verdict, self.radius = False, "", 0.0
        self.stale = 0  # iterations in which the bound has not risen
        self.short = self.stalled = 0  # short steps in a row, short ones before y is feasible
        self.bound = -np.inf  # best lower bound of the objective by the multipliers so far
        self.exact = False  # S is C + F(y) to the last digit
        self.Fz = self._start_multipliers(norms)

    def _start_multipliers(self, norms: list[Vector]) -> list[Matrix]:
        """Return factors of F(w) + xi I: least-norm solution of F*(Z) = c, xi well past its spectrum."""
        identities: list[Matrix] = [
            np.eye(d, dtype=C.dtype) for d, C in zip(self.affine.sizes, self.C, strict=True)
        ]
        if np.any(self.c) and self.normal.factor(identities, identities):
            least = self.affine.apply(self.normal.solve(self.c, 1e-8))
            spectra = [np.linalg.eigvalsh(M) for M in least]
            lowest = min(float(w[0]) for w in spectra)
            largest = max(float(np.abs(w).max()) for w in spectra)
            xi = max(-5.0 * lowest, 0.01 * largest)
            factors = _all_factors([cholesky(M + xi * one) for M, one in zip(least, identities, strict=True)])
            if xi > 0.0 and factors is not None:
                return factors
        starts = []
        for one, column in zip(identities, norms, strict=True):
            ratio = (1.0 + np.abs(self.c)) / (1.0 + column)
            root = np.sqrt(len(one))
            starts.append(np.sqrt(max(10.0, root, root * float(ratio[column > 0.0].max(initial=0.0)))) * one)
        return starts

    # -- one iteration ---------------------------------------------------------------------------

    def solve(self) -> Solution:
        """Iterate until optimal, infeasible, or no further progress."""
        idle = np.flatnonzero(~self.used & (self.c != 0.0))
        if idle.size:
            return self._finish(
                "failed", 0, "the objective is unbounded: it moves coordinates that no block contains"
            )
        self.start_residual = 1.0 + self._residual_norm()
        expected = self.c
        for iteration in range(1, self.max_iterations + 1):
            at = self._point()
            if not 0.0 < at.complementarity < np.inf:
                break
            self._measure(at, expected if iteration > 1 else None)
            if self.exact and self._is_optimal(at):
                return self._finish("optimal", iteration - 1, "", at.Z)
            if self._has_stalled():
                break
            scalings = self._scalings()
            if scalings is None:
                break
            certificate = None if self.exact else self._infeasible(at, scalings)
            if certificate is not None:
                return self._finish("infeasible", iteration, self.verdict, certificate)
            step = self._step(scalings, at)
            if step is None:
                break
            expected = (1.0 - step[1]) * at.rp
            if self._stands_still(iteration, step) or self._is_stopped(iteration, at.objective, step):
                break
        return self._give_up(iteration)

    def _scalings(self) -> list[Scaling] | None:
        """Scale to S and Z and factor the normal equations; None where they have no factor."""
        scalings = [Scaling(Ls, Fz) for Ls, Fz in zip(self.Ls, self.Fz, strict=True)]
        result = self.normal.factor([s.Ri for s in scalings], [s.G for s in scalings])
        return scalings if result else None

    def _point(self) -> _Point:
        Z = [F @ F.conj().T for F in self.Fz]
        gradient = self.affine.adjoint(Z)
        return _Point(
            Z,
            gradient,
            rp=self.c - gradient,
            Rd=self._primal_residual(),
            objective=float(self.c @ self.y),
            complementarity=sum(inner(S, W) for S, W in zip(self.S, Z, strict=True)),
        )

    def _measure(self, at: _Point, expected: Vector | None) -> None:
        """Set gap and infeasibility; be careful from now on where the last step left another residual of
        F*(Z) = c.

        expected : what it should have left; None before the first step.
        """
        size = np.abs(self.y)
        self.gap = at.complementarity / at.scale
        self.infeasibility = float(np.abs(at.rp) @ size) / at.scale
        if expected is not None and float(np.abs(at.rp - expected) @ size) > self.tolerance * at.scale:
            self.normal.careful = True

    def _infeasible(self, at: _Point, scalings: list[Scaling]) -> list[Matrix] | None:
        """Return multipliers that prove that no y is feasible, if there are any by now."""
        self.radius = max(self.radius, self.excluded_radius(at.Z))
        return self.farkas(at.Z) or self._certificate(scalings, at.Z, at.gradient)

    def _has_stalled(self) -> bool:
        """Return whether the gap is small and the lower bound has ceased to rise."""
        return self.exact and self.gap < self.tolerance and self.stale >= 3

    def _is_optimal(self, at: _Point) -> bool:
        """Raise the lower bound; return whether gap and multipliers are within the tolerance."""
        objective, scale = at.objective, at.scale
        # <C, Z> < 0 here; the bound holds in as far as the optimal |y| is not beyond this one
        bound = objective - (self.gap + self.infeasibility) * scale
        self.stale = 0 if bound > self.bound + 0.1 * self.tolerance * scale else self.stale + 1
        self.bound = bound if objective < self.bound else max(self.bound, bound)
        return self.gap < self.tolerance and (
            self.infeasibility < 10.0 * self.tolerance
            or objective - self.bound < 11.0 * self.tolerance * scale
        )

    def _stands_still(self, iteration: int, step: tuple[float, float]) -> bool:
        """Return whether steps have been too short for a while."""
        self.short = self.short + 1 if max(step) < 1e-4 or min(step) < 1e-7 else 0
        self.stalled = self.stalled + 1 if not self.exact and step[0] < 2e-3 else 0
        return (self.short >= 3 and iteration >= 12) or self.stalled >= 8

    def _is_stopped(self, iteration: int, objective: float, step: tuple[float, float]) -> bool:
        """Tell the callback; return whether it wants no more."""
        if self.callback is None:
            return False
        residual = self._residual_norm() / self.start_residual
        report = Progress(iteration, objective, self.gap, residual, self.infeasibility, step)
        self.stopped = bool(self.callback(report))
        return self.stopped

    def _primal_residual(self) -> list[Matrix]:
        """Return Rd = C + F(y) - S, zero once S is exact."""
        if self.exact:
            return [np.zeros_like(S) for S in self.S]
        moved = self.affine.apply(self.y)
        return [C + F - S for C, F, S in zip(self.C, moved, self.S, strict=True)]

    def _residual_norm(self) -> float:
        return 0.0 if self.exact else sum(float(np.linalg.norm(R)) for R in self._primal_residual())

    def _step(self, scalings: list[Scaling], at: _Point) -> tuple[float, float] | None:
        """Take a predictor-corrector step; None where the linear algebra has come to its end."""
        rp, Rd, mu = at.rp, at.Rd, at.complementarity / self.degree
        residual = (
            None
            if self.exact
            else self.affine.adjoint([s.G @ R @ s.G for s, R in zip(scalings, Rd, strict=True)])
        )

        def direction(
            targets: list[Matrix], accuracy: float = 1e-12
        ) -> tuple[Vector, list[Matrix], list[Matrix], list[Matrix]]:
            right = self.affine.adjoint([s.unscale(K) for s, K in zip(scalings, targets, strict=True)]) - rp
            if residual is not None:
                right -= residual
            dy = self.normal.solve(right, accuracy)
            dS = self.affine.apply(dy)
            if residual is not None:
                dS = [F + R for F, R in zip(dS, Rd, strict=True)]
            ds = [s.scale(M) for s, M in zip(scalings, dS, strict=True)]
            return dy, dS, ds, [K - d for K, d in zip(targets, ds, strict=True)]

        def lengths(ds: list[Matrix], dz: list[Matrix], share: float) -> tuple[float, float]:
            primal = min(s.longest_step(d) for s, d in zip(scalings, ds, strict=True))
            dual = min(s.longest_step(d) for s, d in zip(scalings, dz, strict=True))
            return min(1.0, share * primal), min(1.0, share * dual)

        _, _, ds, dz = direction([s.target(0.0, None) for s in scalings], 1e-6)
        ap, ad = lengths(ds, dz, 1.0)
        after = sum(s.product(ap * a, ad * b) for s, a, b in zip(scalings, ds, dz, strict=True))
        least = min(ap, ad)
        reached = max(after / self.degree / mu, 0.0)
        # Bold once y is strictly feasible; before, S must not reach its boundary ahead of C + F(y).
        power = max(1.5, 8.0 * least**2) if self.exact else max(1.0, 3.0 * least**2)
        sigma = 0.3 if least < 0.1 else min(1.0, max(1e-6, reached**power))
        crosses = [(a @ b + b @ a) / 2.0 for a, b in zip(ds, dz, strict=True)]
        targets = [s.target(sigma * mu, x) for s, x in zip(scalings, crosses, strict=True)]
        accuracy = 1e-12 if self.exact else 1e-8
        result = direction(targets, accuracy)
        share = min(0.98, 0.9 + 0.09 * least)
        ap, ad = lengths(result[2], result[3], share)
        for _ in range(self.correctors):
            longer = min(1.0, ap + 0.3), min(1.0, ad + 0.3)
            targets = [
                K + s.centring(longer[0] * a, longer[1] * b, sigma * mu)
                for K, s, a, b in zip(targets, scalings, result[2], result[3], strict=True)
            ]
            other = direction(targets, accuracy)
            bp, bd = lengths(other[2], other[3], share)
            if not (bp * bd > 1.02 * ap * ad and min(bp, bd) >= 0.9 * min(ap, ad)):
                break
            result, ap, ad = other, bp, bd
        dy, dS, _, dz = result
        if not np.all(np.isfinite(dy)):
            return None
        return self._move(scalings, dy, dS, dz, ap, ad)

    def _move(
        self, scalings: list[Scaling], dy: Vector, dS: list[Matrix], dz: list[Matrix], ap: float, ad: float
    ) -> tuple[float, float] | None:
        """Move y, S and Z; shorten a step whose end is not numerically positive definite."""
        for _ in range(8):
            y = self.y + ap * dy
            full = self.exact or ap == 1.0
            if full:
                S = [C + F for C, F in zip(self.C, self.affine.apply(y), strict=True)]
            else:
                S = [A + ap * B for A, B in zip(self.S, dS, strict=True)]
            Ls = _all_factors([cholesky(M) for M in S])
            if Ls is not None:
                self.y, self.S, self.exact, self.Ls = y, S, full, Ls
                break
            ap *= 0.8
        else:
            ap = 0.0
        if not self.exact:
            self._close_residual()
        for _ in range(8):
            Fz = _all_factors([s.updated_factor(ad, d) for s, d in zip(scalings, dz, strict=True)])
            if Fz is not None:
                self.Fz = Fz
                break
            ad *= 0.8
        else:
            ad = 0.0
        return None if ap == 0.0 and ad == 0.0 else (ap, ad)

    def _close_residual(self) -> None:
        """Make S exact where C + F(y) lies so close to it that it is as good a point."""
        moved = self.affine.apply(self.y)
        for L, S, C, F in zip(self.Ls, self.S, self.C, moved, strict=True):
            if not distance(L, C + F - S) < 0.1:
                return
        self._use_exact()

    def _use_exact(self) -> None:
        """Let S be C + F(y) from now on if that is positive definite."""
        S = [C + F for C, F in zip(self.C, self.affine.apply(self.y), strict=True)]
        Ls = _all_factors([cholesky(M) for M in S])
        if Ls is not None:
            self.S, self.exact, self.Ls = S, True, Ls

    # -- ends ------------------------------------------------------------------------------------

    def _certificate(self, scalings: list[Scaling], Z: list[Matrix], gradient: Vector) -> list[Matrix] | None:
        """Project Z onto F*(Z) = 0; return it where it proves that no y is feasible.

        The projection in the metric of the scaling, Z - G F(w) G with H w = F*(Z), stays
        positive definite once <C, Z> is far below zero. A feasible y would satisfy
        0 <= <S(y), Z> = <C, Z> + y' F*(Z), so with <C, Z> < 0 what is left of F*(Z) by
        rounding bounds the size below which there is none.
        """
        if not sum(inner(C, W) for C, W in zip(self.C, Z, strict=True)) < 0.0:
            return None
        scaled: list[Matrix] = [np.diag(s.D).astype(C.dtype) for s, C in zip(scalings, self.C, strict=True)]
        projected = Z
        for _ in range(2):
            w = self.normal.solve(gradient)
            if not np.all(np.isfinite(w)):
                return None
            moved = [s.scale(F) for s, F in zip(scalings, self.affine.apply(w), strict=True)]
            scaled = [z - m for z, m in zip(scaled, moved, strict=True)]
            if any(cholesky(z) is None for z in scaled):
                return None
            projected = [s.unscale(z) for s, z in zip(scalings, scaled, strict=True)]
            gradient = self.affine.adjoint(projected)
        return self.farkas(projected)

    def farkas(self, Z: list[Matrix]) -> list[Matrix] | None:
        """Return Z scaled to <C, Z> = -1 where it proves that no y is feasible; `verdict` says how far."""
        if len(Z) != len(self.C) or any(cholesky(W) is None for W in Z):
            return None
        radius = self.excluded_radius(Z)
        if not radius > _LEAST_RADIUS:
            return None
        value = sum(inner(C, W) for C, W in zip(self.C, Z, strict=True))
        self.verdict = (
            "no point satisfies all inequalities: multipliers Z > 0 with <C, Z> = -1 and "
            f"F*(Z) = 0 but for {1.0 / radius:.1e}; a feasible point would need an entry above {radius:.1e}"
        )
        return [W / -value for W in Z]

    def excluded_radius(self, Z: list[Matrix]) -> float:
        """Return R such that Z > 0 excludes a feasible y with all entries below R (0: nothing excluded)."""
        value = sum(inner(C, W) for C, W in zip(self.C, Z, strict=True))
        magnitude = sum(inner(np.abs(C), np.abs(W)) for C, W in zip(self.C, Z, strict=True))
        if not value < -1e-9 * magnitude:
            return 0.0
        residual = float(np.abs(self.affine.adjoint(Z)).sum())
        return -value / residual if residual > 0.0 else float("inf")

    def _give_up(self, iteration: int) -> Solution:
        """End without having reached the tolerance."""
        Z = [F @ F.conj().T for F in self.Fz]
        objective = float(self.c @ self.y)
        if not self.exact:
            text = "no strictly feasible point found, no certificate that there is none"
            if self.radius > 1.0:
                text += f"; a feasible point would need an entry above {self.radius:.1e}"
            return self._finish("failed", iteration, text, Z)
        uncertainty = (objective - self.bound) / (1.0 + abs(objective))
        text = f"strictly feasible, objective within {uncertainty:.1e} relative of a lower bound"
        if self._unbounded(objective):
            return self._finish(
                "failed", iteration, "the objective is unbounded below along the point returned", Z
            )
        if self.gap < 1e3 * self.tolerance:
            if uncertainty > 10.0 * self.tolerance:
                text += f" (gap {self.gap:.1e}); the optimum is approached only by growing variables"
            return self._finish("almost optimal", iteration, text, Z)
        return self._finish("failed", iteration, text, Z)

    def _unbounded(self, objective: float) -> bool:
        """Tell whether y is, next to its size, a direction that stays feasible and lowers the objective."""
        if not objective < -1e6:
            return False
        return all(np.linalg.eigvalsh(F)[0] > 1e-6 * objective for F in self.affine.apply(self.y))

    def _finish(self, status: str, iterations: int, message: str, Z: list[Matrix] | None = None) -> Solution:
        values, scalars = self.affine.unpack(self.y)
        return Solution(
            status=status,
            values=values,
            scalars=scalars,
            objective=float(self.c @ self.y),
            gap=getattr(self, "gap", float("inf")),
            iterations=iterations,
            seconds=time.perf_counter() - self.started,
            engine="structured",
            multipliers=None if Z is None else tuple(Z),
            message=message,
        )


def _all_factors(factors: list[Matrix | None]) -> list[Matrix] | None:
    """Return the factors where there is one for each matrix."""
    rows = [F for F in factors if F is not None]
    return rows if len(rows) == len(factors) else None
