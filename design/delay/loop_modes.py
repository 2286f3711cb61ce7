r"""All swings of a closed loop with latency, packets and loss, and which mode of the open loop each one is.

With the plant G, the controller K and the path H_i of each signal the characteristic equation is

.. math:: f(s) = \det\big(I - K(s)\, \mathrm{diag}(H_i(s))\, G(s)\big) = 0,

one determinant of the size of the actuators. Times the open loop's poles it has no poles: so the roots within
a rectangle can be counted by how often its phase turns along the edge (the argument principle), and a list of
them is known to be complete. Names go from the open loop to the closed one by continuation: the gain rises
from 0 to 1 without latency, then the latency from 0 to what it is, as certificates do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from interarea.models.blocks.pmu import PmuFilter

from ..linear.linearise import select
from ..linear.matrices import LinearMatrices
from ..linear.systems import state_space
from ..modes.modes import damping_ratio
from .characteristic_roots import DelayError
from .transfer_matrix import TransferMatrix, transfer_matrix

if TYPE_CHECKING:
    import control

ComplexArray = npt.NDArray[np.complex128]
Transfer = Callable[[ComplexArray], ComplexArray]

#: frequencies in which a root counts as a swing, Hz
SWING_HZ = (0.1, 2.5)
_LEFT, _RIGHT = -12.0, 2.0  # 1/s: at 2.5 Hz a damping ratio of 0.6, and growth faster than any swing's
_ACROSS = 48  # points of the grid on which zeros are looked for, half as many as up
_LARGEST_TURN = 0.7  # rad between two points of the edge
_SAME = 1e-6
_ROUNDS = 12  # of Newton's method, each with the zeros of those before divided out
_ASIDE = 1e-7 + 1e-7j


@dataclass(frozen=True)
class DelayedPath:
    """How a signal gets to the controller, as a linear system: what it does to the mean of the signal.

    latency_s : transport. interval_s : of packets whose value is held until the next; 0: continuous.
    loss : share of the packets that are lost, each independent of the others. on_loss : what is read then.
    lost : nothing arrives at all. measured : the PMU before it, of whose bus the plant gives the frequency.
    """

    latency_s: float = 0.0
    interval_s: float = 0.0
    loss: float = 0.0
    on_loss: Literal["zero", "hold"] = "zero"
    lost: bool = False
    measured: PmuFilter | None = None

    def transfer(self, s: ComplexArray) -> ComplexArray:
        """Return H(s); of lost packets its mean, exact for independent losses, aliases left out."""
        if self.lost or (self.loss >= 1.0 and self.interval_s > 0.0):
            return np.zeros_like(s)
        path = np.exp(-s * self.latency_s)
        if self.measured is not None:
            path = path * self.measured.frequency(s)
        if not self.interval_s > 0.0:
            return path
        shift = np.exp(-s * self.interval_s)
        path = path * (1.0 - shift) / (s * self.interval_s)
        arriving = 1.0 - self.loss
        return np.asarray(
            path * arriving / (1.0 - self.loss * shift) if self.on_loss == "hold" else path * arriving
        )

    def slope(self, s: ComplexArray) -> ComplexArray:
        """Return dH/ds; H has no poles near a swing, so that a difference is accurate."""
        h = 1e-5 * (1.0 + np.abs(s))
        return np.asarray((self.transfer(s + h) - self.transfer(s - h)) / (2.0 * h))


@dataclass(frozen=True)
class LoopModes:
    """Roots of a closed loop, 1/s.

    roots : all within `SWING_HZ` with a damping ratio below 0.6 or so, least damped first. named : mode of
    the open loop -> its root in the closed one; a mode whose path was lost has none.
    """

    roots: tuple[complex, ...]
    named: Mapping[str, complex]

    @property
    def least(self) -> complex | None:
        """The least damped root of everything that swings; None where nothing does."""
        return min([*self.roots, *self._swinging], key=damping_ratio, default=None)

    @property
    def _swinging(self) -> list[complex]:
        low, high = (2.0 * np.pi * f for f in SWING_HZ)
        return [z for z in self.named.values() if low <= abs(z.imag) <= high]

    def name_of(self, root: complex) -> str:
        """Return the mode that a root is of; "" for one that the controller or the latency brought in."""
        near = (name for name, z in self.named.items() if abs(z - root) <= _SAME * (1.0 + abs(root)))
        return next(near, "")


def open_loop_modes(eigenvalues: ComplexArray, open_loop: Mapping[str, complex]) -> LoopModes:
    """Return the swings of a plant without a controller."""
    swings = eigenvalues[_inside(eigenvalues, (_LEFT, _RIGHT), _band())]
    return LoopModes(tuple(sorted(map(complex, swings), key=damping_ratio)), dict(open_loop))


class LoopFunction:
    """The characteristic function of plant and controller, quick to evaluate at many points.

    Parameters
    ----------
    plant : without reference angle, speeds in rad/s. controller : u = + K y, names among the plant's.
    """

    def __init__(
        self, plant: control.StateSpace | LinearMatrices, controller: control.StateSpace | LinearMatrices
    ) -> None:
        if not isinstance(controller, LinearMatrices):
            state_space(controller, "controller")
        self.signals = tuple(controller.input_labels)
        G = select(plant, list(controller.output_labels), list(self.signals))
        self._G, self._K = transfer_matrix(G), transfer_matrix(controller)
        self.poles = np.concatenate([self._G.poles, self._K.poles])

    def loop(self, paths: Mapping[str, DelayedPath], gain: float = 1.0) -> Characteristic:
        """Return the characteristic function for signals that travel so; those not named as they are."""
        direct = DelayedPath()
        return Characteristic(self._G, self._K, [paths.get(name, direct) for name in self.signals], gain)

    def modes(
        self, paths: Mapping[str, DelayedPath], open_loop: Mapping[str, complex], *, left: float = _LEFT
    ) -> LoopModes:
        """Return all swings of the loop, and what became of the modes of the open one.

        open_loop : mode -> its eigenvalue, 1/s. left : 1/s, roots that decay faster are not listed; a large
            grid has so many of them there, close together, that not all may be told apart.

        Raises
        ------
        DelayError : roots found and roots counted differ.
        """
        named = self._followed(paths, open_loop)
        roots = zeros_of(self.loop(paths), self.poles, (left, _RIGHT), _band(), list(named.values()))
        return LoopModes(tuple(sorted(map(complex, roots), key=damping_ratio)), named)

    def _followed(
        self, paths: Mapping[str, DelayedPath], open_loop: Mapping[str, complex]
    ) -> dict[str, complex]:
        """Follow each mode: gain, then latency; where that ends in one root for two, gain at the latency."""

        def at_once(t: float) -> Characteristic:
            return self.loop({n: replace(w, latency_s=0.0, interval_s=0.0) for n, w in paths.items()}, t * t)

        def later(t: float) -> Characteristic:
            return self.loop({n: _share(w, t) for n, w in paths.items()})

        def gain(t: float) -> Characteristic:
            return self.loop(paths, t * t)

        names, starts = list(open_loop), np.array(list(open_loop.values()), dtype=complex)
        ends = self._follow(later, self._follow(at_once, starts))
        again = [k for k, z in enumerate(ends) if np.isnan(z) or any(not _apart(z, y) for y in ends[:k])]
        if again:
            ends[again] = self._follow(gain, starts[again])
        followed: dict[str, complex] = {}
        for name, root in zip(names, map(complex, ends), strict=True):
            if root == root and all(_apart(root, z) for z in followed.values()):
                followed[name] = root
        return followed

    def _follow(self, function_at: Callable[[float], Characteristic], starts: ComplexArray) -> ComplexArray:
        """Follow roots from t = 0 to 1, each NaN from where it cannot be told from others."""
        roots, slopes = starts.copy(), np.zeros(len(starts), dtype=complex)
        now, step = 0.0, 0.05
        while now < 1.0 and not np.all(np.isnan(roots)):
            ahead = min(now + step, 1.0)
            live = np.flatnonzero(~np.isnan(roots))
            guesses = roots[live] + slopes[live] * (ahead - now)
            last = ahead == 1.0
            moved = _newton(function_at(ahead), self.poles, guesses, 8, 1e-11 if last else 1e-6)
            ok = np.abs(moved - guesses) <= 0.04 + 0.2 * np.abs(guesses - roots[live])
            ok &= np.abs(moved - roots[live]) <= 0.5
            if not np.all(ok) and step > 1e-4:
                step *= 0.4
                continue
            moved[~ok] = np.nan
            slopes[live] = (moved - roots[live]) / (ahead - now)
            roots[live] = moved
            now, step = ahead, min(1.6 * step, 0.1)
        return roots


class Characteristic:
    """f(s) = det(I - K H G) and its logarithmic derivative, at many points at once."""

    def __init__(self, G: TransferMatrix, K: TransferMatrix, paths: list[DelayedPath], gain: float) -> None:
        self._G, self._K, self._paths, self._gain = G, K, paths, gain

    def value(self, s: ComplexArray) -> ComplexArray:
        """Return f (N,)."""
        rest = np.eye(self._K.outputs) - self._sent(s) @ self._G.at(s)
        return np.asarray(rest[:, 0, 0] if self._K.outputs == 1 else np.linalg.det(rest))

    def ratio(self, s: ComplexArray) -> ComplexArray:
        """Return f' / f (N,); infinite where f is 0."""
        H, dH = (
            self._gain * np.stack([f(s) for f in selected], axis=-1)[:, None, :] for selected in self._both
        )
        K, G = self._K.at(s), self._G.at(s)
        change = (self._K.slope(s) * H + K * dH) @ G + (K * H) @ self._G.slope(s)
        rest = np.eye(self._K.outputs) - (K * H) @ G
        if self._K.outputs == 1:
            return np.asarray(-change[:, 0, 0] / rest[:, 0, 0])
        result = np.full(len(s), np.inf, dtype=complex)
        for k in range(len(s)):
            with suppress(np.linalg.LinAlgError):
                result[k] = -np.trace(np.linalg.solve(rest[k], change[k]))
        return result

    @property
    def _both(self) -> tuple[list[Transfer], list[Transfer]]:
        return [path.transfer for path in self._paths], [path.slope for path in self._paths]

    def _sent(self, s: ComplexArray) -> ComplexArray:
        H = self._gain * np.stack([path.transfer(s) for path in self._paths], axis=-1)
        return np.asarray(self._K.at(s) * H[:, None, :])


