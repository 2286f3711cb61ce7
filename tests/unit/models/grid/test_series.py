"""Series capacitors: the line is what its reactance says, they rest, derivatives are exact, they trip."""

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
from interarea.models.grid.series import with_series_nodes, without_series_nodes

ROW = {"branch": "7-8 a", "x0_pu": 0.044, "x_min_pu": 0.022, "x_max_pu": 0.077}


def with_tcsc(base="two-area-thesis", **row):
    return load_case(base).with_changes({"tcscs": {"tcsc1": ROW | row}})


def of_impedances(base="two-area-thesis"):
    """The case with its loads as shunts: its network does not depend on where it rests."""
    case = load_case(base)
    shunts = {
        f"of {q.name}": {"bus": q.bus, "P_mw": q.P_mw, "Q_mvar": -q.Q_mvar}
        for q in case.loads
        if q.in_service
    }
    loads = {q.name: "none" for q in case.loads}
    return case.with_changes({"shunts": shunts, "loads": loads, "tcscs": {"tcsc1": ROW}})


def by_hand(case, x):
    """The case without a device, the line's reactance less x."""
    line = case.branch("7-8 a")
    return case.with_changes({"tcscs": {"tcsc1": "none"}, "branches": {"7-8 a": {"x": line.x - x}}})


def test_the_power_flow_is_that_of_the_line_less_its_reactance():
    case = with_tcsc()
    own, other = solve_powerflow(case), solve_powerflow(by_hand(case, 0.044))
    assert np.max(np.abs(own.voltages - other.voltages)) < 1e-13
    assert own.tie_p == pytest.approx(other.tie_p, abs=1e-12)


def test_what_nodes_add_is_taken_out_again():
    case = with_tcsc()
    again = without_series_nodes(with_series_nodes(case))
    assert again.buses == case.buses
    assert again.shunts == case.shunts
    assert again.svcs == case.svcs
    assert again.tie == case.tie
    for own, other in zip(again.branches, case.branches, strict=True):
        assert (own.name, own.from_bus, own.to_bus) == (other.name, other.from_bus, other.to_bus)
        assert np.allclose([own.r, own.x, own.b], [other.r, other.x, other.b], rtol=1e-13)
    assert with_series_nodes(with_series_nodes(case)) == with_series_nodes(case)


@pytest.mark.parametrize("network", ["dense", "sparse"])
@pytest.mark.parametrize("base", ["two-area-thesis", "kundur-manual"])
def test_it_rests_and_the_derivatives_are_those_of_differences(network, base):
    plant = BlockShim(plant_block(with_tcsc(base), network=network))
    rates, _ = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 5e-11  # of the machines: 1.5e-11 without any device
    assert abs(rates[plant.state_names.index("tcsc1.x")]) < 1e-12
    h = 1e-4 if base == "kundur-manual" else 1e-5  # its ports are solved to 1e-12
    rates_off, outputs_off = plant.directional_errors(1e-3, h)
    assert rates_off < 1e-9
    assert outputs_off < 1e-7


@pytest.mark.parametrize("network", ["dense", "sparse"])
@pytest.mark.parametrize("x", [0.022, 0.06, 0.077])
def test_at_any_reactance_the_plant_is_that_of_such_a_line(network, x):
    """Powers and voltages at given states are those of a plant whose line has that reactance."""
    case, shown = of_impedances(), ["branch[7-8 a].*", "bus7.v", "bus8.v"]
    plant = BlockShim(plant_block(case, network=network, more=shown))
    other = BlockShim(plant_block(by_hand(case, x), more=shown))
    at = plant.x.copy()
    at[plant.state_names.index("tcsc1.x")] = x
    columns = [k for k, name in enumerate(plant.state_names) if name != "tcsc1.x"]
    assert [plant.state_names[k] for k in columns] == list(other.state_names)
    check_same(plant, plant.derivatives(at)[1], other, other.derivatives(at[columns])[1])


def check_same(plant, y, other, expected):
    """Both show the same, to what the ports are solved to."""
    for name in other.output_names:
        own, reference = y[plant.output_names.index(name)], expected[other.output_names.index(name)]
        assert own == pytest.approx(reference, abs=1e-11), name


@pytest.mark.parametrize("network", ["dense", "sparse"])
def test_power_is_balanced(network):
    """What machines give is what loads, shunts and lines take; the capacitor itself takes no active power."""
    case = with_tcsc()
    both = ["branch[7-8 a].p", "tcsc1.i", "bus7.re", "bus7.im", "bus8.re", "bus8.im"]
    plant = BlockShim(plant_block(case, network=network, more=both))
    at = plant.x.copy()
    x = at[plant.state_names.index("tcsc1.x")] = 0.07
    _, y = plant.derivatives(at)
    seen = dict(zip(plant.output_names, y, strict=True))
    v7, v8 = (complex(seen[f"bus{k}.re"], seen[f"bus{k}.im"]) for k in (7, 8))
    line = case.branch("7-8 a")
    current = (v7 - v8) / complex(line.r, line.x - x)
    assert seen["tcsc1.i"] == pytest.approx(abs(current), abs=1e-12)
    into = (v7 * np.conj(current + 0.5j * line.b * v7)).real
    assert seen["branch[7-8 a].p"] == pytest.approx(into, abs=1e-12)


@pytest.mark.slow
def test_it_stands_still_for_20_s():
    plant = BlockShim(plant_block(with_tcsc()))
    _, x, _ = plant.run(20.0, 0.002)
    k = plant.state_names.index("tcsc1.x")
    assert np.max(np.abs(x[:, k] - x[0, k])) < 1e-12


