"""Plants side by side: the bits of each alone, the numbers of other tools' FMU runs, failures told apart."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from plant_lanes import PlantLanes
from plant_shim import BlockShim

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.blocks.plant_variables import EVENT_CODES
from interarea.models.case.case import Case, load_case
from interarea.models.case.events import events_of
from interarea.models.grid.network_tables import Form

CASE = "two-area-thesis"


@pytest.fixture(scope="module")
def plants(cache: Path) -> PlantLanes:
    return PlantLanes(load_case(CASE), cache, more=["bus*.*", "branch[*"])


def scenarios(count: int) -> list[dict]:
    """Faults at other buses, times and gains; every third with a machine that trips."""
    case, rows = load_case(CASE), []
    for k in range(count):
        end = 0.2 + 0.0137 * (k % 3)
        events = [
            {"kind": "bus_fault", "bus": 5 + k % 7, "start_s": 0.1, "end_s": end, "x_pu": 0.01},
            {"kind": "branch_trip", "branch": "8-9 a", "start_s": end},
        ]
        if k % 3 == 0:
            events.append({"kind": "machine_trip", "machine": "G2", "start_s": 0.31})
        row = event_parameters(case, events_of(events, where="test"))
        rows.append(row | {"G1.exciter.KA": 150.0 + k, "G3.exciter.Efd_max": 4.0 + 0.1 * k})
    return rows


@pytest.mark.slow
def test_every_number_of_lanes_gives_the_same_bits(plants: PlantLanes) -> None:
    rows = scenarios(11)
    alone = plants.run(rows, stop_s=0.5, lanes=1)
    assert np.all(np.isfinite(alone.outputs)) and not any(alone.errors)
    for lanes in (2, 4, 8):
        if lanes <= plants.group.lanes:
            beside = plants.run(rows, stop_s=0.5, lanes=lanes)
            np.testing.assert_array_equal(beside.outputs, alone.outputs)


def test_waves_and_noise_have_the_same_bits_in_lanes_and_the_numbers_of_another_tool(
    plants: PlantLanes,
) -> None:
    case, f = load_case(CASE), 0.63
    swing = {"kind": "oscillation", "frequency_hz": f, "start_s": 0.05}
    events = [
        [swing | {"on": "voltage_reference", "machine": "G2", "size_pu": 0.01, "harmonics": [0.2]}],
        [swing | {"on": "mechanical_power", "machine": "G3", "size_pu": 0.02, "shape": "square"}],
        [swing | {"on": "load", "bus": 7, "p_pu": 0.5, "end_s": 0.33}],
        [{"kind": "load_noise", "size_pu": 0.02, "start_s": 0.0, "seed": 5}],
        [{"kind": "load_noise", "size_pu": 0.02, "start_s": 0.0, "seed": 5, "load": "L9"}],
    ]
    rows = [event_parameters(case, events_of(each, where="test")) for each in events]
    alone = plants.run(rows, stop_s=1.0, lanes=1)
    assert np.all(np.isfinite(alone.outputs)) and not any(alone.errors)
    assert np.all(np.abs(alone.of("G1_pe")[-1] - alone.of("G1_pe")[0]) > 1e-5)
    for lanes in (2, 4, 8):
        if lanes <= plants.group.lanes:
            beside = plants.run(rows, stop_s=1.0, lanes=lanes)
            np.testing.assert_array_equal(beside.outputs, alone.outputs)
    check_with_fmpy(plants, rows[2:4], 0.4)


def test_a_run_has_the_numbers_of_another_tool(plants: PlantLanes) -> None:
    """The FMU's own binary under fmpy; its step from k h is (k + 1) h - k h, rounded."""
    check_with_fmpy(plants, scenarios(2), 0.4)


def check_with_fmpy(plants: PlantLanes, rows: list[dict], stop_s: float) -> None:
    run = plants.run(rows, stop_s=stop_s)
    for k, row in enumerate(rows):
        result = fmpy.simulate_fmu(
            str(plants.file.path),
            stop_time=stop_s,
            output_interval=0.01,
            step_size=0.01,
            start_values=row,
            output=run.names,
            fmi_type="CoSimulation",
        )
        outputs = np.array([list(r)[1:] for r in result])
        np.testing.assert_allclose(run.outputs[:, :, k], outputs, rtol=0, atol=1e-12)


def test_an_input_reaches_its_own_plant(plants: PlantLanes) -> None:
    rest = plants.run([{}] * 3, stop_s=0.2)
    moved = plants.run([{}] * 3, stop_s=0.2, inputs={(5, 1, "G1_vs"): 0.02})
    np.testing.assert_array_equal(moved.of("G1_vt")[:, [0, 2]], rest.of("G1_vt")[:, [0, 2]])
    assert np.abs(moved.of("G1_vt")[:6, 1] - rest.of("G1_vt")[:6, 1]).max() == 0.0
    assert np.abs(moved.of("G1_vt")[7:, 1] - rest.of("G1_vt")[7:, 1]).max() > 1e-4


