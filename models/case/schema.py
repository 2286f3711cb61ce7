"""Rows of a case: buses, branches, shunts, loads, machines and their controls, with ranges on every field.

Keys are the symbols of the literature in ASCII: `Xd1` is the transient, `Xd2` the
subtransient reactance, `Td01`, `Td02` the open-circuit time constants. Per unit is the
default; any other unit ends the name (`P_mw`, `angle_deg`). Time constants are seconds.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from ..devices.language.expression import scaled_quadratic
from .control_schema import (
    BusControl,
    Compensator,
    Control,
    ConverterControl,
    Exciter,
    Governor,
    Limiter,
    NonNegative,
    Number,
    Positive,
    Row,
    Stabilizer,
)

BusNumber = Annotated[int, Field(strict=True, ge=1)]
Switch = Annotated[bool, Field(strict=True)]
Name = Annotated[str, Field(strict=True, max_length=64, pattern=r"^\S(.*\S)?$")]


LARGEST_EXPONENT = 20.0  #: of a load; what is measured lies below 10
Exponent = Annotated[float, Field(strict=True, ge=0.0, le=LARGEST_EXPONENT)]
LEAST_IMPEDANCE_PU = 1e-9  #: of a branch; a smaller one drowns all others in rounding


class Bus(Row):
    """A bus; `number` is its id in the file."""

    number: BusNumber  #: its id
    name: str = ""  #: free text
    area: Annotated[int, Field(strict=True, ge=1)] = 1  #: used in names of modes and for ties
    kv: Positive | None = None  #: nominal voltage, kV (information only: everything is per unit)
    V_pu: Positive | None = None  #: start value of the power flow; None: flat start
    angle_deg: Number | None = None  #: start value of the power flow; None: flat start
    latitude_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = None  #: position on a map
    longitude_deg: Annotated[float, Field(ge=-180.0, le=180.0)] | None = None  #: position on a map


class Branch(Row):
    """A line or transformer as a pi circuit, per unit on the base of the case.

    The tap is on the `from` side: ``V_from / (tap e^{j shift})`` feeds r + jx; half of b at each end.
    In a file a row may carry `base_mva`; r, x, b are then converted to the base of the case on loading.
    """

    name: Name  #: its id
    kind: Literal["line", "transformer"] = "line"  #: a transformer has its tap and shift at the `from` side
    from_bus: BusNumber = Field(alias="from")  #: number of the bus at one end
    to_bus: BusNumber = Field(alias="to")  #: number of the bus at the other end
    r: Number = 0.0  #: series resistance, pu of the system base
    #: series reactance, pu of the system base; below 0: series capacitor, winding of a star; r + jx not 0
    x: Number
    b: Number = 0.0  #: total line charging susceptance, pu of the system base
    tap: Positive = 1.0  #: off-nominal turns ratio at the `from` side
    shift_deg: Number = 0.0  #: phase shift of a transformer
    in_service: Switch = True  #: false: out at the start; can be reclosed

    @model_validator(mode="after")
    def _impedance(self) -> Self:
        if not abs(complex(self.r, self.x)) >= LEAST_IMPEDANCE_PU:
            raise ValueError(
                f"r + jx = {self.r:g} + j{self.x:g}, allowed: a size of at least {LEAST_IMPEDANCE_PU:g} pu "
                "(join the buses instead)"
            )
        return self


class Shunt(Row):
    """A constant admittance to ground, given by its active and reactive power at 1 pu voltage."""

    name: Name  #: its id
    bus: BusNumber  #: number of its bus
    P_mw: Number = 0.0  #: consumed at 1 pu
    Q_mvar: Number = 0.0  #: generated at 1 pu (capacitor positive)
    in_service: Switch = True  #: false: out at the start; can be switched in


class Load(Row):
    """A load: constant P, Q in the power flow; a voltage characteristic in the dynamics.

    ``P = P0 (V/V0)^P_exponent`` or, with `P_zip` = (z, i, p), ``P = P0 (z (V/V0)^2 + i V/V0 + p)``;
    Q likewise.
    Exponents 2, 1, 0 are constant impedance, current, power. Default: constant impedance.
    """

    name: Name  #: its id
    bus: BusNumber  #: number of its bus
    P_mw: Number  #: active power at the voltage of the power flow
    Q_mvar: Number  #: reactive power at the voltage of the power flow
    P_exponent: Exponent = 2.0  #: exponent of V in P; 2: constant impedance, 0: constant power
    Q_exponent: Exponent = 2.0  #: exponent of V in Q
    #: shares of constant impedance, current and power in P, in place of `P_exponent`
    P_zip: tuple[Number, Number, Number] | None = None
    #: shares of constant impedance, current and power in Q, in place of `Q_exponent`
    Q_zip: tuple[Number, Number, Number] | None = None
    in_service: Switch = True  #: false: disconnected

    @model_validator(mode="after")
    def _one_characteristic(self) -> Self:
        for letter in "PQ":
            mix = getattr(self, f"{letter}_zip")
            if mix is None:
                continue
            if f"{letter}_exponent" in self.model_fields_set:
                raise ValueError(f"{letter}_zip and {letter}_exponent are both given, allowed: one of them")
            if not abs(sum(mix) - 1.0) <= 1e-9:
                raise ValueError(f"{letter}_zip = {list(mix)} sums to {sum(mix):g}, allowed: a sum of 1")
        return self

    @property
    def is_constant_impedance(self) -> bool:
        """True when both P and Q follow the square of the voltage."""
        return self.p_is_impedance and self.q_is_impedance

    @property
    def p_is_impedance(self) -> bool:
        """True when P follows the square of the voltage."""
        return self.P_zip == (1.0, 0.0, 0.0) if self.P_zip else self.P_exponent == 2.0

    @property
    def q_is_impedance(self) -> bool:
        """True when Q follows the square of the voltage."""
        return self.Q_zip == (1.0, 0.0, 0.0) if self.Q_zip else self.Q_exponent == 2.0


# ---------------------------------------------------------------- machine


class Saturation(Row):
    """Exponential saturation: psi_I = Asat exp(Bsat (psi_at - psiT1)) of the air-gap flux psi_at.

    `use`: "none" ignores it, "total" applies K_s = psi_at / (psi_at + psi_I) everywhere, "incremental"
    does so at the operating point and uses Kundur's incremental factor, a straight line, for deviations:
    use it for eigenvalues as in his book, and "total" for large disturbances. The jump to psi_I = 0
    below psiT1 is omitted: there psi_I is small and continues to fall.
    """

    Asat: Positive  #: factor A of A exp(B (flux - psiT1))
    Bsat: Positive  #: exponent B
    psiT1: NonNegative  #: flux below which there is no saturation, pu
    #: total, or incremental: linearisation of the book for small signals
    use: Literal["none", "total", "incremental"] = "total"


class FluxSaturation(Row):
    """Saturation as in PSS/E: factor S as a function of a flux state, S10 at 1.0 pu and S12 at 1.2 pu.

    quadratic: ``E S(E) = B (E - A)^2`` above A (GENROU, GENSAL); exponential: ``S = S10 E^x`` (the others).
    It acts on the d axis, with `axes` = both also on the q axis in the ratio (Xq - Xl)/(Xd - Xl).
    """

    S10: Positive  #: saturation at 1.0 pu
    S12: Positive  #: saturation at 1.2 pu
    #: curve through both points: quadratic in GENROU, exponential in GENROE
    shape: Literal["quadratic", "exponential"] = "quadratic"
    #: flux that determines saturation: GENROU and GENSAL differ
    of: Literal["subtransient_flux", "transient_emf"] = "subtransient_flux"
    axes: Literal["both", "d"] = "both"  #: axes that saturate: both, or d only

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if not self.S12 > self.S10:
            raise ValueError(f"S12 = {self.S12:g} with S10 = {self.S10:g}, allowed: S12 > S10")
        return self

    @property
    def coefficients(self) -> tuple[float, float]:
        """A, B of the quadratic; exponent and factor of the exponential shape."""
        if self.shape == "exponential":
            return math.log(self.S12 / self.S10) / math.log(1.2), self.S10
        return scaled_quadratic(1.0, self.S10, 1.2, self.S12)

    def factor(self, flux: float) -> float:
        """Return S at `flux`."""
        A, B = self.coefficients
        if self.shape == "exponential":
            return float(B * flux**A)
        return B * max(flux - A, 0.0) ** 2 / flux


#: what each machine model must be given
NEEDED: dict[str, tuple[str, ...]] = {
    "round_rotor": ("H", "Xd1", "Xd", "Xq", "Xl", "Xq1", "Xd2", "Xq2", "Td01", "Td02", "Tq02"),
    "classical": ("H", "Xd1"),
    "infinite_bus": ("Xd1",),
    "power_flow": (),
}


class Machine(Row):
    """A synchronous machine, its dispatch and its controls; per unit on its own `base_mva`.

    round_rotor: sixth order, needs Xd, Xq, Xl, Xd1, Xq1, Xd2, Xq2, Td01, Tq01, Td02, Tq02 with
    Xd > Xd1 >= Xd2 > 0, Xq >= Xq1 >= Xq2 > 0, Xd1 > Xl and Xq1 > Xl. Without Tq01 it has one winding on the
    q axis (GENSAL and GENSAE of PSS/E): Xq1 is Xq then, and saturation acts on that winding.
    Where the air gap counts (saturation of it, or Xd2 not Xq2), Xd2 >= Xl and Xq2 >= Xl as well. Elsewhere
    the stored energy is positive without them, only the damper's leakage reactance is not: published data
    have such machines.
    classical: H and a constant EMF behind Ra + j Xd1.
    infinite_bus: that EMF turns at nominal frequency whatever happens (a classical machine of infinite H).
    power_flow: a dispatch without dynamic data, good for the power flow only.
    """

    name: Annotated[str, Field(strict=True, max_length=64, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]  #: its id
    bus: BusNumber  #: number of its bus
    area: Annotated[int, Field(strict=True, ge=1)] = 1  #: used in names of modes
    base_mva: Positive  #: base of its per-unit values
    #: order of the model; infinite_bus: constant voltage and frequency; power_flow: no dynamics
    model: Literal["round_rotor", "classical", "infinite_bus", "power_flow"] = "round_rotor"
    H: Positive | None = None  #: inertia constant, s
    D: Number = 0.0  #: damping torque, pu per pu of speed; below 0: destabilising (a textbook's K_D = -10)
    Ra: NonNegative = 0.0  #: armature resistance, pu of the machine's base
    Xd1: Positive | None = None  #: transient reactance X'd, pu
    Xd: Positive | None = None  #: synchronous reactance, d axis, pu of the machine's base
    Xq: Positive | None = None  #: synchronous reactance, q axis, pu
    Xl: NonNegative | None = None  #: leakage reactance, pu
    Xq1: Positive | None = None  #: transient reactance X'q, pu
    Xd2: Positive | None = None  #: subtransient reactance X''d, pu
    Xq2: Positive | None = None  #: subtransient reactance X''q, pu
    Td01: Positive | None = None  #: transient open-circuit time constant T'd0, s
    #: transient open-circuit time constant T'q0, s; none: one winding on the q axis
    Tq01: Positive | None = None
    Td02: Positive | None = None  #: subtransient open-circuit time constant T''d0, s
    Tq02: Positive | None = None  #: subtransient open-circuit time constant T''q0, s
    saturation: Saturation | None = None  #: as in Kundur's book, exponential in the air-gap flux
    flux_saturation: FluxSaturation | None = None  #: as in PSS/E (GENROU, GENSAL, ...)
    #: true: 2H d slip/dt = (Pm - D slip)/(1 + slip) - Te, as PSS/E; false: without the division by 1 + slip
    torque_by_speed: Switch = False
    P_mw: Number  #: dispatch; only a start value at the slack machine
    Q_mvar: Number | None = None  #: its share of Q at its bus; the rest is shared by rating
    V_pu: Positive  #: voltage that the power flow holds at its bus
    slack: Switch = False  #: true: the slack machine of the power flow
    angle_deg: Number = 0.0  #: bus angle, slack machine only
    exciter: Exciter = Control(kind="constant")  #: device and its values; default: constant field voltage
    stabilizer: Stabilizer | None = None  #: device and its values; default: none
    compensator: Compensator | None = None  #: voltage that the exciter regulates; default: terminal voltage
    limiter: Limiter | None = None  #: excitation limiter, which changes its reference; default: none
    governor: Governor = Control(kind="none")  #: device and its values; default: constant mechanical power

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if "angle_deg" in self.model_fields_set and self.angle_deg and not self.slack:
            raise ValueError(f"angle_deg = {self.angle_deg:g} at a machine that is not the slack")
        missing = [key for key in NEEDED[self.model] if getattr(self, key) is None]
        if missing:
            raise ValueError(f"a {self.model} machine needs {', '.join(missing)} as well")
        if self.model == "round_rotor":
            self._check_round_rotor()
        else:
            if self.exciter.kind != "constant" or self.stabilizer or self.limiter:
                what = "constant exciter, no stabilizer or limiter"
                raise ValueError(f"a {self.model} machine has no field circuit, allowed: {what}")
            if self.model == "infinite_bus" and (
                self.governor.kind != "none" or self.H is not None or self.D
            ):
                raise ValueError("an infinite bus has neither inertia nor a governor, allowed: Ra and Xd1")
        return self

    def _check_round_rotor(self) -> None:
        """Raise ValueError for saturation or controls given twice, and for reactances that no machine has."""
        if self.saturation is not None and self.flux_saturation is not None:
            raise ValueError("saturation and flux_saturation are both given, allowed: one of them")
        beside = [word for word in ("stabilizer", "compensator", "limiter") if getattr(self, word)]
        if self.exciter.kind == "constant" and beside:
            raise ValueError(f"a {beside[0]} but constant excitation; give it an exciter")
        self._check_reactances()

    def _check_reactances(self) -> None:
        """Raise ValueError for an order of reactances that leaves no sound equations."""
        if self.one_q_winding and self.Xq1 != self.Xq:
            raise ValueError(
                f"Xq1 = {self.Xq1:g} without Tq01, allowed: Xq1 = Xq = {self.Xq:g} (one winding on the q "
                "axis), or Tq01 as well"
            )
        chains: list[tuple[str, ...]] = [
            ("Xd2", "<=", "Xd1", "<", "Xd"),
            ("Xq2", "<=", "Xq1", "<=", "Xq"),
            ("Xl", "<", "Xd1"),
            ("Xl", "<", "Xq1"),
        ]
        if self.saturation is not None or self.Xd2 != self.Xq2:
            chains += [("Xl", "<=", "Xd2"), ("Xl", "<=", "Xq2")]
        for chain in chains:
            for low, sign, high in zip(chain[0:-2:2], chain[1:-1:2], chain[2::2], strict=True):
                a, b = getattr(self, low), getattr(self, high)
                if not (a < b or (sign == "<=" and a == b)):
                    raise ValueError(f"{high} = {b:g} with {low} = {a:g}, allowed: {' '.join(chain)}")
        if self.Xl in (self.Xd2, self.Xq2) and self.Xd2 != self.Xq2:
            raise ValueError(f"Xl = {self.Xl:g} is Xd2 or Xq2, allowed: below both, or all three the same")

    @property
    def one_q_winding(self) -> bool:
        """True when the q axis of a round_rotor machine has one winding: ed1 stays 0."""
        return self.Tq01 is None

    @property
    def has_constant_emf(self) -> bool:
        """True when the machine is a constant EMF behind Ra + j Xd1."""
        return self.model in ("classical", "infinite_bus")

    def number(self, key: str) -> float:
        """Return the value `key` that the machine's model needs; ValueError when it is not given."""
        value = getattr(self, key)
        if value is None:
            raise ValueError(f"machines.{self.name}.{key} is not given (model {self.model})")
        return float(value)


