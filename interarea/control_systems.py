"""Public functions on any linear system, without a grid: exact delays, H-infinity and H2 synthesis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from interarea.design.delay.characteristic_roots import (
    DelayedChannel,
    DelayedLoop,
    DelayError,
    rightmost_roots,
)
from interarea.design.delay.margin import DelayMargin, delay_margin_of
from interarea.design.linear.systems import LinearSystemError, SystemLike, state_space
from interarea.design.synthesis.check import Synthesis
from interarea.design.synthesis.generalized_plant import GeneralizedPlant, loop_shift
from interarea.design.synthesis.h2 import h2_optimal
from interarea.design.synthesis.hinf import hinf_region
from interarea.design.synthesis.lmi_form import PoleRegion
from interarea.models.arguments import checked_types


@checked_types
def delay_margin(loop: SystemLike, *, sign: int = -1, upto_s: float = 10.0) -> DelayMargin:
    """Return the smallest delay that makes a feedback loop unstable, exactly, without a Padé approximation.

    Parameters
    ----------
    loop : open-loop transfer L = G K, continuous, D = 0, square. All signals have the same delay.
    sign : -1: the loop is closed by u = -y, as `control.feedback` does; +1: by u = +y.
    upto_s : largest delay examined, s.

    Returns
    -------
    DelayMargin: `margin_s` (inf: none up to `upto_s`), `frequency_rad`, all `crossings`.

    Raises
    ------
    UserError : not a linear system, D not zero, or a loop that is unstable without delay.

    Examples
    --------
    An integrator of gain 2 has a delay margin of pi / 4 s.

    >>> import control
    >>> round(delay_margin(control.ss(0, 1, 2, 0)).margin_s, 6)
    0.785398
    """
    delayed = _delayed(loop, 0.0, sign)
    return delay_margin_of(delayed, tuple(c.name for c in delayed.channels), upto_s=upto_s)


@checked_types
def delayed_poles(
    loop: SystemLike,
    latency_s: float | Sequence[float],
    *,
    sign: int = -1,
    right_of: float = -1.0,
    least: int = 1,
) -> npt.NDArray[np.complex128]:
    """Return the poles of a feedback loop with delay, 1/s, rightmost first: roots of the exact equation.

    Parameters
    ----------
    loop, sign : as `delay_margin` takes them.
    latency_s : of all signals, or one of each output, s.
    right_of : least real part of the poles, 1/s; reduced until there are `least` poles.

    Raises
    ------
    UserError : not a linear system, D not zero, a negative delay, or poles that cannot be separated.

    Examples
    --------
    >>> import control
    >>> complex(delayed_poles(control.ss(0, 1, 1, 0), 0.1)[0].round(4))
    (-1.1183+0j)
    """
    return rightmost_roots(_delayed(loop, latency_s, sign), right_of=right_of, least=least)


@checked_types
def hinfsyn(
    plant: SystemLike,
    measurements: int,
    controls: int,
    *,
    damping_ratio: float = 0.0,
    decay_rate: float | None = None,
    radius: float | None = None,
) -> Synthesis:
    """Design u = +K y of the least H-infinity norm from w to z, with the closed-loop poles in a region.

    Parameters
    ----------
    plant : continuous; inputs w then u, outputs z then y, as returned by `control.augw`.
    measurements, controls : number of outputs y and of inputs u; they are the last ones.
    damping_ratio : least damping ratio of the poles. decay_rate : least decay rate of the poles, 1/s.
    radius : largest magnitude of the poles, rad/s.

    Returns
    -------
    Synthesis: `controller` (D = 0 where the plant has no D22), `gamma`, `norm_of` and `poles_of` of the
    closed loop, and `facts` with the optimum. Without a region by Riccati equations, else by LMIs.
    [Chilali1996]

    Raises
    ------
    InfeasibleDesign : names the infeasible constraint. UncertifiedDesign : the closed loop contradicts the
    solver. UserError : not a linear system; an empty region.

    Examples
    --------
    x' = x + w1 + u, z = (x, u), y = x + w2: the optimum is 1 + sqrt(3).

    >>> import control
    >>> P = control.ss(1, [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> round(hinfsyn(P, 1, 1).facts["gamma_optimum"], 6)
    2.732051
    """
    P, D22 = _generalized(plant, measurements, controls)
    region = PoleRegion(damping_ratio, decay_rate, radius)
    return _shifted(hinf_region(P, region), D22)


@checked_types
def h2syn(plant: SystemLike, measurements: int, controls: int) -> Synthesis:
    """Design u = +K y of the least H2 norm from w to z (LQG). [Zhou1996]

    plant, measurements, controls : as `hinfsyn` takes them.

    Returns
    -------
    Synthesis: `gamma` is the optimum, `norm_of` the H2 norm of the closed loop.

    Raises
    ------
    InfeasibleDesign : a fixed unstable mode; D11, D12 or D21 without an optimum.
    UncertifiedDesign : the closed loop contradicts the equations. UserError : not a linear system.

    Examples
    --------
    >>> import control
    >>> P = control.ss(-1, [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> round(h2syn(P, 1, 1).gamma, 4)
    0.6866
    """
    P, D22 = _generalized(plant, measurements, controls)
    return _shifted(h2_optimal(P), D22)


def _delayed(loop: SystemLike, latency_s: float | Sequence[float], sign: int) -> DelayedLoop:
    """Return a loop closed through delays, a channel for each output."""
    G = state_space(loop, "loop")
    if G.ninputs != G.noutputs:
        raise LinearSystemError(f"loop: {G.noutputs} outputs and {G.ninputs} inputs, wanted as many of both")
    if G.D.any():
        raise DelayError(
            f"loop: D is not zero (largest {np.abs(G.D).max():.3g}): with a delay the equation is of "
            "neutral type, with infinitely many fast poles; low-pass the loop"
        )
    if sign not in (-1, 1):
        raise DelayError(f"sign = {sign!r}, allowed: -1 (u = -y) or 1 (u = +y)")
    latencies = np.asarray(latency_s, dtype=float)
    if latencies.ndim and latencies.shape != (G.noutputs,):
        raise DelayError(f"latency_s = {latency_s!r}, allowed: one, or one of each of {G.noutputs} outputs")
    delays = np.broadcast_to(latencies, (G.noutputs,))
    if not np.all((delays >= 0.0) & np.isfinite(delays)):
        raise DelayError(f"latency_s = {latency_s!r}, allowed: 0 s or more")
    channels = [DelayedChannel(f"y{k + 1}", float(t), sign * G.B[:, k], G.C[k]) for k, t in enumerate(delays)]
    return DelayedLoop(np.asarray(G.A, dtype=float), tuple(channels))


def _generalized(
    plant: SystemLike, measurements: int, controls: int
) -> tuple[GeneralizedPlant, npt.NDArray[np.float64]]:
    """Return the generalized plant without its D22, and D22."""
    G = state_space(plant, "plant")
    for name, count, total, others in (
        ("measurements", measurements, G.noutputs, "outputs are z, the performance outputs"),
        ("controls", controls, G.ninputs, "inputs are w, the disturbances"),
    ):
        if not 1 <= count < total:
            allowed = f"1 to {total - 1}" if total > 1 else "no number"
            raise LinearSystemError(
                f"{name} = {count!r}, allowed: {allowed} of the plant's {total}; the first {others}; "
                "control.augw makes such a plant"
            )
    p, m = G.noutputs - measurements, G.ninputs - controls
    P = GeneralizedPlant(
        A=G.A,
        B1=G.B[:, :m],
        B2=G.B[:, m:],
        C1=G.C[:p],
        C2=G.C[p:],
        D11=G.D[:p, :m],
        D12=G.D[:p, m:],
        D21=G.D[p:, :m],
        inputs=tuple(G.input_labels[m:]),
        outputs=tuple(G.output_labels[p:]),
    )
    return P, G.D[p:, m:]


def _shifted(design: Synthesis, D22: npt.NDArray[np.float64]) -> Synthesis:
    """Return the design for the plant with D22."""
    if not D22.any():
        return design
    return replace(design, controller=loop_shift(design.controller, D22))
