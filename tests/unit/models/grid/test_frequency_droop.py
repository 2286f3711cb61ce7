"""The plant control's frequency droop: steady state in closed form, exact derivatives, modes, its record."""

from __future__ import annotations

import numpy as np
import pytest
from grid_text import pair_with
from plant_shim import BlockShim
from sparse_blocks import agreeing_blocks

from interarea.design.linear.linearise import linearise
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import case_of, load_case
from interarea.models.case.events import events_of
from interarea.models.errors import CaseError
from interarea.models.grid.machine_tables import in_plant_order
from interarea.models.importers.psse import import_psse

ACTIVE = {"PLANT": 1, "plant_FFLAG": 1, "plant_Kpg": 1.0, "plant_Kig": 2.0, "plant_Tp": 0.05, "plant_Tg": 0.1}
DROOP = ACTIVE | {"plant_Ddn": 20.0, "plant_Dup": 20.0}
BAND = {"plant_fdbd1": -0.0006, "plant_fdbd2": 0.0006}


def with_droop(base="two-area-thesis", **more):
    row = {"bus": 8, "base_mva": 200.0, "P_mw": 100.0, "Q_mvar": 20.0}
    row["control"] = {"kind": "wecc_converter"} | DROOP | more
    return load_case(base).with_changes({"converters": {"pv1": row}})


#: a machine of 200 MVA with TGOV1 and a plant of 100 MVA, lines without resistance, a load of constant power
R, MACHINE, PLANT = 0.05, 200.0, 100.0


def alone(**parameters):
    governor = {"kind": "tgov1", "R": R, "T1": 0.2, "Vmax": 1.2, "Vmin": 0.0, "T2": 0.0, "T3": 0.3, "Dt": 0.0}
    machine = {"bus": 1, "area": 1, "model": "classical", "H": 5.0, "D": 0.0, "Xd1": 0.2, "base_mva": MACHINE}
    machine |= {"P_mw": 100.0, "V_pu": 1.0, "slack": True, "governor": governor}
    plant = {"bus": 2, "base_mva": PLANT, "P_mw": 50.0, "Q_mvar": 0.0}
    plant["control"] = {"kind": "wecc_converter"} | ACTIVE | parameters
    load = {"bus": 3, "P_mw": 150.0, "Q_mvar": 0.0, "P_exponent": 0.0, "Q_exponent": 2.0}
    document = {
        "name": "droop",
        "title": "a machine and a plant",
        "source": "ours",
        "frequency_hz": 50.0,
        "base_mva": 100.0,
        "buses": {str(k): {"area": 1} for k in (1, 2, 3)},
        "branches": {f"{k}-3": {"from": k, "to": 3, "x": 0.05} for k in (1, 2)},
        "machines": {"G1": machine},
        "converters": {"pv1": plant},
        "loads": {"L3": load},
    }
    return case_of(document, where="droop")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("step", "more"),
    [
        (0.1, {}),
        (0.1, BAND),
        (-0.1, {"plant_Dup": 0.0}),
        (0.1, {"plant_Dup": 0.0}),
        (-0.1, BAND | {"plant_Ddn": 10.0, "plant_Dup": 0.0}),
    ],
)
def test_a_step_of_load_is_shared_by_the_droops(step, more):
    """The load is served by the machine, -df/R, and by the plant, D times what is beyond its band."""
    parameters = {"plant_Ddn": 20.0, "plant_Dup": 20.0} | more
    event = {"kind": "load_step", "bus": 3, "start_s": 0.5, "p_pu": step, "q_pu": 0.0}
    case = alone(**parameters)
    plant = BlockShim(plant_block(case), event_parameters(case, events_of([event], where="test")))
    time_s, x, y = plant.run(40.0, 0.01)
    assert np.max(np.abs(x[time_s < 0.5] - x[0])) < 1e-12
    names = {name: k for k, name in enumerate(plant.state_names)}
    df = x[-1, names["G1.slip"]]
    gain = parameters["plant_Dup" if step > 0.0 else "plant_Ddn"]
    band = parameters.get("plant_fdbd2", 0.0)
    of_plant = gain * PLANT / 100.0
    expected = -np.sign(step) * (abs(step) + of_plant * band) / (MACHINE / 100.0 / R + of_plant)
    assert df == pytest.approx(expected, rel=1e-5)
    rise = y[-1, plant.output_names.index("pv1.p")] - y[0, plant.output_names.index("pv1.p")]
    assert rise == pytest.approx(-of_plant * np.sign(df) * (abs(df) - band), abs=1e-6)


