"""What a controller does on the full linear plant: normal, signals lost, with exact latency.

Swing modes of the closed loop keep the name of the open-loop mode that they come from: the eigenvalues are
followed while the loop's gain rises from 0 to 1, so that a controller's own poles are never taken for one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import control
import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment, minimize_scalar

from ..controllers.controller import Controller
from ..delay.curves import DelayError, delayed_loop, rightmost_roots, track_gain, track_roots
from ..delay.signal_conditions import Condition
from ..errors import UncertifiedDesign
from ..linear.linearise import select
from ..linear.matrices import ZERO_EIGENVALUE, decays
from ..linear.norms import hinf_of
from ..linear.systems import state_space
from ..modes.modes import Modes, damping_ratio
from ..reduction.gramians import separate_slow

ComplexArray = npt.NDArray[np.complex128]


def study_conditions(remote: str, local: str) -> tuple[Condition, ...]:
    """Return the latencies every controller of the study is judged at; remote and local name its signals."""
    both = (remote, local)
    return (
        *(Condition(f"non-synchronous {d} ms", (), {remote: d / 1e3}) for d in (100, 200, 300)),
        *(Condition(f"synchronous {d} ms", (), dict.fromkeys(both, d / 1e3)) for d in (50, 100, 200)),
        Condition("remote lost, local 100 ms", (remote,), {local: 0.1}),
    )


def closed_loop_matrix(
    plant: control.StateSpace, K: control.StateSpace, *, lost: Sequence[str] = (), gain: float = 1.0
) -> npt.NDArray[np.float64]:
    """Return the state matrix of the plant (speeds in rad/s, D = 0) with u = gain K y, lost signals zero."""
    state_space(K, "controller")
    G = select(plant, list(K.output_labels), list(K.input_labels))
    keep = np.array([gain * (name not in lost) for name in K.input_labels])
    return np.block([[G.A + G.B @ (K.D * keep) @ G.C, G.B @ K.C], [(K.B * keep) @ G.C, np.asarray(K.A)]])


def swing_poles(
    plant: control.StateSpace,
    K: control.StateSpace,
    modes: Modes,
    *,
    lost: Sequence[str] = (),
    steps: int = 60,
) -> dict[str, complex]:
    """Return mode name -> closed-loop pole, followed from the open loop as the gain rises.

    modes : of the open loop. At each step poles are paired by distance and by overlap of eigenvectors.
    """
    names = list(modes)
    values, vectors = np.linalg.eig(closed_loop_matrix(plant, K, lost=lost, gain=0.0))
    start = [int(np.argmin(np.abs(values - modes[name].eigenvalue))) for name in names]
    poles, shapes, slope = values[start], vectors[:, start], np.zeros(len(names), complex)
    for k in range(1, steps + 1):
        values, vectors = np.linalg.eig(closed_loop_matrix(plant, K, lost=lost, gain=(k / steps) ** 2))
        overlap = np.abs(shapes.conj().T @ vectors)
        distance = np.abs(values[None, :] - (poles + slope)[:, None])
        rows, columns = linear_sum_assignment(distance + 2.0 * (1.0 - overlap))
        columns = columns[np.argsort(rows)]
        slope = values[columns] - poles
        poles, shapes = values[columns], vectors[:, columns]
    return {name: complex(p) for name, p in zip(names, poles, strict=True)}


def certificate(
    plant: control.StateSpace,
    controller: Controller,
    modes: Modes,
    conditions: Sequence[Condition] | None = None,
) -> dict[str, Any]:
    """Return what a controller does on the full plant: damping, poles, effort, and the table of conditions.

    Its local signal is the speed of the machine that it acts on, the remote one any other.

    Parameters
    ----------
    plant : full plant without reference angle, speeds in rad/s.
    modes : its open-loop swing modes.
    conditions : besides normal and remote lost; None = those of the study.
    """
    K = controller.system
    local = f"{controller.outputs[0].removesuffix('_vs')}_dw"
    remote = next((name for name in controller.inputs if name != local), local)
    always = (Condition("normal"), Condition("remote lost", (remote,)))
    others = study_conditions(remote, local) if conditions is None else conditions
    rows = [_condition_row(plant, K, modes, c) for c in (*always, *others)]
    normal, lost = rows[0], rows[1]
    poles = np.linalg.eigvals(closed_loop_matrix(plant, K))
    own = np.linalg.eigvals(np.asarray(K.A))
    return {
        "order": controller.order,
        "order_full": controller.design.get("order_full", controller.order),
        "method": controller.design.get("method", "given"),
        "region": controller.design.get("region", {}),
        "damping_ratio": {"normal": normal["damping_ratio"], "remote_lost": lost["damping_ratio"]},
        "stable": {"normal": normal["stable"], "remote_lost": lost["stable"]},
        "slowest_pole": float(np.max(poles.real)),
        "fastest_pole": float(np.max(np.abs(poles))),
        "controller_fastest_pole": float(np.max(np.abs(own))) if own.size else 0.0,
        "effort": effort(plant, K),
        "remote_utilisation": remote_utilisation(K, remote, abs(modes.inter_area.eigenvalue.imag)),
        "loss_criterion": loss_criterion(plant, K, local),
        "conditions": rows,
    }


def _condition_row(
    plant: control.StateSpace, K: control.StateSpace, modes: Modes, condition: Condition
) -> dict[str, Any]:
    poles = swing_poles(plant, K, modes, lost=condition.lost)
    if not condition.latency_s_of:
        values = np.linalg.eigvals(closed_loop_matrix(plant, K, lost=condition.lost))
        rightmost = complex(values[np.argmax(values.real)])
    else:
        loop = delayed_loop(plant, K, dict(condition.latency_s_of), lost=condition.lost)
        rightmost = complex(rightmost_roots(loop, right_of=0.0)[0])
        poles = _delayed_poles(plant, K, modes, poles, condition)
    return {
        "condition": condition.name,
        "stable": decays(rightmost),
        "damping_ratio": {name: damping_ratio(p) for name, p in poles.items()},
        "rightmost": [rightmost.real, rightmost.imag],
    }


def _delayed_poles(
    plant: control.StateSpace,
    K: control.StateSpace,
    modes: Modes,
    poles: Mapping[str, complex],
    condition: Condition,
) -> dict[str, complex]:
    """Follow the swing poles of the loop to its latency, or those of the open loop along the gain at it.

    Raises UncertifiedDesign naming a mode that neither way leads to, or two that end in one pole.
    """
    loop = delayed_loop(plant, K, condition.latency_s_of, lost=condition.lost)
    fixed = delayed_loop(plant, K, lost=condition.lost)
    latency = max(condition.latency_s_of.values())
    together = len(set(condition.latency_s_of.values())) == 1
    followed: dict[str, complex] = {}
    for name, pole in poles.items():
        delayed_poles = None
        if together:
            with suppress(DelayError):
                delayed_poles = complex(
                    track_roots(fixed, tuple(condition.latency_s_of), [latency], pole)[-1]
                )
        if delayed_poles is None or _taken(delayed_poles, followed):
            try:
                delayed_poles = track_gain(loop, modes[name].eigenvalue)
            except DelayError as error:
                raise UncertifiedDesign(
                    f"condition {condition.name!r}: the pole of mode {name!r} could not be tracked from "
                    f"the open loop ({error}); its damping is unknown, so this controller is not certified"
                ) from error
        twin = _taken(delayed_poles, followed)
        if twin is not None:
            raise UncertifiedDesign(
                f"condition {condition.name!r}: modes {twin!r} and {name!r} are both tracked to the pole "
                f"{delayed_poles:.6g}; one of them is unknown, so this controller is not certified"
            )
        followed[name] = delayed_poles
    return followed


def _taken(pole: complex, followed: Mapping[str, complex]) -> str | None:
    """Name of the mode that already has this pole, or its conjugate."""
    for name, other in followed.items():
        if min(abs(pole - other), abs(pole - other.conjugate())) <= 1e-7 * (1.0 + abs(pole)):
            return name
    return None


def effort(plant: control.StateSpace, K: control.StateSpace) -> float:
    """Return the H-infinity norm of K (I - G K)^-1 on the full plant, pu per rad/s.

    A common speed that nothing brings back is a root at 0 of the loop too where K lets no constant pass, and
    then no output shows it: that root is left out of the loop, not of the plant, whose response needs it.
    """
    G = select(plant, list(K.output_labels), list(K.input_labels))
    A, D = closed_loop_matrix(plant, K), np.asarray(K.D)
    B, C = np.vstack([G.B @ K.D, np.asarray(K.B)]), np.hstack([K.D @ G.C, np.asarray(K.C)])
    if np.abs(np.linalg.eigvals(A)).min(initial=np.inf) < ZERO_EIGENVALUE:
        A, B, C, D = separate_slow(A, B, C, D, ZERO_EIGENVALUE).stable
    return float(hinf_of(A, B, C, D).value)


def remote_utilisation(K: control.StateSpace, remote: str, omega: float) -> float:
    """Return the remote signal's part |k_r| / sqrt(sum |k_i|^2) of the controller's gain at `omega` rad/s."""
    gains = np.abs(K.C @ np.linalg.solve(1j * omega * np.eye(K.nstates) - K.A, K.B) + K.D)
    total = float(np.linalg.norm(gains))
    part = float(np.linalg.norm(gains[:, list(K.input_labels).index(remote)]))
    return part / total if total > 0.0 else 0.0


def loss_criterion(plant: control.StateSpace, K: control.StateSpace, present: str | Sequence[str]) -> float:
    """Return the largest real eigenvalue of K_kept(s) G_kept(s) over real s >= 0, as `largest_real_gain`.

    Without s = 0 where a common speed that nothing brings back has its pole there.

    plant : full plant without reference angle, speeds in rad/s, stable in open loop but for that speed.
    present : names of signals.
    """
    names = [present] if isinstance(present, str) else list(present)
    if not names:
        return 0.0
    G = select(plant, list(K.output_labels), names)
    integrating = bool(np.abs(np.linalg.eigvals(np.asarray(G.A))).min(initial=np.inf) < ZERO_EIGENVALUE)
    return largest_real_gain(
        K,
        names,
        lambda s: G.C @ np.linalg.solve(s * np.eye(G.nstates) - G.A, G.B) + G.D,
        at_rest=not integrating,
    )


def largest_real_gain(
    K: control.StateSpace, present: Sequence[str], G: Callable[[float], npt.NDArray[Any]], *, at_rest: bool
) -> float:
    """Return the largest real eigenvalue of K_kept(s) G(s) over real s.

    Above 1 the loop that is left with the other signals lost is unstable: this is the loop gain of the kept
    signals, and where an eigenvalue passes 1 at a real s there is a real closed-loop pole. Searched on 400
    points from 1e-3 to 1e3 rad/s, then polished between neighbours; at_rest : at s = 0 too.
    """
    columns = [list(K.input_labels).index(name) for name in present]
    b, d = np.asarray(K.B)[:, columns], np.asarray(K.D)[:, columns]

    def gain(s: float) -> float:
        k = K.C @ np.linalg.solve(s * np.eye(K.nstates) - K.A, b) + d
        values = np.linalg.eigvals(k @ G(s))
        real = values.real[np.abs(values.imag) <= 1e-9 * (1.0 + np.abs(values))]
        return float(real.max(initial=-np.inf))

    grid = np.concatenate([[0.0] if at_rest else [], np.geomspace(1e-3, 1e3, 400)])
    gains = np.array([gain(s) for s in grid])
    k = int(np.argmax(gains))
    low, high = grid[max(k - 1, 0)], grid[min(k + 1, grid.size - 1)]
    best = minimize_scalar(lambda s: -gain(s), bounds=(low, high), method="bounded")
    return max(float(gains[k]), -float(best.fun))
