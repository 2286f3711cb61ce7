"""The three controllers of the study, from the full linear plant to matrices: `design_wdc`, `_cc`, `_ftc`.

Each takes the full plant as `remove_reference` leaves it (inputs ``G1_vs`` ..., outputs
``G1_dw`` ... in pu) and a specification whose defaults are the study's
[Sundaria2016], chapters 5.1 and 5.2, where it prints them; each is deterministic. The
steps are the same: take the loop, balance and truncate the plant, synthesise by
LMIs, reduce the controller by what its states do in the closed loop, close the loop on the
*full* plant and refuse a controller that does not stabilize it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, TypeAlias

import control
import numpy as np

from ..controllers.controller import Controller
from ..delay.curves import delayed_plant
from ..errors import InfeasibleDesign, UncertifiedDesign
from ..linear.linearise import select, speeds_in_rad
from ..lmi.problem import Matrix
from ..reduction.balanced import balanced_truncation
from .check import describe_mode, describe_reach, out_of_reach
from .generalized_plant import mixed_sensitivity
from .hinf import Conditioning, Synthesis, conventional, fault_tolerant, wide_area_damping
from .lmi_form import PoleRegion
from .reduced_order import (
    closed_loop_poles,
    closed_norm,
    effort_of,
    on_difference,
    reduced_order,
    reduction_price,
)

#: largest factor on a controller's norm and effort on the full plant due to its order reduction
PRICE_CAP = 2.5


@dataclass(frozen=True)
class WdcSpec:
    """Wide-area damping by mixed sensitivity on the speed difference ``remote - local``.

    The thesis prints the weights, both orders and the result, not the sector. With 0.28 the
    inter-area mode reaches at least the printed 0.291 at order 4 too; 0.30 gains 0.02 of damping
    and loses 0.17 s of delay margin, because a faster controller mode then crosses first.
    """

    actuator: str = "G4_vs"  #: controlled input of the plant
    remote: str = "G2_dw"  #: the remote signal
    local: str = "G4_dw"  #: the signal measured at the actuator
    plant_order: int = 6  #: states of the reduced plant of the design
    order: int = 4  #: states of the reduced controller
    damping_ratio: float = 0.28  #: least damping ratio of the poles, as LMI constraint
    decay_rate: float | None = None  #: least decay rate of those poles, 1/s; none: no constraint
    radius: float | None = 300.0  #: largest magnitude of those poles, rad/s; none: no constraint
    low_pass: float = 30.0  #: W1 = low_pass / (s + low_pass), rad/s
    high_pass: tuple[float, float] = (10.0, 100.0)  #: W2 = gain s / (s + corner), corner in rad/s
    gamma_cap: float = 10.0  #: bound of the weighted norm
    trace_weight: float = 1e-3  #: weight of the traces, which condition the LMIs
    limit_pu: float = 0.15  #: bound of the magnitude of the output
    price_cap: float = PRICE_CAP  #: largest factor on norm and effort due to the order reduction
    latency_s: float = 0.0  #: latency of the design plant, as a Padé model
    #: delayed signals: both (synchronous feedback), or the remote one
    latency_on: Literal["both", "remote"] = "both"
    pade_order: int = 2  #: order of that model

    def weights(self) -> tuple[control.StateSpace, control.StateSpace]:
        """Return W1 and W2. [Sundaria2016], section 5.1.5"""
        gain, corner = self.high_pass
        return (
            control.ss([[-self.low_pass]], [[1.0]], [[self.low_pass]], [[0.0]]),
            control.ss([[-corner]], [[1.0]], [[-gain * corner]], [[gain]]),
        )


@dataclass(frozen=True)
class CcSpec:
    """Conventional control: least effort with a pole region, designed for all signals available.

    For the fair comparison with a fault-tolerant controller see `design_cc_like`.
    """

    actuator: str = "G4_vs"  #: controlled input of the plant
    remote: str = "G2_dw"  #: the remote signal
    local: str = "G4_dw"  #: the signal measured at the actuator
    plant_order: int = 8  #: states of the reduced plant of the design
    order: int = 8  #: states of the reduced controller
    damping_ratio: float = 0.36  #: least damping ratio of the poles, as LMI constraint
    decay_rate: float | None = None  #: least decay rate of those poles, 1/s; none: no constraint
    radius: float | None = 300.0  #: largest magnitude of those poles, rad/s; none: no constraint
    effort_cap: float | None = None  #: largest effort, pu per rad/s; none: no limit
    trace_weight: float = 1e-3  #: weight of the traces, which condition the LMIs
    limit_pu: float = 0.15  #: bound of the magnitude of the output
    price_cap: float = PRICE_CAP  #: largest factor on norm and effort due to the order reduction


@dataclass(frozen=True)
class FtcSpec:
    """Passive fault-tolerant control with a damping target for each loss pattern.

    Equal targets make the controller purely local; the higher target with all signals
    available makes it use the remote one.
    """

    actuator: str = "G4_vs"  #: controlled input of the plant
    signals: tuple[str, ...] = ("G2_dw", "G4_dw")  #: the signals, the remote one first
    #: least damping ratio for each pattern of loss, `normal` and those of `loss_of`
    damping_ratio_of: Mapping[str, float] = field(
        default_factory=lambda: {"normal": 0.36, "remote_lost": 0.30}
    )
    #: pattern of loss -> lost signals
    loss_of: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: {"remote_lost": ("G2_dw",)})
    plant_order: int = 8  #: states of the reduced plant of the design
    order: int = 5  #: states of the reduced controller
    decay_rate: float | None = None  #: least decay rate of those poles, 1/s; none: no constraint
    radius: float = 100.0  #: largest magnitude of those poles, rad/s
    effort_cap: float | None = None  #: largest effort, pu per rad/s; none: no limit
    limit_pu: float = 0.15  #: bound of the magnitude of the output
    price_cap: float = PRICE_CAP  #: largest factor on norm and effort due to the order reduction


StudySpec: TypeAlias = WdcSpec | CcSpec | FtcSpec
#: name of a study's controller -> what it is specified by
SPECIFICATIONS: Mapping[str, type[StudySpec]] = {"wdc": WdcSpec, "cc": CcSpec, "ftc": FtcSpec}


def design_wdc(
    full_plant: control.StateSpace,
    spec: WdcSpec | None = None,
    *,
    omega_b: float,
    engine: str = "structured",
) -> Controller:
    """Design the wide-area damping controller; inputs remote and local signal, as ``k(s) [1, -1]``.

    Parameters
    ----------
    full_plant : after `remove_reference`, speeds in pu.
    spec : None: the study's.
    omega_b : rated speed, rad/s.

    Raises
    ------
    InfeasibleDesign, UncertifiedDesign, ValueError
    """
    spec = WdcSpec() if spec is None else spec
    plant = speeds_in_rad(full_plant, omega_b)
    difference = {spec.remote: 1.0, spec.local: -1.0}
    loop = select(plant, [spec.actuator], {"difference": difference})
    require_target_modes(loop, "wide-area damping")
    reduction = balanced_truncation(loop, _plant_order(spec.plant_order, loop, "wide-area damping"))
    design_plant = reduction.system
    if spec.latency_s != 0.0 and spec.latency_on == "both":
        late = {"difference": spec.latency_s}
        design_plant = delayed_plant(design_plant, late, spec.pade_order)
        loop = delayed_plant(loop, late, spec.pade_order)
    elif spec.latency_s != 0.0:
        late = {spec.remote: spec.latency_s}
        signals = select(plant, [spec.actuator], [spec.remote, spec.local])
        design_plant, loop = (
            select(
                delayed_plant(G, {spec.remote: spec.latency_s}, spec.pade_order),
                None,
                {"difference": difference},
            )
            for G in (balanced_truncation(signals, reduction.order).system, signals)
        )
    synthesis = wide_area_damping(
        design_plant,
        PoleRegion(spec.damping_ratio, spec.decay_rate, spec.radius),
        weights=spec.weights(),
        gamma_cap=spec.gamma_cap,
        conditioning=Conditioning(spec.trace_weight),
        engine=engine,
    )
    result = synthesis.controller, reduced_order(loop, synthesis.controller, spec.order)
    full, K = (on_difference(k, spec.remote, spec.local, spec.actuator) for k in result)
    facts = {"gamma": synthesis.gamma, "mixed_sensitivity": synthesis.norm_of["normal"]}
    P = mixed_sensitivity(loop, *spec.weights())
    norms = closed_norm(P, result[0]), closed_norm(P, result[1])
    return _finish(
        "wdc",
        "H-infinity mixed sensitivity with a pole region",
        plant,
        (full, K),
        norms,
        spec,
        synthesis,
        facts,
        {},
    )


def design_cc(
    full_plant: control.StateSpace,
    spec: CcSpec | None = None,
    *,
    omega_b: float,
    engine: str = "structured",
) -> Controller:
    """Design the conventional controller: two signals, least effort in a pole region.

    It promises nothing when the remote signal is lost; its certificate says what happens.

    Raises
    ------
    InfeasibleDesign, UncertifiedDesign, ValueError
    """
    spec = CcSpec() if spec is None else spec
    plant = speeds_in_rad(full_plant, omega_b)
    loop = select(plant, [spec.actuator], [spec.remote, spec.local])
    require_target_modes(loop, "conventional control")
    reduction = balanced_truncation(loop, _plant_order(spec.plant_order, loop, "conventional control"))
    synthesis = conventional(
        reduction.system,
        PoleRegion(spec.damping_ratio, spec.decay_rate, spec.radius),
        effort_cap=spec.effort_cap,
        conditioning=Conditioning(spec.trace_weight),
        engine=engine,
    )
    K = reduced_order(loop, synthesis.controller, spec.order)
    facts = {"effort_bound": synthesis.gamma}
    result = synthesis.controller, K
    return _finish("cc", "least effort with a pole region", plant, result, None, spec, synthesis, facts, {})


def design_cc_like(
    reference: Controller,
    full_plant: control.StateSpace,
    spec: CcSpec | None = None,
    *,
    omega_b: float,
    band_hz: tuple[float, float] = (0.3, 0.9),
    engine: str = "structured",
) -> Controller:
    """Design the conventional controller with the full-plant damping of `reference`, all signals there.

    The least damping ratio among the poles between `band_hz` is compared (the inter-area mode's
    band); the sector follows by the secant method to 5e-4.

    Raises
    ------
    InfeasibleDesign, UncertifiedDesign, ValueError
    """
    spec = CcSpec() if spec is None else spec
    plant = speeds_in_rad(full_plant, omega_b)
    target = _band_damping(closed_loop_poles(plant, reference.system), band_hz)
    zeta, last, best = target, None, None
    for _ in range(8):
        candidate = design_cc(full_plant, replace(spec, damping_ratio=zeta), omega_b=omega_b, engine=engine)
        reached = _band_damping(closed_loop_poles(plant, candidate.system), band_hz)
        if best is None or abs(reached - target) < best[0]:
            best = (abs(reached - target), candidate)
        if best[0] <= 5e-4:
            break
        slope = 1.0 if last is None or zeta == last[0] else (reached - last[1]) / (zeta - last[0])
        last = (zeta, reached)
        zeta = float(np.clip(zeta + (target - reached) / (slope if slope > 0.2 else 1.0), 0.02, 0.95))
    assert best is not None
    return best[1]


def design_ftc(
    full_plant: control.StateSpace,
    spec: FtcSpec | None = None,
    *,
    omega_b: float,
    engine: str = "structured",
) -> Controller:
    """Design the passive fault-tolerant controller; stable on the full plant under every loss pattern.

    Raises
    ------
    InfeasibleDesign, UncertifiedDesign, ValueError
    """
    spec = FtcSpec() if spec is None else spec
    plant = speeds_in_rad(full_plant, omega_b)
    loop = select(plant, [spec.actuator], list(spec.signals))
    require_target_modes(loop, "fault-tolerant control")
    reduction = balanced_truncation(loop, _plant_order(spec.plant_order, loop, "fault-tolerant control"))
    synthesis = fault_tolerant(
        reduction.system,
        spec.damping_ratio_of,
        loss_of=spec.loss_of,
        radius=spec.radius,
        decay_rate=spec.decay_rate,
        effort_cap=spec.effort_cap,
        engine=engine,
    )
    K = reduced_order(loop, synthesis.controller, spec.order)
    facts = {"effort_bound": synthesis.gamma, "half_steps": len(synthesis.facts["history"])}
    return _finish(
        "ftc",
        "passive fault tolerance by alternating LMIs",
        plant,
        (synthesis.controller, K),
        None,
        spec,
        synthesis,
        facts,
        spec.loss_of,
    )


def require_target_modes(
    loop: control.StateSpace, what: str, band_hz: tuple[float, float] = (0.1, 0.9)
) -> None:
    """Refuse a loop whose least damped mode in the inter-area band it cannot move, naming the mode.

    Raises
    ------
    InfeasibleDesign
    """
    values = np.linalg.eigvals(loop.A)
    frequency = np.abs(values.imag) / (2.0 * np.pi)
    inside = (frequency >= band_hz[0]) & (frequency <= band_hz[1]) & (values.imag > 0.0)
    if not np.any(inside):
        return
    damping = np.where(inside, -values.real / np.maximum(np.abs(values), 1e-12), np.inf)
    k = int(np.argmin(damping))
    mode = complex(values[k])
    if out_of_reach(loop.A, loop.B, loop.C, mode):
        raise InfeasibleDesign(
            f"{what}: mode {describe_mode(mode)} cannot be moved from "
            f"{', '.join(loop.input_labels)} with {', '.join(loop.output_labels)}: "
            f"{describe_reach(loop.A, loop.B, loop.C, mode)}; choose another actuator or signal "
            "(see the loop ranking)",
            constraint="controllability",
            asked=None,
        )


def _plant_order(order: int, loop: control.StateSpace, what: str) -> int:
    """Refuse a design order above the plant's."""
    if not 1 <= order <= loop.nstates:
        raise ValueError(
            f"{what}: plant_order is {order}, the plant has {loop.nstates} states; give 1..{loop.nstates}"
        )
    return order


