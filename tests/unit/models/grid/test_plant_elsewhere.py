"""Plant controls that see another bus or a branch: what they see off rest and restore, their record."""

from __future__ import annotations

import numpy as np
import pytest
from grid_text import pair_with
from plant_shim import BlockShim
from sparse_blocks import agreeing_blocks

import interarea as ia
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import load_case
from interarea.models.case.events import events_of
from interarea.models.errors import CaseError
from interarea.models.grid.machine_tables import in_plant_order
from interarea.models.grid.network import branch_stamp
from interarea.models.importers.psse import import_psse

SHARE = 2.0  #: its base over that of the case
CONTROL = {"PLANT": 1, "plant_Kp": 1.0, "plant_Ki": 4.0, "plant_Tfltr": 0.02, "plant_Tfv": 0.05}
ACTIVE = {"plant_FFLAG": 1, "plant_Kpg": 0.5, "plant_Kig": 2.0, "plant_Tp": 0.25, "plant_Tg": 0.1}
WIDE = {"QMAX": 9.0, "QMIN": -9.0, "plant_Qmax": 9.0, "plant_Qmin": -9.0, "PMAX": 9.0, "Imax": 3.0}
WIDE |= {"plant_emax": 9.0, "plant_emin": -9.0, "plant_Pmax": 9.0, "plant_Pmin": -9.0, "PMIN": -9.0}
CONTROL |= WIDE
#: name -> where it measures, parameters
SEES = {
    "bus": ({"regulates": 9}, {"plant_REFFLAG": 1}),
    "droop": ({"regulates": 9, "measures": "7-8 a"}, {"plant_REFFLAG": 1, "plant_Kc": 0.1}),
    "drop": (
        {"regulates": 9, "measures": "8-9 b"},
        {"plant_REFFLAG": 1, "plant_VCFLAG": 1, "plant_Rc": 0.01, "plant_Xc": 0.05},
    ),
    "flow": ({"measures": "7-8 a", "measures_from": 8}, ACTIVE),
    "transformer": ({"measures": "4-10"}, ACTIVE),
}


def with_plant(name="bus", base="two-area-thesis", **more):
    where, parameters = SEES[name]
    row = {"bus": 8, "base_mva": 100.0 * SHARE, "P_mw": 100.0, "Q_mvar": 20.0} | where
    row["control"] = {"kind": "wecc_converter"} | CONTROL | parameters | more
    return load_case(base).with_changes({"converters": {"pv1": row}})


def seen(case, volts):
    """Return voltage regulated, that less the drop, power into the branch on its base; volts: by bus."""
    row, p = case.converters[0], {"plant_VCFLAG": 0} | case.converters[0].control.parameters
    V = volts[row.regulates or row.bus]
    if row.measures is None:
        return abs(V), abs(V), None
    branch = next(b for b in case.branches if b.name == row.measures)
    ends, stamp = [volts[branch.from_bus], volts[branch.to_bus]], branch_stamp(branch)
    at = 1 if row.measures_from == branch.to_bus else 0
    current = (stamp @ ends)[at]
    drop = complex(p.get("plant_Rc", 0.0), p.get("plant_Xc", 0.0)) if p["plant_VCFLAG"] else 0.0
    return abs(V), abs(V - drop * current / SHARE), ends[at] * np.conj(current) / SHARE


def voltages(case, y, at):
    return {b.number: complex(*(y[at[f"bus{b.number}.{part}"]] for part in ("re", "im"))) for b in case.buses}


@pytest.mark.parametrize(
    ("name", "network", "base"),
    [
        *((n, "dense", "two-area-thesis") for n in SEES),
        ("drop", "sparse", "kundur-manual"),
        ("flow", "sparse", "kundur-manual"),
    ],
)
def test_it_rests_and_the_derivatives_are_those_of_differences(name, network, base):
    plant = BlockShim(plant_block(with_plant(name, base), network=network))
    rates, y = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 5e-11
    assert y[plant.output_names.index("pv1.p")] == pytest.approx(1.0, abs=1e-11)
    off, outputs_off = plant.directional_errors(1e-4, 1e-5)
    assert off < 1e-7 and outputs_off < 1e-6