def test_its_input_moves_it_within_its_limits():
    plant = BlockShim(plant_block(with_tcsc()))
    u = plant.u.copy()
    for value, expected in ((0.01, 0.054), (1.0, 0.077), (-1.0, 0.022)):
        u[plant.input_names.index("tcsc1_x_mod")] = value
        _, x, _ = plant.run(0.3, 0.002, u)
        assert x[-1, plant.state_names.index("tcsc1.x")] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("network", ["dense", "sparse"])
def test_a_bypass_leaves_the_line(network):
    case, shown = of_impedances(), ["bus7.v", "bus8.v", "tie_p"]
    events = events_of([{"kind": "device_trip", "device": "tcsc1", "start_s": 0.1}], where="test")
    plant = BlockShim(plant_block(case, network=network, more=shown), event_parameters(case, events))
    _, x, y = plant.run(0.3, 0.002)
    columns = [k for k, name in enumerate(plant.state_names) if name != "tcsc1.x"]
    other = BlockShim(plant_block(by_hand(case, 0.0), more=shown))
    check_same(plant, y[-1], other, other.derivatives(x[-1, columns])[1])


@pytest.mark.parametrize("network", ["dense", "sparse"])
def test_a_trip_of_its_line_is_that_of_any_line(network):
    case, shown = of_impedances(), ["bus7.v", "bus8.v", "tie_p"]
    trip = [{"kind": "branch_trip", "branch": "7-8 a", "start_s": 0.1, "end_s": 0.2}]
    runs = []
    for each, form in ((case, network), (by_hand(case, 0.044), "dense")):
        events = event_parameters(each, events_of(trip, where="test"))
        plant = BlockShim(plant_block(each, network=form, more=shown), events)
        runs.append((plant, plant.run(0.3, 0.002)[2]))
    (plant, y), (other, expected) = runs
    for name in other.output_names:
        own, reference = y[:, plant.output_names.index(name)], expected[:, other.output_names.index(name)]
        assert np.max(np.abs(own - reference)) < 1e-9, name
    assert np.ptp(expected[:, other.output_names.index("bus8.v")]) > 0.01


@pytest.mark.parametrize("base", ["two-area-thesis", "kundur-manual"])
def test_the_sparse_blocks_have_its_state_matrix(base):
    """`interarea loops` reads the plant as blocks: with its matrix and inputs."""
    case = in_plant_order(with_tcsc(base))
    blocks, _, _ = agreeing_blocks(case)
    assert blocks.inputs[-1] == "tcsc1_x_mod"


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ({"branch": "7-9"}, "tcscs.tcsc1.branch: branch '7-9' does not exist; did you mean"),
        ({"x_max_pu": 0.1}, "x_max_pu = 0.1 leaves less than 0.2 of the line's 0.11, allowed: at most 0.088"),
        ({"x0_pu": 0.08}, "x0_pu = 0.08 is 0.003 beyond x_max_pu = 0.077, allowed: within the limits"),
        ({"x0_pu": 0.01}, "x0_pu = 0.01 is 0.012 beyond x_min_pu = 0.022"),
        ({"x_min_pu": 0.08}, "allowed: x_min_pu <= x_max_pu"),
        ({"branch": "1-5"}, "allowed: a line, without tap and shift"),
    ],
)
def test_a_row_that_is_wrong_is_refused_with_the_remedy(row, says):
    changes = {"branches": {"1-5": {"tap": 1.02}}} if row.get("branch") == "1-5" else {}
    with pytest.raises(CaseError) as caught:
        load_case("two-area-thesis").with_changes({"tcscs": {"tcsc1": ROW | row}, **changes})
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_its_line_out_of_service_is_refused_with_the_remedy():
    with pytest.raises(
        CaseError, match=r"'7-8 a' is out of service.*take tcsc1 out too \(tcscs.tcsc1 = \"none\"\)"
    ):
        with_tcsc().with_changes({"branches": {"7-8 a": {"in_service": False}}})


def test_a_linear_study_on_a_limit_is_refused_with_the_margin():
    with pytest.raises(
        CaseError, match=r"tcscs.tcsc1: x \(.*\) is at 0.077, \S+ from its limit x_max_pu; .*widen"
    ):
        linear_matrices(with_tcsc(x0_pu=0.077), default_cache())


def test_the_device_does_not_stand_at_a_bus():
    row = {"bus": 8, "base_mva": 200.0, "control": {"kind": "tcsc"}}
    with pytest.raises(
        CaseError, match="a series capacitor stands in a branch, allowed: a row of the table tcscs"
    ):
        load_case("two-area-thesis").with_changes({"svcs": {"svc1": row}})


def test_a_line_without_current_is_refused():
    case = with_tcsc()
    same = {"loads": {name: {"P_mw": 0.0, "Q_mvar": 0.0} for name in [q.name for q in case.loads]}}
    same["machines"] = {m.name: {"P_mw": 0.0, "V_pu": 1.0} for m in case.machines}
    same["shunts"] = {s.name: {"Q_mvar": 0.0} for s in case.shunts}
    same["branches"] = {b.name: {"b": 0.0} for b in case.branches}
    with pytest.raises(CaseError, match=r"line '7-8 a' carries .* pu at the equilibrium, allowed: at least"):
        operating_point(case.with_changes(same))


def test_a_written_file_has_the_line_as_it_is_at_rest():
    case = with_tcsc()
    written = matpower_of(case)
    assert any("series capacitors move (tcsc1)" in line for line in written.losses)
    (row,) = [r for r in written.text.splitlines() if r.split()[:2] == ["7", "8"] and "0.066" in r]
    assert float(row.split()[3]) == pytest.approx(0.066, abs=1e-15)
