"""Dc links with voltage-source converters: balances, rest, derivatives, limits, another implementation.

No oracle: no published record of such a link was found.
"""

from __future__ import annotations

import numpy as np
import pytest
from independent.vsc_link import Link, Side
from plant_shim import BlockShim
from sparse_blocks import agreeing_blocks

from interarea.cosim.run.artefacts import linear_matrices
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import case_of, load_case
from interarea.models.case.events import events_of
from interarea.models.errors import CaseError
from interarea.models.exporters.matpower import matpower_of
from interarea.models.files import default_cache
from interarea.models.grid.machine_tables import in_plant_order
from interarea.models.grid.powerflow import solve_powerflow

ROW = {"from_bus": 7, "to_bus": 9, "base_mva": 200.0, "vdc_kv": 300.0, "P_mw": 100.0, "r_ohm": 10.0}
ROW |= {"from_q_mvar": 10.0, "to_q_mvar": -20.0, "from_loss_mw": 1.0, "to_loss_mw": 1.5}
HOLDS_V = {"from_keeps": "v", "to_keeps": "v"}
BACK = {"P_mw": -100.0, "from_priority": "q", "to_priority": "q"}
ENDS = ("p_from", "q_from", "p_to", "q_to")


def with_link(base="two-area-thesis", **row):
    return load_case(base).with_changes({"vscs": {"vsc1": ROW | row}})


def plant_of(case, events=(), **options):
    block = plant_block(case, more=["vsc1.*", "bus7.v", "bus9.v"], **options)
    return BlockShim(block, event_parameters(case, events_of(list(events), where="test")))


def shown(plant, y):
    return dict(zip(plant.output_names, y, strict=True))


@pytest.mark.parametrize("P", [100.0, -100.0, 0.0])
def test_the_power_flow_leaves_at_one_end_what_line_and_losses_leave_of_the_other(P):
    """In kV and kA: (300 + 10 I) I = P - loss at the end that keeps its power, 300 I - loss at the other."""
    case = with_link(P_mw=P)
    flow = solve_powerflow(case)
    current = max(np.roots([10.0, 300.0, -(P - 1.0)]))  # the other root lies beyond the line's most
    assert flow.at_buses[0] * 100.0 == pytest.approx(complex(-P, 10.0), abs=1e-10)
    assert flow.inverters[0] * 100.0 == pytest.approx(complex(300.0 * current - 1.5, -20.0), abs=1e-10)
    # what branches, loads and shunts leave at its buses
    for bus, power in ((7, flow.at_buses[0]), (9, flow.inverters[0])):
        out = sum(flow.flow(b.name, bus) for b in case.branches if bus in (b.from_bus, b.to_bus))
        load = sum(complex(q.P_mw, q.Q_mvar) for q in case.loads if q.bus == bus) / 100.0
        shunt = sum(q.Q_mvar for q in case.shunts if q.bus == bus) / 100.0 * abs(flow.voltage(bus)) ** 2
        assert abs(power - load + 1j * shunt - out) < 1e-12


@pytest.mark.parametrize("network", ["dense", "sparse"])
@pytest.mark.parametrize("row", [{}, HOLDS_V | BACK])
def test_power_is_balanced_at_any_state(network, row):
    """What end 1 takes is what end 2 gives, line, losses and chopper take and the capacitor stores."""
    plant = plant_of(with_link(**row), network=network)
    k = {name: plant.state_names.index(f"vsc1.{name}") for name in ("ip1", "iq1", "ip2", "iq2", "vdc")}
    R = 10.0 / (300.0**2 / 200.0)
    moves = [
        {},
        {"ip1": 0.3, "iq1": -0.5},
        {"vdc": 0.7},
        {"vdc": 1.15, "ip2": 0.2},
        {"ip2": -0.9, "iq2": 0.9},
    ]
    for moved in moves:
        x = plant.x.copy()
        for name, value in moved.items():
            x[k[name]] = value
        rates, y = plant.derivatives(x)
        seen, v = {name: value / 2.0 for name, value in shown(plant, y).items()}, x[k["vdc"]]
        into = -seen["vsc1.p_from"] - 1.0 / 200.0
        i = (np.sqrt(v * v + 4.0 * R * into) - v) / (2.0 * R)
        stored = 0.06 * v * rates[k["vdc"]]
        left = into - R * i * i - seen["vsc1.p_to"] - 1.5 / 200.0 - 10.0 * max(v - 1.1, 0.0) * v - stored
        # the ports of a sparse network are solved to 1e-12 of their voltages, at rest they are as they were
        assert abs(left) < (1e-12 if network == "dense" or not moved else 1e-11), moved
        for end, name in ((7, "1"), (9, "2")):
            side, u = {7: "from", 9: "to"}[end], shown(plant, y)[f"bus{end}.v"]
            assert seen[f"vsc1.p_{side}"] == pytest.approx(u * x[k[f"ip{name}"]], abs=1e-12)
            assert seen[f"vsc1.q_{side}"] == pytest.approx(u * x[k[f"iq{name}"]], abs=1e-12)


