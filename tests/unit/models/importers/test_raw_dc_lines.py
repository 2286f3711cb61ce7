"""Two-terminal dc lines of RAW files: dc links with a closed form at both ends, or constant powers."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from raw_grids import raw_grid

from interarea.models.case.case import load_case
from interarea.models.errors import CaseError
from interarea.models.exporters.raw import raw_of
from interarea.models.grid.dc_link import link_point
from interarea.models.grid.powerflow import solve_powerflow
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.psse import import_psse

LINE = "'POLE 1',{mode},10.0,{setting},200.0,0,{comp},0.15,'I',0,20,1"
RECTIFIER = "2,2,90,5,{rc},6.0,110.0,0.9,{tap},1.5,0.5,0.00625,0,0,0,'1',{xcap}"
INVERTER = "{to},2,90,15,{rc},6.0,110.0,0.9,1.0,1.5,0.5,0.00625"
USUAL = {"mode": 1, "setting": 50.0, "comp": 0.0, "rc": 0.0, "tap": 1.0, "xcap": 0.0, "to": 3}


def imported(folder: Path, version: int = 33, *, as_power: bool = False, **values):
    lines = [line.format(**(USUAL | values)) for line in (LINE, RECTIFIER, INVERTER)]
    if version >= 35:  # a field more behind IC
        lines[1] = lines[1].replace(",0,0,0,'1'", ",0,0,0,0,'1'")
    path = folder / "grid.raw"
    path.write_text(raw_grid(version, extra={"two-terminal dc": lines}))
    return import_psse(path, options=ImportOptions(dc_lines="power" if as_power else "model"))


AT_RECTIFIER = (-200.0 + math.sqrt(200.0**2 + 4.0 * 10.0 * 50.0)) / 20.0  # kA: (200 + 10 I) I = 50


@pytest.mark.parametrize(
    ("version", "values", "current"),
    [
        (23, {}, AT_RECTIFIER),
        *(
            pytest.param(*row, marks=pytest.mark.slow)
            for row in (
                (35, {"setting": -50.0}, 0.25),  # at the inverter
                (33, {"mode": 2, "setting": 240.0, "comp": 5.0}, 0.24),  # amperes; the inverter: 200 - 5 I kV
                (36, {"rc": 0.1}, AT_RECTIFIER),
            )
        ),
    ],
)
def test_a_dc_line_becomes_a_link_with_its_powers_at_both_ends(tmp_path, version, values, current):
    """Sec. 10.2 of Kundur: Vd = Vd0 cos - n (3/pi X +- 2 R) I, Vd0 = 3 sqrt2/pi n E, cos(phi) = Vd/Vd0."""
    result = imported(tmp_path, version, **values)
    case = result.case
    (link,) = case.hvdcs
    flow = solve_powerflow(case)
    alpha = link_point(link, abs(flow.voltage(2)), abs(flow.voltage(3))).alpha
    at_inverter = 200.0 - values.get("comp", 0.0) * current
    rc = values.get("rc", 0.0)
    for bus, power, volts, angle, drop in (
        (2, -flow.at_buses[0], at_inverter + 10.0 * current, alpha, 3.0 / math.pi * 6.0 + 2.0 * rc),
        (3, -flow.inverters[0], at_inverter, math.radians(link.gamma_deg), 3.0 / math.pi * 6.0 - 2.0 * rc),
    ):
        no_load = 3.0 * math.sqrt(2.0) / math.pi * 2 * 99.0 * abs(flow.voltage(bus))
        assert volts == pytest.approx(no_load * math.cos(angle) - 2 * drop * current, rel=1e-7)
        assert abs(power.real) * 100.0 == pytest.approx(volts * current, rel=1e-7)
        assert power.imag * 100.0 == pytest.approx(current * math.sqrt(no_load**2 - volts**2), rel=1e-7)
    assert (link.margin, link.idc_ka is None) == (0.15, values.get("mode") != 2)
    assert any("dc line 'POLE 1': dc link hvdc_POLE_1, " in line for line in result.report.lines)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"tap": 1.3}, "its delay angle would be below 5 deg; set a lower TAP"),
        ({"xcap": 2.0}, r"commutation capacitors \(XCAP\) are not modelled; set them to 0"),
        ({"setting": 0.0}, "it carries no power; set SETVL"),
        ({"to": 2}, "one end is not in the case, or both are at one node"),
        ({"as_power": True}, "as requested"),
    ],
)
def test_what_no_link_can_hold_stays_a_constant_power_with_the_reason(tmp_path, values, reason):
    result = imported(tmp_path, **values)
    assert result.case.hvdcs == ()
    assert sum(load.name.startswith("D") for load in result.case.loads) == 2
    (remark,) = [
        text for text in result.report.assumed if text.startswith("dc line modelled as constant P and Q")
    ]
    assert re.search(reason, remark)
    assert ".raw:" in result.report.first[remark]


def test_a_line_to_a_bus_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(CaseError, match=r"grid\.raw:\d+: bus 77 does not exist, allowed: a bus of this file"):
        imported(tmp_path, to=77)


@pytest.mark.parametrize("order", ["current", "power"])
def test_a_link_comes_back_from_a_written_file(tmp_path, order):
    case = load_case("two-area-hvdc")
    if order == "power":
        document = case.hvdcs[0].model_copy(update={"idc_ka": None, "P_mw": 95.0})
        case = case.model_copy(update={"hvdcs": (document,)})
    flow = solve_powerflow(case)
    written = raw_of(case, flow)
    assert any(
        "control, rating, inductance and capacitance of dc links (hvdc1)" in line for line in written.losses
    )
    path = tmp_path / "back.raw"
    path.write_text(written.text)
    back = import_psse(path).case
    again = solve_powerflow(back)
    (one,), (other,) = case.hvdcs, back.hvdcs
    assert other.gamma_deg == pytest.approx(one.gamma_deg, abs=1e-6)
    assert (other.rectifier_bus, other.inverter_bus, other.bridges) == (105, 115, 4)
    assert (other.idc_ka, other.r_ohm, other.margin) == (one.idc_ka, 100.0, 0.15)
    assert np.max(np.abs(again.inverters - flow.inverters)) < 1e-7
    assert np.max(np.abs(again.voltages - flow.voltages)) < 1e-7