def _band_damping(poles: Matrix, band_hz: tuple[float, float]) -> float:
    """Least damping ratio of the poles in a band; 1 if there is none."""
    frequency = np.abs(poles.imag) / (2.0 * np.pi)
    inside = poles[(frequency >= band_hz[0]) & (frequency <= band_hz[1])]
    return float(np.min(-inside.real / np.abs(inside))) if inside.size else 1.0


def _finish(
    name: str,
    method: str,
    plant: control.StateSpace,
    result: tuple[control.StateSpace, control.StateSpace],
    norms: tuple[float, float] | None,
    spec: StudySpec,
    synthesis: Synthesis,
    facts: Mapping[str, Any],
    loss_of: Mapping[str, tuple[str, ...]],
) -> Controller:
    """Check a controller on the full plant and attach the provenance.

    It must be stable for every promised pattern, and reducing its order must not have raised norm and effort
    by more than `spec.price_cap`. made : before and after; norms : of the two, None: the effort is the norm.
    """
    full, K = result
    efforts = {}
    for pattern, lost in {"normal": (), **loss_of}.items():
        poles = closed_loop_poles(plant, K, lost)
        worst = complex(poles[np.argmax(poles.real)])
        if not worst.real < 0.0:
            raise UncertifiedDesign(
                f"{name}, {pattern}: the controller of order {K.nstates} leaves the full plant with the pole "
                f"{worst:.4g}; ask for a higher controller order, a higher plant order or a milder region"
            )
        efforts[pattern] = effort_of(plant, K, lost)
    price = reduction_price(name, plant, full, K, norms, efforts["normal"], spec.price_cap)
    design = {
        "method": method,
        "specification": asdict(spec),
        "order_full": int(synthesis.controller.nstates),
        "order": int(K.nstates),
        "region": {pattern: region.describe() for pattern, region in synthesis.region_of.items()},
        "design_plant_damping_ratio": synthesis.damping_ratio,
        "effort": efforts,
        "engine": synthesis.engine,
        "lmi_problems": synthesis.solves,
        "reduction_price": price,
        **facts,
    }
    return Controller(name=name, system=K, limit_pu=spec.limit_pu, design=design)
