"""Laws of what the user writes: it comes back as it went, and what does not fit is reported in one line."""

from __future__ import annotations

import copy
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interarea.cosim.errors import ScenarioError, SweepError
from interarea.cosim.scenario.document import scenario_document
from interarea.cosim.scenario.scenario import load_scenario
from interarea.cosim.sweep.plan import plan_sweep
from interarea.cosim.sweep.spec import load_sweep
from interarea.models.case.case import Case, case_of, load_case
from interarea.models.case.write_toml import export_toml
from interarea.models.errors import CaseError
from interarea.models.grid.equilibrium import operating_point

milliseconds = st.integers(0, 3000).map(lambda n: n / 1000)
#: no control characters: files that hold them are refused
words = st.text(st.characters(codec="utf-8", exclude_categories=["Cc"]), max_size=12)

SCENARIO: dict[str, Any] = {
    "title": "A title",
    "case": "two-area-thesis",
    "controller": "none",
    "stop_s": 4.0,
    "step_s": 0.01,
    "channels": {
        "remote": {
            "signal": "G2_dw",
            "latency_s": 0.1,
            "on_loss": "hold",
            "reporting_interval_s": 0.02,
            "jitter_s": 0.01,
            "latency": {"kind": "gamma", "shape": 2.0, "scale_s": 0.01},
            "loss": {"kind": "gilbert_elliott", "good_to_bad": 0.1, "bad_to_good": 0.3},
            "seed": 4,
            "outages_s": [[1.0, 2.0]],
        },
        "local": {
            "signal": "G4_dw",
            "reporting_interval_s": 0.02,
            "latency": {"kind": "empirical", "quantiles_s": [0.0, 0.1]},
            "loss": {"kind": "bernoulli", "rate": 0.1},
        },
    },
    "fmus": {"mine": {"file": "mine.fmu", "start": {"gain": 3.0}, "latency_s": 0.1, "isolate": True}},
    "connections": [["plant.G1_dw", "mine.u"]],
    "event": [
        {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 0.7},
        {"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": 1.1, "x_pu": 1e-4},
        {"kind": "branch_trip", "branch": "8-9 a", "start_s": 1.1},
    ],
    "master": {"inputs": "linear", "loops": "auto", "tolerance": 1e-6, "arrivals": "grid"},
    "expect": {"stable": True, "damping_ratio": {"inter-area": [0.1, 0.2]}, "settling_time_s": [1.0, 9.0]},
}
SWEEP: dict[str, Any] = {
    "scenario": {k: SCENARIO[k] for k in ("case", "stop_s", "channels", "event")},
    "seed": 3,
    "samples": 4,
    "metrics": ["stable", "damping"],
    "time_limit_s": 10.0,
    "trajectories": {"keep": "unstable", "columns": ["plant.G1_dw"], "every": 2},
    "parameters": {
        "a": {"path": "channels.remote.latency_s", "values": [0.1, 0.2]},
        "b": {"path": "channels.*.loss.rate", "range": {"start": 0.0, "stop": 0.4, "step": 0.1}},
        "c": {"path": "event.1.size_pu", "latin_hypercube": {"low": 0.1, "high": 0.2, "digits": 3}},
        "d": {"path": "case.load_scale", "random": {"mean": 1.0, "deviation": 0.01, "low": 0.9, "high": 1.1}},
    },
}
SWEEP["scenario"]["channels"] = {
    n: {**c, "loss": {"kind": "bernoulli", "rate": 0.1}} for n, c in SCENARIO["channels"].items()
}


def toml(value: Any) -> str:
    """Write a value as TOML; tables inline. JSON's strings and numbers are TOML's too."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(k)} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml(v) for v in value) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def file_of(table: dict[str, Any], folder: str) -> Path:
    path = Path(folder) / "file.toml"
    path.write_text("".join(f"{k} = {toml(v)}\n" for k, v in table.items()), encoding="utf-8")
    return path


@st.composite
def channels(draw: st.DrawFn) -> dict[str, Any]:
    table: dict[str, Any] = {
        "latency_s": draw(milliseconds),
        "on_loss": draw(st.sampled_from(["zero", "hold"])),
    }
    if draw(st.booleans()):
        table |= {
            "reporting_interval_s": draw(st.integers(1, 100)) / 1000,
            "jitter_s": draw(milliseconds),
            "seed": draw(st.integers(0, 2**31 - 1)),
            "loss": {"kind": "bernoulli", "rate": draw(st.floats(0.0, 1.0))},
        }
    edges = sorted(draw(st.lists(st.integers(0, 3900), max_size=6, unique=True)))
    table["outages_s"] = [[a / 1000, b / 1000] for a, b in zip(edges[::2], edges[1::2], strict=False)]
    return table


@st.composite
def scenarios(draw: st.DrawFn) -> dict[str, Any]:
    table: dict[str, Any] = {
        "case": "two-area-thesis",
        "stop_s": 4.0,
        "title": draw(words),
        "source": draw(words),
    }
    signals = draw(st.lists(st.sampled_from(["G1_dw", "G2_dw", "G3_dw", "G4_dw"]), unique=True))
    table["channels"] = {f"from_{s}": {"signal": s, **draw(channels())} for s in signals}
    pulses = draw(
        st.lists(st.tuples(st.integers(0, 3000), st.integers(1, 900), st.floats(-0.1, 0.1)), max_size=3)
    )
    table["event"] = [
        {"kind": "vref_pulse", "machine": "G1", "size_pu": s, "start_s": a / 1000, "end_s": (a + d) / 1000}
        for a, d, s in pulses
    ]
    if draw(st.booleans()):
        table["master"] = {
            "tolerance": draw(st.floats(1e-12, 0.5)),
            "inputs": draw(st.sampled_from(["hermite", "linear"])),
        }
    return table


@pytest.mark.slow
@settings(max_examples=50)
@given(scenarios())
def test_a_scenario_written_down_is_the_same_scenario(table: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        first = load_scenario(file_of(table, folder))
        again = load_scenario(file_of(scenario_document(first), folder))
    assert again == first
    assert again.event_times_s == first.event_times_s
    for name, channel in first.channels.items():
        assert again.channels[name].parameters("x") == channel.parameters("x")
    assert load_scenario(table).model_dump(exclude={"name", "folder"}) == first.model_dump(
        exclude={"name", "folder"}
    )


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every place in a document, from the outside in."""
    if at:
        yield at
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(inner, (*at, key))


