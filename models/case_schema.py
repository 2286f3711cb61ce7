"""Rows of a case: buses, branches, shunts, loads, machines and their controls, with ranges on every field.

Keys are the symbols of the literature in ASCII: `Xd1` is the transient, `Xd2` the
subtransient reactance, `Td01`, `Td02` the open-circuit time constants. Per unit is the
default; any other unit ends the name (`P_mw`, `angle_deg`). Time constants are seconds.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Number = Annotated[float, Field(strict=True)]
Positive = Annotated[float, Field(strict=True, gt=0.0)]
NonNegative = Annotated[float, Field(strict=True, ge=0.0)]
BusNumber = Annotated[int, Field(strict=True, ge=1)]
Switch = Annotated[bool, Field(strict=True)]
Name = Annotated[str, Field(strict=True, pattern=r"^\S(.*\S)?$")]


class Row(BaseModel):
    """One row of a case table: frozen, unknown keys refused, numbers finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True)

    source: str = ""  #: "KEY, where" when it differs from the source of the whole table


class Bus(Row):
    """A bus; `number` is its id in the file."""

    number: BusNumber
    name: str = ""
    area: Annotated[int, Field(strict=True, ge=1)] = 1
    kv: Positive | None = None  #: nominal voltage, kV (information only: everything is per unit)


class Branch(Row):
    """A line or transformer as a pi circuit, per unit on the base of the case.

    The tap is on the `from` side: ``V_from / (tap e^{j shift})`` feeds r + jx; half of b at each end.
    In a file a row may carry `base_mva`; r, x, b are then converted to the base of the case on loading.
    """

    name: Name
    kind: Literal["line", "transformer"] = "line"
    from_bus: BusNumber = Field(alias="from")
    to_bus: BusNumber = Field(alias="to")
    r: NonNegative = 0.0
    x: Positive
    b: NonNegative = 0.0  #: total charging
    tap: Positive = 1.0
    shift_deg: Number = 0.0
    in_service: Switch = True


class Shunt(Row):
    """A constant admittance to ground, given by what it takes and gives at 1 pu voltage."""

    name: Name
    bus: BusNumber
    P_mw: Number = 0.0  #: consumed at 1 pu
    Q_mvar: Number = 0.0  #: generated at 1 pu (capacitor positive)
    in_service: Switch = True


class Load(Row):
    """A load: constant P, Q in the power flow; a voltage characteristic in the dynamics.

    ``P = P0 (V/V0)^P_exponent`` or, with `P_zip` = (z, i, p), ``P = P0 (z (V/V0)^2 + i V/V0 + p)``;
    Q likewise.
    Exponents 2, 1, 0 are constant impedance, current, power. Default: constant impedance.
    """

    name: Name
    bus: BusNumber
    P_mw: Number
    Q_mvar: Number
    P_exponent: NonNegative = 2.0
    Q_exponent: NonNegative = 2.0
    P_zip: tuple[Number, Number, Number] | None = None
    Q_zip: tuple[Number, Number, Number] | None = None
    in_service: Switch = True

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


def _ordered(pairs: list[tuple[str, float | None, str, float | None]]) -> None:
    for low_name, low, high_name, high in pairs:
        if low is not None and high is not None and not low <= high:
            raise ValueError(
                f"{low_name} = {low:g} with {high_name} = {high:g}, allowed: {low_name} <= {high_name}"
            )


# ---------------------------------------------------------------- exciters


class ConstantExciter(Row):
    """Manual excitation: the field voltage stays at its equilibrium value."""

    kind: Literal["constant"] = "constant"


class StaticExciter(Row):
    """Thyristor exciter: transducer TR, gain KA, lag TA, non-windup limits on Efd (none when not given)."""

    kind: Literal["static"] = "static"
    KA: Positive
    TA: NonNegative = 0.0  #: 0: no lag
    TR: NonNegative = 0.0  #: 0: no transducer lag
    Efd_min: Number | None = None
    Efd_max: Number | None = None

    @model_validator(mode="after")
    def _limits(self) -> Self:
        _ordered([("Efd_min", self.Efd_min, "Efd_max", self.Efd_max)])
        return self


class StaticTgrExciter(Row):
    """Thyristor exciter with transient gain reduction (1 + s TC)/(1 + s TB) before the gain."""

    kind: Literal["static_tgr"] = "static_tgr"
    KA: Positive
    TA: NonNegative = 0.0
    TR: NonNegative = 0.0
    TC: NonNegative
    TB: Positive
    Efd_min: Number | None = None
    Efd_max: Number | None = None

    @model_validator(mode="after")
    def _limits(self) -> Self:
        _ordered([("Efd_min", self.Efd_min, "Efd_max", self.Efd_max)])
        return self