WITH_DEVICES = """
base = "two-area-thesis"
name = "devices"
title = "two areas with converters, an SVC, a series capacitor and both kinds of dc links"
source = "test"
[change.svcs]
svc1 = { bus = 8, base_mva = 200.0, V_pu = 0.97, control = { kind = "svc", K = 20.0, TR = 0.05 } }
[change.tcscs]
tcsc1 = { branch = "7-8 a", x0_pu = 0.044, x_max_pu = 0.08 }
[change.converters]
pv1 = { bus = 7, base_mva = 200.0, P_mw = 100.0, Q_mvar = 20.0, control = { kind = "wecc_converter" } }
pv3 = { bus = 7, base_mva = 60.0, P_mw = 30.0, control = { kind = "wecc_converter", REGCC = 1 } }
wt1 = { bus = 9, base_mva = 60.0, P_mw = 30.0, control = { kind = "wecc_converter", TRAIN = 1, WT3 = 1 } }
der1 = { bus = 9, base_mva = 50.0, P_mw = 20.0, control = { kind = "der_a", FreqFlag = 1, Ddn = 20.0 } }
gfm1 = { bus = 8, base_mva = 100.0, P_mw = 50.0, Q_mvar = 5.0, control = { kind = "regfm_a1", Imax = 1.2 } }
vsm1 = { bus = 8, base_mva = 50.0, P_mw = 20.0, control = { kind = "regfm_b1", Tvf = 0.02, Tif = 0.01 } }
[change.converters.pv2]
bus = 9
base_mva = 90.0
P_mw = 40.0
regulates = 8
measures = "8-9 a"
[change.converters.pv2.control]
kind = "wecc_converter"
PLANT = 1
plant_Ki = 2.0
plant_Tfltr = 0.02
plant_REFFLAG = 1
plant_VCFLAG = 1
plant_Xc = 0.05
[change.hvdcs.hvdc1]
rectifier_bus = 7
inverter_bus = 9
base_mva = 200.0
vdc_kv = 250.0
idc_ka = 0.4
gamma_deg = 20.0
rectifier_kv = 112.0
inverter_kv = 107.0
rectifier_xc_ohm = 6.0
inverter_xc_ohm = 5.0
r_ohm = 10.0
l_mh = 800.0
[change.vscs]
vsc1 = { from_bus = 7, to_bus = 9, base_mva = 60.0, vdc_kv = 300.0, P_mw = 50.0, r_ohm = 9.0, to_keeps = "v" }
"""


def test_devices_at_buses_have_the_same_bits_in_lanes(cache: Path, tmp_path: Path) -> None:
    """SVC, series capacitor, both kinds of converters and of dc links through a fault; most lose some."""
    path = tmp_path / "devices.toml"
    path.write_text(WITH_DEVICES)
    case = load_case(path)
    fault = {"kind": "bus_fault", "bus": 9, "start_s": 0.1, "end_s": 0.2, "x_pu": 0.05}
    lost = [[], [{"kind": "device_trip", "device": name, "start_s": 0.25} for name in ("pv1", "hvdc1")]]
    lost.append(
        [
            {"kind": "device_trip", "device": name, "start_s": 0.3}
            for name in ("svc1", "tcsc1", "gfm1", "vsc1")
        ]
    )
    rows = [event_parameters(case, events_of([fault, *lost[k % 3]], where="test")) for k in range(5)]
    plants = PlantLanes(case, cache, more=["svc1.*", "pv1.*", "gfm1*", "tcsc1.*", "hvdc1.*", "vsc1.*"])
    # every input of the link of converters, of two lanes
    inputs = {(5, k, f"vsc1_{word}"): 0.03 for k in (0, 3) for word in ("p_mod", "q_mod_from", "v_mod_to")}
    still = plants.run(rows, stop_s=0.6, lanes=1)
    alone = plants.run(rows, stop_s=0.6, lanes=1, inputs=inputs)
    for end in ("p_from", "q_from", "q_to"):
        off = np.max(np.abs(alone.of(f"vsc1.{end}") - still.of(f"vsc1.{end}")), axis=0)
        assert np.all((off > 1e-3) == [True, False, False, True, False])
    assert np.all(np.isfinite(alone.outputs)) and not any(alone.errors)
    assert np.all(alone.of("pv1.p")[-1, [1, 4]] == 0.0) and np.all(alone.of("pv1.p")[-1, [0, 2, 3]] > 0.5)
    assert alone.of("svc1.q")[-1, 2] == alone.of("gfm1.p")[-1, 2] == 0.0
    assert np.ptp(alone.of("gfm1_delta")[:, 0]) > 0.1
    ends = alone.of("hvdc1.p_inverter")[-1]
    assert np.all(ends[[1, 4]] == 0.0) and np.all(ends[[0, 2, 3]] > 0.5)
    assert np.ptp(alone.of("tcsc1.i")[-1]) > 0.1
    assert alone.of("vsc1.p_to")[-1, 2] == 0.0 and np.all(alone.of("vsc1.p_to")[-1, [0, 1, 3, 4]] > 0.3)
    for lanes in (2, 4, 8):
        if lanes <= plants.group.lanes:
            beside = plants.run(rows, stop_s=0.6, lanes=lanes, inputs=inputs)
            np.testing.assert_array_equal(beside.outputs, alone.outputs)