@pytest.mark.parametrize("network", ["dense", "sparse"])
@pytest.mark.parametrize(
    ("base", "row"),
    [("two-area-thesis", {}), ("two-area-thesis", HOLDS_V), ("two-area-thesis", BACK), ("kundur-manual", {})],
)
def test_it_rests_and_the_derivatives_are_those_of_differences(network, base, row):
    plant = plant_of(with_link(base, **row), network=network)
    rates, _ = plant.derivatives(plant.x)
    own = [k for k, name in enumerate(plant.state_names) if name.startswith("vsc1.")]
    assert np.max(np.abs(rates[own])) < 1e-12
    assert np.max(np.abs(rates)) < 5e-11  # of the machines: 1.5e-11 without any device
    rates_off, outputs_off = plant.directional_errors(1e-3, 1e-4)
    most = 1e-9 if network == "dense" else 1e-8  # sparse ports are solved to 1e-12 of their voltages
    assert rates_off < most
    assert outputs_off < most


@pytest.mark.slow
def test_it_stands_still_for_20_s():
    plant = plant_of(with_link())
    _, x, _ = plant.run(20.0, 0.002)
    own = [k for k, name in enumerate(plant.state_names) if name.startswith("vsc1.")]
    assert len(own) == 8
    assert np.max(np.abs(x[:, own] - x[0, own])) < 1e-12


@pytest.mark.parametrize("base", ["two-area-thesis", "kundur-manual"])
def test_the_sparse_blocks_have_its_state_matrix(base):
    """Complex steps in C against the blocks, beside a link of the other kind and an SVC."""
    rows = {"vsc1": ROW | BACK, "vsc2": ROW | HOLDS_V | {"from_bus": 6, "to_bus": 10}}
    lcc = {"rectifier_bus": 7, "inverter_bus": 9, "base_mva": 200.0, "vdc_kv": 250.0, "idc_ka": 0.2}
    lcc |= {"gamma_deg": 20.0, "rectifier_kv": 112.0, "inverter_kv": 107.0, "r_ohm": 10.0, "l_mh": 800.0}
    lcc |= {"rectifier_xc_ohm": 6.0, "inverter_xc_ohm": 5.0}
    svc = {"svc1": {"bus": 8, "base_mva": 200.0, "V_pu": 0.97, "control": {"kind": "svc", "K": 10.0}}}
    change = {"vscs": rows, "hvdcs": {"hvdc1": lcc}, "svcs": svc}
    case = in_plant_order(load_case(base).with_changes(change))
    blocks, _, _ = agreeing_blocks(case)
    links = (
        "vsc1_p_mod",
        "vsc1_q_mod_from",
        "vsc1_q_mod_to",
        "vsc2_p_mod",
        "vsc2_v_mod_from",
        "vsc2_v_mod_to",
    )
    assert blocks.inputs[-7:] == ("hvdc1_p_mod", *links)


def test_without_power_the_dc_side_has_the_closed_form_and_the_grid_its_own_modes():
    """C TI s^3 + C s^2 + u KPD s + u KID = 0 with u at end 2: what moves the capacitor moves no voltage."""
    case = load_case("two-area-actuators")
    a = linear_matrices(case, default_cache())
    b = linear_matrices(case.with_changes({"vscs": {"vsc1": "none"}}), default_cache())
    own = [k for k, name in enumerate(a.state_labels) if name.startswith("vsc1.")]
    others = np.setdiff1d(np.arange(len(a.A)), own)
    assert [a.state_labels[k] for k in others] == list(b.state_labels)
    values = np.linalg.eigvals(a.A)
    assert max(np.min(np.abs(values - expected)) for expected in np.linalg.eigvals(b.A)) < 1e-8
    u = abs(solve_powerflow(case).voltage(9))
    for expected in np.roots([0.06 * 0.01, 0.06, 3.0 * u, 50.0 * u]):
        assert np.min(np.abs(values - expected)) < 1e-6


def test_its_input_moves_the_power_within_its_limit():
    plant = plant_of(with_link(p_mod_pu=0.05))
    u = plant.u.copy()
    for value, expected in ((0.02, 0.02), (1.0, 0.05), (-1.0, -0.05)):
        u[plant.input_names.index("vsc1_p_mod")] = value
        _, x, y = plant.run(1.0, 0.002, u)
        taken = -shown(plant, y[-1])["vsc1.p_from"] / 2.0
        assert taken == pytest.approx(0.5 + expected, abs=1e-3)
        assert x[-1, plant.state_names.index("vsc1.vdc")] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("network", ["dense", "sparse"])