class St1aExciter(Row):
    """IEEE ST1A-like: as static_tgr, the output limited to Vt VRmin .. Vt VRmax - KC Ifd."""

    kind: Literal["st1a"] = "st1a"
    KA: Positive
    TA: NonNegative = 0.0
    TR: NonNegative = 0.0
    TC: NonNegative = 0.0  #: TB = TC = 0: no lead-lag
    TB: NonNegative = 0.0
    VRmin: Number
    VRmax: Number
    KC: NonNegative = 0.0

    @model_validator(mode="after")
    def _limits(self) -> Self:
        _ordered([("VRmin", self.VRmin, "VRmax", self.VRmax)])
        if self.TB == 0.0 and self.TC > 0.0:
            raise ValueError(f"TB = 0 with TC = {self.TC:g}, allowed: TB > 0, or both 0 for no lead-lag")
        return self


class Dc1Exciter(Row):
    """IEEE dc type 1: regulator KA/(1 + s TA) with limits, exciter KE, TE, rate feedback KF, TF.

    Exciter saturation SE(Efd) = Aex exp(Bex Efd); the loss term is (KE + SE) Efd. ``KE = "self-excited"``
    makes KE = -SE(Efd0), so that the regulator output is zero at the start.
    """

    kind: Literal["dc1"] = "dc1"
    KA: Positive
    TA: NonNegative = 0.0
    TR: NonNegative = 0.0
    TC: NonNegative = 0.0
    TB: NonNegative = 0.0  #: TB = TC = 0: no lead-lag
    KE: Number | Literal["self-excited"] = 1.0
    TE: Positive
    KF: NonNegative = 0.0
    TF: Positive = 1.0
    Aex: NonNegative = 0.0
    Bex: NonNegative = 0.0
    VRmin: Number | None = None
    VRmax: Number | None = None

    @model_validator(mode="after")
    def _limits(self) -> Self:
        _ordered([("VRmin", self.VRmin, "VRmax", self.VRmax)])
        if self.TB == 0.0 and self.TC > 0.0:
            raise ValueError(f"TB = 0 with TC = {self.TC:g}, allowed: TB > 0, or both 0 for no lead-lag")
        return self


Exciter = Annotated[
    ConstantExciter | StaticExciter | StaticTgrExciter | St1aExciter | Dc1Exciter, Field(discriminator="kind")
]


# ---------------------------------------------------------------- stabilizer, governors


class Stabilizer(Row):
    """Speed-input stabilizer: K sTw/(1+sTw) times lead-lags (1+sT1)/(1+sT2), (T3, T4), (T5, T6).

    Input: pu speed deviation through the transducer 1/(1 + s TR); output limited to Vs_min .. Vs_max.
    A stage whose two times are 0 is absent.
    """

    K: Number
    Tw: Positive
    T1: NonNegative = 0.0
    T2: NonNegative = 0.0
    T3: NonNegative = 0.0
    T4: NonNegative = 0.0
    T5: NonNegative = 0.0
    T6: NonNegative = 0.0
    TR: NonNegative = 0.0
    Vs_min: Number | None = None
    Vs_max: Number | None = None

    @model_validator(mode="after")
    def _proper(self) -> Self:
        _ordered([("Vs_min", self.Vs_min, "Vs_max", self.Vs_max)])
        for lead, lag in (("T1", "T2"), ("T3", "T4"), ("T5", "T6")):
            if getattr(self, lead) > 0.0 and not getattr(self, lag) > 0.0:
                raise ValueError(f"{lag} = 0 with {lead} = {getattr(self, lead):g}, allowed: {lag} > 0")
        return self

    @property
    def lead_lags(self) -> tuple[tuple[float, float], ...]:
        """(lead, lag) times of the stages present, s."""
        pairs = ((self.T1, self.T2), (self.T3, self.T4), (self.T5, self.T6))
        return tuple(pair for pair in pairs if pair[1] > 0.0)


class NoGovernor(Row):
    """Mechanical power constant."""

    kind: Literal["none"] = "none"


class SteamGovernor(Row):
    """Steam turbine and governor: gain Kp, droop Rp, speed relay Tsr, servo Tsm with rate and gate limits.

    The turbine is a chain of stages from T5 (steam chest) to T2 with torque fractions F5 .. F2;
    a stage with T = 0 passes its input on. Per unit on the machine base.
    """

    kind: Literal["steam"] = "steam"
    Kp: Positive = 1.0
    Rp: Positive
    Tsr: NonNegative = 0.0
    Tsm: Positive
    vg_min: Number | None = None  #: gate speed, pu/s
    vg_max: Number | None = None
    gate_min: Number | None = None
    gate_max: Number | None = None
    T2: NonNegative = 0.0
    T3: NonNegative = 0.0
    T4: NonNegative = 0.0
    T5: NonNegative = 0.0
    F2: NonNegative = 0.0
    F3: NonNegative = 0.0
    F4: NonNegative = 0.0
    F5: NonNegative = 0.0

    @model_validator(mode="after")
    def _limits(self) -> Self:
        _ordered(
            [
                ("vg_min", self.vg_min, "vg_max", self.vg_max),
                ("gate_min", self.gate_min, "gate_max", self.gate_max),
            ]
        )
        total = self.F2 + self.F3 + self.F4 + self.F5
        if not abs(total - 1.0) <= 1e-6:
            raise ValueError(f"F2 + F3 + F4 + F5 = {total:g}, allowed: 1")
        return self


