"""The public functions: a controller of any form, tables and figures, errors in one line."""

from __future__ import annotations

from pathlib import Path

import control
import numpy as np
import pytest

import interarea as ia

PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 0.7}
SHORT = {"case": "two-area-thesis", "stop_s": 3.0, "step_s": 0.02, "event": [PULSE]}


@pytest.fixture(scope="module")
def run(hand_controller: ia.Controller) -> object:
    return ia.simulate(SHORT, controller=hand_controller)


def test_a_controller_is_taken_as_object_as_state_space_as_file_and_as_fmu(
    run: object, hand_controller: ia.Controller, tmp_path: Path
) -> None:
    """One loop however the controller comes: the same bits."""
    forms = [
        hand_controller.system,
        hand_controller.save(tmp_path / "k.json"),
        str(ia.build_fmu(hand_controller, tmp_path / "k.fmu")),
    ]
    for form in forms:
        other = ia.simulate(SHORT, controller=form)
        assert np.array_equal(other["plant.G2_dw"], run["plant.G2_dw"])  # type: ignore[index]
    grid = ia.System(stop_s=3.0, step_s=0.02).plant("two-area-thesis").controller(hand_controller.system)
    grid.connect("plant.G2_dw", "controller.G2_dw").connect("plant.G4_dw", "controller.G4_dw")
    grid.connect("controller.G4_vs", "plant.G4_vs").event(**PULSE)
    assert np.array_equal(grid.run()["plant.G2_dw"], run["plant.G2_dw"])  # type: ignore[index]


def test_a_changed_case_goes_in_as_an_object(run: object) -> None:
    """Half the inertia: speeds move faster right after the pulse starts."""
    case = ia.load_case("two-area-thesis")
    light = case.with_changes({"machines": {"defaults": {"H": 0.5 * case.machines[0].H}}}, name="light")
    lighter = ia.simulate(SHORT, case=light)
    assert lighter.case.name == "light"  # type: ignore[attr-defined]
    plain = ia.simulate(SHORT)
    at = np.searchsorted(plain["time_s"], 0.6)
    assert abs(lighter["plant.G1_dw"][at]) > 1.5 * abs(plain["plant.G1_dw"][at])


@pytest.mark.slow
def test_a_run_is_looked_at_and_saved(run: ia.Result, tmp_path: Path) -> None:  # type: ignore[name-defined]
    table = run.to_frame()
    assert table.index.name == "time_s" and table.index[-1] == 3.0
    assert np.array_equal(table["plant.G2_dw"], run["plant.G2_dw"])
    assert len(run.plot().axes) == 3
    shown = run._repr_html_()
    assert shown.startswith("<p><b>two-area-thesis, controller by_hand") and "<svg" in shown
    names = {p.name for p in run.save(tmp_path)}
    data = {"trajectory.csv", "trajectory.parquet", "ledger.json", "metrics.json", "run.svg"}
    assert names == data | {"report.html", "scenario.toml", "run.json"}
    assert names == {p.name for p in tmp_path.iterdir()}


def test_modes_and_loops_as_tables_and_figures() -> None:
    modes, loops = ia.modes("two-area-thesis"), ia.loops("two-area-thesis")
    table = modes.to_frame()
    assert list(table.index) == list(modes)
    assert table.loc["inter-area", "frequency_hz"] == modes["inter-area"].frequency_hz
    assert "inter-area" in modes._repr_html_() and "two-area-thesis" in repr(modes)
    assert modes.plot("local area 1").axes
    ranking = loops.to_frame()
    assert (ranking.actuator[0], ranking.signal[0]) == ("G4_vs", "dw24")
    assert (loops.selected.actuator, loops.selected.signal) == ("G4_vs", "dw24")
    assert len(loops.plot().axes[0].patches) == len(ranking) == 10
    assert "dw24" in loops._repr_html_() and "sets of actuators" in loops._repr_html_()
    assert repr(loops) == "Loops(inter-area: best G4_vs with dw24)"


def test_the_selected_loop_is_for_the_least_damped_target() -> None:
    modes = ia.modes("nets-nyps")
    worst = min((m for n, m in modes.items() if n.startswith("inter-area")), key=lambda m: m.damping_ratio)
    result = ia.loops("nets-nyps", signals=["speed"], most=3)
    assert len(result.targets) == 4 and len(result.to_frame()) == 12
    assert result.selected.mode == result.least_damped
    assert result.selected is result.loops[result.least_damped][0]
    near = [m for m in modes.values() if abs(m.damping_ratio - worst.damping_ratio) < 1e-6]
    assert len(near) == 1 and result.least_damped == near[0].name


def test_a_dense_model_of_too_many_states_is_refused_before_it_is_built(monkeypatch) -> None:
    from interarea.cosim.run import artefacts

    monkeypatch.setattr(artefacts, "MOST_DENSE", 1000)
    with pytest.raises(ia.UserError, match=r"wecc-240: 1167 states, allowed for a dense linear model: 1000"):
        ia.linearise("wecc-240")


