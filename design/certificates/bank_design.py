"""Active fault tolerance: one controller per set of signals, a supervisor, and the proof for every sequence.

For each set of signals the controller of least effort with a pole region is designed on the plant as
it is seen through those signals. Members that damp very hard for one set of signals and not for another
have no common Lyapunov function: sectors of 0.40 for "both" and "local" and 0.25 for "remote" have none on
``two-area-thesis``, the defaults have one, undetected losses included.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

import control

from ..controllers.bank import ControllerBank
from ..controllers.controller import Controller
from ..linear.linearise import select, speeds_in_rad
from ..reduction.balanced import balanced_truncation
from ..reduction.weighted import closed_loop_reduction
from ..synthesis.hinf import Conditioning, conventional
from ..synthesis.lmi_form import PoleRegion
from .switching import switching_certificate


@dataclass(frozen=True)
class ActiveSpec:
    """A bank for a remote and a local signal.

    damping_ratio_of : member -> sector asked of the design plant; members are "both", "local", "remote".
    order_of : member -> order after reduction.
    fade_s, loss_s, return_s : of the supervisor, see `ControllerBank`.
    """

    actuator: str = "G4_vs"
    remote: str = "G2_dw"
    local: str = "G4_dw"
    damping_ratio_of: Mapping[str, float] = field(
        default_factory=lambda: {"both": 0.36, "local": 0.30, "remote": 0.18}
    )
    order_of: Mapping[str, int] = field(default_factory=lambda: {"both": 6, "local": 6, "remote": 5})
    plant_order: int = 8
    radius: float = 300.0  #: rad/s
    trace_weight: float = 1e-3
    limit_pu: float = 0.15
    fade_s: float = 0.05
    loss_s: float = 0.0
    return_s: float = 1.0


def design_active(
    full_plant: control.StateSpace,
    spec: ActiveSpec | None = None,
    *,
    omega_b: float,
    certified: bool = True,
    engine: str = "structured",
) -> ControllerBank:
    """Design the bank and prove its switching on the full plant.

    Parameters
    ----------
    full_plant : after `remove_reference`, speeds in pu.
    omega_b : rated speed, rad/s.
    certified : False leaves out the proof, which takes most of the time.

    Raises
    ------
    InfeasibleDesign, UncertifiedDesign, ValueError
    """
    spec = ActiveSpec() if spec is None else spec
    plant = speeds_in_rad(full_plant, omega_b)
    seen = {"both": (spec.remote, spec.local), "local": (spec.local,), "remote": (spec.remote,)}
    unknown = sorted({*spec.damping_ratio_of, *spec.order_of} - set(seen))
    if unknown or not spec.damping_ratio_of:
        raise ValueError(f"active design: members {unknown} are not known, allowed: {', '.join(seen)}")
    members = []
    for name, signals in seen.items():
        if name not in spec.damping_ratio_of:
            continue
        loop = select(plant, [spec.actuator], list(signals))
        result = conventional(
            balanced_truncation(loop, spec.plant_order).system,
            PoleRegion(spec.damping_ratio_of[name], None, spec.radius),
            conditioning=Conditioning(spec.trace_weight),
            engine=engine,
        )
        K = result.controller
        named = control.ss(K.A, K.B, K.C, K.D, inputs=list(signals), outputs=[spec.actuator])
        order = spec.order_of.get(name, named.nstates)
        small = named if named.nstates <= order else closed_loop_reduction(loop, named, order).system
        members.append(Controller(name, small, spec.limit_pu, {"effort_bound": result.gamma}))
    bank = ControllerBank(
        "active",
        tuple(members),
        spec.limit_pu,
        spec.fade_s,
        spec.loss_s,
        spec.return_s,
        {"method": "bank of least-effort controllers, one per set of signals", "specification": asdict(spec)},
    )
    if not certified:
        return bank
    rows, P = switching_certificate(plant, bank)
    return replace(bank, certificate=rows.as_dict(), lyapunov=P)
