"""Controllers side by side: the same runs as alone, and roots over latency that a single loop confirms."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.cosim.errors import ScenarioError
from interarea.cosim.run.compare import LATENCIES_S, compare_controllers
from interarea.cosim.run.run import run_scenario, system_of
from interarea.cosim.scenario.scenario import Scenario, load_scenario
from interarea.design.controllers.controller import Controller
from interarea.design.delay.loop_modes import LoopModes

DOCUMENT: dict[str, Any] = {
    "case": "two-area-thesis",
    "stop_s": 5.0,
    "channels": {
        "remote": {"signal": "G2_dw", "latency_s": 0.1},
        "local": {"signal": "G4_dw", "latency_s": 0.02},
    },
    "event": [{"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}],
}


@pytest.fixture
def scenario(tmp_path: Path, hand_controller: Controller) -> Scenario:
    hand_controller.save(tmp_path / "mine.json")
    return load_scenario(DOCUMENT | {"folder": tmp_path})


@pytest.mark.slow
def test_each_is_the_run_that_it_is_alone(scenario: Scenario, cache: Path) -> None:
    reported: list[tuple[str, float]] = []
    none, own = compare_controllers(
        scenario, ["none", "mine.json"], cache=cache, progress=lambda *now: reported.append(now)
    )
    alone = run_scenario(scenario.model_copy(update={"controller": "mine.json"}))
    assert np.array_equal(own.run["plant.G2_dw"], alone["plant.G2_dw"])
    assert own.row()["least_damping_ratio"] == alone.metrics.least_damping_ratio
    assert none.row()["inter_area_damping_ratio"] == pytest.approx(0.0806, abs=0.001)  # of the thesis' plant
    assert {name for name, _ in reported} == {"none", "mine"} and reported[-1] == ("mine", 1.0)


@pytest.mark.slow
def test_roots_over_latency_are_those_of_the_loop_with_that_latency(scenario: Scenario, cache: Path) -> None:
    (own,) = compare_controllers(scenario, ["mine.json"], cache=cache)
    at_s = LATENCIES_S[8]
    late = {n: c.model_copy(update={"latency_s": at_s}) for n, c in scenario.channels.items()}
    single = scenario.model_copy(update={"channels": late, "controller": "mine.json"})
    expected = system_of(single, cache=cache).linear_swings()
    result = own.locus[at_s]
    assert isinstance(expected, LoopModes) and isinstance(result, LoopModes)
    assert result.least == pytest.approx(expected.least, rel=1e-9)
    rows = [r for r in own.roots() if r["latency_s"] == at_s]
    assert min(r["damping_ratio"] for r in rows) == pytest.approx(-expected.least.real / abs(expected.least))  # type: ignore[union-attr]
    least = [m.least for m in own.locus.values() if isinstance(m, LoopModes) and m.least is not None]
    assert len({round(z.real, 6) for z in least}) == len(LATENCIES_S)  # latency moves them


def test_all_wrong_controllers_at_once(scenario: Scenario, cache: Path) -> None:
    with pytest.raises(ScenarioError) as caught:
        compare_controllers(scenario, ["robst", "wcd", "none"], cache=cache)
    first, second = caught.value.args
    assert "'robst' is neither a name nor a file; did you mean 'robust'" in first
    assert "'wcd' is neither a name nor a file; did you mean 'wdc'" in second
    with pytest.raises(ScenarioError, match="robust given twice"):
        compare_controllers(scenario, ["robust", "robust"], cache=cache)


@pytest.mark.slow
def test_the_command_writes_one_page(interarea, tmp_path: Path, scenario: Scenario) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "s.toml"
    text = 'case = "two-area-thesis"\nstop_s = 3.0\n[channels.a]\nsignal = "G2_dw"\nlatency_s = 0.1\n'
    event = '[[event]]\nkind = "vref_pulse"\nmachine = "G1"\nsize_pu = 0.05\nstart_s = 0.5\nend_s = 0.7\n'
    file.write_text(text + event, encoding="utf-8")
    own = tmp_path / "mine.json"
    code, out, err = interarea("compare", "none", own, "--scenario", file, "--out", tmp_path / "o", "--json")
    assert code == 0, err
    rows = json.loads(out)["controllers"]
    assert [r["controller"] for r in rows] == ["none", "mine"]
    page = (tmp_path / "o" / "compare.html").read_text(encoding="utf-8")
    assert page.count("<figure>") == 3 and '<td class="t">mine</td>' in page
    assert json.loads((tmp_path / "o" / "compare.json").read_text(encoding="utf-8")) == json.loads(out)
    assert (tmp_path / "o" / "mine" / "report.html").is_file()