def test_a_linear_and_a_reduced_model() -> None:
    full, relative = ia.linearise("two-area-thesis", reference=True), ia.linearise("two-area-thesis")
    assert full.nstates == relative.nstates + 1 and "G2_dw" in relative.output_labels
    for method in ("balanced", "singular_perturbation", "hankel"):
        reduced = ia.reduce(relative, 12, method=method)
        assert reduced.system.nstates == 12 and reduced.error <= reduced.bound * (1.0 + 1e-6)
        assert repr(reduced).startswith("Reduction(12 states by ") and f"{reduced.error:.3g}" in repr(reduced)
    with pytest.raises(ia.UserError, match="method = 'pade', allowed: balanced, singular_perturbation"):
        ia.reduce(relative, 12, method="pade")


@pytest.mark.slow
def test_certify_judges_any_form_by_one_family(hand_controller: ia.Controller) -> None:
    family = {
        "name": "small",
        "case": "two-area-thesis",
        "remote": "G2_dw",
        "local": "G4_dw",
        "actuator": "G4_vs",
        "conditions": ["N"],
        "point": [{"name": "base"}],
        "ask": {"worst_swing": 0.9},
    }
    certificate = ia.certify(hand_controller.system, spec=family)
    assert not certificate.ok and "worst swing damping" in certificate.violations[0]
    assert list(certificate.rows.point) == ["base"] and certificate.rows.stable.all()
    assert certificate.plot().axes[0].get_xlabel() == "least damping ratio of the swings"
    assert "controller on two-area-thesis" in certificate._repr_html_()
    easy = ia.certify(hand_controller, spec={**family, "ask": {}})
    assert easy.ok and easy.rows.worst_swing[0] == certificate.rows.worst_swing[0]


def test_mistakes_are_user_errors_in_one_line() -> None:
    discrete = control.ss([[0.5]], [[1.0, 0.0]], [[1.0]], [[0.0, 0.0]], 0.01)
    for call, words in (
        (lambda: ia.load_case("kundr"), "did you mean kundur"),
        (lambda: ia.simulate("lost-signl"), "did you mean 'lost-signal'"),
        (lambda: ia.simulate(SHORT, controller="robst"), "did you mean 'robust'"),
        (lambda: ia.simulate(SHORT, controller=3), "controller: is an int, wanted a control.StateSpace"),
        (lambda: ia.simulate(SHORT, controller=discrete), "discrete time"),
        (lambda: ia.Channel(latncy_s=0.1), "Channel: latncy_s = 0.1: no such key"),
        (lambda: ia.Channel(latency_s=-1), "greater than or equal to 0"),
        (lambda: ia.import_case("grid.xls"), "no such file"),
        (lambda: ia.read_sweep("nowhere"), "no such folder"),
        (lambda: ia.build_fmu("two-area-thesis", "x.fmu"), "allowed: a Case"),
        (lambda: ia.certify("robst"), "did you mean 'robust'"),
    ):
        with pytest.raises(ia.UserError, match=words) as caught:
            call()
        assert "\n" not in str(caught.value)


def test_a_channel_object_is_the_table_of_a_file() -> None:
    by_keys = {**SHORT, "channels": {"remote": {"signal": "G2_dw", "latency_s": 0.1}}}
    by_object = {**SHORT, "channels": {"remote": ia.Channel(signal="G2_dw", latency_s=0.1)}}
    first, second = ia.simulate(by_keys), ia.simulate(by_object)
    assert np.array_equal(first["remote.y"], second["remote.y"])


def test_a_sweep_and_its_results_read_back(tmp_path: Path) -> None:
    spec = {
        "name": "two",
        "scenario": {**SHORT, "channels": {"remote": {"signal": "G2_dw"}}},
        "parameters": {"latency": {"path": "channels.remote.latency_s", "values": [0.1, 0.2]}},
    }
    results = ia.sweep(spec, out=tmp_path / "out", workers=1)
    assert results.summary["runs"] == 2 == len(results.to_frame())
    assert list(ia.read_sweep(tmp_path / "out").to_frame().latency) == [0.1, 0.2]
    assert "2 runs" in repr(results) and "latency" in results._repr_html_()


@pytest.mark.slow
def test_an_fmu_and_an_archive_pass_our_check(tmp_path: Path, hand_controller: ia.Controller) -> None:
    scenario = {**SHORT, "channels": {"remote": {"signal": "G2_dw", "latency_s": 0.1}}}
    for file in (
        ia.build_fmu(hand_controller, tmp_path / "k.fmu"),
        ia.write_ssp(scenario, tmp_path / "loop.ssp"),
        ia.write_container(scenario, tmp_path / "loop.fmu"),
    ):
        result = ia.check(file, run=False)
        assert result.clean, result
        assert repr(result).splitlines() == [f"{file}: {result.verdict}"]