def zeros_of(
    function: Characteristic,
    poles: ComplexArray,
    real: tuple[float, float],
    imag: tuple[float, float],
    starts: list[complex],
) -> ComplexArray:
    """Return all zeros of a function within a rectangle of the upper half plane.

    poles : at which the function may have simple poles; where one is cancelled, it counts as a zero (a mode
    that the loop does not reach stays what it is). starts : guesses beside those of a grid.

    Raises
    ------
    DelayError : the zeros found are not as many as the phase along the edge says.
    """
    count = _turns(function, real, imag) + int(np.sum(_inside(poles, real, imag)))
    wide = (real[0] - 0.5, real[1] + 0.5), (max(imag[0] - 0.5, 1e-3), imag[1] + 0.5)
    near = np.concatenate([poles[_inside(poles, *wide)], np.array(starts, dtype=complex)])
    roots = np.zeros(0, dtype=complex)
    for finer in (1, 2, 4):
        guesses = np.concatenate([_minima(function, poles, *wide, finer), near])
        if finer > 1:
            guesses = np.concatenate([guesses, _spread(*wide, 4 * finer)])
        for _ in range(_ROUNDS):
            reached = newton_zeros(function, poles, guesses, roots)
            more = _distinct(np.concatenate([roots, reached]))
            zeros, roots, before = more[_inside(more, real, imag)], more, len(roots)
            if len(zeros) == count:
                return zeros
            if len(roots) == before:
                break
    raise DelayError(
        f"{len(zeros)} roots found between {imag[0]:.3g} and {imag[1]:.3g} rad/s, {count} counted on the edge"
    )


