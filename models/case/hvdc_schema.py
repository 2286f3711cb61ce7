"""The row of a dc link with line-commutated converters."""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from .control_schema import Control, NonNegative, Positive
from .link_schema import DcLink
from .schema import BusNumber

Angle = Annotated[float, Field(strict=True, gt=0.0, lt=90.0)]  #: of a converter, deg


class Hvdc(DcLink):
    """A dc link with line-commutated converters: a rectifier at one bus, an inverter at another.

    The inverter rests at `gamma_deg`, the rectifier at the angle that `idc_ka` or `P_mw` asks for. The
    voltages of its buses commutate: filters and reactances in front of them are rows of their own.
    """

    name: Annotated[str, Field(strict=True, max_length=64, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]  #: its id
    rectifier_bus: BusNumber  #: number of the bus of the rectifier
    inverter_bus: BusNumber  #: number of the bus of the inverter
    base_mva: Positive  #: rated power, base of its per-unit values with `vdc_kv`
    vdc_kv: Positive  #: rated dc voltage
    idc_ka: Positive | None = None  #: current of the equilibrium and of its control; None: `P_mw`
    P_mw: Positive | None = None  #: dc power of the rectifier at the equilibrium and of its control
    gamma_deg: Angle  #: extinction angle of the inverter at the equilibrium
    bridges: Annotated[int, Field(strict=True, ge=1)] = 2  #: six-pulse bridges in series, at each end
    rectifier_kv: Positive  #: valve-side line voltage of a bridge at 1 pu bus voltage, taps included
    inverter_kv: Positive  #: the same for the inverter
    rectifier_xc_ohm: NonNegative  #: commutation reactance of a bridge
    inverter_xc_ohm: NonNegative  #: the same for the inverter
    r_ohm: NonNegative  #: resistance of the line
    l_mh: Positive  #: inductance of the line and of both smoothing reactors
    alpha_min_deg: Angle = 5.0  #: least delay angle of the rectifier
    alpha_max_deg: Angle = 85.0  #: largest delay angle of the rectifier
    gamma_min_deg: Angle = 15.0  #: least extinction angle of the inverter
    gamma_max_deg: Angle = 85.0  #: largest extinction angle of the inverter
    rectifier_gain: NonNegative = 0.5  #: proportional gain of the current control, rad per pu of current
    rectifier_integral: Positive = 5.0  #: its integral gain, rad/s per pu of current
    #: proportional gain of the inverter, rad per pu of dc voltage
    inverter_gain: Annotated[float, Field(strict=True, ge=0.0, le=1.0)] = 0.1
    inverter_integral: Positive = 1.0  #: its integral gain, rad/s per pu of dc voltage
    margin: Annotated[float, Field(strict=True, gt=0.0, lt=1.0)] = 0.1  #: current margin, share of the order
    margin_gain: NonNegative = 5.0  #: gain of a current below order less margin, relative to the voltage gain
    i_min_pu: NonNegative = 0.1  #: least current order
    i_max_pu: Positive = 1.2  #: largest current order
    p_mod_pu: NonNegative = 0.1  #: largest modulation of the power, either sign
    v_min_pu: Positive = 0.5  #: least dc voltage that divides a power order
    t_voltage_s: NonNegative = 0.02  #: time constant of the dc voltage measurement
    t_order_s: Positive = 0.02  #: time constant of the current order

    vdcol_i_pu: Positive | None = None  #: largest current order at low dc voltage; None: no such limit
    vdcol_low_pu: NonNegative = 0.3  #: dc voltage of the rectifier up to which that limit applies
    vdcol_high_pu: Positive = 0.8  #: dc voltage above which `i_max_pu` applies; linear between both
    t_vdcol_s: NonNegative = 0.05  #: time constant of the measurement of that voltage

    @model_validator(mode="after")
    def _one_order(self) -> Self:
        if (self.idc_ka is None) == (self.P_mw is None):
            got = "neither" if self.P_mw is None else "both"
            raise ValueError(f"{got} of idc_ka and P_mw, allowed: one, which the control keeps")
        self._require_two("rectifier_bus", "inverter_bus")
        self._require_below(
            ("alpha_min_deg", "alpha_max_deg"),
            ("gamma_min_deg", "gamma_max_deg"),
            ("i_min_pu", "i_max_pu"),
            ("vdcol_low_pu", "vdcol_high_pu"),
            ("vdcol_i_pu", "i_max_pu"),
        )
        if not self.gamma_deg >= self.gamma_min_deg:
            raise ValueError(
                f"gamma_deg = {self.gamma_deg:g} is below gamma_min_deg = {self.gamma_min_deg:g}: the "
                "inverter would not commutate; allowed: at least that; set gamma_deg or gamma_min_deg"
            )
        if not self.gamma_deg <= self.gamma_max_deg:
            raise ValueError(
                f"gamma_deg = {self.gamma_deg:g} with gamma_max_deg = {self.gamma_max_deg:g}, allowed: at "
                "most that"
            )
        return self

    @property
    def bus(self) -> int:
        """Number of the rectifier's bus."""
        return self.rectifier_bus

    @property
    def seen_bus(self) -> int:
        """Number of the inverter's bus."""
        return self.inverter_bus

    @property
    def control(self) -> Control:
        """Its device with all values, per unit, rad and s."""
        angles = {
            key: math.radians(value)
            for key, value in (
                ("AMIN", self.alpha_min_deg),
                ("AMAX", self.alpha_max_deg),
                ("GMIN", self.gamma_min_deg),
                ("GMAX", self.gamma_max_deg),
            )
        }
        values = angles | {
            "POWER": float(self.P_mw is not None),
            "TV": self.t_voltage_s,
            "TI": self.t_order_s,
            "VMIN": self.v_min_pu,
            "VDCOL": float(self.vdcol_i_pu is not None),
            "TVL": self.t_vdcol_s if self.vdcol_i_pu is not None else 0.0,
            "VLOW": self.vdcol_low_pu,
            "VHIGH": self.vdcol_high_pu,
            "ILOW": self.vdcol_i_pu or 0.3 * self.i_max_pu,
            "PMOD": self.p_mod_pu,
            "IMIN": self.i_min_pu,
            "IMAX": self.i_max_pu,
            "KPR": self.rectifier_gain,
            "KIR": self.rectifier_integral,
            "KPI": self.inverter_gain,
            "KII": self.inverter_integral,
            "MARGIN": 1.0 - self.margin,
            "KM": self.margin_gain,
            "R": self.r_ohm / self.base_ohm,
            "L": 1e-3 * self.l_mh / self.base_ohm,
        }
        return Control(kind="lcc", **values)  # type: ignore[arg-type]
