"""Parameters of a machine with its controls from a record: which are identifiable, values, covariance.

Gauss-Newton (Levenberg, Marquardt) on P and Q of the machine (`play_in.py`), each weighted by its noise, in
shares of the start values. The initial power is fitted too, and the instant of each voltage jump within its
step of the record. Sensitivities are differences of two runs with the same steps. Before the fit, the
singular values of the sensitivities identify the combinations that the record does not determine within
`LIMIT`; the largest parameter of each is fixed and named (Golub and Van Loan 2013, 5.5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import lsq_linear
from scipy.stats import norm

from interarea.models.case.case import Case
from interarea.models.case.parameter_path import parameter_value
from interarea.models.errors import UserError

from .ambient import LEVEL
from .play_in import Bench, terminal_of
from .record import Array, Record, RecordError

LIMIT = 0.2  #: deviation over the value from which on a record does not show a parameter
MOST = 6  #: parameters that are fitted at once
_STEP = 1e-5  # of a value, for its sensitivity
_CLOSE = 1e-3  # of a value: what the last step may change
_MOST_STEPS = 20
_FARTHEST = 0.4  # of a value: what one step may change
_JUMP_PU = 0.01  # second difference of a voltage: between two frames the record does not say when
_BESIDE = 0.3  # of a jump: what the voltage may move in the steps beside it, for its instant to be fitted
_MOST_JUMPS = 8  # whose instants are fitted
_AROUND = 3  # frames on both sides of a jump that are not judged
_FLOOR = 0.005  # of what P and Q move: errors of a model and of a spline between frames are not less
_PARTNER = 0.3  # component of a singular direction that names a parameter


@dataclass(frozen=True)
class Parameter:
    """A parameter that was fitted. start : in the case. deviation : standard. interval : at `LEVEL`."""

    name: str
    start: float
    value: float
    deviation: float
    interval: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Fit:
    """A machine beside its record.

    misfit : rms of P and Q relative to their motion, with the case's parameters. fitted : with the new ones.
    kept_as_is : parameter -> why it was not fitted. covariance : of `parameters`, in their units, squared.
    time_s, measured, played : the record, and the machine with the new parameters, (points, 2), pu of the
    case's base.
    """

    source: str
    machine: str
    misfit: tuple[float, float]
    fitted: tuple[float, float]
    parameters: tuple[Parameter, ...]
    kept_as_is: dict[str, str]
    covariance: Array
    time_s: Array
    measured: Array
    played: Array
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return plain types, for JSON."""
        rows = [{**vars(p), "interval": list(p.interval)} for p in self.parameters]
        plain = {k: v for k, v in vars(self).items() if k not in ("time_s", "measured", "played")}
        curves = {
            f"{letter}_{what}_pu": values[:, k].tolist()
            for what, values in (("measured", self.measured), ("played", self.played))
            for k, letter in enumerate("PQ")
        }
        return {
            **plain, "misfit": list(self.misfit), "fitted": list(self.fitted), "parameters": rows,
            "level": LEVEL, "covariance": self.covariance.tolist(), "notes": list(self.notes),
            "time_s": self.time_s.tolist(),
            **curves,
        }  # fmt: skip


@dataclass(eq=False)
class _Problem:
    """What is minimised. judged : (points,) whether a point counts. noise : (2,) of P and Q.

    jumps : points after which the voltage jumps. What is fitted beside the parameters, `other`: P and Q at
    rest, then of each jump where it is within its step, 0 to 1.
    """

    bench: Bench
    names: tuple[str, ...]
    starts: Array
    measured: Array
    judged: Array
    noise: Array
    jumps: tuple[int, ...]

    def run(self, u: Array, other: Array) -> Array:
        values = {n: float(s * v) for n, s, v in zip(self.names, self.starts, u, strict=True)}
        jumps = dict(zip(self.jumps, other[2:].tolist(), strict=True))
        y = self.bench.run(values, complex(other[0], other[1]), jumps)
        if not np.all(np.isfinite(y)):
            raise RecordError(f"{self.bench.machine}: unstable with {values}")
        return y

    def rest(self, y: Array) -> Array:
        return np.asarray(((y - self.measured)[self.judged] / self.noise).ravel())

    def slopes(self, u: Array, other: Array, y: Array) -> Array:
        """Return the derivatives of `rest` by shares of the parameters, then by `other`."""
        columns = []
        for k in range(len(u)):
            moved = u.copy()
            moved[k] += _STEP
            columns.append((self.rest(self.run(moved, other)) - self.rest(y)) / _STEP)
        for k in range(len(other)):
            step = -_STEP if k >= 2 and other[k] > 0.5 else _STEP  # within the step of the record
            moved = other.copy()
            moved[k] += step
            columns.append((self.rest(self.run(u, moved)) - self.rest(y)) / step)
        return np.column_stack(columns)

    def moved(self, slopes: Array, y: Array, other: Array, damping: float) -> Array:
        """Return the step of Gauss-Newton; a jump stays within its step of the record."""
        n = len(self.names)
        rest, step = self.rest(y), np.zeros(slopes.shape[1])
        free = np.ones(len(step), bool)
        for _ in range(len(self.jumps) + 1):
            own = slopes[:, free]
            normal = own.T @ own
            normal += damping * np.diag(np.diag(normal))
            left = rest + slopes[:, ~free] @ step[~free]
            step[free] = -np.linalg.solve(normal, own.T @ left)
            reached = other + step[n:]
            out = free[n:] & ((reached < 0.0) | (reached > 1.0))
            out[:2] = False
            if not out.any():
                break
            step[n:][out] = np.clip(reached[out], 0.0, 1.0) - other[out]
            free[n:][out] = False
        return step