@pytest.mark.parametrize("network", ["dense", "sparse"])
@pytest.mark.parametrize("name", SEES)
def test_off_rest_it_measures_what_the_voltages_of_the_buses_give(name, network):
    """T x' + x of each measurement is the voltage, or S = V conj(Y11 V + Y12 V') of the branch, by hand."""
    case = with_plant(name)
    plant = BlockShim(plant_block(case, network=network, more=["*"]))
    at = {n: k for k, n in enumerate(plant.output_names)}
    state = {n.removeprefix("pv1."): k for k, n in enumerate(plant.state_names) if n.startswith("pv1.")}
    rng = np.random.default_rng(3)
    for _ in range(3):
        x = plant.x + 0.02 * rng.standard_normal(len(plant.x))
        rates, y = plant.derivatives(x)
        volt, less, power = seen(case, voltages(case, y, at))
        p = case.converters[0].control.parameters
        if p.get("plant_REFFLAG"):
            expected = (
                less
                if p.get("plant_VCFLAG")
                else volt + (p.get("plant_Kc", 0.0) * power.imag if power else 0)
            )
            assert x[state["rv"]] + 0.02 * rates[state["rv"]] == pytest.approx(expected, abs=1e-10)
        else:
            assert x[state["rq"]] + 0.02 * rates[state["rq"]] == pytest.approx(power.imag, abs=1e-10)
            assert x[state["rp"]] + 0.25 * rates[state["rp"]] == pytest.approx(power.real, abs=1e-10)


def run(case, seconds, events=(), p_mod=0.0):
    block = plant_block(case, more=["*"])
    plant = BlockShim(block, event_parameters(case, events_of(list(events), where="test")))
    u = plant.u.copy()
    u[plant.input_names.index("pv1_p_mod")] = p_mod
    time_s, x, y = plant.run(seconds, 0.002, u)
    at = {n: k for k, n in enumerate(plant.output_names)}
    own = {n.removeprefix("pv1."): x[:, k] for k, n in enumerate(plant.state_names) if n.startswith("pv1.")}
    return time_s, own, [voltages(case, row, at) for row in y[::500]]


@pytest.mark.slow
def test_it_restores_the_voltage_of_the_bus_that_it_regulates_and_not_of_its_own():
    """Its integral moves until its error is 0: V9 comes back after a load step, V8 goes elsewhere."""
    step = {"kind": "load_step", "bus": 9, "start_s": 0.1, "p_pu": 0.0, "q_pu": 0.5}
    _, _, V = run(with_plant("bus", plant_Ki=20.0), 30.0, [step])
    _, _, other = run(with_plant("bus", plant_Kp=0.0, plant_Ki=0.0), 30.0, [step])
    moved = {
        bus: [np.mean([abs(at[bus]) for at in course[-10:]]) - abs(course[0][bus]) for course in (V, other)]
        for bus in (8, 9)
    }
    assert abs(moved[9][0]) < 0.1 * abs(moved[9][1])
    assert abs(moved[8][0]) > 5.0 * abs(moved[9][0])


@pytest.mark.slow
def test_it_holds_the_flow_of_its_branch():
    """P from 8 into 7-8 a is its set-point and p_mod, Q its set-point, where its own power is neither."""
    case = with_plant("flow")
    _, _, V = run(case, 40.0, p_mod=-0.05)
    first, last = (seen(case, at)[2] for at in (V[0], V[-1]))
    assert last == pytest.approx(first - 0.05, abs=2e-3)


def test_once_the_branch_is_out_its_flow_is_zero():
    case = with_plant("flow", plant_Kpg=0.0, plant_Kig=0.0, plant_Ki=0.0, plant_Kp=0.0)
    time_s, own, _ = run(case, 3.0, [{"kind": "branch_trip", "branch": "7-8 a", "start_s": 0.5}])
    falls = time_s > 0.5
    for name, T in (("rp", 0.25), ("rq", 0.02)):
        expected = own[name][falls][0] * np.exp(-(time_s[falls] - time_s[falls][0]) / T)
        assert own[name][falls] == pytest.approx(expected, abs=1e-6)
    assert abs(own["rp"][0]) > 0.2


