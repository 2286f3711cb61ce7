"""Every bundled scenario does what it says it does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from scenario_loop import Loop
from typer.testing import CliRunner

from interarea.cli.app import app
from interarea.cosim.errors import ScenarioError
from interarea.cosim.run.names import refuse_wrong_names
from interarea.cosim.scenario.scenario import load_scenario
from interarea.models.bundled import bundled

DESIGNED = ("wdc", "cc", "ftc")


def _case(name: str) -> Any:
    marks = [pytest.mark.slow] if load_scenario(name).controller in DESIGNED else []
    return pytest.param(name, marks=marks)


@pytest.mark.parametrize("name", [_case(n) for n in bundled("scenario")])
def test_the_outcome_is_the_stated_one(name: str, scenario: Any) -> None:
    run = scenario(name)
    assert run.scenario.title and run.scenario.source
    assert run.scenario.expect.model_fields_set
    assert not run.unmet


def test_what_is_expected_and_is_not_is_said(scenario: Any) -> None:
    stated = scenario("ring-down").scenario.model_dump(mode="json", exclude_unset=True)
    expected = {"stable": False, "synchronism": False, "verdict": "growing", "settling_time_s": [0.0, 1e-3]}
    damping = {"inter-area": [0.5, 0.6], "least": [0.5, 0.6], "no mode": [0.0, 1.0]}
    run = scenario(stated | {"expect": {**expected, "peak_pu": [1.0, 2.0], "damping_ratio": damping}})
    assert [line.split(" is ")[0] for line in run.unmet] == [
        *("stable", "synchronism", "verdict"),
        *(f"damping_ratio of {mode}" for mode in damping),
        *("settling_time_s", "peak_pu"),
    ]
    assert "damping_ratio of no mode is none, expected from 0 to 1" in run.unmet


def test_a_run_that_is_not_as_expected_ends_with_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = 'case = "two-area-thesis"\nstop_s = 1.0\n[expect]\nstable = {}\n'
    for stable, code in (("true", 0), ("false", 1)):
        Path("s.toml").write_text(text.format(stable))
        said = CliRunner().invoke(app, ["run", "s.toml"])
        assert said.exit_code == code
        assert ("not as expected: stable is True, expected False" in said.stderr) is bool(code)


def test_limits_that_fall_are_refused() -> None:
    with pytest.raises(ScenarioError, match=r"peak_pu.*has \[2, 1\], allowed: \[least, most\]"):
        load_scenario({"case": "two-area-thesis", "stop_s": 1.0, "expect": {"peak_pu": [2.0, 1.0]}})
    with pytest.raises(ScenarioError, match="swing: has 'G2' twice, allowed: two machines"):
        refuse_wrong_names(load_scenario({"case": "two-area-thesis", "stop_s": 1.0, "swing": ["G2", "G2"]}))


@pytest.mark.parametrize("name", [_case(n) for n in bundled("scenario")])
def test_every_connection_has_the_latency_that_the_ledger_states(name: str) -> None:
    with Loop(load_scenario(name)) as loop:
        measured = loop.self_test()
    assert measured.passed and measured.worst_s <= 1e-6, str(measured)


def test_a_scenario_runs_once(scenario: Any) -> None:
    assert scenario("ring-down") is scenario("ring-down")


def test_one_circuit_out_lowers_the_inter_area_frequency_by_a_fifth(scenario: Any) -> None:
    """One 8-9 circuit out: 0.490 Hz instead of 0.623 Hz by an independent computation.

    That one solves the power flow again with constant P and Q; here the loads are impedances that stay as
    they are, so the state after the trip is another: 3 %.
    """
    assert scenario("fault").metrics.frequency_hz["inter-area"] == pytest.approx(0.490, rel=0.03)
