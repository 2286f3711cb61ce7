"""Latency in the loop: Padé models to design with, and the exact delayed loop to judge by.

Exact: y_i(t - tau_i) enters the controller as it is. Roots, margins and damping of the exact loop
are in `delay_roots` and `delay_crossing`, and offered from here as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from math import factorial, isfinite

import control
import numpy as np
from numpy.typing import NDArray

from interarea.models.errors import UserError

from ..linear.linearise import select
from ..linear.systems import state_space
from ..reduction.gramians import balance
from .characteristic_roots import (
    DelayedChannel,
    DelayedLoop,
    DelayError,
    LatencySweep,
    rightmost_roots,
    stability_map_of,
    sweep_latency,
    track_gain,
    track_roots,
)
from .margin import DelayMargin, delay_margin_of

__all__ = [
    "DelayError",
    "DelayMargin",
    "DelayedChannel",
    "DelayedLoop",
    "LatencySweep",
    "damping_over_latency",
    "delay_margin",
    "delayed_loop",
    "delayed_plant",
    "pade",
    "rightmost_roots",
    "stability_map",
    "sweep_latency",
    "track_gain",
    "track_roots",
]

Matrix = NDArray[np.float64]


def pade(latency_s: float, order: int) -> control.StateSpace:
    r"""Padé approximation of a delay, numerator and denominator of the same order.

    .. math:: e^{-s\tau} \approx \frac{\sum_k (-1)^k c_k (s\tau)^k}{\sum_k c_k (s\tau)^k}, \qquad
              c_k = \frac{(2n-k)!\, n!}{(2n)!\, k!\, (n-k)!}

    All-pass; the relative error is of order :math:`(\omega\tau)^{2n+1}`. Realised in balanced coordinates,
    where it is well conditioned at every order.

    Parameters
    ----------
    latency_s : tau >= 0, s; 0 gives the constant 1.
    order : n, 1 to 12.

    Raises
    ------
    ValueError : negative or infinite latency, order out of range.

    Examples
    --------
    >>> float(abs(pade(0.1, 3)(2j) - np.exp(-0.2j))) < 1e-9
    True
    """
    latency = checked_latency(latency_s, "the channel")
    if isinstance(order, bool) or not isinstance(order, (int, np.integer)) or not 1 <= order <= 12:
        raise ValueError(f"order = {order!r} of the Padé model: must be a whole number from 1 to 12")
    if latency == 0.0:
        return control.ss([], [], [], 1.0, inputs=["u"], outputs=["y"])
    A, B, C, D = _pade_of_one_second(int(order))
    root = np.sqrt(latency)
    states = [f"p{k + 1}" for k in range(len(A))]
    return control.ss(A / latency, B / root, C / root, D, states=states, inputs=["u"], outputs=["y"])


@cache
def _pade_of_one_second(n: int) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Balanced matrices of the model in z = s tau."""
    c = [
        factorial(2 * n - k) * factorial(n) / (factorial(2 * n) * factorial(k) * factorial(n - k))
        for k in range(n + 1)
    ]
    # companion form of the monic denominator
    den = np.array(c) / c[n]
    num = den * (-1.0) ** np.arange(n + 1)
    A = np.diag(np.ones(n - 1), 1)
    A[-1] = -den[:n]
    B = np.zeros((n, 1))
    B[-1] = 1.0
    D = num[n]
    C = (num[:n] - D * den[:n])[None, :]
    b = balance(A, B, C, np.array([[D]]))
    return b.A, b.B, b.C, b.D


def checked_latency(latency_s: float, signal: str) -> float:
    """A latency in s, or ValueError naming the signal."""
    value = float(latency_s)
    if not (isfinite(value) and value >= 0.0):
        raise ValueError(f"latency_s = {latency_s!r} of {signal}: must be finite and not negative")
    return value


def delayed_plant(
    system: control.StateSpace, latency_s_of: Mapping[str, float], order: int
) -> control.StateSpace:
    """Put Padé models of latency on named outputs of a plant; the design model of the channels.

    Parameters
    ----------
    system : n states.
    latency_s_of : output name -> latency, s. Outputs not named are not delayed.
    order : of every Padé model.

    Returns
    -------
    StateSpace with n + order * (number of latencies > 0) states and the same signal names.
    """
    state_space(system, "plant")
    outputs = list(system.output_labels)
    _known(latency_s_of, outputs, "output")
    A, B, C, D = (np.asarray(M, dtype=float).copy() for M in (system.A, system.B, system.C, system.D))
    states = list(system.state_labels)
    for name, latency in latency_s_of.items():
        if checked_latency(latency, name) == 0.0:
            continue
        p = pade(latency, order)
        i, n, q = outputs.index(name), A.shape[0], p.nstates
        A = np.block([[A, np.zeros((n, q))], [p.B @ C[i : i + 1], p.A]])
        B = np.vstack([B, p.B @ D[i : i + 1]])
        C = np.hstack([C, np.zeros((C.shape[0], q))])
        C[i, :n] *= p.D[0, 0]
        C[i, n:] = p.C[0]
        D[i] *= p.D[0, 0]
        states += [f"pade.{name}.{k + 1}" for k in range(q)]
    return control.ss(
        A, B, C, D, states=states, inputs=list(system.input_labels), outputs=outputs, name=system.name
    )


