"""What a run is judged by: stated, or the extreme machines of the inter-area mode; named in every result."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from interarea.cosim.errors import ScenarioError
from interarea.cosim.results import run_figure
from interarea.cosim.results.run_figure import run_plot
from interarea.cosim.run import swing_signal
from interarea.cosim.run.artefacts import linear_plant
from interarea.cosim.run.run import run_scenario
from interarea.cosim.run.swing_signal import swing_of
from interarea.cosim.sweep.front import run_sweep
from interarea.cosim.sweep.parts import read_rows
from interarea.design.linear.linearise import remove_reference
from interarea.models.case.case import load_case
from interarea.models.case.write_toml import export_toml

PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.02, "start_s": 0.5, "end_s": 0.7}


@pytest.mark.parametrize("name", ["new-england", "nets-nyps"])
def test_large_cases_are_judged_between_areas(name: str, cache: Path) -> None:
    """G2 and G4 are in one area of both. The pair has opposite ends of the least damped mode between areas,
    read off the matrix of the plant here: among all pairs none is further apart."""
    case = load_case(name)
    swing = swing_of(case, cache)
    assert case.areas[swing.ahead] != case.areas[swing.behind]
    plant = remove_reference(linear_plant(case, cache))
    values, vectors = np.linalg.eig(plant.A)
    machines = list(case.areas)
    rows = [plant.output_labels.index(f"{m}_dw") for m in machines]
    at = [i for i, z in enumerate(values) if f"{z.imag / (2.0 * np.pi):.3f} Hz" in swing.source]
    spread = []
    for i in at:
        shape = plant.C[rows] @ vectors[:, i]
        apart = np.abs(shape[:, None] - shape[None, :])
        a, b = machines.index(swing.ahead), machines.index(swing.behind)
        spread.append(apart[a, b] / apart.max())
    assert spread and max(spread) > 0.9


@pytest.mark.parametrize("name", ["two-area-thesis", "new-england"])
def test_a_grid_too_large_for_matrices_has_the_same_from_its_sparse_blocks(
    name: str, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = load_case(name)
    dense = swing_of(case, cache)
    monkeypatch.setattr(swing_signal, "states_beyond_dense", lambda case: 7)
    monkeypatch.setattr(swing_signal, "cached_json", lambda cache, kind, key, make: make())
    monkeypatch.setattr(swing_signal, "linear_matrices", None)
    sparse = swing_of(case, cache)
    assert (sparse.ahead, sparse.behind) == (dense.ahead, dense.behind)
    assert (
        sparse.source.partition(" at ")[2] == dense.source.partition(" at ")[2]
    )  # names count what was sought


def test_parts_that_no_branch_connects_are_judged_within_the_largest(cache: Path) -> None:
    apart = {"8-9 a": {"in_service": False}, "8-9 b": {"in_service": False}}
    case = load_case("two-area-thesis").with_changes({"branches": apart, "machines": {"G1": {"slack": True}}})
    assert swing_of(case, cache).source == "stated by the case"
    swing = swing_of(case.model_copy(update={"swing": None}), cache)
    assert (swing.ahead, swing.behind) == ("G1", "G2") and "the largest of 2 islands" in swing.source


def test_of_many_machines_those_are_drawn_whose_speeds_go_furthest(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = run_scenario({"case": "two-area-thesis", "stop_s": 2.0, "event": [PULSE]}, cache=cache)
    legend = run_plot(run).axes[1].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["G1", "G2", "G3", "G4"]
    monkeypatch.setattr(run_figure, "_MOST", 2)
    legend = run_plot(run).axes[1].get_legend()
    peaks = {m: float(np.abs(run.trajectory[f"plant.{m}_dw"]).max()) for m in ("G1", "G2", "G3", "G4")}
    furthest = sorted(peaks, key=lambda m: -peaks[m])[:2]
    assert [text.get_text() for text in legend.get_texts()] == sorted(furthest)
    assert legend.get_title().get_text() == "2 of 4, the largest deviations"


def test_case_and_scenario_state_their_own(cache: Path) -> None:
    case = load_case("two-area-thesis")
    assert swing_of(case, cache).name == "dw24"
    assert swing_of(case, cache, ("G1", "G3")).name == "dw13"
    assert swing_of(case.with_changes({"swing": ["G1", "G4"]}), cache).name == "dw14"
    assert case.with_changes({"swing": ["G1", "G4"]}).hash == case.hash  # the same grid
    with pytest.raises(ScenarioError, match="machine 'G9' does not exist; did you mean"):
        swing_of(case, cache, ("G1", "G9"))
    with pytest.raises(ValueError, match="swing: machine 'G7' does not exist"):
        case.with_changes({"swing": ["G1", "G7"]})


@pytest.mark.slow
def test_every_result_names_it_and_its_numbers_have_units(cache: Path, tmp_path: Path) -> None:
    table = {"case": "two-area-thesis", "swing": ["G1", "G3"], "stop_s": 3.0, "event": [PULSE]}
    run = run_scenario(table, cache=cache)
    signal = run["plant.G1_dw"] - run["plant.G3_dw"]
    assert run.metrics.signal == "dw13" and "dw13" in run.summary
    assert run.metrics.peak_pu == pytest.approx(np.max(np.abs(signal)), rel=1e-12)
    run.save(tmp_path / "run")
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["signal"] == "dw13" and metrics["peak_dw13_pu"] == metrics["peak_pu"]
    assert "G1 less that of G3 (stated by the scenario)" in metrics["methods"]["signal"]
    sweep = {"scenario": table, "parameters": {"size": {"path": "event.1.size_pu", "values": [0.02]}}}
    run_sweep(sweep, tmp_path / "sweep", workers=1, cache=cache)
    assert read_rows(tmp_path / "sweep").peak_pu[0] == run.metrics.peak_pu
    (part,) = (tmp_path / "sweep").glob("runs/*.parquet")
    notes = pq.read_schema(part).metadata
    assert b"dw13" in notes[b"swing"]


def test_clearing_after_eight_cycles_is_rounded_and_said(cache: Path) -> None:
    """1 + 8/60 s is no whole number of nanoseconds: the run is that of 1.133333333 s, and says so."""
    fault = {"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": 1.0 + 8.0 / 60.0, "x_pu": 1e-3}
    table = {"case": "two-area-thesis", "stop_s": 2.0, "event": [fault]}
    run = run_scenario(table, cache=cache)
    as_written = run_scenario(table | {"event": [fault | {"end_s": 1.133333333}]}, cache=cache)
    np.testing.assert_array_equal(run.data, as_written.data)
    assert "event 1.end_s = 1.1333333333333333 s is rounded to 1.133333333 s" in str(run.ledger)
    assert as_written.ledger.rounded == ()
    same = fault | {"start_s": 1.0, "end_s": 1.0 + 3e-10}
    with pytest.raises(ScenarioError, match="on one tick"):
        run_scenario(table | {"event": [same]}, cache=cache)


@pytest.mark.slow
def test_thyristor_case_has_no_limits_that_act(cache: Path) -> None:
    """Example 12.6 states none: with +-2000 a fault on bus 8 gives the same swing."""
    fault = {"kind": "bus_fault", "bus": 8, "start_s": 0.5, "end_s": 0.6, "x_pu": 1e-3}
    case = load_case("kundur-thyristor-z")
    wide = {"machines": {"defaults": {"exciter": {"Efd_min": -2000.0, "Efd_max": 2000.0}}}}
    curves = []
    folder = cache / "tests"
    folder.mkdir(parents=True, exist_ok=True)
    for name, this in (("as-bundled", case), ("wide", case.with_changes(wide, name="wide"))):
        file = folder / f"thyristor-{name}.toml"
        export_toml(this, file)
        run = run_scenario({"case": str(file), "stop_s": 3.0, "event": [fault]}, cache=cache)
        curves.append(run["plant.G2_dw"] - run["plant.G4_dw"])
    assert np.max(np.abs(curves[0] - curves[1])) <= 2e-4 * np.max(np.abs(curves[1]))
