"""What a sweep file says: how many runs, which values, and what is refused with which words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.cosim.errors import ScenarioError, SweepError
from interarea.cosim.scenario.channels import derived_seed
from interarea.cosim.sweep.plan import plan_of_document, plan_sweep
from interarea.cosim.sweep.point import point_of
from interarea.cosim.sweep.spec import load_sweep, split_path


def test_a_grid_has_every_combination_once(document: Any) -> None:
    sweep = load_sweep(document())
    assert sweep.size == 12
    rows = [tuple(sweep.values(k).values()) for k in range(12)]
    assert sorted(rows) == [(a, b) for a in (0.1, 0.2, 0.3) for b in (0.0, 0.2, 0.5, 0.7)]


def test_a_decimal_range_stays_decimal(document: Any) -> None:
    table = {
        "latency": {"path": "channels.remote.latency_s", "range": {"start": 0, "stop": 0.7, "step": 0.1}}
    }
    sweep = load_sweep(document(parameters=table))
    assert [sweep.values(k)["latency"] for k in range(sweep.size)] == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]


def test_a_logarithmic_range_has_equal_ratios(document: Any) -> None:
    table = {
        "size": {
            "path": "event.1.size_pu",
            "range": {"start": 1e-3, "stop": 1e-1, "count": 5, "scale": "log"},
        }
    }
    sweep = load_sweep(document(parameters=table))
    values = np.array([sweep.values(k)["size"] for k in range(5)])
    assert values[1:] / values[:-1] == pytest.approx([10**0.5] * 4)


def test_latin_hypercube_puts_one_draw_in_each_of_n_cells(document: Any) -> None:
    table = {
        "latency": {"path": "channels.remote.latency_s", "latin_hypercube": {"low": 0.0, "high": 0.4}},
        "size": {"path": "event.1.size_pu", "latin_hypercube": {"low": 1e-3, "high": 1e-1, "scale": "log"}},
    }
    sweep = load_sweep(document(parameters=table, samples=40))
    values = [sweep.values(k) for k in range(40)]
    cells = sorted(int(v["latency"] / 0.01) for v in values)
    logs = sorted(int(40 * (np.log10(v["size"]) + 3.0) / 2.0) for v in values)
    assert cells == list(range(40))
    assert logs == list(range(40))
    assert all(round(v["latency"], 9) == v["latency"] for v in values)  # on the clock's tick


def test_draws_depend_on_seed_and_name_only_and_every_cell_has_the_same(document: Any) -> None:
    table = {
        "loss": {"path": "channels.*.loss.rate", "values": [0.0, 0.5]},
        "size": {"path": "event.1.size_pu", "random": {"mean": 0.05, "deviation": 0.01}},
    }
    one = load_sweep(document(parameters=table, samples=500))
    other = load_sweep(document(parameters=table, samples=500, seed=4))
    draws = [one.values(k)["size"] for k in range(500)]
    assert draws == [one.values(k)["size"] for k in range(500, 1000)]
    assert one.values(7)["size"] != other.values(7)["size"]
    assert np.mean(draws) == pytest.approx(0.05, abs=4 * 0.01 / 500**0.5)  # four standard errors
    assert np.std(draws) == pytest.approx(0.01, rel=4 / 1000**0.5)


def test_runs_with_the_same_case_are_neighbours(document: Any) -> None:
    table = {
        "loss": {"path": "channels.*.loss.rate", "values": [0.0, 0.5]},
        "tie": {"path": "case.tie_flow_mw", "values": [0.0, 50.0, 100.0]},
    }
    sweep = load_sweep(document(parameters=table))
    assert [sweep.values(k)["tie"] for k in range(6)] == [0.0, 0.0, 50.0, 50.0, 100.0, 100.0]


def test_values_reach_scenario_case_and_controller(document: Any, two_area: Any) -> None:
    table = {
        "loss": {"path": "channels.*.loss.rate", "values": [0.25]},
        "size": {"path": "event.1.size_pu", "values": [0.07]},
        "H": {"path": "case.machines.G1.H", "values": [7.5]},
        "tie": {"path": "case.tie_flow_mw", "values": [80.0]},
        "gain": {"path": "controller.gain", "values": [2.0]},
        "limit": {"path": "controller.limit", "values": [0.1]},
        "seed": {"values": [5]},
    }
    sweep = load_sweep(document(parameters=table))
    point = point_of(sweep, sweep.values(0))
    channels = point.scenario.channels
    assert channels["remote"].loss is not None and channels["remote"].loss.rate == 0.25  # type: ignore[union-attr]
    assert channels["local"].loss == channels["remote"].loss
    assert point.scenario.event[0].size_pu == 0.07
    assert (channels["remote"].seed, channels["local"].seed) == (
        derived_seed(5, "remote"),
        derived_seed(5, "local"),
    )
    assert channels["remote"].seed != channels["local"].seed
    case = point.change.apply(two_area)
    assert case.machine("G1").H == 7.5
    assert case.load("L9").P_mw == two_area.load("L9").P_mw + 80.0
    assert (point.gain, dict(point.controller_start)) == (2.0, {"limit": 0.1})


def test_a_plan_survives_being_written_down(document: Any, cache: Path) -> None:
    plan = plan_sweep(load_sweep(document()), cache)
    again = plan_of_document(plan.document())
    assert again.hash == plan.hash
    assert again.sweep.values(5) == plan.sweep.values(5)
    assert plan_sweep(load_sweep(document(seed=4)), cache).hash != plan.hash


def test_a_quoted_word_may_hold_a_dot() -> None:
    assert split_path('case.branches."8-9 a.b".x', "p") == ("case", "branches", "8-9 a.b", "x")
    for wrong in ("", "a..b", "a.", ".a", '"a"b'):
        with pytest.raises(SweepError, match="allowed: words with dots"):
            split_path(wrong, "p")


def _p(**one: Any) -> dict[str, Any]:
    return {"parameters": {"x": one}}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            _p(path="channels.remote.latncy_s", values=[0.1]),
            r"'latncy_s' is no key of a channel; did you mean 'latency_s'",
        ),
        (_p(path="channels.remot.latency_s", values=[0.1]), r"'remot' is no channel; did you mean 'remote'"),
        (
            _p(path="chanels.remote.latency_s", values=[0.1]),
            r"cannot be varied; did you mean 'channels'",
        ),
        (_p(path="event.2.size_pu", values=[0.1]), r"event.K.KEY with K from 1 to 1"),
        (_p(path="event.1.size", values=[0.1]), r"did you mean 'size_pu'"),
        (_p(path="case.machines.G9.H", values=[1.0]), r"'G9' is no row of machines"),
        (_p(path="case.machines.G1.Hh", values=[1.0]), r"no key of machines; did you mean 'H'"),
        (_p(path="case.tie_flow", values=[1.0]), r"did you mean 'tie_flow_mw'"),
        (_p(path="controller.limits", values=[1.0]), r"did you mean 'limit'"),
        (_p(path="master.inptus", values=["hermite"]), r"did you mean 'inputs'"),
        (_p(values=[1.0]), r"'x' cannot be varied"),
        (
            _p(path="channels.remote.loss.rate", values=[1.5]),
            r"the value 1.5 does not fit: .*rate = 1.5, allowed",
        ),
        (_p(path="channels.remote.latency_s", values=["late"]), r"the value 'late' does not fit"),
        (_p(path="case.machines.G1.H", values=[-1.0]), r"the value -1.0 does not fit"),
        (_p(path="event.1.start_s", values=[9.0]), r"the value 9.0 does not fit"),
        (_p(path="channels.remote.latency_s", values=[]), r"0 runs, since parameters.x has no values"),
        (_p(path="channels.remote.latency_s", values=[0.1, 0.1]), r"values has 0.1 twice"),
        (
            _p(path="seed", range={"start": 1, "stop": 1e6, "step": 1}),
            r"1,000,000 runs = 1000000 \(x\).*--large",
        ),
        (_p(path="seed", range={"start": 1, "stop": 9, "step": -1}), r"step = -1 never leads from 1 to 9"),
        (_p(path="seed", range={"start": 1, "stop": 9}), r"a range has step or count"),
        (
            _p(path="seed", range={"start": 0, "stop": 9, "count": 3, "scale": "log"}),
            r"allowed: both above 0",
        ),
        (
            _p(path="seed", values=[1], random={"low": 0, "high": 1}),
            r"has values and random, allowed: exactly one",
        ),
        (_p(path="seed"), r"has no values, allowed: exactly one"),
        (_p(path="seed", valeus=[1]), r"did you mean 'values'"),
        (_p(path="seed", random={"low": 0.0, "high": 1.0}), r"samples is missing"),
        (_p(path="seed", latin_hypercube={"low": 1.0, "high": 1.0}) | {"samples": 2}, r"allowed: low < high"),
        (_p(path="seed", values=[1]) | {"samples": 2}, r"no parameter has latin_hypercube or random"),
        (_p(path="seed", values=[1]) | {"metrics": ["dampng"]}, r"did you mean 'damping'"),
        ({"metrcs": []}, r"no such key; did you mean 'metrics'"),
        ({"parameters": {"run": {"path": "seed", "values": [1]}}}, r"none of the result's columns"),
        (
            {"parameters": {"a": {"path": "seed", "values": [1]}, "b": {"path": "seed", "values": [2]}}},
            r"set by parameters.a too",
        ),
        (
            {
                "parameters": {
                    "a": {"path": "seed", "values": [1]},
                    "b": {"path": "channels.*.seed", "values": [2]},
                }
            },
            r"both set the seed of a channel",
        ),
        (
            {
                "parameters": {
                    "a": {"path": "channels.remote.loss", "values": [1]},
                    "b": {"path": "channels.remote.loss.rate", "values": [0.2]},
                }
            },
            r"overwrite each other",
        ),
        (
            {
                "parameters": {
                    "a": {"path": "stop_s", "bisect": {"low": 1, "high": 2, "tolerance": 0.1}},
                    "b": {"path": "event.1.size_pu", "bisect": {"low": 1, "high": 2, "tolerance": 0.1}},
                }
            },
            r"bisect in a and b, allowed: in one parameter",
        ),
        (_p(path="controller", values=["nobody"]), r"neither a name nor a file"),
        (_p(path="controller", range={"start": 0, "stop": 1, "count": 2}), r"controller needs names"),
    ],
)
def test_a_mistake_is_refused_in_one_line(document: Any, cache: Path, change: Any, words: str) -> None:
    with pytest.raises((SweepError, ScenarioError), match=words) as caught:
        plan_sweep(load_sweep(document(**change)), cache)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = [", "not valid TOML"),
        ("seed = 1", "scenario is missing"),
        ("scenario = 3", "allowed: a file, a bundled name"),
        ('scenario = "lost-sgnal"', "did you mean 'lost-signal'"),
        ('scenario = "nothere.toml"', "no such scenario file"),
        ("\udcff", "not valid TOML"),
    ],
)
def test_a_file_that_is_no_sweep(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "s.toml"
    file.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises((SweepError, ScenarioError), match=words):
        load_sweep(file)
