"""VSC dc lines of RAW files: dc links with the powers of the file at both ends, or constant powers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from raw_grids import raw_grid

from interarea.grids import linearise
from interarea.models.case.case import load_case
from interarea.models.errors import CaseError
from interarea.models.exporters.raw import raw_of
from interarea.models.grid.powerflow import solve_powerflow
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.psse import import_psse

LINE = "'V 1',1,{r},1,1.0"
POWER_END = "{bus},2,{mode},{power},{ac},100.0,0.5,0.0,{smax},{imax},{pwf},99,-99,0,100"
VOLTAGE_END = "{to},1,1,300.0,{volts},200.0,0.0,250.0,{smax},0,1,99,-99,{remote},100"
USUAL = {"r": 2.0, "mode": 2, "power": 40.0, "smax": 100.0, "imax": 0.0, "pwf": 0.0, "to": 3, "remote": 0}
USUAL |= {"bus": 2, "ac": 1.0, "volts": 1.0}


def imported(folder: Path, version: int = 33, *, as_power: bool = False, **values):
    lines = [line.format(**(USUAL | values)) for line in (LINE, POWER_END, VOLTAGE_END)]
    path = folder / "grid.raw"
    path.write_text(raw_grid(version, extra={"VSC dc": lines}))
    return import_psse(path, options=ImportOptions(dc_lines="power" if as_power else "model"))


@pytest.mark.parametrize(("version", "power"), [(29, 40.0), (36, -40.0)])
def test_a_vsc_line_becomes_a_link_with_its_powers_at_both_ends(tmp_path, version, power):
    """300 kV at bus 3, I = (P + losses)/(300 - R I) kA to bus 2; losses ALOSS + BLOSS I or MINLOSS."""
    result = imported(tmp_path, version, power=power)
    (link,) = result.case.vscs
    current = power / 300.0
    for _ in range(50):
        current = (power + 0.1 + 0.5 * abs(current)) / (300.0 - 2.0 * current)
    flow = solve_powerflow(result.case)
    p1, p2 = 100.0 * flow.at_buses[0].real, 100.0 * flow.inverters[0].real
    assert p1 == pytest.approx(power, rel=1e-12)
    assert p2 == pytest.approx(-300.0 * current - 0.25, rel=1e-9)
    assert (link.from_keeps, link.to_keeps, link.from_priority, link.to_priority) == ("q", "v", "q", "p")
    assert (link.base_mva, link.from_i_max_pu, link.r_ohm, link.vdc_kv) == (100.0, 1.0, 2.0, 300.0)
    assert any("VSC dc line 'V 1': dc link vsc_V_1, 300 kV, " in line for line in result.report.lines)
    powers = solve_powerflow(imported(tmp_path, version, power=power, as_power=True).case)
    assert np.max(np.abs(powers.voltages - flow.voltages)) < 1e-9


def test_ratings_in_ampere_and_mva_give_the_current_limits(tmp_path):
    (link,) = imported(tmp_path, imax=420.0).case.vscs
    assert link.from_i_max_pu == pytest.approx(3.0**0.5 * 110.0 * 0.42 / 100.0, rel=1e-12)
    result = imported(tmp_path, smax=0.0, remote=2)
    assert any("regulates another bus" in text for text in result.report.assumed)
    (link,) = result.case.vscs
    assert link.from_i_max_pu == link.to_i_max_pu == 1.1 and link.base_mva > 40.0 / 1.02


@pytest.mark.parametrize(("ac", "q"), [(1.0, 0.0), (0.95, 13.147364), (-0.95, -13.147364)])
def test_set_points_hold_where_the_stored_voltages_are_no_solution(tmp_path, ac, q):
    """Of 132 MVA off: 40 MW tan(acos 0.95) = 13.147 Mvar at the power end, 1.03 pu at the voltage end."""
    result = imported(tmp_path, ac=ac, volts=1.03)
    (link,) = result.case.vscs
    assert link.from_q_mvar == pytest.approx(q, abs=1e-6)
    flow = solve_powerflow(result.case)
    assert flow.magnitudes[2] == pytest.approx(1.03, abs=1e-9)
    assert sum("converter holds its set-point" in text for text in result.report.assumed) == 1
    assert any("no solution" in line for line in result.report.lines)
    path = tmp_path / "solved.raw"  # of the solution itself, the stored voltages give the same Q
    path.write_text(raw_of(result.case, flow).text)
    (again,) = import_psse(path).case.vscs
    assert (again.from_q_mvar, again.to_q_mvar) == pytest.approx((link.from_q_mvar, link.to_q_mvar), abs=1e-6)


def test_a_converter_beside_a_unit_that_holds_the_voltage_gives_no_reactive_power(tmp_path):
    (link,) = imported(tmp_path, bus=1, mode=1).case.vscs
    assert link.from_q_mvar == 0.0


@pytest.mark.parametrize("values", [{"ac": 0.0}, {"ac": 1.5}, {"volts": 0.0}])
def test_a_setting_that_no_converter_has_leaves_q_to_the_stored_voltages(tmp_path, values):
    remarks = imported(tmp_path, **values).report.assumed
    assert (
        "Q of a dc line or FACTS device is what stored voltages leave over that are not a solution" in remarks
    )


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"smax": -5.0}, r"SMAX \(field 9\) = -5, allowed: 0 \(no limit\) or above"),
        ({"imax": -5.0}, r"IMAX \(field 10\) = -5, allowed: 0 \(no limit\) or above"),
        ({"to": 77}, r"raw:27: bus 77 does not exist"),
    ],
)
def test_a_wrong_converter_is_refused_by_its_line(tmp_path, values, says):
    with pytest.raises(CaseError, match=says):
        imported(tmp_path, **values)


def test_a_written_power_factor_is_that_of_its_own_end(tmp_path):
    """P_mw less losses and R I^2 at the voltage end; another program computes its Q from both."""
    case = load_case("two-area-thesis")
    row = load_case("two-area-actuators").vscs[0]
    row = row.model_copy(update={"P_mw": 60.0, "to_keeps": "q", "to_q_mvar": -20.0, "to_loss_mw": 8.0})
    flow = solve_powerflow(case := case.model_copy(update={"vscs": (row,)}))
    written = raw_of(case, flow).text.splitlines()
    (line,) = [text for text in written if text.startswith(f"{row.to_bus},1,2,")]
    p2 = 100.0 * flow.inverters[0].real
    assert abs(p2) < 53.0
    assert float(line.split(",")[4]) == pytest.approx(-abs(p2) / np.hypot(p2, 20.0), rel=1e-9)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (
            {"smax": 30.0},
            r"its current at bus 2 is \d.* MVA at 1 pu, not below its rating of 30; set a higher",
        ),
        ({"r": -1.0}, "RDC is below 0; set it"),
        ({"to": 2}, "one end is not in the case, or both are at one node"),
        ({"as_power": True}, "as requested"),
    ],
)
def test_what_no_link_can_hold_stays_a_constant_power_with_the_reason(tmp_path, values, reason):
    result = imported(tmp_path, **values)
    assert result.case.vscs == ()
    assert sum(load.name.startswith("D") for load in result.case.loads) == 2
    (remark,) = [text for text in result.report.assumed if text.startswith("VSC line modelled as constant P")]
    assert re.search(reason, remark) and ".raw:" in result.report.first[remark]


def test_a_link_comes_back_from_a_written_file(tmp_path):
    """With power, reactive power, losses and limits; its modes are those of the case."""
    case = load_case("two-area-thesis")
    row = load_case("two-area-actuators").vscs[0]
    row = row.model_copy(
        update={"P_mw": 60.0, "from_q_mvar": 12.0, "to_keeps": "v", "from_loss_mw": 0.4, "to_loss_mw": 0.7}
    )
    case = case.model_copy(update={"vscs": (row,)})
    flow = solve_powerflow(case)
    written = raw_of(case, flow)
    assert any("capacitance of dc links" in line and row.name in line for line in written.losses)
    path = tmp_path / "back.raw"
    path.write_text(written.text)
    (back,) = import_psse(path).case.vscs
    same = ("from_bus", "to_bus", "from_keeps", "to_keeps", "from_priority", "to_priority", "vdc_kv", "r_ohm")
    assert all(getattr(back, key) == getattr(row, key) for key in same)
    for key in ("P_mw", "from_q_mvar", "to_q_mvar", "from_loss_mw", "to_loss_mw"):
        assert getattr(back, key) == pytest.approx(getattr(row, key), abs=1e-5), key
    limits = [(r.from_i_max_pu * r.base_mva, r.to_i_max_pu * r.base_mva) for r in (row, back)]
    assert limits[1] == pytest.approx(limits[0], rel=1e-12)
    scale = back.base_mva / row.base_mva  # per-unit values of the control are on another base
    same_base = back.model_copy(
        update={
            "name": row.name,
            "base_mva": row.base_mva,
            "from_i_max_pu": back.from_i_max_pu * scale,
            "to_i_max_pu": back.to_i_max_pu * scale,
            "energy_s": row.energy_s,
        }
    )
    modes = [linearise(case.model_copy(update={"vscs": (r,)})).poles() for r in (row, same_base)]
    assert np.max(np.abs(np.sort_complex(modes[0]) - np.sort_complex(modes[1]))) < 1e-5
