"""Devices at buses: they rest, their derivatives are exact, they trip, and lanes have their bits."""

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
from interarea.models.files import default_cache
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.machine_tables import in_plant_order
from interarea.models.grid.powerflow import solve_powerflow
from interarea.models.grid.start import release_limits, require_off_limits, start_of

CONTROLS = {
    "svc": {"kind": "svc", "K": 10.0, "TR": 0.05, "TC": 0.65, "TB": 0.2},
    "csvgn1": {"kind": "csvgn1", "CBASE": 60.0},
    "statcom": {"kind": "statcom", "KR": 20.0},
}


def with_svc(kind, base="two-area-thesis", **row):
    row_of_svc = {"bus": 8, "base_mva": 200.0, "control": CONTROLS[kind]} | row
    return load_case(base).with_changes({"svcs": {"svc1": row_of_svc}})


@pytest.mark.parametrize("network", ["dense", "sparse"])
@pytest.mark.parametrize(("control", "regulates"), [("svc", 8), ("csvgn1", 7), ("statcom", 8)])
@pytest.mark.parametrize("base", ["two-area-thesis", "kundur-manual"])
def test_it_rests_and_the_derivatives_are_those_of_differences(control, network, regulates, base):
    plant = BlockShim(plant_block(with_svc(control, base, Q_mvar=20.0, regulates=regulates), network=network))
    rates, y = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 2e-11  # of the machines: 1.5e-11 without any device
    # rounding of the voltage, 2e-15, times gain over lag: 650 1/s of the SVC
    assert np.max(np.abs(rates[[n.startswith("svc1.") for n in plant.state_names]])) < 2e-12
    assert y[plant.output_names.index("svc1.q")] == pytest.approx(0.2, abs=1e-12)
    h = 1e-4 if base == "kundur-manual" else 1e-5  # its ports are solved to 1e-12
    rates_off, outputs_off = plant.directional_errors(1e-3, h)
    assert rates_off < 1e-9
    assert outputs_off < 1e-7


@pytest.mark.parametrize(("control", "power"), [("svc", 2), ("statcom", 1)])
def test_held_at_its_limit_it_gives_the_power_of_its_law(control, power):
    """v_mod drives the state to its limit; Q/V^2 of an SVC, Q/V of a STATCOM is then that limit."""
    case = with_svc(control, V_pu=1.0)
    plant = BlockShim(plant_block(case, more=["bus8.v"]))
    u = plant.u.copy()
    u[plant.input_names.index("svc1_v_mod")] = 1.0
    _, _, y = plant.run(1.0, 0.002, u)
    q, v = (y[-1, plant.output_names.index(name)] for name in ("svc1.q", "bus8.v"))
    assert v > 1.02
    assert q / v**power == pytest.approx(2.0, rel=1e-9)  # 200 MVA at 1 pu on 100 MVA


@pytest.mark.slow
def test_it_stands_still_for_20_s():
    plant = BlockShim(plant_block(with_svc("svc", V_pu=1.0)))
    _, x, _ = plant.run(20.0, 0.002)
    k = [plant.state_names.index(name) for name in ("svc1.y", "svc1.b")]
    assert np.max(np.abs(x[:, k] - x[0, k])) < 1e-12


@pytest.mark.parametrize("network", ["dense", "sparse"])
def test_a_trip_leaves_the_grid_without_it(network):
    case = with_svc("svc", Q_mvar=60.0)
    events = events_of([{"kind": "device_trip", "device": "svc1", "start_s": 0.1}], where="test")
    plant = BlockShim(plant_block(case, network=network, more=["bus8.v"]), event_parameters(case, events))
    _, x, y = plant.run(0.3, 0.002)
    q = y[:, plant.output_names.index("svc1.q")]
    assert q[0] == pytest.approx(0.6, abs=1e-12)
    assert q[-1] == 0.0
    states = [k for k, name in enumerate(plant.state_names) if name.startswith("svc1.")]
    assert np.array_equal(x[-1, states], x[60, states])
    without = x[-1].copy()
    without[plant.state_names.index("svc1.b")] = 0.0
    _, expected = BlockShim(plant_block(case, network=network, more=["bus8.v"])).derivatives(without)
    assert y[-1] == pytest.approx(expected, abs=1e-11)  # of 4 pu over the tie


