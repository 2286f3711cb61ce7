r"""Passive fault-tolerant synthesis: one controller for every loss pattern. [Sundaria2016], section 4.3

Loss pattern i measures :math:`C_i` (rows of lost signals are zero). One pair X, Y
serves all, and ``B^ C_i Y`` is bilinear, so two kinds of LMI alternate: Y
fixed, then B^ fixed. Differences from the printed iteration, and why:

* Step (i) has the closed form B^ = 0: no feedback, each pattern's damping is the open loop's.
* The printed search for the smallest angle is flat and ends in useless high gain (effort 58,
  poles of 1e5 rad/s). Here the damping targets are given, possibly different for each pattern;
  each half-step minimises ``-margin + w gamma``, where the margin t of ``sector_i >= t I`` may not
  exceed 0 and gamma bounds the effort \|K (I - G_i K)^-1\| for every pattern. Once the
  targets are met, the rest of the iteration lowers the effort.
* "theta" is the half-angle: zeta_min = cos theta.

With equal targets the optimum ignores the remote signal (a purely local
controller damps the same whatever is lost); a higher target for `normal` than
for the losses makes it use the signal.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import control
import numpy as np

from ..errors import InfeasibleDesign, UncertifiedDesign
from ..lmi import regions
from ..lmi.expressions import Program, linear, trace
from ..lmi.problem import Matrix, Solution
from ..lmi.recover import recover
from ..lmi.solve import solve, usable
from .check import Synthesis, checked, largest_feasible, require_reachable, weak_words
from .generalized_plant import GeneralizedPlant, balanced_states, effort_plant, scaled
from .lmi_form import PoleRegion, Unknowns, closed_loop

#: The margin may rise to this much above zero, so that the accepted point is strictly inside.
_MARGIN = 1e-4

Pattern = Mapping[str, tuple[Matrix, Matrix]]


@dataclass(frozen=True)
class Alternation:
    """How the half-steps are run.

    Attributes
    ----------
    effort_weight : w in ``-margin + w gamma``.
    trace_weight : eps of ``eps trace(X + Y) / n``.
    half_steps : most LMIs solved.
    tolerance : stop when a pair of half-steps lowers the effort by less than this, relative.
    """

    effort_weight: float = 0.1
    trace_weight: float = 1e-3
    half_steps: int = 24
    tolerance: float = 1e-2


@dataclass(frozen=True)
class _Iterate:
    """Result of one half-step: a full set of unknowns, its margin and effort."""

    X: Matrix
    Y: Matrix
    Ah: Matrix
    Bh: Matrix
    Ch: Matrix
    margin: float
    gamma: float


def fault_tolerant(
    G: control.StateSpace,
    damping_ratio_of: Mapping[str, float],
    *,
    loss_of: Mapping[str, tuple[str, ...]] | None = None,
    radius: float = 300.0,
    decay_rate: float | None = None,
    effort_cap: float | None = None,
    alternation: Alternation | None = None,
    engine: str = "structured",
) -> Synthesis:
    r"""Find one controller with a damping target for every loss pattern at little effort.

    Parameters
    ----------
    G : design plant, D = 0, outputs named; speeds in rad/s.
    damping_ratio_of : loss pattern -> least damping ratio, e.g. ``{"normal": 0.4, "remote_lost": 0.22}``.
    loss_of : loss pattern -> names of the outputs lost; ``"normal"`` loses none. None: for the
        patterns beside "normal", of which there may be one, the first output.
    radius, decay_rate : further pole region, for every pattern.
    effort_cap : largest acceptable effort; None: any.
    alternation, engine : how to iterate, with what.

    Returns
    -------
    Synthesis
        gamma is the effort bound for every pattern; ``facts["history"]`` holds (margin, gamma) of
        each half-step, ``facts["open_loop_damping_ratio"]`` the closed form of step (i).

    Raises
    ------
    InfeasibleDesign
        With the largest common fraction of the way from the open loop to the targets that was reached.
    UncertifiedDesign, ValueError
    """
    what = "fault-tolerant control"
    options = Alternation() if alternation is None else alternation
    started = time.perf_counter()
    P = scaled(balanced_states(effort_plant(G)))
    pattern_of = loss_patterns(P, damping_ratio_of, loss_of)
    region_of = {name: PoleRegion(z, decay_rate, radius) for name, z in damping_ratio_of.items()}
    weak = []
    for name, (C2, _) in pattern_of.items():
        weak += require_reachable(P.A, P.B2, C2, region_of[name], f"{what}, {name}")

    run = _Run(P, pattern_of, radius, decay_rate, options, engine)
    last = run.to(damping_ratio_of)
    values = np.linalg.eigvals(P.A)
    open_loop = float(np.min(-values.real / np.abs(values)))
    if last is None or last.margin < 0.0:
        _explain(run, damping_ratio_of, max(open_loop, 0.0), weak, what)
    assert last is not None
    if effort_cap is not None and not last.gamma <= effort_cap:
        raise InfeasibleDesign(
            f"{what}: the least effort found at damping ratios {_words(damping_ratio_of)} is "
            f"{last.gamma:.4g}, allowed is {effort_cap:.4g}; raise the cap to "
            f"{1.01 * last.gamma:.4g} or lower the targets",
            constraint="effort",
            asked=effort_cap,
            reachable=last.gamma,
        )
    try:
        K = recover(P.A, P.B2, None, last.X, last.Y, last.Ah, last.Bh, last.Ch)
    except ValueError as error:
        raise UncertifiedDesign(f"{what}: {error}") from error
    poles_of, norm_of = checked(P, K, pattern_of, region_of, last.gamma, what=what)
    return Synthesis(
        controller=P.controller(*K),
        gamma=last.gamma,
        norm_of=norm_of,
        poles_of=poles_of,
        region_of=region_of,
        solves=run.solves,
        seconds=time.perf_counter() - started,
        engine=engine,
        facts={"history": tuple(run.history), "open_loop_damping_ratio": open_loop},
    )


def loss_patterns(
    P: GeneralizedPlant,
    damping_ratio_of: Mapping[str, float],
    loss_of: Mapping[str, tuple[str, ...]] | None,
) -> dict[str, tuple[Matrix, Matrix]]:
    """Return loss pattern -> (C2, D21) with the rows of lost signals zero.

    Raises
    ------
    ValueError
        If "normal" is missing, a pattern has no rule, a signal is unknown, or nothing is left.
    """
    if "normal" not in damping_ratio_of:
        raise ValueError(f"fault-tolerant control: no target for 'normal' among {sorted(damping_ratio_of)}")
    if loss_of is None:
        others = [name for name in damping_ratio_of if name != "normal"]
        if len(others) > 1:
            raise ValueError(f"fault-tolerant control: name in loss_of the signals that {others} lose")
        loss_of = {name: tuple(P.outputs[:1]) for name in others}
    patterns = {}
    for name in damping_ratio_of:
        if name != "normal" and name not in loss_of:
            raise ValueError(
                f"fault-tolerant control: loss_of has no entry for {name!r}, it has {sorted(loss_of)}"
            )
        lost = () if name == "normal" else loss_of[name]
        unknown = sorted(set(lost) - set(P.outputs))
        if unknown:
            raise ValueError(f"fault-tolerant control: {name!r} loses {unknown}, known signals: {P.outputs}")
        keep = np.array([signal not in lost for signal in P.outputs], dtype=float)
        if not np.any(keep):
            raise ValueError(f"fault-tolerant control: {name!r} loses every signal, no damping is possible")
        patterns[name] = (keep[:, None] * P.C2, keep[:, None] * P.D21)
    return patterns


class _Run:
    """The alternation for one plant; counts its solves."""

    def __init__(
        self,
        P: GeneralizedPlant,
        pattern_of: Pattern,
        radius: float,
        decay_rate: float | None,
        options: Alternation,
        engine: str,
    ) -> None:
        self.P, self.pattern_of, self.options, self.engine = P, pattern_of, options, engine
        self.radius, self.decay_rate = radius, decay_rate
        self.solves = 0
        self.history: list[tuple[float, float]] = []
        self.refusal: Solution | None = None  #: the last LMI without a usable point

    def to(self, damping_ratio_of: Mapping[str, float], *, stop_when_met: bool = False) -> _Iterate | None:
        """Alternate until the targets are met and the effort settles; None if the first LMI fails."""
        n, p = self.P.order, self.P.C2.shape[0]
        self.history, self.refusal = [], None
        last = self.half_step(damping_ratio_of, Bh=np.zeros((n, p)))
        earlier: _Iterate | None = None
        for k in range(1, self.options.half_steps):
            if last is None:
                return None
            fixed = {"Y": last.Y} if k % 2 else {"Bh": last.Bh}
            result = self.half_step(damping_ratio_of, **fixed)
            if result is None:
                return last
            if k % 2 == 0:
                if earlier is not None and self._settled(earlier, result):
                    return result
                earlier = result
            last = result
            if stop_when_met and last.margin >= 0.0:
                return last
        return last

    def _settled(self, before: _Iterate, now: _Iterate) -> bool:
        """Whether a pair of half-steps changed too little to go on."""
        if now.margin < 0.0:
            return now.margin - before.margin < 1e-3 * abs(before.margin)
        return before.margin >= 0.0 and before.gamma - now.gamma < self.options.tolerance * before.gamma

    def half_step(
        self, damping_ratio_of: Mapping[str, float], *, Y: Matrix | None = None, Bh: Matrix | None = None
    ) -> _Iterate | None:
        """Solve one LMI problem with Y or B^ fixed; None without a strictly feasible point."""
        P, w = self.P, self.options.effort_weight
        program = Program()
        u = Unknowns.of(program, P, Y=Y, Bh=Bh)
        margin, gamma = program.scalar("margin"), program.scalar("gamma")
        program.require("margin <= 0", _MARGIN * np.eye(1) - margin * np.eye(1))
        for k, (name, (C2, D21)) in enumerate(self.pattern_of.items()):
            loop = closed_loop(P, u, C2=C2, D21=D21)
            if k == 0:
                program.require("Lyapunov matrix", loop.N)
            sector = regions.sector(loop.M, damping_ratio_of[name])
            program.require(f"damping ratio, {name}", sector - margin * np.eye(2 * P.order))
            program.require(f"radius, {name}", regions.disk(loop.M, loop.N, self.radius))
            if self.decay_rate is not None:
                program.require(f"decay rate, {name}", regions.shift(loop.M, loop.N, self.decay_rate))
            program.require(f"effort, {name}", regions.hinf(loop.M, loop.Bw, loop.Cz, loop.D, gamma))
        program.minimise(linear(margin) * -1.0 + linear(gamma) * w)
        program.minimise(trace(u.X + u.Y) * (self.options.trace_weight / P.order))
        problem = program.problem()
        solution: Solution = solve(problem, self.engine)
        self.solves += 1
        if not usable(problem, solution):
            self.refusal = solution
            return None
        v, s = solution.values, solution.scalars
        self.history.append((s["margin"], s["gamma"]))
        return _Iterate(
            X=v["X"],
            Y=v["Y"] if Y is None else Y,
            Ah=v["A^"],
            Bh=v["B^"] if Bh is None else Bh,
            Ch=v["C^"],
            margin=s["margin"],
            gamma=s["gamma"],
        )


def _explain(
    run: _Run,
    damping_ratio_of: Mapping[str, float],
    open_loop: float,
    weak: list[tuple[complex, float]],
    what: str,
) -> None:
    """Raise InfeasibleDesign with the largest fraction of the targets that is reached."""
    if run.refusal is not None and run.refusal.status != "infeasible":
        raise UncertifiedDesign(
            f"{what}: after {len(run.history)} half-steps {run.refusal.engine} stopped with "
            f"{run.refusal.status!r} ({run.refusal.message}); try the other engine or a larger radius"
        )

    def targets(fraction: float) -> dict[str, float]:
        return {
            k: min(z, open_loop) + fraction * max(z - open_loop, 0.0) for k, z in damping_ratio_of.items()
        }

    def feasible(fraction: float) -> bool:
        result = run.to(targets(fraction), stop_when_met=True)
        return result is not None and result.margin >= 0.0

    fraction = largest_feasible(feasible, 0.0, 1.0, steps=7)
    if fraction is None:
        raise InfeasibleDesign(
            f"{what}: not even the open loop's damping ratio {open_loop:.4f} is reached inside radius "
            f"{run.radius:g} rad/s and decay rate {run.decay_rate}; loosen these{weak_words(weak)}",
            constraint="radius" if run.decay_rate is None else "decay_rate",
            asked=run.radius if run.decay_rate is None else run.decay_rate,
        )
    reachable = targets(fraction)
    raise InfeasibleDesign(
        f"{what}: damping ratios {_words(damping_ratio_of)} were not reached by one controller; reached are "
        f"{_words(reachable)}{weak_words(weak)}",
        constraint="damping_ratio",
        asked=dict(damping_ratio_of),
        reachable=reachable,
    )


def _words(damping_ratio_of: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {z:.3f}" for name, z in damping_ratio_of.items())
