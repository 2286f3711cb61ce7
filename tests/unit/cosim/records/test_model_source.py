"""Sources of oscillations by the model: runs of the full plant, an independent solution, misleading data."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import invoke

import interarea as ia
from interarea.cosim.designs.design_tables import PointTable
from interarea.cosim.designs.family import at_point
from interarea.cosim.records.model_source import LOAD, MECHANICAL, REFERENCE, ModelSource, source_by_model
from interarea.cosim.records.record import Channel, Record, RecordError
from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.design.linear.resolvent import Shifted
from interarea.design.linear.sparse_plant import SparsePlant
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case

SHOWN = ["branch[*].p", "branch[*].q", "bus*.v", "bus*.angle"]
F = 0.8


@cache
def plant_of(name: str) -> SparsePlant:
    return sparse_linear_plant(load_case(name), default_cache())


@cache
def recorded(case: str, *sources: tuple[str, str, str, float]) -> Record:
    """Return 30 s of a run of the full plant after 20 s of (on, key, place, size) at F."""
    events = [
        {"kind": "oscillation", "on": on, key: place, "frequency_hz": F, "size_pu": size, "start_s": 0.0}
        for on, key, place, size in sources
    ]
    run = ia.simulate({"case": case, "controller": "none", "stop_s": 50.0, "event": events, "show": SHOWN})
    return ia.read_record(run.to_frame()).between(20.0, 50.0)


def answer(case: str, *sources: tuple[str, str, str, float], **options: Any) -> ModelSource:
    record = recorded(case, *sources)
    return source_by_model(record, load_case(case), plant_of(case), frequency_hz=F, **options)


@pytest.mark.parametrize(
    ("on", "key", "place", "size", "kind", "unit"),
    [
        ("voltage_reference", "machine", "G3", 0.01, REFERENCE, "pu"),
        ("load", "load", "L7", 0.02, LOAD, "of the load"),
    ],
)
def test_a_run_of_the_full_plant_gives_place_kind_and_size(
    on: str, key: str, place: str, size: float, kind: str, unit: str
) -> None:
    """Linear and full plant differ by their curvature only: less than 1e-5 of the squares is left."""
    result = answer("two-area-thesis", (on, key, place, size))
    assert result.source is not None
    assert (result.source.places, result.source.kinds) == ((place,), (kind,))
    assert result.source.amplitude[0] == pytest.approx(size, rel=2e-3)
    assert result.source.units == (unit,)
    assert result.source.unexplained < 1e-5
    assert result.frequency_hz == pytest.approx(F, abs=1e-4)


def test_torque_at_a_shaft_has_the_size_of_the_event() -> None:
    """Of a machine without a governor the event's power is the torque, pu of the machine."""
    result = answer("kundur-manual", ("mechanical_power", "machine", "G2", 0.01))
    assert result.source is not None
    assert (result.source.places, result.source.kinds) == (("G2",), (MECHANICAL,))
    assert result.source.amplitude[0] == pytest.approx(0.01, rel=0.01)


def test_two_sources_are_named_where_one_does_not_explain_the_record() -> None:
    result = answer(
        "two-area-thesis",
        ("voltage_reference", "machine", "G1", 0.01),
        ("load", "load", "L9", 0.02),
    )
    assert result.source is not None
    assert dict(zip(result.source.places, result.source.kinds, strict=True)) == {"G1": REFERENCE, "L9": LOAD}


def test_a_model_of_another_grid_names_no_source() -> None:
    record = recorded("two-area-thesis", ("voltage_reference", "machine", "G3", 0.01))
    other = source_by_model(record, load_case("kundur-manual"), plant_of("kundur-manual"), frequency_hz=F)
    assert other.source is None
    assert "outside the model, or this is not its operating point" in other.why


def test_noise_alone_names_no_source() -> None:
    """Of white noise at every channel any pattern explains as much as any other."""
    record = recorded("two-area-thesis", ("voltage_reference", "machine", "G3", 0.01))
    noise = 1e-3 * np.random.default_rng(3).standard_normal(record.values.shape)
    still = Record("noise.csv", record.time_s, 1.0 + noise, record.channels)
    result = source_by_model(still, load_case("two-area-thesis"), plant_of("two-area-thesis"), frequency_hz=F)
    assert result.source is None


def test_a_reference_that_all_angles_share_changes_nothing() -> None:
    """Angles against that of bus 7: the answer may not depend on what a recorder takes as zero."""
    record = recorded("two-area-thesis", ("load", "load", "L7", 0.02))
    turned = [k for k, c in enumerate(record.channels) if c.quantity == "voltage angle"]
    values = record.values.copy()
    values[:, turned] -= record["plant.bus7.angle"][:, None]
    other = Record(record.source, record.time_s, values, record.channels)
    case = load_case("two-area-thesis")
    a, b = (source_by_model(r, case, plant_of(case.name), frequency_hz=F) for r in (record, other))
    assert a.source is not None and b.source is not None
    assert (a.source.places, a.source.kinds) == (b.source.places, b.source.kinds)
    assert b.source.amplitude[0] == pytest.approx(a.source.amplitude[0], rel=5e-3)