def fitted(
    record: Record,
    case: Case,
    machine: str,
    cache: Path,
    *,
    parameters: Sequence[str] = (),
    rest_s: float = 0.5,
    progress: Callable[[str], object] = lambda _: None,
) -> Fit:
    """Compare a machine of a case with its record; fit those of `parameters` that the record determines.

    parameters : such as ``H``, ``exciter.KA``; none: comparison only. rest_s : duration of the steady state
    at the start of the record.

    Raises
    ------
    RecordError : an error of `terminal_of`, no such parameter, too many, one that is 0, an unstable machine.
    CaseError : a machine without an equilibrium at the operating point of the record.
    """
    terminal = terminal_of(record, case, machine, rest_s)
    names = tuple(parameters)
    starts = _starts(case, machine, names)
    bench = Bench(case, machine, terminal, cache)
    measured = np.column_stack([terminal.P, terminal.Q])
    judged = _judged(terminal.V)
    noise = np.maximum(_noise(measured[judged]), _FLOOR * measured[judged].std(axis=0))
    if not np.all(noise > 0.0):
        raise RecordError(
            f"{record.source}: P or Q of {machine} never moves, wanted: a record with a disturbance"
        )
    jumps = _jumps(terminal.V * np.exp(1j * terminal.angle))
    other = np.array([bench.power0.real, bench.power0.imag, *[0.5] * len(jumps)])
    problem = _Problem(bench, names, starts, measured, judged, noise, jumps)
    progress("with the parameters of the case")
    other, y = _with_jumps(problem, other)
    first = y
    kept_as_is: dict[str, str] = {}
    shown: tuple[Parameter, ...] = ()
    covariance = np.zeros((0, 0))
    notes = []
    if not judged.all():
        notes.append(f"{np.sum(np.logical_not(judged))} frames at jumps of the voltage are not evaluated")
    if names:
        slopes = problem.slopes(np.ones(len(names)), other, y)
        visible = _shown(slopes, names, kept_as_is)
        problem = replace(problem, names=tuple(names[k] for k in visible), starts=starts[visible])
        columns = slopes[:, [*visible, *range(len(names), slopes.shape[1])]]
        u, y, covariance = _minimised(problem, columns, other, y, progress)
        wide = float(norm.ppf(0.5 + 0.5 * LEVEL))
        scale = problem.starts
        covariance = covariance * np.outer(scale, scale)
        rows = []
        for k, name in enumerate(problem.names):
            value, deviation = float(u[k] * scale[k]), float(np.sqrt(covariance[k, k]))
            interval = (value - wide * deviation, value + wide * deviation)
            rows.append(Parameter(name, float(scale[k]), value, deviation, interval))
        shown = tuple(rows)
    return Fit(
        record.source, machine, _share(first, measured, judged), _share(y, measured, judged), shown,
        kept_as_is, covariance, record.time_s, measured, y, (*record.notes, *notes),
    )  # fmt: skip


def _starts(case: Case, machine: str, names: Sequence[str]) -> Array:
    """Return the values of parameters in the case."""
    if len(names) > MOST or len(set(names)) < len(names):
        raise RecordError(f"{', '.join(names)}: {len(names)} parameters, allowed: {MOST}, each once")
    starts = []
    for name in names:
        if name in ("P_mw", "Q_mvar", "V_pu", "bus", "base_mva", "area", "angle_deg"):
            raise RecordError(f"{name}: cannot be fitted, allowed: H, Xd, exciter.KA, ... of {machine}")
        value = parameter_value(case, f"machines.{machine}.{name}")
        if value == 0.0:
            raise RecordError(
                f"{machine}.{name} is 0 in {case.name}, so the function is absent, wanted: a start value"
            )
        starts.append(value)
    return np.array(starts)


def _judged(V: Array) -> Array:
    """Return which points are not beside a jump of the voltage."""
    jumps = np.abs(np.diff(V, 2)) > _JUMP_PU
    judged = np.ones(len(V), bool)
    for k in np.flatnonzero(jumps) + 1:
        judged[max(0, k - _AROUND) : k + 1 + _AROUND] = False
    return judged


def _jumps(V: npt.NDArray[np.complex128]) -> tuple[int, ...]:
    """Return after which points the phasor jumps within one step; none where there are too many."""
    moves = np.abs(np.diff(V))
    beside = np.maximum(moves[:-2], moves[2:])
    jumps = 1 + np.flatnonzero((moves[1:-1] > _JUMP_PU) & (beside < _BESIDE * moves[1:-1]))
    return tuple(jumps.tolist()) if len(jumps) <= _MOST_JUMPS else ()