class Svc(Row):
    """A static var compensator or STATCOM: reactive power at a bus, set by its control.

    In the power flow it holds `V_pu` at its bus or gives `Q_mvar`; P is 0. The control rests at what that
    gives: a susceptance (kind svc) or a current (statcom), per unit on `base_mva`, capacitive above 0.
    """

    name: Annotated[str, Field(strict=True, max_length=64, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]  #: its id
    bus: BusNumber  #: number of its bus
    regulates: BusNumber | None = None  #: number of the bus whose voltage it regulates; None: its own
    base_mva: Positive  #: base of its per-unit values
    V_pu: Positive | None = None  #: voltage that the power flow holds at its bus; None: `Q_mvar`
    Q_mvar: Number = 0.0  #: reactive power into the network without `V_pu`
    control: BusControl  #: device and its values

    @model_validator(mode="after")
    def _one_start(self) -> Self:
        if self.V_pu is not None and "Q_mvar" in self.model_fields_set and self.Q_mvar:
            raise ValueError(f"V_pu = {self.V_pu:g} and Q_mvar = {self.Q_mvar:g}, allowed: one of them")
        if self.V_pu is not None and self.seen_bus != self.bus:
            raise ValueError(
                f"V_pu at bus {self.bus}, regulates = {self.regulates}, allowed: Q_mvar where it regulates "
                "another bus than its own"
            )
        return self

    @property
    def seen_bus(self) -> int:
        """Number of the bus whose voltage it regulates."""
        return self.bus if self.regulates is None else self.regulates


LEFT_OF_LINE = 0.2  #: of a line's reactance that a series capacitor leaves at least


class Tcsc(Row):
    """A thyristor controlled series capacitor: a series reactance, set by a lag within limits.

    ``x = lag(x0_pu + tcsc1_x_mod, T_s)``, kept within `x_min_pu` and `x_max_pu`; the line has x less of its
    own reactance, in the power flow `x0_pu`. Bypassed (`device_trip`) x is 0.
    """

    name: Annotated[str, Field(strict=True, max_length=64, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]  #: its id
    branch: Name  #: name of its line
    x0_pu: Number  #: capacitive reactance at the equilibrium, system base
    x_min_pu: Number = 0.0  #: least capacitive reactance; below 0: inductive
    x_max_pu: Number  #: largest capacitive reactance
    T_s: Positive = 0.015  #: time constant of the thyristors

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        if not self.x_min_pu <= self.x_max_pu:
            raise ValueError(
                f"x_min_pu = {self.x_min_pu:g} with x_max_pu = {self.x_max_pu:g}, allowed: x_min_pu <= "
                "x_max_pu"
            )
        if not self.x_min_pu <= self.x0_pu <= self.x_max_pu:
            limit, value = (
                ("x_min_pu", self.x_min_pu) if self.x0_pu < self.x_min_pu else ("x_max_pu", self.x_max_pu)
            )
            raise ValueError(
                f"x0_pu = {self.x0_pu:g} is {abs(self.x0_pu - value):g} beyond {limit} = {value:g}, allowed: "
                f"within the limits; set {limit} or x0_pu"
            )
        return self


class Converter(Row):
    """A converter plant, such as solar or wind: P and Q at a bus, set by its control.

    In the power flow it gives `P_mw` and `Q_mvar`; the control rests at the currents, or the voltage of
    its source, that these ask for, per unit on `base_mva`, which is that of all its parameters.
    """

    name: Annotated[str, Field(strict=True, max_length=64, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]  #: its id
    bus: BusNumber  #: number of its bus
    base_mva: Positive  #: base of its per-unit values
    P_mw: Number  #: active power into the network
    Q_mvar: Number = 0.0  #: reactive power into the network
    regulates: BusNumber | None = None  #: number of the bus that its plant control regulates; None: its own
    #: name of the branch whose flow its plant control measures; None: its own power
    measures: Name | None = None
    #: number of the bus at which that flow leaves; None: `from` of the branch
    measures_from: BusNumber | None = None
    control: ConverterControl  #: device and its values

    @property
    def V_pu(self) -> None:
        """None: the power flow lets its voltage free, other than at an SVC."""
        return None

    @property
    def seen_bus(self) -> int:
        """Number of the bus whose voltage it sees."""
        return self.bus


class Tie(Row):
    """The interface whose active power is the output `tie_p`: flow from bus `from` into `branches`."""

    branches: Annotated[tuple[Name, ...], Field(min_length=1)]  #: names of the branches of the tie
    from_bus: BusNumber = Field(alias="from")  #: number of the exporting bus
