"""Dc links: power is balanced, they rest, derivatives are exact, orders and limits hold, they trip."""

from __future__ import annotations

import numpy as np
import pytest
from plant_shim import BlockShim
from sparse_blocks import agreeing_blocks

from interarea.cosim.run.artefacts import linear_matrices
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import load_case
from interarea.models.case.events import events_of
from interarea.models.errors import CaseError
from interarea.models.exporters.matpower import matpower_of
from interarea.models.files import default_cache
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.machine_tables import in_plant_order
from interarea.models.grid.powerflow import solve_powerflow

ROW = {"rectifier_bus": 7, "inverter_bus": 9, "base_mva": 200.0, "vdc_kv": 250.0, "idc_ka": 0.4}
ROW |= {"gamma_deg": 20.0, "rectifier_kv": 112.0, "inverter_kv": 107.0, "r_ohm": 10.0, "l_mh": 800.0}
ROW |= {"rectifier_xc_ohm": 6.0, "inverter_xc_ohm": 5.0}
POWER = {"idc_ka": "none", "P_mw": 100.0}
ENDS = ("p_rectifier", "q_rectifier", "p_inverter", "q_inverter")


def with_link(base="two-area-thesis", **row):
    whole = {key: value for key, value in (ROW | row).items() if value != "none"}
    return load_case(base).with_changes({"hvdcs": {"hvdc1": whole}})


def plant_of(case, **options):
    return BlockShim(plant_block(case, more=["hvdc1.*", "bus7.v", "bus9.v"], **options))


def shown(plant, y):
    return dict(zip(plant.output_names, y, strict=True))


@pytest.mark.parametrize("row", [{}, POWER])
def test_the_power_flow_has_the_equations_of_kundur(row):
    """Sec. 10.2: Vd = Vd0 cos - 3/pi X B Id, Vd0 = 3 sqrt2/pi B E, cos(phi) = Vd/Vd0; in kV and kA."""
    case = with_link(**row)
    flow, point = solve_powerflow(case), operating_point(case)
    at = dict(zip(point.state_names, point.x0, strict=True))
    i = at["hvdc1.idc"] * 0.8
    volts = []
    for bus, kv, xc, angle, power in (
        (7, 112.0, 6.0, at["hvdc1.xr"], -flow.at_buses[0]),
        (9, 107.0, 5.0, np.radians(20.0), -flow.inverters[0]),
    ):
        no_load = 3.0 * np.sqrt(2.0) / np.pi * 2.0 * kv * abs(flow.voltage(bus))
        vd = no_load * np.cos(angle) - 3.0 / np.pi * 2.0 * xc * i
        assert abs(power.real) * 100.0 == pytest.approx(vd * i, abs=1e-9)
        assert power.imag * 100.0 == pytest.approx(vd * i * np.tan(np.arccos(vd / no_load)), abs=1e-7)
        volts.append(vd)
    assert volts[0] - volts[1] == pytest.approx(10.0 * i, abs=1e-9)
    assert (volts[0] * i if row else i) == pytest.approx(100.0 if row else 0.4, abs=1e-9)


@pytest.mark.parametrize("network", ["dense", "sparse"])
def test_power_is_balanced_at_any_state(network):
    """What the rectifier takes is what the inverter gives, the line loses and its inductance stores."""
    plant = plant_of(with_link(), network=network)
    k = {name: plant.state_names.index(f"hvdc1.{name}") for name in ("idc", "iord", "xr", "xi")}
    base = 250.0**2 / 200.0
    moves = [{}, {"idc": 0.8}, {"xr": 0.9, "xi": 0.5}, {"idc": 0.1, "iord": 0.9}, {"xr": 0.01}, {"idc": 0.0}]
    for moved in moves:
        x = plant.x.copy()
        for name, value in moved.items():
            x[k[name]] = value
        rates, y = plant.derivatives(x)
        seen, i = shown(plant, y), x[k["idc"]]
        stored = 0.8 / base * i * rates[k["idc"]]
        drawn = -seen["hvdc1.p_rectifier"] / 2.0  # of the link's base
        left = drawn - seen["hvdc1.p_inverter"] / 2.0 - 10.0 / base * i * i - stored
        assert abs(left) < 1e-12, moved
        assert seen["hvdc1.q_rectifier"] <= 0.0 and seen["hvdc1.q_inverter"] <= 0.0