def _spread(real: tuple[float, float], imag: tuple[float, float], across: int) -> ComplexArray:
    """Return points all over a rectangle."""
    x, y = np.linspace(*real, across), np.linspace(*imag, 2 * across)
    return np.asarray((x[None, :] + 1j * y[:, None]).ravel())


def _minima(
    function: Characteristic,
    poles: ComplexArray,
    real: tuple[float, float],
    imag: tuple[float, float],
    finer: int,
) -> ComplexArray:
    """Return points of a grid at which the function times its poles is smaller than around them."""
    grid = _spread(real, imag, _ACROSS * finer).reshape(-1, _ACROSS * finer)
    with np.errstate(all="ignore"):
        size = np.log(np.abs(function.value(grid.ravel()))).reshape(grid.shape)
        for pole in poles:
            size += np.log(np.abs(grid - pole))
    low = size[1:-1, 1:-1]
    around = [size[1 + i : size.shape[0] - 1 + i, 1 + j : size.shape[1] - 1 + j] for i, j in _AROUND]
    return np.asarray(grid[1:-1, 1:-1][np.all([low <= other for other in around], axis=0)])


_NONE: ComplexArray = np.zeros(0, dtype=np.complex128)
_AROUND = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


def newton_zeros(
    function: Characteristic,
    poles: ComplexArray,
    guesses: ComplexArray,
    known: ComplexArray = _NONE,
) -> ComplexArray:
    """Return the zeros that Newton's method on the function times its poles reaches from the guesses.

    known : zeros that are divided out, so that each guess goes to another one.
    """
    result = _newton(function, poles, guesses, 40, 1e-11, known)
    result = result[~np.isnan(result)]
    if known.size:  # where the quotient is 0 the function is; what is left of the others' rounding goes
        result = _newton(function, poles, result, 4, 1e-11)
    return np.asarray(result[~np.isnan(result)])