def _noise(values: Array) -> Array:
    """Return the deviation of what is white in each column, by its second differences."""
    second = np.diff(values, 2, axis=0)
    return np.asarray(np.median(np.abs(second), axis=0) / 0.6745 / math.sqrt(6.0))


def _shown(slopes: Array, names: Sequence[str], kept_as_is: dict[str, str]) -> list[int]:
    """Return which parameters the record shows; say of the others in `kept_as_is` why not."""
    places = list(range(len(names)))
    while places:
        rest = slopes[:, len(names) :]
        own = slopes[:, places]
        own = own - rest @ np.linalg.lstsq(rest, own, rcond=None)[0]
        _, sigma, right = np.linalg.svd(own, full_matrices=False)
        if sigma[-1] * LIMIT >= 1.0:
            break
        direction = right[-1]
        worst = int(np.argmax(np.abs(direction)))
        others = [names[places[k]] for k in np.flatnonzero(np.abs(direction) > _PARTNER) if k != worst]
        spread = f"{1.0 / sigma[-1]:.0%} of it" if sigma[-1] > 1e-3 else "any share of it"
        together = f" together with {', '.join(others)}" if others else ""
        kept_as_is[names[places[worst]]] = (
            f"a change by {spread}{together} has no visible effect in the record; kept"
        )
        del places[worst]
    return places


def _with_jumps(problem: _Problem, other: Array) -> tuple[Array, Array]:
    """Return `other` with the instants of the jumps fitted to the parameters of the case, and that run."""
    problem, u = replace(problem, names=(), starts=np.ones(0)), np.ones(0)
    y = problem.run(u, other)
    if not problem.jumps:
        return other, y
    slopes = problem.slopes(u, other, y)[:, 2:]
    for _ in range(_MOST_STEPS):
        shares = other[2:]
        step = lsq_linear(slopes, -problem.rest(y), (-shares - _STEP, 1.0 - shares + _STEP)).x
        reached = np.concatenate([other[:2], np.clip(shares + step, 0.0, 1.0)])
        moved = problem.run(u, reached)
        if not np.sum(problem.rest(moved) ** 2) < np.sum(problem.rest(y) ** 2):
            break
        other, y = reached, moved
        if np.max(np.abs(step)) < _CLOSE:
            break
    return other, y


def _minimised(
    problem: _Problem, slopes: Array, other: Array, y: Array, progress: Callable[[str], object]
) -> tuple[Array, Array, Array]:
    """Return shares of the start values, P and Q, and the covariance of the shares."""
    n = len(problem.names)
    u, damping = np.ones(n), 0.0
    misfit = float(np.sum(problem.rest(y) ** 2))
    for k in range(_MOST_STEPS):
        progress(f"step {k + 1}")
        step = problem.moved(slopes, y, other, damping)
        size = float(np.max(np.abs(step[:n] / u), initial=0.0))
        step *= min(1.0, _FARTHEST / max(size, 1e-300))
        try:
            moved = problem.run(u + step[:n], other + step[n:])
            better = float(np.sum(problem.rest(moved) ** 2))
        except UserError:  # values that the case refuses, or with which the machine is unstable
            better = math.inf
        if better > misfit:
            if size < _CLOSE:
                break
            damping = max(10.0 * damping, 1e-2)
            continue
        u, other, y, misfit, damping = u + step[:n], other + step[n:], moved, better, 0.1 * damping
        if size < _CLOSE:
            break
        slopes = problem.slopes(u, other, y)
    else:
        raise RecordError(
            f"{problem.bench.machine}: no fit within {_MOST_STEPS} steps from the values of the case, "
            "wanted: fewer parameters, or better start values"
        )
    slopes = problem.slopes(u, other, y)
    rest = problem.rest(y).reshape(-1, 2)
    spread = np.sqrt(np.mean(rest**2, axis=0))
    weighted = (slopes.reshape(len(rest), 2, -1) / spread[:, None]).reshape(2 * len(rest), -1)
    covariance = np.linalg.pinv(weighted.T @ weighted) * _together(rest)
    return u, y, covariance[:n, :n]


def _together(rest: Array) -> float:
    """Return by how much misfit that is not white widens a covariance: 1 + 2 x its correlations."""
    noise = rest - rest.mean(axis=0)
    total = 1.0
    size = np.sum(noise**2, axis=0)
    for lag in range(1, len(noise) // 4):
        correlation = float(np.max(np.sum(noise[lag:] * noise[:-lag], axis=0) / np.maximum(size, 1e-300)))
        if correlation <= 2.0 / math.sqrt(len(noise)):
            break
        total += 2.0 * correlation
    return total


def _share(y: Array, measured: Array, judged: Array) -> tuple[float, float]:
    off = np.sqrt(np.mean((y - measured)[judged] ** 2, axis=0))
    moves = np.maximum(np.std(measured[judged], axis=0), 1e-12)
    return float(off[0] / moves[0]), float(off[1] / moves[1])