@pytest.mark.parametrize("kind", ["device_trip", "hvdc_block"])
def test_without_its_converters_it_carries_nothing_and_after_a_block_goes_on(network, kind):
    event = {"kind": kind, "device": "vsc1", "start_s": 0.1}
    event |= {"end_s": 0.3} if kind == "hvdc_block" else {}
    plant = plant_of(with_link(), [event], network=network)
    t, x, y = plant.run(2.0, 0.002)
    own = [plant.output_names.index(f"vsc1.{name}") for name in ENDS]
    states = [k for k, name in enumerate(plant.state_names) if name.startswith("vsc1.")]
    during = (t > 0.1 + 1e-9) & (t < 0.3 - 1e-9)
    assert np.all(np.abs(y[0, own]) > 0.05) and np.all(y[during][:, own] == 0.0)
    assert np.all(np.ptp(x[during][:, states], axis=0) == 0.0)
    if kind == "hvdc_block":
        assert np.max(np.abs(y[-1, own] - y[0, own])) < 0.01
    else:
        assert np.all(y[-1, own] == 0.0)


#: a link between two infinite buses, each behind a line, and the same numbers for the other program
DOCUMENT = {
    "name": "between",
    "source": "ours",
    "frequency_hz": 50.0,
    "base_mva": 100.0,
    "buses": {"1": {}, "2": {}, "3": {}, "4": {}},
    "branches": {"1-2": {"from": 1, "to": 2, "x": 0.1}, "3-4": {"from": 3, "to": 4, "x": 0.2}},
    "machines": {
        name: {"bus": bus, "base_mva": 100.0, "model": "infinite_bus", "Xd1": 0.05, "P_mw": 0.0, "V_pu": 1.02}
        | {"slack": True}
        for name, bus in (("A", 1), ("B", 4))
    },
}


def between(P, keeps, first):
    """Return the case and the other program's link: 100 MVA, 12 ohm, losses of .5 and .7 MW."""
    row = {"from_bus": 2, "to_bus": 3, "base_mva": 100.0, "vdc_kv": 300.0, "P_mw": 100.0 * P, "r_ohm": 12.0}
    row |= {"from_q_mvar": 10.0, "to_q_mvar": 15.0, "from_loss_mw": 0.5, "to_loss_mw": 0.7}
    row |= {"from_keeps": keeps, "to_keeps": keeps, "from_priority": first, "to_priority": first}
    case = case_of(DOCUMENT | {"vscs": {"vsc1": row}}, where="test")
    flow = solve_powerflow(case)
    sides = []
    for bus, x, line in ((1, 0.15, "1-2"), (4, 0.25, "3-4")):
        V = flow.voltage(bus)
        E = V + 0.05j * np.conj(flow.flow(line, bus) / V)
        sides.append(Side(abs(E), x, 1.1, keeps, first))
    gains = {
        "chopper": 1.1,
        "chopper_gain": 10.0,
        "low": 0.6,
        "full": 0.8,
        "dc_gain": 3.0,
        "dc_integral": 50.0,
    }
    gains |= {"gain": 1.0, "integral": 20.0, "current_s": 0.01, "voltage_s": 0.01}
    R = 12.0 / (300.0**2 / 100.0)
    return case, Link(tuple(sides), P, (0.1, 0.15), R, 0.06, (0.005, 0.007), gains)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("P", "keeps", "first", "end"),
    [(0.9, "q", "p", 1), (0.9, "v", "q", 1), (0.9, "v", "p", 0), (-0.9, "v", "q", 1), (-0.9, "v", "q", 0)],
)
def test_another_implementation_goes_through_a_limit_with_it(P, keeps, first, end):
    """A short circuit beside one end, 150 ms: within 3e-3 of the base, 2e-3 as measured."""
    case, link = between(P, keeps, first)
    fault = {"kind": "bus_fault", "bus": 2 + end, "start_s": 0.1, "end_s": 0.25, "x_pu": 0.05}
    block = plant_block(case, more=["vsc1.*"])
    plant = BlockShim(block, event_parameters(case, events_of([fault], where="test")))
    rates, _ = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 1e-10
    t, x, _ = plant.run(0.6, 5e-4)
    t, places = np.unique(t, return_index=True)
    other = link.run((end, 0.1, 0.25, 0.05), t)
    names = ("ip1", "iq1", "ip2", "iq2", "vm1", "vm2", "vdc")
    plant_has = x[places][:, [plant.state_names.index(f"vsc1.{name}") for name in names]]
    assert np.max(np.abs(plant_has[0] - other[0, :7])) < 1e-9
    off = np.max(np.abs(plant_has - other[:, :7]), axis=0)
    assert np.all(off < 3e-3), dict(zip(names, off, strict=True))
    # it is driven hard: a current at its limit, or all of it cut off, and the dc voltage far from rest
    size = np.hypot(plant_has[:, 2 * end], plant_has[:, 2 * end + 1])
    assert np.max(size) > 1.09
    assert np.ptp(plant_has[:, 6]) > 0.03