def _newton(
    function: Characteristic,
    poles: ComplexArray,
    guesses: ComplexArray,
    steps: int,
    tolerance: float,
    known: ComplexArray = _NONE,
) -> ComplexArray:
    """Return where each guess converges to, zeros that are `known` divided out; NaN where it does not."""
    s = np.array(guesses, dtype=complex) + _ASIDE  # not on a pole itself
    left = np.arange(len(s))
    for _ in range(steps):
        z = s[left]
        away = z[:, None] - poles[None, :]
        with np.errstate(all="ignore"):
            rest = np.sum(1.0 / away, axis=1) - np.sum(1.0 / (z[:, None] - known[None, :]), axis=1)
            move = -1.0 / (function.ratio(z) + rest)
        on_pole = np.min(np.abs(away), axis=1, initial=np.inf) < 1e-12  # which the loop does not reach
        move[on_pole | np.isnan(move)] = 0.0
        long = np.abs(move) > 1.0
        move[long] /= np.abs(move[long])
        s[left] = z + move
        left = left[np.abs(move) > tolerance * (1.0 + np.abs(z))]
        if not left.size:
            break
    s[left] = np.nan
    return s


def _turns(function: Characteristic, real: tuple[float, float], imag: tuple[float, float]) -> int:
    """Return zeros less poles of a function within a rectangle: the turns of its phase along the edge."""
    corners = [
        complex(x, y) for x, y in zip((*real, *real[::-1]), (imag[0],) * 2 + (imag[1],) * 2, strict=True)
    ]
    edge = np.concatenate(
        [
            np.linspace(a, b, 300, endpoint=False)
            for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
        ]
    )
    edge = np.append(edge, edge[0])
    values = function.value(edge)
    for _ in range(40):
        turn = np.angle(values[1:] / values[:-1])
        wide = np.flatnonzero(np.abs(turn) > _LARGEST_TURN)
        if not wide.size:
            break
        middle = 0.5 * (edge[wide] + edge[wide + 1])
        edge, values = np.insert(edge, wide + 1, middle), np.insert(values, wide + 1, function.value(middle))
    return round(float(np.sum(np.angle(values[1:] / values[:-1]))) / (2.0 * np.pi))


def _inside(z: ComplexArray, real: tuple[float, float], imag: tuple[float, float]) -> npt.NDArray[np.bool_]:
    return (real[0] < z.real) & (z.real < real[1]) & (imag[0] < z.imag) & (z.imag < imag[1])


def _distinct(z: ComplexArray) -> ComplexArray:
    distinct: list[complex] = []
    for one in map(complex, z):
        if all(_apart(one, other) for other in distinct):
            distinct.append(one)
    return np.array(distinct, dtype=complex)


def _apart(one: complex, other: complex) -> bool:
    return abs(one - other) > _SAME * (1.0 + abs(one))


def _band() -> tuple[float, float]:
    return 2.0 * np.pi * SWING_HZ[0], 2.0 * np.pi * SWING_HZ[1]


def _share(path: DelayedPath, t: float) -> DelayedPath:
    return replace(path, latency_s=t * path.latency_s, interval_s=t * path.interval_s)
