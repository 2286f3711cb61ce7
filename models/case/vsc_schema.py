"""The row of a dc link with voltage-source converters."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from .control_schema import Control, NonNegative, Number, Positive
from .link_schema import DcLink
from .schema import BusNumber

Keeps = Literal["q", "v"]
Priority = Literal["p", "q"]
Energy = Annotated[float, Field(strict=True, ge=0.005, le=1.0)]
FullFrom = Annotated[float, Field(strict=True, gt=0.0, le=0.95)]


class Vsc(DcLink):
    """A dc link with voltage-source converters: one end controls the power, the other the dc voltage.

    In the power flow it takes `P_mw` at `from_bus` and gives there what the line and both converters leave of
    it at `to_bus`, with the reactive power of each end; dc voltage and `vdc_kv` are the same at `to_bus`.
    """

    name: Annotated[str, Field(strict=True, max_length=64, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]  #: its id
    from_bus: BusNumber  #: number of the bus of the end that controls the power
    to_bus: BusNumber  #: number of the bus of the end that controls the dc voltage
    base_mva: Positive  #: rated power, base of its per-unit values with `vdc_kv`
    vdc_kv: Positive  #: rated pole-to-pole dc voltage, that of the equilibrium
    P_mw: Number  #: power from the network at `from_bus` into the link; below 0: reverse
    from_q_mvar: Number = 0.0  #: reactive power into the network at `from_bus`
    to_q_mvar: Number = 0.0  #: the same at `to_bus`
    r_ohm: NonNegative  #: resistance of the line, both poles
    energy_s: Energy = 0.03  #: energy of all dc capacitors at rated voltage, MJ per MVA of `base_mva`
    #: controlled at `from_bus` in a run: "q" reactive power, "v" ac voltage, as at the equilibrium
    from_keeps: Keeps = "q"
    to_keeps: Keeps = "q"  #: the same at `to_bus`
    from_i_max_pu: Positive = 1.1  #: largest current at `from_bus`
    to_i_max_pu: Positive = 1.1  #: the same at `to_bus`
    #: current with priority at the limit there: "p" active, "q" reactive
    from_priority: Priority = "p"
    to_priority: Priority = "p"  #: the same at `to_bus`
    from_loss_mw: NonNegative = 0.0  #: loss of the converter at `from_bus`
    to_loss_mw: NonNegative = 0.0  #: loss of the converter at `to_bus`
    p_mod_pu: Positive = 0.1  #: largest modulation of the power, either sign
    q_mod_pu: Positive = 0.1  #: largest modulation of the reactive power of an end that keeps it, either sign
    v_mod_pu: Positive = 0.1  #: largest modulation of the ac voltage of an end that keeps it, either sign
    t_voltage_s: NonNegative = 0.01  #: time constant of the ac voltage measurement
    #: time constant of current control
    t_current_s: Annotated[float, Field(strict=True, ge=0.001, le=1.0)] = 0.01
    vdc_gain: Positive = 3.0  #: proportional gain of dc voltage control at `to_bus`, pu per pu
    vdc_integral: Positive = 50.0  #: its integral gain, pu/s per pu
    v_gain: NonNegative = 1.0  #: proportional gain of ac voltage control, pu per pu
    v_integral: Positive = 20.0  #: its integral gain, pu/s per pu
    chopper_pu: Annotated[float, Field(strict=True, gt=1.0)] = 1.1  #: dc voltage at which the chopper starts
    chopper_gain: NonNegative = 10.0  #: chopper current per dc voltage above that, pu per pu; 0: no chopper
    #: dc voltage up to which `from_bus` takes no power out of the link
    vdc_low_pu: NonNegative = 0.6
    vdc_full_pu: FullFrom = 0.8  #: dc voltage above which it may take all; linear between both

    @model_validator(mode="after")
    def _two_ends(self) -> Self:
        self._require_two("from_bus", "to_bus")
        self._require_below(("vdc_low_pu", "vdc_full_pu"))
        return self

    @property
    def bus(self) -> int:
        """Number of the bus of the end that keeps its power."""
        return self.from_bus

    @property
    def seen_bus(self) -> int:
        """Number of the bus of its other end."""
        return self.to_bus

    @property
    def control(self) -> Control:
        """Its device with all values, per unit and s."""
        values = {
            "PFIRST1": float(self.from_priority == "p"),
            "PFIRST2": float(self.to_priority == "p"),
            "KEEPV1": float(self.from_keeps == "v"),
            "KEEPV2": float(self.to_keeps == "v"),
            "IMAX1": self.from_i_max_pu,
            "IMAX2": self.to_i_max_pu,
            "LOSS1": self.from_loss_mw / self.base_mva,
            "LOSS2": self.to_loss_mw / self.base_mva,
            "TV": self.t_voltage_s,
            "TI": self.t_current_s,
            "PMOD": self.p_mod_pu,
            "QMOD": self.q_mod_pu,
            "VMOD": self.v_mod_pu,
            "KPD": self.vdc_gain,
            "KID": self.vdc_integral,
            "KPV": self.v_gain,
            "KIV": self.v_integral,
            "R": self.r_ohm / self.base_ohm,
            "C": 2.0 * self.energy_s,
            "CHOP": self.chopper_gain,
            "VCHOP": self.chopper_pu,
            "VLOW": self.vdc_low_pu,
            "VFULL": self.vdc_full_pu,
        }
        return Control(kind="vsc", **values)  # type: ignore[arg-type]