def saturated() -> Case:
    return load_case("kundur-thyristor")


def with_power() -> Case:
    """A load of constant current and one of constant power."""
    power = {"L7": {"P_exponent": 1.0, "Q_exponent": 2.0}, "L9": {"P_exponent": 0.0, "Q_exponent": 0.5}}
    return load_case(CASE).with_changes({"loads": power})


def few_ports() -> Case:
    """New England with one load of constant power and one saturating machine."""
    case = load_case("new-england")
    saturates = {"saturation": {"Asat": 0.015, "Bsat": 9.6, "psiT1": 0.9, "use": "total"}}
    loads = {case.loads[3].name: {"P_exponent": 0.0, "Q_exponent": 0.0}}
    return case.with_changes({"loads": loads, "machines": {case.machines[1].name: saturates}})


def hard_rows(case: Case, count: int) -> list[dict]:
    """A run at rest; faults at other places, some so near that slopes at rest do no longer; a trip."""
    rows: list[dict] = [{}]
    for k in range(count - 1):
        bus = case.buses[(5 * k + 4) % len(case.buses)].number
        end = 0.15 + 0.0137 * (k % 3)
        fault = {"kind": "bus_fault", "bus": bus, "start_s": 0.05, "end_s": end, "x_pu": 10.0 ** -(1 + k % 4)}
        events = [
            fault,
            {"kind": "load_step", "load": case.loads[k % 2].name, "start_s": 0.21, "size_pu": -0.4},
        ]
        if k % 3 == 0:
            events.append({"kind": "machine_trip", "machine": case.machines[1].name, "start_s": 0.31})
        rows.append(event_parameters(case, events_of(events, where="test")))
    return rows


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "network"), [(saturated, None), (with_power, None), (few_ports, "sparse"), (few_ports, "dense")]
)
def test_ports_side_by_side_have_the_bits_of_each_alone(
    make: Callable[[], Case], network: Form | None, cache: Path
) -> None:
    case = make()
    plants = PlantLanes(case, cache, network=network)
    rows = hard_rows(case, 11)
    alone = plants.run(rows, stop_s=0.6, lanes=1)
    ended = np.array([error != "" for error in alone.errors])  # constant power beside a near fault
    swing = np.ptp(alone.of("G1_dw"), axis=0)
    assert ended.sum() <= 1 and swing[0] < 1e-9 and np.all(swing[1:][~ended[1:]] > 1e-5)
    for lanes in (2, 4, 8):
        if lanes <= plants.group.lanes:
            beside = plants.run(rows, stop_s=0.6, lanes=lanes)
            assert beside.errors == alone.errors
            np.testing.assert_array_equal(beside.outputs, alone.outputs)


def test_slopes_at_rest_are_tried_again_and_change_nothing_but_the_way_to_the_solution() -> None:
    """A fault that lasts: 0.25 s after other slopes were wanted an event, and then none but the end."""
    case = with_power()
    fault = {"kind": "bus_fault", "bus": case.buses[8].number, "start_s": 0.05, "end_s": 5.0, "x_pu": 0.1}
    plant = BlockShim(plant_block(case), event_parameters(case, events_of([fault], where="test")))
    x = plant.x.copy()
    plant.event(0.05, x)
    before, y = plant.derivatives(x, t=0.05)
    again = plant.next_event(0.05)
    assert again == pytest.approx(0.3)
    assert plant.next_event(0.5) > 0.5  # one that was stepped over is made good later
    plant.event(again, x)
    after, y_after = plant.derivatives(x, t=again)
    assert plant.next_event(again) == 5.0
    np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(y_after, y, rtol=1e-9, atol=1e-11)


def test_a_run_that_fails_says_why_and_leaves_the_others_alone(plants: PlantLanes) -> None:
    rows = scenarios(5)
    for k in range(4):  # of all machines: the last one may not go
        trip = {"kind": EVENT_CODES["machine_trip"], "target": k + 1, "start": 0.25, "end": 1e30}
        rows[2] |= {f"event[{3 + k}].{key}": value for key, value in trip.items()}
    rows[4] |= {"event[1].target": 99}
    good, run = plants.run(scenarios(5), stop_s=0.4), plants.run(rows, stop_s=0.4)
    assert "the last machine was tripped" in run.errors[2]
    assert run.ended_s[2] in (pytest.approx(0.24), pytest.approx(0.25))
    assert np.all(np.isfinite(run.outputs[:25, :, 2])) and np.all(np.isnan(run.outputs[26:, :, 2]))
    assert "event[1].target = 99" in run.errors[4]
    assert np.all(np.isnan(run.outputs[:, :, 4]))
    np.testing.assert_array_equal(run.outputs[:, :, [0, 1, 3]], good.outputs[:, :, [0, 1, 3]])