@pytest.mark.slow
def test_at_rest_it_stands_for_20_s():
    plant = BlockShim(plant_block(with_plant("drop")))
    own = [k for k, name in enumerate(plant.state_names) if name.startswith("pv1.")]
    _, x, _ = plant.run(20.0, 0.002)
    assert np.max(np.abs(x[:, own] - x[0, own])) < 1e-11


@pytest.mark.parametrize("base", ["two-area-thesis", "kundur-manual"])
@pytest.mark.parametrize("name", SEES)
def test_the_sparse_blocks_have_its_state_matrix(name, base):
    blocks, _, _ = agreeing_blocks(in_plant_order(with_plant(name, base)))
    assert "pv1_p_mod" in blocks.inputs


def test_a_run_of_it_has_a_verdict():
    case = with_plant("drop")
    run = ia.simulate({"name": "elsewhere", "case": case.name, "stop_s": 3.0, "step_s": 0.01}, case=case)
    assert run.stable and abs(run["plant.G1_dw"]).max() < 1e-9


@pytest.mark.parametrize(
    ("where", "more", "says"),
    [
        ({"regulates": 99}, {}, "converters.pv1.regulates = 99: no such bus"),
        ({"measures": "8-9 z"}, {}, "converters.pv1.measures: branch '8-9 z' does not exist"),
        ({"measures": "8-9 a", "measures_from": 7}, {}, "does not end there, allowed: 8 or 9"),
        ({"measures_from": 8}, {}, "measures_from without measures"),
        ({"regulates": 9}, {"PLANT": 0}, "without a plant control, allowed: with PLANT = 1"),
        (
            {"regulates": 9},
            {"plant_VCFLAG": 1},
            "there is no branch; give measures, or set plant_VCFLAG to 0",
        ),
    ],
)
def test_what_it_cannot_measure_is_named(where, more, says):
    row = {"bus": 8, "base_mva": 200.0, "P_mw": 100.0, "Q_mvar": 20.0} | where
    row["control"] = {"kind": "wecc_converter"} | CONTROL | more
    with pytest.raises(CaseError) as reported:
        load_case("two-area-thesis").with_changes({"converters": {"pv1": row}})
    assert says in str(reported.value)


RECORD = """4 'REGCA1' 1 0 0.02 10 0.9 0.4 1.22 1.2 0.8 0.4 -1.3 0.02 0.7 99 -99 0.7 /
4 'REECB1' 1 0 0 0 0 0 -99 99 0.02 0 0 0 1.1 -1.1 0 0.05 2 -2 1.1 0.9 0 0.1 0 40 0.02 9 -9 2 0 2.3 0.02 /
4 'REPCA1' 1 WHERE 0 1 0 0.02 1 5 0 0.05 0.7 0 0 0.02 0.1 -0.1 0 0 2 -2 1 0.5 0.25 0 0 99 -99 1 0 0.1 0 0 /
"""


def imported(folder, where):
    return import_psse(*pair_with(folder, RECORD.replace("WHERE", where))).case


@pytest.mark.parametrize(
    ("where", "expected"),
    [
        ("4 0 0 0", (None, None, None)),
        ("10 0 0 0", (10, None, None)),
        ("10 10 4 3", (10, "4-10", 10)),
        ("0 9 8 '9'", (None, "8-9 9", 9)),
    ],
)
def test_a_record_names_bus_and_branch(tmp_path, where, expected):
    case = imported(tmp_path, where)
    row = case.converters[0]
    assert (row.regulates, row.measures, row.measures_from) == expected
    plant = BlockShim(plant_block(case))
    assert np.max(np.abs(plant.derivatives(plant.x)[0])) < 1e-8


@pytest.mark.parametrize(
    ("where", "says"),
    [
        ("99 0 0 0", "REPCA1 regulates bus 99, which is not in service; give 0"),
        ("0 4 9 1", "REPCA1 measures branch 4-9 '1', allowed: a line or transformer"),
        ("0 8 9 7", "REPCA1 measures branch 8-9 '7', allowed"),
    ],
)
def test_a_record_that_names_none_is_refused_with_its_line(tmp_path, where, says):
    with pytest.raises(CaseError) as reported:
        imported(tmp_path, where)
    assert says in str(reported.value) and ".dyr:" in str(reported.value)
