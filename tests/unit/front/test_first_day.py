"""The first day of a control engineer: ten things that slipped once, each with the test that holds it.

`TEN` lists them; what is tested nowhere else is tested here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

import interarea as ia
from interarea.cosim.run.controllers import design_controller

UNIT = Path(__file__).resolve().parents[1]
OWN = "cli/test_own_conditions.py"
#: what a first day shows -> its test
TEN = {
    "matrices": "front/test_first_day.py::test_matrices_are_taken_where_a_system_is",
    "units of speeds": f"{OWN}::test_it_is_judged_under_plain_conditions_and_by_stability_alone",
    "own conditions": f"{OWN}::test_the_command_exits_with_what_was_found",
    "prediction": f"{OWN}::test_no_prediction_stands_beside_its_refutation",
    "double pole": "front/test_first_day.py::test_a_double_pole_has_its_linear_loop",
    "hinfsyn": "../docs/test_own_controller.py::test_the_extra_that_the_page_names_is_there",
    "active": "front/test_first_day.py::test_active_is_there_at_once",
    "compare": "front/test_first_day.py::test_controllers_are_compared_as_the_command_does",
    "run without --out": "cli/test_first_steps.py::test_a_run_without_a_folder_prints_and_writes_nothing",
    "mode": "design/modes/test_modes.py::test_a_mode_shows_itself_as_a_person_reads_it",
}
PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 0.7}
SHORT = {"case": "two-area-thesis", "stop_s": 3.0, "step_s": 0.02, "event": [PULSE]}
LATE = SHORT | {"channels": {"remote": {"signal": "G2_dw", "latency_s": 0.1}}}


def lead(*poles: float, gain: float = 0.02) -> control.StateSpace:
    """Return a controller of two speeds with a washout and leads that end at `poles` (1/s)."""
    s = control.tf("s")
    K = 10 * s / (1 + 10 * s)
    for p in poles:
        K = K * (1 + 0.2 * s) / (1 + s / p)
    K = control.ss(gain * K)
    names: dict[str, Any] = {"inputs": ["G2_dw", "G4_dw"], "outputs": ["G4_vs"]}
    return control.ss(K.A, K.B @ [[-1, 1]], K.C, K.D @ [[-1, 1]], **names)


@pytest.mark.parametrize("what", TEN)
def test_each_of_the_ten_has_its_test(what: str) -> None:
    file, _, name = TEN[what].partition("::")
    assert f"def {name}(" in (UNIT / file).read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", [np.array, np.matrix, list], ids=["array", "matrix", "list"])
def test_matrices_are_taken_where_a_system_is(kind: Any) -> None:
    """Wherever a `StateSpace` is taken, its four matrices give the same."""
    rows = ([[-1.0, 0.5], [0.0, -3.0]], [[1.0], [1.0]], [[2.0, 1.0]], [[0.0]])
    G, matrices = control.ss(*rows), tuple(kind(M) for M in rows)
    assert ia.reduce(matrices, 1).error == ia.reduce(G, 1).error
    assert ia.delay_margin(matrices).margin_s == ia.delay_margin(G).margin_s
    assert np.array_equal(ia.delayed_poles(matrices, 0.1), ia.delayed_poles(G, 0.1))
    plant = ([[1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]])
    assert ia.h2syn(tuple(kind(M) for M in plant), 1, 1).gamma == ia.h2syn(control.ss(*plant), 1, 1).gamma
    # a controller's ports need names, of a `StateSpace` too: the refusal says how to give them
    for unnamed in (matrices, G):
        with pytest.raises(ia.UserError, match=r'inputs=\["G2_dw"\], outputs=\["G4_vs"\]\), rad/s to pu'):
            ia.Controller.of(unnamed)


def test_a_double_pole_has_its_linear_loop() -> None:
    """Its roots are those of two poles close by, which have a modal form."""
    double = ia.simulate(LATE, controller=lead(20.0, 20.0)).metrics
    close = ia.simulate(LATE, controller=lead(20.0, 20.02)).metrics
    assert double.least_damping_ratio == pytest.approx(close.least_damping_ratio, rel=1e-3)
    assert double.least_frequency_hz == pytest.approx(close.least_frequency_hz, rel=1e-3)


def test_active_is_there_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It comes along: nothing is designed, built or written."""
    monkeypatch.setenv("INTERAREA_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(f"{design_controller.__module__}.design_controller", pytest.fail)
    assert len(ia.load_controller("active").members) > 1  # type: ignore[union-attr]
    assert not (tmp_path / "cache").exists()


@pytest.mark.slow
def test_controllers_are_compared_as_the_command_does(tmp_path: Path) -> None:
    """Objects beside names; each run as alone; the files that `interarea compare` writes, all or none."""
    own = ia.Controller("mine", lead(20.0, 20.0))
    steps: list[tuple[str, float]] = []
    comparison = ia.compare(["none", own], LATE, progress=lambda *now: steps.append(now))
    assert list(comparison.runs) == ["none", "mine"] and steps[-1] == ("mine", 1.0)
    alone = ia.simulate(LATE, controller=own)
    assert np.array_equal(comparison.runs["mine"]["plant.G2_dw"], alone["plant.G2_dw"])
    table = comparison.to_frame()
    assert table.least_damping_ratio["mine"] == alone.metrics.least_damping_ratio
    at_100_ms = comparison.roots.query("controller == 'mine' and latency_s == 0.1")
    assert at_100_ms.damping_ratio.min() > 0.0
    assert "G2" in comparison.worth["mine"] and "none" not in comparison.worth
    assert repr(comparison).startswith("Comparison(scenario: none ") and "<table" in comparison._repr_html_()
    assert len(comparison.plot().axes) == 2
    files = comparison.save(tmp_path / "o")
    assert [f.name for f in files[-2:]] == ["compare.json", "compare.html"]
    assert (tmp_path / "o" / "mine" / "report.html").is_file()
    (tmp_path / "p" / "compare.html").mkdir(parents=True)  # a folder in the way of the last file
    with pytest.raises(IsADirectoryError):
        comparison.save(tmp_path / "p")
    assert not [p for p in (tmp_path / "p").rglob("*") if p.is_file()]


@pytest.mark.slow
def test_a_controller_is_compared_on_another_case() -> None:
    case = ia.load_case("two-area-thesis")
    light = case.with_changes({"machines": {"defaults": {"H": 0.5 * case.machines[0].H}}}, name="light")
    comparison = ia.compare(["none"], SHORT, case=light)
    alone = ia.simulate(SHORT, case=light)
    assert comparison.runs["none"].case.name == "light"
    assert np.array_equal(comparison.runs["none"]["plant.G1_dw"], alone["plant.G1_dw"])