def _known(names: Iterable[str], known: list[str], kind: str) -> None:
    """Raise UserError for the first name that is not known."""
    for name in names:
        if name not in known:
            raise UserError(f"unknown {kind} {name!r}; known are {', '.join(known)}")


def delayed_loop(
    plant: control.StateSpace,
    controller: control.StateSpace,
    latency_s_of: Mapping[str, float] | None = None,
    *,
    lost: Iterable[str] = (),
    scale_of: Mapping[str, float] | None = None,
) -> DelayedLoop:
    r"""Close the loop u = + K y with exact latencies on the controller's input signals.

    With plant (A, B, C, D) and controller (Ak, Bk, Ck, Dk), states x = (plant, controller):

    .. math:: \dot x = A_0 x + \sum_i b_i\, c_i x(t - \tau_i), \qquad
              b_i = \begin{bmatrix} B D_k e_i \\ B_k e_i \end{bmatrix}, \quad
              c_i = e_i^T [\,C \;\; D C_k\,] .

    Parameters
    ----------
    plant : inputs and outputs include, by name, the controller's outputs and inputs.
    controller : K.
    latency_s_of : controller input -> latency, s; others 0.
    lost : controller inputs that read zero.
    scale_of : controller input -> factor on it; others 1.

    Raises
    ------
    DelayError : D and Dk both nonzero (a delay equation of neutral type).
    ValueError : unknown signals, negative latency.
    """
    state_space(controller, "controller")
    latencies = dict(latency_s_of or {})
    lost, scales = tuple(lost), dict(scale_of or {})
    signals = list(controller.input_labels)
    _known(latencies, signals, "controller input")
    _known(lost, signals, "controller input")
    _known(scales, signals, "controller input")
    picked = select(plant, list(controller.output_labels), signals)
    A, B, C, D = (np.asarray(M, dtype=float) for M in (picked.A, picked.B, picked.C, picked.D))
    Ak, Bk, Ck, Dk = (
        np.asarray(M, dtype=float) for M in (controller.A, controller.B, controller.C, controller.D)
    )
    if np.any(D != 0.0) and np.any(Dk != 0.0):
        raise DelayError(
            "plant and controller both have direct feedthrough (D and Dk not zero): with latency the loop "
            "is of neutral type, which this analysis does not cover; use a strictly proper controller"
        )
    n, nk = A.shape[0], Ak.shape[0]
    A0 = np.block([[A, B @ Ck], [np.zeros((nk, n)), Ak]])
    c = np.hstack([C, D @ Ck])
    b = np.vstack([B @ Dk, Bk])
    channels = []
    for i, name in enumerate(signals):
        if name in lost:
            continue
        late = checked_latency(latencies.get(name, 0.0), name)
        channels.append(DelayedChannel(name, late, scales.get(name, 1.0) * b[:, i], c[i]))
    return DelayedLoop(A0, tuple(channels))


def delay_margin(
    plant: control.StateSpace,
    controller: control.StateSpace,
    signals: Iterable[str] | None = None,
    *,
    latency_s_of: Mapping[str, float] | None = None,
    upto_s: float = 10.0,
) -> DelayMargin:
    """Find the smallest common latency of `signals` at which the loop touches the stability limit.

    Synchronous feedback: all signals (the default); non-synchronous: the remote one only.

    Parameters
    ----------
    signals : controller inputs that are delayed together.
    latency_s_of : fixed latencies of the other signals, s.
    upto_s : margins above this are reported as infinite.

    Raises
    ------
    DelayError : the loop is unstable without the latency.
    """
    moving = tuple(controller.input_labels if signals is None else signals)
    _known(moving, list(controller.input_labels), "controller input")
    return delay_margin_of(delayed_loop(plant, controller, latency_s_of), moving, upto_s=upto_s)


def damping_over_latency(
    plant: control.StateSpace,
    controller: control.StateSpace,
    latencies_s: Matrix | list[float],
    signals: Iterable[str] | None = None,
    *,
    roots: Mapping[str, complex],
    latency_s_of: Mapping[str, float] | None = None,
) -> LatencySweep:
    """Follow named roots of the exact loop while the latency of `signals` grows.

    Parameters
    ----------
    latencies_s : (k,) increasing, s.
    signals : controller inputs delayed together; all for synchronous feedback.
    roots : name -> eigenvalue of the loop without that latency, such as the closed-loop swing modes.
    latency_s_of : fixed latencies of the other signals, s.
    """
    moving = tuple(controller.input_labels if signals is None else signals)
    _known(moving, list(controller.input_labels), "controller input")
    return sweep_latency(delayed_loop(plant, controller, latency_s_of), moving, latencies_s, roots)


def stability_map(
    plant: control.StateSpace,
    controller: control.StateSpace,
    first: tuple[str, Matrix | list[float]],
    second: tuple[str, Matrix | list[float]],
) -> Matrix:
    """Spectral abscissa (1/s) of the exact loop over two latencies, shape (len(first), len(second)).

    first, second : (controller input, latencies in s). Negative entries are stable points.
    """
    for name, _ in (first, second):
        _known([name], list(controller.input_labels), "controller input")
    return stability_map_of(delayed_loop(plant, controller), first, second)