@pytest.mark.parametrize(("more", "acts"), [({}, True), (BAND, False), ({"plant_FFLAG": 0}, False)])
def test_the_linear_model_has_the_droop_where_it_acts_at_rest(more, acts):
    """p_mod moves the common speed by 1/(droops in parallel); within a band the plant's is open."""
    case = alone(plant_Ddn=20.0, plant_Dup=20.0, **more)
    plant = BlockShim(plant_block(case))
    model = linearise(plant)
    B = model.B[:, plant.input_names.index("pv1_p_mod")]
    slow = np.linalg.solve(1e-6 * np.eye(len(B)) - model.A, B)  # the common angle has no rest
    own = 20.0 * PLANT / 100.0 if acts else 0.0
    expected = (PLANT / 100.0) / (MACHINE / 100.0 / R + own)
    assert slow[plant.state_names.index("G1.slip")] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("network", "base"), [("dense", "two-area-thesis"), ("sparse", "kundur-manual")])
def test_it_rests_and_the_derivatives_are_those_of_differences(network, base):
    plant = BlockShim(plant_block(with_droop(base), network=network))
    own = [n.removeprefix("pv1.") for n in plant.state_names if n.startswith("pv1.")]
    assert {"rfr", "rfi"} < set(own)
    rates, y = plant.derivatives(plant.x)
    assert np.max(np.abs(rates)) < 5e-11
    assert y[plant.output_names.index("pv1.p")] == pytest.approx(1.0, abs=1e-11)
    off, outputs_off = plant.directional_errors(1e-4, 1e-5)
    assert off < 1e-7 and outputs_off < 1e-6


def test_a_plant_without_droop_has_neither_its_states_nor_other_bits():
    """Off rest the rates are those of a plant whose band is beyond all that moves, to the last bit."""
    one, other = (
        BlockShim(plant_block(with_droop(**more)))
        for more in (
            {"plant_Ddn": 0.0, "plant_Dup": 0.0},
            {"plant_fdbd1": -9.0, "plant_fdbd2": 9.0},
        )
    )
    assert [n for n in other.state_names if n not in one.state_names] == ["pv1.rfr", "pv1.rfi"]
    columns = [other.state_names.index(n) for n in one.state_names]
    moved = one.x + 1e-3 * np.sin(np.arange(one.x.size))
    x = other.x.copy()
    x[columns] = moved
    np.testing.assert_array_equal(other.derivatives(x)[0][columns], one.derivatives(moved)[0])


def test_the_sparse_blocks_have_its_state_matrix():
    blocks, _, _ = agreeing_blocks(in_plant_order(with_droop()))
    assert blocks.inputs[-2:] == ("pv1_p_mod", "pv1_q_mod")


RECORD = """4 'REGCA1' 1 0 0.02 10 0.9 0.4 1.22 1.2 0.8 0.4 -1.3 0.02 0.7 99 -99 0.7 /
4 'REECB1' 1 0 0 0 0 0 -99 99 0.02 0 0 0 1.1 -1.1 0 0.05 0.8 -0.8 1.1 0.9 0 0.1 0 40
  0.02 9 -9 1 0 1.3 0.02 /
4 'REPCA1' 1 0 0 0 0 0 0 1 0.02 1 5 0 0.05 0.7 0 0 0.02 0.1 -0.1 0 0 0.8 -0.8 1 0.5 0.25 FDBD
  9 -9 1 0 0.1 20 5 /
"""


def imported(folder, band):
    return import_psse(*pair_with(folder, RECORD.replace("FDBD", band))).case


def test_a_record_with_a_droop_is_imported(tmp_path):
    case = imported(tmp_path, "-0.0006 0.0006")
    values = case.converters[0].control.parameters
    result = [values[f"plant_{key}"] for key in ("Ddn", "Dup", "fdbd1", "fdbd2", "Tfrq")]
    assert result == [20.0, 5.0, -0.0006, 0.0006, 0.05]
    plant = BlockShim(plant_block(case))
    assert np.max(np.abs(plant.derivatives(plant.x)[0])) < 1e-8
    assert any(name.endswith(".rfr") for name in plant.state_names)


def test_a_band_that_does_not_hold_the_nominal_frequency_is_refused(tmp_path):
    with pytest.raises(CaseError, match="give plant_fdbd1 at most 0, plant_fdbd2 at least 0"):
        imported(tmp_path, "0.0006 -0.0006")