#: what nobody means, for any key
SPOILT = st.one_of(
    st.sampled_from(
        [
            -1,
            0,
            -1e-09,
            1e308,
            10**30,
            float("nan"),
            float("inf"),
            True,
            False,
            "",
            " ",
            "x",
            "..",
            "a.b",
            [],
            {},
            [[]],
            [{}],
            {"": 1},
            {"x": {"y": 1}},
            [1, "a"],
            "0.1",
            1e-12,
            0.1 + 1e-13,
            2**63,
            -(2**63),
            "\n",
            "\x1b",
        ]
    ),
    words,
    st.floats(allow_nan=False, allow_infinity=False),
    st.integers(-(10**20), 10**20),
    st.lists(st.one_of(words, st.integers(), st.none().map(lambda _: [])), max_size=3),
)


def spoilt(document: dict[str, Any], data: st.DataObject) -> dict[str, Any]:
    """Change, remove or misname one entry of a document."""
    table = copy.deepcopy(document)
    at = data.draw(st.sampled_from(sorted(places(table), key=repr)))
    inner: Any = table
    for word in at[:-1]:
        inner = inner[word]
    how = data.draw(st.sampled_from(["change", "change", "change", "remove", "misname"]))
    if how == "change":
        inner[at[-1]] = data.draw(SPOILT)
    elif how == "misname" and isinstance(inner, dict):
        inner[data.draw(words) or "q"] = inner.pop(at[-1])
    else:
        del inner[at[-1]]
    return table


def check_lines(error: Exception) -> None:
    assert error.args and all(a and "\n" not in a and len(a) < 1000 for a in error.args)


@pytest.mark.slow
@settings(max_examples=400)
@given(st.data())
def test_a_spoilt_scenario_loads_or_is_refused_in_one_line(data: st.DataObject) -> None:
    table = spoilt(SCENARIO, data)
    try:
        load_scenario(table)
    except ScenarioError as error:
        check_lines(error)


@pytest.mark.slow
@settings(max_examples=150)
@given(st.data())
def test_a_spoilt_sweep_is_planned_or_refused_in_one_line(cache: Path, data: st.DataObject) -> None:
    table = spoilt(SWEEP, data)
    try:
        plan = plan_sweep(load_sweep(table), cache)
    except (SweepError, ScenarioError, CaseError) as error:
        check_lines(error)
    else:
        values = plan.sweep.values(plan.sweep.size - 1)
        assert set(values) == set(plan.sweep.parameters)


def small_case() -> dict[str, Any]:
    return dict(json.loads(json.dumps(load_case("two-area-thesis").document())))


@pytest.mark.slow
@settings(max_examples=200)
@given(st.data())
def test_a_spoilt_case_loads_or_is_refused_in_one_line(data: st.DataObject) -> None:
    try:
        case_of(spoilt(small_case(), data), where="spoilt")
    except CaseError as error:
        check_lines(error)


@pytest.mark.slow
@settings(max_examples=25)
@given(
    words, words, st.floats(0.9, 1.05), st.floats(2.0, 9.0), st.floats(0.0, 2.0),
    st.sampled_from(["two-area-thesis", "kundur-thyristor", "kundur-manual"]),
)  # fmt: skip
def test_a_case_written_out_has_the_same_operating_point(
    title: str, source: str, factor: float, H: float, damping: float, name: str
) -> None:
    base = load_case(name)
    document = json.loads(json.dumps(base.document()))
    document |= {"title": title, "source": source or "x"}
    for load in (row for row in document["loads"].values() if isinstance(row, dict)):
        load["P_mw"] *= factor
    machine = document["machines"]["G1"]
    machine |= {"H": H, "D": damping}
    changed = case_of(document, where="changed")
    with tempfile.TemporaryDirectory() as folder:
        export_toml(changed, Path(folder) / "case.toml")
        loaded: Case = load_case(Path(folder) / "case.toml")
    assert loaded.hash == changed.hash and (loaded.title, loaded.source) == (changed.title, changed.source)
    original, there = operating_point(changed), operating_point(loaded)
    assert list(original.x0) == list(there.x0)


def test_what_is_spoilt_here_is_sound(cache: Path) -> None:
    assert load_scenario(SCENARIO).channels["local"].loss is not None
    assert plan_sweep(load_sweep(SWEEP), cache).sweep.size == 2 * 5 * 4
    with pytest.raises(CaseError):
        case_of({}, where="nothing")