def test_the_power_flow_holds_its_voltage_or_takes_its_power():
    held = solve_powerflow(with_svc("svc", V_pu=1.0))
    assert abs(held.voltage(8)) == pytest.approx(1.0, abs=1e-12)
    again = solve_powerflow(with_svc("svc", Q_mvar=100.0 * float(held.at_buses[0].imag)))
    assert np.max(np.abs(again.voltages - held.voltages)) < 1e-9
    assert np.max(np.abs(again.generation - held.generation)) < 1e-8


def test_an_ordinary_case_keeps_its_hash_and_its_form():
    case = load_case("two-area-thesis")
    assert "svcs" not in case.document()
    assert case.with_changes({"svcs": {}}).hash == case.hash
    assert with_svc("svc").hash != case.hash


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ({"bus": 99}, "svcs.svc1.bus = 99: no such bus"),
        ({"regulates": 99}, "svcs.svc1.regulates = 99: no such bus"),
        ({"V_pu": 1.0, "bus": 1}, "a machine holds the voltage of bus 1, allowed: Q_mvar in its place"),
        ({"V_pu": 1.0, "regulates": 7}, "allowed: Q_mvar where it regulates another bus"),
        ({"V_pu": 1.0, "Q_mvar": 5.0}, "allowed: one of them"),
        ({"control": {"kind": "svcc"}}, "svc 'svcc' does not exist; did you mean svc"),
        ({"control": {"kind": "sexs"}}, "svc 'sexs' does not exist"),
        ({"control": {"kind": "svc", "TR": 0.0}}, "TR = 0.0, allowed: above 0"),
    ],
)
def test_a_row_that_is_wrong_is_refused_with_the_remedy(row, says):
    with pytest.raises(CaseError) as caught:
        with_svc("svc", **row)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_rest_beyond_its_limit_names_limit_and_remedy():
    with pytest.raises(
        CaseError, match=r"svcs.svc1.control: b .* is 0.49709 at the equilibrium, above BMAX = 0.3; set BMAX"
    ):
        operating_point(with_svc("svc", Q_mvar=100.0, control={"kind": "svc", "BMAX": 0.3}))


def test_a_linear_study_on_a_limit_is_refused_with_the_margin():
    q = float(operating_point(with_svc("svc", Q_mvar=60.0)).controls.at_buses[0].rest.output)
    at_limit = with_svc("svc", Q_mvar=60.0, control={"kind": "svc", "BMAX": q})
    with pytest.raises(
        CaseError, match=r"svc1: b \(susceptance\) is at 0.309\d*, 0 from its limit BMAX; .*widen"
    ):
        linear_matrices(at_limit, default_cache())
    assert (
        "svc1: b is 0.309359 at the equilibrium, at BMAX (0 from it); a linear study is rejected"
        in start_of(at_limit).text()
    )
    require_off_limits(release_limits(at_limit)[0])
    require_off_limits(with_svc("svc", Q_mvar=60.0, control={"kind": "svc", "BMAX": q + 1e-3}))
    require_off_limits(load_case("two-area-thesis"))


def test_an_output_that_is_no_state_is_refused():
    text = """
name = "quick"
kind = "svc"
diagram = '''
x = lag(vref + vs - vt, T)
b = K*x*x
'''
[parameters]
T = { unit = "s", above = 0 , default = 0.1, text = "time" }
K = { unit = "pu", default = 1.0, text = "gain" }
"""
    case = load_case("two-area-thesis")
    row = {"bus": 8, "base_mva": 200.0, "Q_mvar": 20.0, "control": {"kind": "quick"}}
    with pytest.raises(CaseError, match="allowed: a lag or an integrator, or a number times one"):
        operating_point(case.with_changes({"devices": {"quick.toml": text}, "svcs": {"svc1": row}}))


def test_a_trip_of_a_device_that_does_not_exist_is_refused():
    events = events_of([{"kind": "device_trip", "device": "svc2", "start_s": 0.1}], where="test")
    with pytest.raises(CaseError, match=r"device_trip: device 'svc2' does not exist; did you mean svc1"):
        event_parameters(with_svc("svc"), events)


@pytest.mark.parametrize("base", ["two-area-thesis", "kundur-manual"])
@pytest.mark.parametrize("where", [{"V_pu": 1.0}, {"regulates": 7}])
def test_the_sparse_blocks_have_its_state_matrix(base, where):
    """`interarea loops` reads the plant as blocks: with its matrix and inputs."""
    case = in_plant_order(with_svc("svc", base, **where))
    blocks, _, _ = agreeing_blocks(case)
    assert blocks.inputs[-1] == "svc1_v_mod"