@pytest.mark.slow
def test_units_at_one_bus_with_one_pattern_are_named_together() -> None:
    """Machines 4131_B and 4131_H are equal: their voltage references move the grid by the same pattern."""
    case = load_case("wecc-240")
    plant = plant_of("wecc-240")
    one, other = (plant.inputs.index(f"G4131_{unit}_vs") for unit in "BH")
    swing = plant.forced(
        2j * np.pi * F, plant.Bu.toarray()[:, [one, other]], np.zeros((len(plant.bus_names), 2, 2))
    )
    a, b = swing.voltages.reshape(-1, 2).T
    assert abs(np.vdot(a, b)) == pytest.approx(np.linalg.norm(a) * np.linalg.norm(b), rel=1e-5)
    size, angle = plant.size_and_angle(swing.voltages)
    time = np.arange(0.0, 40.0, 0.05)
    channels, columns = [], []
    for k in range(0, len(plant.bus_names), 4):
        for quantity, row, unit in (("voltage", size, "pu"), ("voltage angle", angle, "rad")):
            bus = f"bus{plant.bus_names[k]}"
            channels.append(Channel(f"{bus} {quantity}", quantity, unit, bus))
            columns.append(1.0 + np.real(row[k, 1] * 0.01 * np.exp(2j * np.pi * F * time)))
    values = np.array(columns).T
    noise = 0.1 * values.std(axis=0).mean() * np.random.default_rng(5).standard_normal(values.shape)
    record = Record("made.csv", time, values + noise, tuple(channels))
    result = source_by_model(record, case, plant, frequency_hz=F)
    assert result.source is not None
    named = {c.places[0] for c in (result.source, *result.others)}
    assert named == {"G4131_B", "G4131_H"}
    assert "at the same bus" in result.why


@pytest.mark.parametrize("case", ["two-area-thesis", "two-area-svc"])
def test_forced_swings_are_those_of_the_resolvent(case: str) -> None:
    """States by `Shifted`, which eliminates buses and works in the devices' modes; voltages of those."""
    plant, s = plant_of(case), 2j * np.pi * F
    Bu = plant.Bu.toarray()
    swing = plant.forced(s, Bu, np.zeros((len(plant.bus_names), 2, Bu.shape[1])))
    states = Shifted(plant, s).solve(Bu)
    np.testing.assert_allclose(swing.states, states, rtol=1e-8, atol=1e-10 * np.abs(states).max())
    voltages = plant.voltages(states)
    np.testing.assert_allclose(swing.voltages, voltages, rtol=1e-7, atol=1e-10 * np.abs(voltages).max())


def test_records_without_enough_of_the_grid_or_time_are_refused() -> None:
    record = recorded("two-area-thesis", ("load", "load", "L7", 0.02))
    case, plant = load_case("two-area-thesis"), plant_of("two-area-thesis")
    with pytest.raises(RecordError, match=r"5 s are 4 periods of 0\.8 Hz, wanted: 5 at least"):
        source_by_model(record.between(0.0, 5.0), case, plant, frequency_hz=F)
    few = record.only([c.name for c in record.channels][:3])
    with pytest.raises(RecordError, match=r"channels are at places of two-area-thesis, wanted: 4"):
        source_by_model(few, case, plant, frequency_hz=F)


def test_the_command_says_both_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = recorded("two-area-thesis", ("voltage_reference", "machine", "G3", 0.01))
    frame = record.to_frame()
    path = tmp_path / "run.csv"
    frame.to_csv(path)
    code, out, err = invoke(["locate", str(path), "--case", "two-area-thesis"], monkeypatch)
    assert code == 0, err
    assert "by the energy flow: " in out
    assert "by the model: G3 (voltage reference); one source" in out
    code, out, _ = invoke(["locate", str(path), "--case", "two-area-thesis", "--json"], monkeypatch)
    assert json.loads(out)["model"]["source"]["places"] == ["G3"]
    volts = tmp_path / "volts.csv"
    frame[[c for c in frame.columns if c.endswith((".v", ".angle"))]].to_csv(volts)
    code, out, err = invoke(["locate", str(volts), "--case", "two-area-thesis"], monkeypatch)
    assert code == 0, err
    assert "by the model: G3" in out
    assert "no energy flow: " in err
    code, _, err = invoke(["locate", str(volts)], monkeypatch)
    assert code == 2
    assert "no terminal has power and angle" in err


@pytest.mark.parametrize(
    ("point", "named"),
    [(PointTable(name="load", load_scale=1.1), True), (PointTable(name="out", out=("7-8 a",)), False)],
)
def test_another_load_leaves_more_and_a_missing_line_names_nothing(point: PointTable, named: bool) -> None:
    """The record is of the grid as it is; the model of 10 % more load, or without a circuit of the tie."""
    record = recorded("two-area-thesis", ("voltage_reference", "machine", "G3", 0.01))
    case = at_point(load_case("two-area-thesis"), point)
    result = source_by_model(record, case, sparse_linear_plant(case, default_cache()), frequency_hz=F)
    assert 1e-3 < result.candidates[0].unexplained < 0.1
    assert (result.source is not None) == named
    assert result.candidates[0].places == ("G3",)