def test_the_capacitor_keeps_the_energy_of_a_run():
    """Over a fault that drives it into its limits: stored is what came in less what went out."""
    case, _ = between(0.9, "q", "p")
    fault = {"kind": "bus_fault", "bus": 3, "start_s": 0.1, "end_s": 0.25, "x_pu": 0.05}
    plant = BlockShim(
        plant_block(case, more=["vsc1.*"]), event_parameters(case, events_of([fault], where="test"))
    )
    t, x, y = plant.run(0.25, 2.5e-4)
    v = x[:, plant.state_names.index("vsc1.vdc")]
    into, out = (y[:, plant.output_names.index(f"vsc1.p_{end}")] for end in ("from", "to"))
    R, into = 12.0 / 900.0, -into - 0.005
    i = (np.sqrt(v * v + 4.0 * R * into) - v) / (2.0 * R)
    power = into - R * i * i - out - 0.007 - 10.0 * np.maximum(v - 1.1, 0.0) * v
    inside = t > 0.1 + 1e-9  # powers jump with the voltage
    stored = 0.03 * (v[inside][-2] ** 2 - v[inside][0] ** 2)
    came = np.trapezoid(power[inside][:-1], t[inside][:-1])
    assert np.max(v) > 1.1 and stored > 1e-3
    assert came == pytest.approx(stored, abs=1e-5)


def test_the_end_that_keeps_its_power_leaves_the_link_before_its_voltage_is_gone():
    """End 2 cannot bring what end 1 takes out: end 1 stops between the two dc voltages of its row."""
    case, _ = between(-0.9, "q", "p")
    fault = {"kind": "bus_fault", "bus": 3, "start_s": 0.1, "end_s": 0.6, "x_pu": 0.02}
    plant = BlockShim(
        plant_block(case, more=["vsc1.*"]), event_parameters(case, events_of([fault], where="test"))
    )
    _, x, y = plant.run(0.6, 5e-4)
    v = x[:, plant.state_names.index("vsc1.vdc")]
    assert 0.6 < v[-2] < 0.8 and np.min(v) > 0.4
    power = y[-2, plant.output_names.index("vsc1.p_from")]
    assert 0.0 < power < 0.6


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ({"to_bus": 99}, "vscs.vsc1.to_bus = 99: no such bus, allowed: the numbers under buses"),
        ({"to_bus": 7}, "from_bus = to_bus = 7, allowed: two buses"),
        ({"vdc_low_pu": 0.9}, "vdc_low_pu = 0.9 with vdc_full_pu = 0.8, allowed: vdc_low_pu < vdc_full_pu"),
        ({"energy_s": 0.001}, "energy_s"),
        ({"from_keeps": "pf"}, "from_keeps"),
        ({"to_priority": "s"}, "to_priority"),
        ({"chopper_pu": 0.9}, "chopper_pu"),
        ({"p_mod_pu": 0.0}, "p_mod_pu"),
    ],
)
def test_a_row_that_is_wrong_is_refused_with_the_remedy(row, says):
    with pytest.raises(CaseError) as caught:
        with_link(**row)
    assert says in str(caught.value) and "vsc1" in str(caught.value)
    assert "allowed" in str(caught.value) and "\n" not in str(caught.value)


def test_a_name_is_given_to_one_device():
    with pytest.raises(
        CaseError, match=r"vscs.G1: a machine or a device has that name too, allowed: another"
    ):
        load_case("two-area-thesis").with_changes({"vscs": {"G1": ROW}})


@pytest.mark.parametrize(
    ("row", "says"),
    [
        (
            {"base_mva": 80.0},
            "from_i_max_pu = 1.1, allowed: below it; set from_i_max_pu or base_mva, or less",
        ),
        ({"to_i_max_pu": 0.4}, "its current at to_bus is 0.497947 pu at the equilibrium, to_i_max_pu = 0.4"),
        (
            {"P_mw": -100.0, "r_ohm": 300.0},
            "P_mw = -100, allowed: above -74, the most that a line of 300 ohm",
        ),
    ],
)
def test_a_link_that_cannot_rest_is_refused_with_the_remedy(row, says):
    with pytest.raises(CaseError) as caught:
        solve_powerflow(with_link(**row))
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_written_file_says_that_it_leaves_links_out():
    assert any("dc links with their power (vsc1)" in line for line in matpower_of(with_link()).losses)
