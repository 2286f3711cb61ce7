r"""Stability in the mean square when packets are lost at random, by the spectral radius of a second moment.

Signals travel in packets every :math:`T`; between two arrivals what the controller reads is constant. From
one time stamp to the next the state :math:`z` (plant, controller, packets under way, what is read) moves by
:math:`z^+ = A_S z`, where :math:`S` is the set of signals whose packet arrives. With losses independent of
:math:`z`

.. math:: E[z z^T]^+ = \sum_S P(S) A_S E[z z^T] A_S^T

so that the root mean square decays as :math:`\rho^{k/2}` with the spectral radius :math:`\rho` of
:math:`\sum_S P(S) A_S \otimes A_S`. With bursts (Gilbert and Elliott) there is one second moment for each
state of the chains [Costa2005]. The rules are those of `models/c/channel/channel_variables.h`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import control
import numpy as np
import numpy.typing as npt
from scipy.linalg import expm, solve_discrete_lyapunov
from scipy.optimize import brentq
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs

from ..linear.linearise import select
from ..lmi.problem import Matrix

OnLoss = Literal["zero", "hold"]
#: of the Arnoldi iteration: relative tolerance, vectors kept, and how much of the unit matrix is in its start
TOLERANCE, VECTORS, SHARE = 1e-9, 30, 1e-6


@dataclass(frozen=True)
class LossyChannel:
    """One signal's way: latency, rule on loss and the chance of losing a packet.

    loss_good, loss_bad : chance in the good and in the bad state. good_to_bad, bad_to_good : chance of a
    change per packet; the default good_to_bad = 0 is independent (Bernoulli) loss with the chance loss_good.
    """

    latency_s: float = 0.0
    on_loss: OnLoss = "zero"
    loss_good: float = 0.0
    loss_bad: float = 0.0
    good_to_bad: float = 0.0
    bad_to_good: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.latency_s < math.inf:
            raise ValueError(f"channel: latency_s is {self.latency_s}, wanted finite and not negative")
        if self.on_loss not in ("zero", "hold"):
            raise ValueError(f"channel: on_loss is {self.on_loss!r}, allowed: zero, hold")
        for key in ("loss_good", "loss_bad", "good_to_bad", "bad_to_good"):
            if not 0.0 <= getattr(self, key) <= 1.0:
                raise ValueError(f"channel: {key} is {getattr(self, key)}, allowed: 0 to 1")

    @property
    def chain(self) -> tuple[npt.NDArray[np.float64], tuple[float, ...]]:
        """Transition matrix of the chain (row: from) and the chance of loss in each of its states."""
        if self.good_to_bad == 0.0:
            return np.ones((1, 1)), (self.loss_good,)
        p, q = self.good_to_bad, self.bad_to_good
        return np.array([[1.0 - p, p], [q, 1.0 - q]]), (self.loss_good, self.loss_bad)

    @property
    def mean_loss(self) -> float:
        """Share of the packets that is lost in the long run."""
        if self.good_to_bad == 0.0:
            return self.loss_good
        bad = self.good_to_bad / (self.good_to_bad + self.bad_to_good)
        return (1.0 - bad) * self.loss_good + bad * self.loss_bad


@dataclass(frozen=True)
class MeanSquare:
    """What random loss leaves of stability.

    radius : spectral radius of the second moment from packet to packet; below 1 is stable in the mean square.
    decay_rate : of the root mean square, 1/s. mean_loss : share of lost packets per signal.
    """

    radius: float
    decay_rate: float
    mean_loss: Mapping[str, float] = field(default_factory=dict)

    @property
    def stable(self) -> bool:
        """Whether the second moment decays."""
        return self.radius < 1.0


class PacketLoop:
    """Plant and controller joined by packets: `step(arriving)` is A_S of the module's text.

    plant : strictly proper, without reference angle. K : u = +K y, inputs named by signal. Signals without an
    entry in `channels` are read continuously and never lost.
    """

    def __init__(
        self,
        plant: control.StateSpace,
        K: control.StateSpace,
        interval_s: float,
        channels: Mapping[str, LossyChannel],
    ) -> None:
        if not (0.0 < interval_s < math.inf):
            raise ValueError(f"packet loop: interval_s is {interval_s}, wanted finite and positive")
        unknown = sorted(set(channels) - set(K.input_labels))
        if unknown:
            raise ValueError(
                f"packet loop: channels for {', '.join(unknown)}; the controller reads "
                f"{', '.join(K.input_labels)}"
            )
        G = select(plant, list(K.output_labels), list(K.input_labels))
        if np.any(G.D):
            raise ValueError("packet loop: the plant has a direct feedthrough, wanted D = 0")
        self.interval_s, self.signals = interval_s, tuple(s for s in K.input_labels if s in channels)
        self.channels = channels
        columns = [list(K.input_labels).index(s) for s in self.signals]
        through = [k for k in range(K.ninputs) if k not in columns]
        C_y = np.asarray(G.C)
        n, n_K = G.nstates, K.nstates
        A = np.block([[G.A, G.B @ K.C], [np.zeros((n_K, n)), K.A]])
        A[:n, :n] += G.B @ K.D[:, through] @ C_y[through]
        A[n:, :n] += K.B[:, through] @ C_y[through]
        drive = np.vstack([G.B @ K.D[:, columns], K.B[:, columns]])
        self._plan(A, drive, np.hstack([C_y[columns], np.zeros((len(columns), n_K))]))

    def _plan(self, A: Matrix, drive: Matrix, C: Matrix) -> None:
        """Lay out z = (x, what is read, packets under way of each signal, newest first)."""
        T = self.interval_s
        whole = {s: math.floor(self.channels[s].latency_s / T + 1e-9) for s in self.signals}
        rest = {s: max(self.channels[s].latency_s - whole[s] * T, 0.0) for s in self.signals}
        n, m = len(A), len(self.signals)
        self.n_x, self.first = n, {}
        size = n + m
        for s in self.signals:
            self.first[s] = size
            size += whole[s] + 1
        self.order = size
        self._sample = np.eye(size)
        for j, s in enumerate(self.signals):
            a, last = self.first[s], self.first[s] + whole[s]
            self._sample[a : last + 1] = 0.0
            self._sample[a, :n] = C[j]
            for k in range(a, last):
                self._sample[k + 1, k] = 1.0
        self._oldest = {s: self.first[s] + whole[s] for s in self.signals}
        hold = np.zeros((n + m, n + m))
        hold[:n, :n], hold[:n, n:] = A, drive
        instants = sorted({0.0, *(r for r in rest.values() if r < T - 1e-12), T})
        self._arrivals: list[list[str]] = [[s for s in self.signals if rest[s] == t] for t in instants[:-1]]
        self._flows = []
        for start, end in itertools.pairwise(instants):
            flow = np.eye(size)
            flow[: n + m, : n + m] = expm(hold * (end - start))
            self._flows.append(flow)
        self._whole = self.step(self.signals)

    def step(self, arriving: Sequence[str]) -> Matrix:
        """Return A_S: from just before one time stamp to just before the next; `arriving`: S."""
        total = self._sample
        for signals, flow in zip(self._arrivals, self._flows, strict=True):
            jump = np.eye(self.order)
            for s in signals:
                row = self.n_x + self.signals.index(s)
                if s in arriving:
                    jump[row] = 0.0
                    jump[row, self._oldest[s]] = 1.0
                elif self.channels[s].on_loss == "zero":
                    jump[row] = 0.0
            total = flow @ jump @ total
        return np.asarray(total)

    @cached_property
    def _differences(self) -> dict[str, tuple[Matrix, npt.NDArray[np.float64], npt.NDArray[np.float64]]]:
        """Of each signal D, f and g (`_moved`)."""
        differences = {}
        for s in self.signals:
            D = self._whole - self.step([other for other in self.signals if other != s])
            U, sizes, V = np.linalg.svd(D)
            differences[s] = D, U[:, 0] * sizes[0], V[0]
        return differences

    def mean_square(self) -> MeanSquare:
        """Return the spectral radius of the second moment under the channels' losses."""
        bursts = any(len(self.channels[s].chain[1]) > 1 for s in self.signals)
        radius = self._radius_with_bursts() if bursts else self._radius_independent()
        decay = -math.log(radius) / (2.0 * self.interval_s) if radius > 0.0 else math.inf
        return MeanSquare(radius, decay, {s: self.channels[s].mean_loss for s in self.signals})

    def stable(self) -> bool:
        """Say whether the second moment decays; of independent losses at a fraction of the radius's cost."""
        if any(len(self.channels[s].chain[1]) > 1 for s in self.signals):
            return self.mean_square().stable
        floor, gain = self._independent()
        return floor < 1.0 and (gain is None or gain(1.0) < 1.0)

    def _moved(
        self, chances: Mapping[str, float]
    ) -> tuple[Matrix, list[tuple[float, npt.NDArray[np.float64], npt.NDArray[np.float64]]]]:
        """Return M and (v_j, f_j, g_j): E[z z^T]^+ = M X M^T + sum_j v_j (g_j^T X g_j) f_j f_j^T.

        chances : of losing each signal's next packet. What reads one packet reads no other, so A_S is affine
        in the losses and each D_j = f_j g_j^T, the difference that packet j makes, has rank 1 [Elia2005].
        """
        mean, parts = self._whole.copy(), []
        for s, (D, f, g) in self._differences.items():
            p = chances[s]
            mean -= p * D
            if p * (1.0 - p) > 0.0:
                parts.append((p * (1.0 - p), f, g))
        return mean, parts

    def _independent(self) -> tuple[float, Callable[[float], float] | None]:
        """Independent losses: how far the spectral radius is from any gamma.

        gamma is an eigenvalue when the matrix of v_j g_i^T X_j g_i, with gamma X_j = M X_j M^T + f_j f_j^T,
        has the spectral radius 1 [Elia2005].
        Returns the spectral radius of M x M and that matrix's as a falling function of gamma above it (None:
        no losses).
        """
        mean, parts = self._moved({s: self.channels[s].loss_good for s in self.signals})
        floor = float(np.abs(np.linalg.eigvals(mean)).max()) ** 2
        if not parts:
            return floor, None

        def gain(gamma: float) -> float:
            H = np.zeros((len(parts), len(parts)))
            for column, (v, f, _) in enumerate(parts):
                X = solve_discrete_lyapunov(mean / math.sqrt(gamma), np.outer(f, f) / gamma)
                H[:, column] = [v * float(g @ X @ g) for _, _, g in parts]
            return float(np.abs(np.linalg.eigvals(H)).max())

        return floor, gain

    def _radius_independent(self) -> float:
        floor, gain = self._independent()
        low = floor * (1.0 + 1e-9)
        if gain is None or not gain(low) > 1.0:
            return floor  # the losses do not reach the slowest mode
        high = 2.0 * floor + 1.0
        while gain(high) > 1.0:
            low, high = high, 2.0 * high
        return float(brentq(lambda gamma: math.log(gain(gamma)), low, high, xtol=1e-12, rtol=1e-12))

    def _radius_with_bursts(self) -> float:
        """One second moment for each state of the chains; Arnoldi on half a second of packets at once."""
        chains = [self.channels[s].chain for s in self.signals]
        modes = list(itertools.product(*(range(len(losses)) for _, losses in chains)))
        moved = [
            self._moved({s: chains[j][1][mode[j]] for j, s in enumerate(self.signals)}) for mode in modes
        ]
        means = np.array([mean for mean, _ in moved])
        rotated = np.ascontiguousarray(means.transpose(0, 2, 1))
        moves = np.array(
            [
                [math.prod(float(chains[j][0][a[j], b[j]]) for j in range(len(chains))) for b in modes]
                for a in modes
            ]
        )
        n, folds = self.order, max(1, round(0.5 / self.interval_s))

        def moment(flat: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
            X = flat.reshape(len(modes), n, n)
            for _ in range(folds):
                after = means @ X @ rotated
                for k, (_, parts) in enumerate(moved):
                    for v, f, g in parts:
                        after[k] += v * float(g @ X[k] @ g) * np.outer(f, f)
                X = np.tensordot(moves, after, (0, 0))
            return np.asarray(X.ravel())

        # Controllers leave the plant's slowest mode nearly as it is, and its outer product is then nearly the
        # dominant moment: from there Arnoldi is through in a third of the steps
        values, vectors = np.linalg.eig(self._whole)
        slowest = vectors[:, int(np.argmax(np.abs(values)))]
        near = np.outer(slowest, slowest.conj()).real
        return float(_radius(moment, len(modes), n, near) ** (1.0 / folds))


def _radius(
    moment: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]], modes: int, n: int, near: Matrix
) -> float:
    """Spectral radius of a map of positive semidefinite matrices to such ones, sought from `near` on."""
    # the unit matrix reaches every moment; its share is far above the tolerance, so that none is passed over
    start = np.tile((near / np.linalg.norm(near) + SHARE * np.eye(n)).ravel(), modes)
    operator = LinearOperator((modes * n * n,) * 2, matvec=moment, dtype=np.float64)
    if modes * n * n <= 16:
        dense = np.column_stack([operator @ e for e in np.eye(modes * n * n)])
        return float(np.abs(np.linalg.eigvals(dense)).max())
    try:
        values = eigs(
            operator,
            k=1,
            which="LM",
            v0=start,
            ncv=min(VECTORS, start.size),
            tol=TOLERANCE,
            return_eigenvectors=False,
        )
        return float(np.abs(values).max())
    except ArpackNoConvergence as error:
        raise RuntimeError(
            "packet loop: the spectral radius of the second moment did not converge; its two largest "
            "eigenvalues are too close"
        ) from error


def critical_loss(
    plant: control.StateSpace,
    K: control.StateSpace,
    interval_s: float,
    channels: Mapping[str, LossyChannel],
    lossy: Sequence[str] | None = None,
    *,
    grid: int = 20,
    tolerance: float = 1e-3,
) -> float:
    """Return the least chance of independent loss, the same for all `lossy` signals, that is not stable.

    A loop that lives with no packets at all can be unstable for some share in between, so the chances
    0, 1/grid, ... are tried first. Returns 1 where none of them is unstable.
    """
    lossy = tuple(channels) if lossy is None else tuple(lossy)

    def stable(p: float) -> bool:
        provided = {
            s: LossyChannel(c.latency_s, c.on_loss, p) if s in lossy else c for s, c in channels.items()
        }
        return PacketLoop(plant, K, interval_s, provided).stable()

    low = 0.0
    for k in range(grid):
        high = k / grid
        if not stable(high):
            break
        low = high
    else:
        return 1.0
    while high - low > tolerance:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low