@pytest.mark.parametrize("network", ["dense", "sparse"])
@pytest.mark.parametrize(
    ("base", "row"), [("two-area-thesis", {}), ("two-area-thesis", POWER), ("kundur-manual", {})]
)
def test_it_rests_and_the_derivatives_are_those_of_differences(network, base, row):
    plant = BlockShim(plant_block(with_link(base, **row), network=network))
    rates, _ = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 5e-11  # of the machines: 1.5e-11 without any device
    # ports are solved to 1e-12, which the rate of the current shows 400 times larger
    rates_off, outputs_off = plant.directional_errors(1e-3, 1e-4)
    assert rates_off < (1e-9 if network == "dense" else 1e-7)
    assert outputs_off < 1e-7


@pytest.mark.slow
def test_it_stands_still_for_20_s():
    plant = BlockShim(plant_block(with_link()))
    _, x, _ = plant.run(20.0, 0.002)
    own = [k for k, name in enumerate(plant.state_names) if name.startswith("hvdc1.")]
    assert len(own) == 5
    assert np.max(np.abs(x[:, own] - x[0, own])) < 1e-12


@pytest.mark.parametrize("row", [{}, POWER])
def test_its_input_moves_the_order_within_its_limit(row):
    """By a power over the dc voltage: as ordered, or by p_mod_pu where more is asked for."""
    plant = plant_of(with_link(p_mod_pu=0.05, **row))
    k = {name: plant.state_names.index(f"hvdc1.{name}") for name in ("idc", "iord", "vm")}
    rest, u = plant.x[k["iord"]], plant.u.copy()
    for value, expected in ((0.02, 0.02), (1.0, 0.05), (-1.0, -0.05)):
        u[plant.input_names.index("hvdc1_p_mod")] = value
        _, x, _ = plant.run(0.4, 0.002, u)
        assert np.max(np.abs(x[-1])) < 10.0
        vm = x[-1, k["vm"]]
        power = rest * plant.x[k["vm"]] if row else rest * vm
        assert x[-1, k["iord"]] * vm == pytest.approx(power + expected, abs=2e-3)


@pytest.mark.parametrize("network", ["dense", "sparse"])
def test_a_trip_takes_both_ends_out(network):
    case = with_link()
    events = events_of([{"kind": "device_trip", "device": "hvdc1", "start_s": 0.1}], where="test")
    plant = plant_of(case, network=network)
    plant = BlockShim(plant_block(case, more=["hvdc1.*"], network=network), event_parameters(case, events))
    _, _, y = plant.run(0.3, 0.002)
    for name in ENDS:
        column = y[:, plant.output_names.index(f"hvdc1.{name}")]
        assert abs(column[0]) > 0.1
        assert column[-1] == 0.0


@pytest.mark.parametrize("network", ["dense", "sparse"])
def test_a_blocked_link_carries_nothing_and_starts_again(network):
    """Its dc current dies away with 10 ms, its control stands still; afterwards the current is as ordered."""
    case = with_link()
    block = [{"kind": "hvdc_block", "device": "hvdc1", "start_s": 0.1, "end_s": 0.3}]
    events = event_parameters(case, events_of(block, where="test"))
    plant = BlockShim(plant_block(case, more=["hvdc1.*"], network=network), events)
    t, x, y = plant.run(3.0, 0.002)
    k = {name: plant.state_names.index(f"hvdc1.{name}") for name in ("idc", "iord", "xr", "xi", "vm")}
    during = (t > 0.1 + 1e-9) & (t < 0.3 - 1e-9)
    for name in ENDS:
        column = y[:, plant.output_names.index(f"hvdc1.{name}")]
        assert np.all(column[during] == 0.0) and abs(column[0]) > 0.1
        assert abs(column[-1] - column[0]) < 0.05 * abs(column[0])
    rest = plant.x
    assert np.max(np.abs(x[during, k["idc"]] - rest[k["idc"]] * np.exp(-(t[during] - 0.1) / 0.01))) < 1e-4
    for name in ("iord", "xr", "xi", "vm"):
        assert np.ptp(x[during, k[name]]) == 0.0
    assert x[-1, k["idc"]] == pytest.approx(rest[k["idc"]], abs=5e-3)


