"""Rows of a case that describe controls: exciters, stabilizer, governors, and the row they all are."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Number = Annotated[float, Field(strict=True)]
Positive = Annotated[float, Field(strict=True, gt=0.0)]
NonNegative = Annotated[float, Field(strict=True, ge=0.0)]


class Row(BaseModel):
    """One row of a case table: frozen, unknown keys refused, numbers finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True)

    source: str = ""  #: "KEY, where" when it differs from the source of the whole table


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
