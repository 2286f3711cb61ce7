"""Exact analysis of linear loops with latency: characteristic roots, margins, damping.

The loop is x' = A0 x + sum_i b_i c_i x(t - tau_i). Its roots solve

    det M(s) = 0,   M(s) = s I - A0 - sum_i b_i c_i exp(-s tau_i).

Each delayed signal is a transport line, discretised at Chebyshev nodes: only the signals, not the
states, grow the matrix. Every root is then corrected by Newton's method on M(s) v = 0 itself, so the
discretisation decides only how many roots are found, not how accurate they are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance

from interarea.models.errors import UserError

from ..modes.modes import damping_ratio

Matrix = NDArray[np.float64]
ComplexMatrix = NDArray[np.complex128]


class DelayError(UserError):
    """An analysis that does not apply to this loop, or that did not converge."""


@dataclass(frozen=True)
class DelayedChannel:
    """One signal c x(t - latency) entering through b; b (n,), c (n,)."""

    name: str
    latency_s: float
    b: Matrix
    c: Matrix


@dataclass(frozen=True)
class DelayedLoop:
    """A closed loop with latencies; A0 (n, n)."""

    A0: Matrix
    channels: tuple[DelayedChannel, ...]

    def at(self, latency_s_of: Mapping[str, float]) -> DelayedLoop:
        """The same loop with other latencies on some channels."""
        return replace(
            self,
            channels=tuple(
                replace(ch, latency_s=float(latency_s_of.get(ch.name, ch.latency_s))) for ch in self.channels
            ),
        )

    def balanced(self) -> DelayedLoop:
        """The same loop with states of like size."""
        total = self.A0 + sum((np.outer(ch.b, ch.c) for ch in self.channels), np.zeros_like(self.A0))
        _, (scale, _) = matrix_balance(total, permute=False, separate=True)
        return DelayedLoop(
            self.A0 * scale / scale[:, None],
            tuple(replace(ch, b=ch.b / scale, c=ch.c * scale) for ch in self.channels),
        )

    def undelayed(self) -> Matrix:
        """State matrix of the loop with every latency set to zero."""
        return np.asarray(
            self.A0 + sum((np.outer(ch.b, ch.c) for ch in self.channels), np.zeros_like(self.A0))
        )

    def characteristic(self, s: complex) -> tuple[ComplexMatrix, ComplexMatrix]:
        """M(s) and dM/ds."""
        n = self.A0.shape[0]
        M = s * np.eye(n) - self.A0.astype(complex)
        dM = np.eye(n, dtype=complex)
        for ch in self.channels:
            e = np.exp(-s * ch.latency_s) * np.outer(ch.b, ch.c)
            M -= e
            dM += ch.latency_s * e
        return M, dM


@dataclass(frozen=True)
class LatencySweep:
    """Roots over latency.

    Attributes
    ----------
    latencies_s : (k,).
    roots : name -> (k,) complex, 1/s.
    abscissa : (k,) real part of the rightmost root, 1/s.
    """

    latencies_s: Matrix
    roots: Mapping[str, ComplexMatrix]
    abscissa: Matrix

    def damping(self, name: str) -> Matrix:
        """Damping ratio (k,) of a followed root."""
        return np.array([damping_ratio(complex(z)) for z in self.roots[name]])


def _chebyshev(n: int) -> tuple[Matrix, Matrix]:
    """Nodes cos(k pi / n), k = 0..n, on [-1, 1] and the differentiation matrix (n + 1, n + 1)."""
    k = np.arange(n + 1)
    x = np.cos(np.pi * k / n)
    c = np.where((k == 0) | (k == n), 2.0, 1.0) * (-1.0) ** k
    gap = x[:, None] - x[None, :] + np.eye(n + 1)
    D = np.outer(c, 1.0 / c) / gap
    D -= np.diag(D.sum(axis=1))
    return x, D


def discretised(loop: DelayedLoop, nodes: int) -> Matrix:
    """State matrix of the loop with each latency > 0 as a line of `nodes` Chebyshev points."""
    n = loop.A0.shape[0]
    delayed = [ch for ch in loop.channels if ch.latency_s > 0.0]
    A = np.zeros((n + nodes * len(delayed),) * 2)
    A[:n, :n] = loop.A0 + sum(
        (np.outer(ch.b, ch.c) for ch in loop.channels if ch.latency_s == 0.0), np.zeros((n, n))
    )
    _, D = _chebyshev(nodes)
    for k, ch in enumerate(delayed):
        line = slice(n + k * nodes, n + (k + 1) * nodes)
        # node 0 is the present value c x; the last one is the delayed value
        A[line, line] = 2.0 / ch.latency_s * D[1:, 1:]
        A[line, :n] = np.outer(2.0 / ch.latency_s * D[1:, 0], ch.c)
        A[:n, n + (k + 1) * nodes - 1] = ch.b
    return A


def rightmost_roots(
    loop: DelayedLoop, *, right_of: float = -1.0, least: int = 1, tolerance: float = 1e-10
) -> ComplexMatrix:
    r"""Characteristic roots with real part above `right_of`, to the accuracy of the exact equation.

    The Chebyshev matrix is grown until two sizes agree on the set of roots; each root is
    then corrected by Newton's method on :math:`M(s) v = 0` and its backward error checked.

    Parameters
    ----------
    right_of : 1/s; lowered until at least `least` roots are found.
    least : how many roots are wanted at least.
    tolerance : backward error accepted, \|M(s) v\| / (\|M\| \|v\|).

    Returns
    -------
    Roots (k,), 1/s, rightmost first, conjugates included.

    Raises
    ------
    DelayError : the set of roots does not settle, or a root fails its residual.
    """
    loop = loop.balanced()
    if not np.all(np.isfinite(loop.A0)):
        raise DelayError("the loop has entries that are not finite")
    longest = max((ch.latency_s for ch in loop.channels), default=0.0)
    if longest == 0.0:
        values, vectors = np.linalg.eig(loop.undelayed())
        result = _selected(values, right_of, least)
        return _corrected(loop, values[result], vectors[:, result], tolerance)
    nodes, before = 16 + int(np.ceil(20.0 * longest)), None
    while nodes <= 240:
        values, vectors = np.linalg.eig(discretised(loop, nodes))
        result = _selected(values, right_of, least)
        if before is not None and _same_set(before, values[result]):
            return _corrected(loop, values[result], vectors[: loop.A0.shape[0], result], tolerance)
        before = values[result]
        nodes = int(1.5 * nodes)
    raise DelayError(
        f"the roots right of {right_of:g} 1/s did not converge with {nodes} nodes; the latency {longest:g} s "
        "spans too many periods of the fastest of them: ask for roots further right"
    )


def _selected(values: ComplexMatrix, right_of: float, least: int) -> NDArray[np.intp]:
    """Indices of the roots right of the line, rightmost first, at least `least` (pairs kept whole)."""
    order = np.lexsort((values.imag, -values.real))
    count = max(int(np.sum(values.real > right_of)), min(least, values.size))
    while count < values.size and values[order[count]].real > values[order[count - 1]].real - 1e-9:
        count += 1
    return np.asarray(order[:count])


def _same_set(one: ComplexMatrix, two: ComplexMatrix) -> bool:
    """Whether two sets of roots agree to 1e-5, each with its own partner."""
    if one.size != two.size:
        return False
    left = list(two)
    for z in one:
        k = int(np.argmin(np.abs(np.array(left) - z)))
        if abs(left[k] - z) > 1e-5 * (1.0 + abs(z)):
            return False
        left.pop(k)
    return True


def _corrected(
    loop: DelayedLoop, values: ComplexMatrix, vectors: ComplexMatrix, tolerance: float
) -> ComplexMatrix:
    """Newton-correct roots one by one; conjugates follow their partner."""
    out = np.empty(values.size, dtype=complex)
    for k, z in enumerate(values):
        partner = (
            [j for j in range(k) if abs(values[j] - np.conj(z)) < 1e-9 * (1.0 + abs(z))] if z.imag else []
        )
        if partner:
            out[k] = np.conj(out[partner[0]])
            continue
        root, _, error = newton(loop, complex(z), vectors[:, k].astype(complex))
        if abs(root - z) > 1e-3 * (1.0 + abs(z)):  # a multiple root: keep what the matrix gave
            root, error = complex(z), _backward_error(loop, complex(z), vectors[:, k].astype(complex))
        if not error <= tolerance:
            raise DelayError(
                f"root {z:.6g} of the discretised loop is not a root of the exact one: residual {error:.2g}, "
                f"allowed {tolerance:g}"
            )
        out[k] = root
    return out[np.lexsort((out.imag, -np.round(out.real, 12)))]


def _backward_error(loop: DelayedLoop, s: complex, v: ComplexMatrix) -> float:
    """|M(s) v| relative to the size of M(s) and v."""
    M, _ = loop.characteristic(s)
    size = abs(s) + np.linalg.norm(loop.A0)
    size += sum(
        abs(np.exp(-s * ch.latency_s)) * np.linalg.norm(ch.b) * np.linalg.norm(ch.c) for ch in loop.channels
    )
    return float(np.linalg.norm(M @ v) / (size * np.linalg.norm(v)))


def newton(
    loop: DelayedLoop, s: complex, v: ComplexMatrix | None = None, *, steps: int = 20
) -> tuple[complex, ComplexMatrix, float]:
    """Solve M(s) v = 0 from a near guess; returns root, unit vector and backward error."""
    n = loop.A0.shape[0]
    if v is None:
        v = np.asarray(np.linalg.svd(loop.characteristic(s)[0])[2][-1].conj())
    v = v / np.linalg.norm(v)
    best = (s, v, _backward_error(loop, s, v))
    for _ in range(steps):
        M, dM = loop.characteristic(s)
        K = np.block([[M, (dM @ v)[:, None]], [v.conj()[None, :], np.zeros((1, 1))]])
        try:
            z = np.linalg.solve(K, np.concatenate([np.zeros(n), [1.0]]).astype(complex))
        except np.linalg.LinAlgError:
            break
        # M(s) v+ + dM v ds = 0 with v^H v+ = 1
        s, v = complex(s + z[n]), z[:n] / np.linalg.norm(z[:n])
        error = _backward_error(loop, s, v)
        if error < best[2]:
            best = (s, v, error)
        if abs(z[n]) <= 1e-14 * (1.0 + abs(s)):
            break
    return complex(best[0]), best[1], best[2]


def track_roots(
    loop: DelayedLoop,
    signals: tuple[str, ...],
    latencies_s: Matrix | list[float],
    start: complex,
    *,
    step_s: float = 0.005,
) -> ComplexMatrix:
    """Follow one root from latency 0 of `signals` through increasing latencies, shape (k,).

    Raises DelayError where the root can no longer be told from others.
    """
    loop = loop.balanced()

    def at(latency_s: float) -> DelayedLoop:
        return loop.at(dict.fromkeys(signals, latency_s))

    s, v = _root_near(at(0.0), start, "the loop without latency")
    now, out = 0.0, []
    for target in np.asarray(latencies_s, dtype=float):
        if target < now:
            raise DelayError(f"latencies must increase and not be negative; {target:g} s follows {now:g} s")
        s, v = _follow(at, s, v, now, target, step_s, "s of latency")
        now = target
        out.append(s)
    return np.array(out)


def track_gain(loop: DelayedLoop, start: complex, *, step: float = 0.02) -> complex:
    """Follow one root of the open loop while the gain of every channel rises from 0 to 1, latencies kept.

    Raises DelayError where the root can no longer be told from others.
    """
    loop = loop.balanced()

    def at(gain: float) -> DelayedLoop:
        return replace(loop, channels=tuple(replace(ch, b=gain * ch.b) for ch in loop.channels))

    s, v = _root_near(at(0.0), start, "the open loop")
    return _follow(at, s, v, 0.0, 1.0, step, "of the gain")[0]


def _root_near(loop: DelayedLoop, start: complex, what: str) -> tuple[complex, ComplexMatrix]:
    s, v, error = newton(loop, start)
    if not error <= 1e-10 or abs(s - start) > 1e-2 * (1.0 + abs(start)):
        raise DelayError(f"{start:.6g} is not a root of {what} (nearest root {s:.6g})")
    return s, v


def _follow(
    loop_at: Callable[[float], DelayedLoop],
    s: complex,
    v: ComplexMatrix,
    now: float,
    target: float,
    longest: float,
    unit: str,
) -> tuple[complex, ComplexMatrix]:
    """Follow a root and its vector from `now` to `target` in steps of at most `longest`."""
    step = longest
    while now < target:
        ahead = min(now + step, target)
        root, vector, error = newton(loop_at(ahead), s, v)
        # the same root turns its vector little; a jump to another one does not
        if error <= 1e-10 and abs(np.vdot(v, vector)) >= 0.95:
            s, v, now, step = root, vector, ahead, min(1.5 * step, longest)
        elif step > 1e-4 * longest:
            step *= 0.5
        else:
            raise DelayError(f"lost the root near {s:.6g} at {ahead:g} {unit}")
    return s, v


def sweep_latency(
    loop: DelayedLoop,
    signals: tuple[str, ...],
    latencies_s: Matrix | list[float],
    roots: Mapping[str, complex],
) -> LatencySweep:
    """Follow named roots and the rightmost one over the common latency of `signals`."""
    taus = np.asarray(latencies_s, dtype=float)
    followed = {name: track_roots(loop, signals, taus, z) for name, z in roots.items()}
    abscissa = [
        rightmost_roots(loop.at(dict.fromkeys(signals, t)), right_of=0.0, least=1)[0].real for t in taus
    ]
    return LatencySweep(taus, followed, np.array(abscissa))


def stability_map_of(
    loop: DelayedLoop, first: tuple[str, Matrix | list[float]], second: tuple[str, Matrix | list[float]]
) -> Matrix:
    """Spectral abscissa over two latencies, shape (len(first), len(second))."""
    out = np.empty((len(first[1]), len(second[1])))
    for i, a in enumerate(first[1]):
        for j, b in enumerate(second[1]):
            out[i, j] = rightmost_roots(loop.at({first[0]: float(a), second[0]: float(b)}), right_of=0.0)[
                0
            ].real
    return out