def test_a_low_dc_voltage_limits_the_order():
    """The voltage-dependent limit in a long dip at the inverter: the order is on its line."""
    row = {"vdcol_i_pu": 0.15, "vdcol_low_pu": 0.85, "vdcol_high_pu": 0.95, "margin_gain": 0.0}
    dip = events_of(
        [{"kind": "bus_fault", "bus": 9, "start_s": 0.1, "end_s": 0.9, "x_pu": 0.02}], where="test"
    )
    ends = []
    for case in (with_link(**row), with_link(margin_gain=0.0)):
        plant = BlockShim(plant_block(case), event_parameters(case, dip))
        t, x, _ = plant.run(0.9, 0.002)
        at = {name: x[:, k] for k, name in enumerate(plant.state_names)}
        last = np.searchsorted(t, 0.9 - 1e-9) - 1
        ends.append((at["hvdc1.iord"][last], at["hvdc1.iord"][0]))
        if case.hvdcs[0].vdcol_i_pu is not None:
            volts = at["hvdc1.vl"][last]
            assert volts < 0.9
            line = np.clip(0.15 + (1.2 - 0.15) * (volts - 0.85) / (0.95 - 0.85), 0.15, 1.2)
            assert at["hvdc1.iord"][last] == pytest.approx(min(line, at["hvdc1.iord"][0]), abs=0.02)
        else:
            assert "hvdc1.vl" not in at
    (limited, rest), (other, _) = ends
    assert limited < rest - 0.1 and other == pytest.approx(rest, abs=1e-9)


@pytest.mark.slow
def test_after_a_fault_it_settles_and_does_not_drift():
    """two-area-hvdc, three minutes after a fault beside the inverter: at rest again, current as ordered."""
    case = load_case("two-area-hvdc")
    fault = [{"kind": "bus_fault", "bus": 14, "start_s": 1.0, "end_s": 1.1, "x_pu": 0.02}]
    events = event_parameters(case, events_of(fault, where="test"))
    plant = BlockShim(plant_block(case, more=["hvdc1.*"]), events)
    t, x, y = plant.run(180.0, 0.005)
    own = [k for k, name in enumerate(plant.output_names) if name.startswith("hvdc1.")]
    assert np.max(np.abs(y[:, own] - y[0, own])) > 0.1
    assert np.max(np.abs(y[-1, own] - y[0, own])) < 1e-4
    swinging = [k for k, name in enumerate(plant.state_names) if not name.endswith(".delta")]
    late = x[t > 150.0][:, swinging]
    assert np.max(np.ptp(late, axis=0)) < 1e-3


def test_the_inverter_takes_the_current_over_where_the_rectifier_is_at_its_least_angle():
    """A dip at the rectifier: its angle is at the limit, and the current does not fall to nothing."""
    case = with_link(margin_gain=20.0, inverter_integral=5.0)
    other = with_link(margin_gain=0.0, inverter_integral=5.0)
    dip = events_of(
        [{"kind": "bus_fault", "bus": 7, "start_s": 0.1, "end_s": 0.5, "x_pu": 0.1}], where="test"
    )
    least = []
    for each in (case, other):
        plant = BlockShim(plant_block(each, more=["bus7.v"]), event_parameters(each, dip))
        _, x, y = plant.run(0.5, 0.001)
        assert np.min(y[:, plant.output_names.index("bus7.v")]) < 0.9
        least.append(x[-1, plant.state_names.index("hvdc1.idc")])
    assert least[0] > least[1] + 0.01