class Tgov1Governor(Row):
    """TGOV1: droop R, valve lag T1 with limits, lead-lag (1 + s T2)/(1 + s T3), turbine damping Dt."""

    kind: Literal["tgov1"] = "tgov1"
    R: Positive
    T1: Positive
    T2: NonNegative
    T3: Positive
    Dt: NonNegative = 0.0
    Vmin: Number | None = None
    Vmax: Number | None = None

    @model_validator(mode="after")
    def _limits(self) -> Self:
        _ordered([("Vmin", self.Vmin, "Vmax", self.Vmax)])
        return self


Governor = Annotated[NoGovernor | SteamGovernor | Tgov1Governor, Field(discriminator="kind")]


# ---------------------------------------------------------------- machine


class Saturation(Row):
    """Exponential saturation: psi_I = Asat exp(Bsat (psi_at - psiT1)) above the air-gap flux psiT1.

    `use`: "none" ignores it, "total" applies K_s = psi_at / (psi_at + psi_I) everywhere, "incremental"
    does so for the operating point and uses the incremental factor in the linearisation.
    """

    Asat: Positive
    Bsat: Positive
    psiT1: NonNegative
    use: Literal["none", "total", "incremental"] = "total"


class Machine(Row):
    """A synchronous machine, its dispatch and its controls; per unit on `base_mva` of its own.

    round_rotor: sixth order, needs Xd, Xq, Xl, Xd1, Xq1, Xd2, Xq2, Td01, Tq01, Td02, Tq02 with
    Xd > Xd1 >= Xd2 > Xl >= 0 and Xq >= Xq1 >= Xq2 > Xl. classical: constant EMF behind Ra + j Xd1.
    """

    name: Annotated[str, Field(strict=True, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
    bus: BusNumber
    area: Annotated[int, Field(strict=True, ge=1)] = 1
    base_mva: Positive
    model: Literal["round_rotor", "classical"] = "round_rotor"
    H: Positive  #: s
    D: NonNegative = 0.0  #: pu torque per pu speed
    Ra: NonNegative = 0.0
    Xd1: Positive
    Xd: Positive | None = None
    Xq: Positive | None = None
    Xl: NonNegative | None = None
    Xq1: Positive | None = None
    Xd2: Positive | None = None
    Xq2: Positive | None = None
    Td01: Positive | None = None
    Tq01: Positive | None = None
    Td02: Positive | None = None
    Tq02: Positive | None = None
    saturation: Saturation | None = None
    P_mw: Number  #: dispatch; the slack machine's is a start value only
    V_pu: Positive
    slack: Switch = False
    angle_deg: Number = 0.0  #: bus angle, slack only
    exciter: Exciter = ConstantExciter()
    stabilizer: Stabilizer | None = None
    governor: Governor = NoGovernor()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if "angle_deg" in self.model_fields_set and self.angle_deg and not self.slack:
            raise ValueError(f"angle_deg = {self.angle_deg:g} at a machine that is not the slack")
        if self.model == "classical":
            if self.exciter.kind != "constant" or self.stabilizer is not None:
                raise ValueError("a classical machine has no field circuit: exciter constant, no stabilizer")
            return self
        needed = ("Xd", "Xq", "Xl", "Xq1", "Xd2", "Xq2", "Td01", "Tq01", "Td02", "Tq02")
        missing = [key for key in needed if getattr(self, key) is None]
        if missing:
            raise ValueError(f"a round_rotor machine needs {', '.join(missing)} as well")
        for chain in (
            ("Xl", "<", "Xd2", "<=", "Xd1", "<", "Xd"),
            ("Xl", "<", "Xq2", "<=", "Xq1", "<=", "Xq"),
        ):
            for low, sign, high in zip(chain[0:-2:2], chain[1:-1:2], chain[2::2], strict=True):
                a, b = getattr(self, low), getattr(self, high)
                if not (a < b or (sign == "<=" and a == b)):
                    raise ValueError(f"{high} = {b:g} with {low} = {a:g}, allowed: {' '.join(chain)}")
        return self


class Tie(Row):
    """The interface whose active power is the output `tie_p`: flow from bus `from` into `branches`."""

    branches: Annotated[tuple[Name, ...], Field(min_length=1)]
    from_bus: BusNumber = Field(alias="from")