@pytest.mark.parametrize("base", ["two-area-thesis", "kundur-manual"])
def test_the_sparse_blocks_have_its_state_matrix(base):
    """`interarea loops` and verdicts read the plant as blocks: a link couples at two buses."""
    row = {"hvdc1": ROW, "hvdc2": ROW | POWER | {"rectifier_bus": 6, "inverter_bus": 10}}
    rows = {name: {k: v for k, v in one.items() if v != "none"} for name, one in row.items()}
    svc = {"svc1": {"bus": 8, "base_mva": 200.0, "V_pu": 0.97, "control": {"kind": "svc", "K": 10.0}}}
    case = in_plant_order(load_case(base).with_changes({"hvdcs": rows, "svcs": svc}))
    blocks, A, _ = agreeing_blocks(case)
    assert blocks.inputs[-2:] == ("hvdc1_p_mod", "hvdc2_p_mod")
    # and in coordinates of the devices' modes, with which the search for modes works
    s = 0.3 + 4.0j
    from interarea.design.linear.resolvent import Shifted

    right = np.ones(len(A))
    expected = np.linalg.solve(s * np.eye(len(A)) - A, right)
    assert np.max(np.abs(Shifted(blocks, s).solve(right) - expected)) < 1e-8 * np.max(np.abs(expected))


@pytest.mark.parametrize(
    ("row", "says"),
    [
        (
            {"inverter_bus": 99},
            "hvdcs.hvdc1.inverter_bus = 99: no such bus, allowed: the numbers under buses",
        ),
        ({"inverter_bus": 7}, "rectifier_bus = inverter_bus = 7, allowed: two buses"),
        ({"gamma_deg": 12.0}, "gamma_deg = 12 is below gamma_min_deg = 15: the inverter would not commutate"),
        (
            {"vdcol_i_pu": 1.3},
            "vdcol_i_pu = 1.3 with i_max_pu = 1.2, allowed: vdcol_i_pu < i_max_pu",
        ),
        ({"P_mw": 100.0}, "both of idc_ka and P_mw, allowed: one"),
        ({"idc_ka": "none"}, "neither of idc_ka and P_mw, allowed: one"),
        (
            {"alpha_min_deg": 86.0},
            "alpha_min_deg = 86 with alpha_max_deg = 85, allowed: alpha_min_deg < alpha",
        ),
    ],
)
def test_a_row_that_is_wrong_is_refused_with_the_remedy(row, says):
    with pytest.raises(CaseError) as caught:
        with_link(**row)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("row", "says"),
    [
        (
            {"idc_ka": 1.0},
            "current at the equilibrium is 1.25 pu, i_max_pu = 1.2, allowed: within its limits; set i_max_pu",
        ),
        (
            {"vdcol_i_pu": 0.4, "vdcol_high_pu": 1.5},
            "vdcol_high_pu = 1.5, allowed: above it, because the order would be at its limit; set a "
            "lower vdcol",
        ),
        ({"rectifier_kv": 100.0}, "no delay angle gives the dc voltage"),
        ({"rectifier_kv": 104.0, "alpha_min_deg": 15.0}, "deg, beyond alpha_min_deg = 15, allowed"),
        ({"rectifier_kv": 150.0, "alpha_max_deg": 30.0}, "set a lower rectifier_kv, or alpha_max_deg"),
    ],
)
def test_a_link_that_cannot_rest_is_refused_with_the_remedy(row, says):
    with pytest.raises(CaseError) as caught:
        solve_powerflow(with_link(**row))
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_linear_study_on_a_limit_is_refused_with_the_margin():
    with pytest.raises(
        CaseError,
        match=r"hvdcs.hvdc1: xi \(.*\) is at 0.349066, \S+ from its limit gamma_min_deg; .*widen",
    ):
        linear_matrices(with_link(gamma_min_deg=20.0), default_cache())


def test_a_written_file_says_that_it_leaves_links_out():
    assert any("dc links with their power (hvdc1)" in line for line in matpower_of(with_link()).losses)
