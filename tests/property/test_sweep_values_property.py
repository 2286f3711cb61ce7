"""Laws of what a sweep file says: how many runs, which values, and that nothing else decides them."""

from __future__ import annotations

import itertools
import json
import math
from collections import Counter
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from interarea.cosim.errors import SweepError
from interarea.cosim.sweep.plan import plan_sweep
from interarea.cosim.sweep.point import OPERATING
from interarea.cosim.sweep.spec import LARGEST, Sweep, load_sweep, sweep_of
from interarea.cosim.sweep.values import Interval, Parameter, Range

SCENARIO: dict[str, Any] = {
    "case": "two-area-thesis",
    "stop_s": 4.0,
    "channels": {
        "remote": {"signal": "G2_dw", "reporting_interval_s": 0.02},
        "local": {"signal": "G4_dw", "reporting_interval_s": 0.02},
    },
    "event": [{"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 0.7}],
}
PATHS = (
    "channels.remote.latency_s",
    "channels.*.loss.rate",
    "event.1.size_pu",
    "case.machines.G1.H",
    "stop_s",
    "seed",
)
#: numbers of few digits, as people write them
decimals = st.builds(lambda m, e: float(f"{m}e{e}"), st.integers(-999, 999), st.integers(-6, 3))
positive = st.builds(lambda m, e: float(f"{m}e{e}"), st.integers(1, 999), st.integers(-6, 3))


@st.composite
def ranges(draw: st.DrawFn) -> dict[str, Any]:
    start = draw(decimals)
    if draw(st.booleans()):
        step = draw(positive) * draw(st.sampled_from([1, -1]))
        steps = draw(st.integers(0, 30))
        return {
            "start": start,
            "stop": float(Fraction(str(start)) + steps * Fraction(str(step))),
            "step": step,
        }
    return {"start": start, "stop": draw(decimals), "count": draw(st.integers(1, 12))}


@st.composite
def intervals(draw: st.DrawFn) -> dict[str, Any]:
    scale = draw(st.sampled_from(["linear", "log"]))
    low = draw(positive if scale == "log" else decimals)
    high = draw(positive if scale == "log" else decimals)
    assume(low < high)
    table: dict[str, Any] = {"low": low, "high": high, "scale": scale}
    return table | ({"digits": draw(st.integers(0, 9))} if draw(st.booleans()) else {})


grids = st.one_of(
    st.lists(decimals, min_size=1, max_size=5, unique=True).map(lambda v: {"values": v}),
    ranges().map(lambda r: {"range": r}),
)
sampled = st.one_of(
    intervals().map(lambda t: {"latin_hypercube": t}),
    intervals().map(lambda t: {"random": t}),
    st.builds(lambda m, d: {"random": {"mean": m, "deviation": d}}, decimals, positive),
    st.lists(decimals, min_size=1, max_size=4).map(lambda v: {"random": {"choose": v}}),
)


@st.composite
def sweeps(draw: st.DrawFn) -> dict[str, Any]:
    """A sweep of up to four parameters, some of them drawn."""
    paths = draw(st.lists(st.sampled_from(PATHS), min_size=1, max_size=4, unique=True))
    tables = {f"p{k}": {"path": p, **draw(st.one_of(grids, sampled))} for k, p in enumerate(paths)}
    document: dict[str, Any] = {
        "scenario": SCENARIO,
        "parameters": tables,
        "seed": draw(st.integers(0, 2**63 - 1)),
    }
    if any("latin_hypercube" in t or "random" in t for t in tables.values()):
        document["samples"] = draw(st.integers(1, 7))
    return document


@pytest.mark.slow
@settings(max_examples=60)
@given(sweeps())
def test_every_cell_of_the_grid_is_run_once_for_each_sample(document: dict[str, Any]) -> None:
    sweep = load_sweep(document)
    listed = {n: p for n, p in sweep.parameters.items() if not p.sampled}
    size = math.prod(p.size for p in listed.values()) * (sweep.samples or 1)
    assert sweep.size == size
    assume(size <= 2000)
    cells = Counter(tuple(sweep.values(k)[n] for n in listed) for k in range(size))
    grid = [[p.grid_value(k) for k in range(p.size)] for p in listed.values()]
    assert cells == Counter(cell for cell in itertools.product(*grid) for _ in range(sweep.samples or 1))
    for n, p in listed.items():
        assert {cell[list(listed).index(n)] for cell in cells} == {p.grid_value(k) for k in range(p.size)}
    for run in (-1, size):
        with pytest.raises(SweepError, match="does not exist, allowed: 0 to"):
            sweep.values(run)


@pytest.mark.slow
@settings(max_examples=60)
@given(sweeps(), st.data())
def test_a_run_knows_its_values_without_the_others_and_on_any_machine(
    document: dict[str, Any], data: st.DataObject
) -> None:
    sweep = load_sweep(document)
    runs = [data.draw(st.integers(0, sweep.size - 1)) for _ in range(4)]
    there: Sweep = sweep_of(json.loads(json.dumps(sweep.document())), "sweep", Path())  # as a worker gets it
    assert [there.values(k) for k in reversed(runs)] == [sweep.values(k) for k in reversed(runs)]
    assert there.document() == sweep.document()


@pytest.mark.slow
@settings(max_examples=60)
@given(sweeps(), st.data())
def test_draws_of_a_parameter_do_not_depend_on_the_others(
    document: dict[str, Any], data: st.DataObject
) -> None:
    drawn = [n for n, t in document["parameters"].items() if "latin_hypercube" in t or "random" in t]
    assume(drawn)
    name = data.draw(st.sampled_from(drawn))
    alone = load_sweep(document | {"parameters": {name: document["parameters"][name]}})
    together = load_sweep(document)
    samples = document["samples"]
    values = [alone.values(k)[name] for k in range(samples)]
    assert Counter(together.values(k)[name] for k in range(min(together.size, 400 * samples))) <= Counter(
        {v: n * together.size for v, n in Counter(values).items()}
    )
    assert {together.values(k)[name] for k in range(min(together.size, 200))} <= set(values)


@pytest.mark.slow
@settings(max_examples=100)
@given(intervals(), st.integers(1, 60), st.integers(0, 2**63 - 1))
def test_a_latin_hypercube_has_one_value_in_each_stratum_and_stays_within_its_limits(
    table: dict[str, Any], samples: int, seed: int
) -> None:
    p = Parameter(latin_hypercube=Interval(**table))
    low, high = table["low"], table["high"]
    values = [p.drawn_value("x", seed, k, samples, is_time=False) for k in range(samples)]
    assert all(low <= v <= high for v in values)
    if "digits" in table:
        assert all(v in (low, high) or round(v, table["digits"]) == v for v in values)
        return
    if table["scale"] == "log":
        strata = [samples * math.log(v / low) / math.log(high / low) for v in values]
    else:
        strata = [samples * (v - low) / (high - low) for v in values]
    # a value is where its stratum is, but for rounding beside an edge
    for k, at in enumerate(sorted(strata)):
        assert k - 1e-6 <= at <= k + 1 + 1e-6


@settings(max_examples=150)
@given(ranges())
def test_a_range_holds_the_decimal_numbers_that_its_words_mean(table: dict[str, Any]) -> None:
    r = Range(**table)
    start, stop = Fraction(str(table["start"])), Fraction(str(table["stop"]))
    if "step" in table:
        step = Fraction(str(table["step"]))
        expected = [float(start + k * step) for k in range((stop - start) // step + 1)]
        assert abs(start + r.size * step - start) > abs(stop - start)  # one more would lie beyond
    else:
        n = table["count"]
        expected = [float(start + (stop - start) * k / max(1, n - 1)) for k in range(n)]
    assert [r.value(k) for k in range(r.size)] == expected


@settings(max_examples=60)
@given(positive, positive, st.integers(2, 50))
def test_a_logarithmic_range_ends_where_it_says(start: float, stop: float, count: int) -> None:
    r = Range(start=start, stop=stop, count=count, scale="log")
    values = [r.value(k) for k in range(count)]
    assert (values[0], values[-1]) == (start, stop)
    for k, value in enumerate(values):
        assert value == pytest.approx(start * (stop / start) ** (k / (count - 1)), rel=1e-9)


@settings(max_examples=40)
@given(
    st.floats(-1e308, 1e308), st.floats(-1e308, 1e308), st.floats(1e-300, 1e300), st.sampled_from([1.0, -1.0])
)
def test_a_range_of_any_size_is_counted_or_refused(a: float, b: float, step: float, sign: float) -> None:
    document = {
        "scenario": SCENARIO,
        "parameters": {"seed": {"range": {"start": a, "stop": b, "step": sign * step}}},
    }
    try:
        size = load_sweep(document).size
    except SweepError as error:
        assert "\n" not in str(error) and (b - a) * sign < 0.0
    else:
        assert size == math.floor((Fraction(str(b)) - Fraction(str(a))) / Fraction(str(sign * step))) + 1


@settings(max_examples=30)
@given(st.integers(2, 10**6), st.integers(2, 10**6), st.integers(1, 10**6))
def test_a_huge_grid_is_refused_with_its_size(cache: Path, one: int, other: int, samples: int) -> None:
    assume(one * other * samples > LARGEST)
    document = {
        "scenario": SCENARIO,
        "samples": samples,
        "parameters": {
            "a": {"path": "event.1.size_pu", "range": {"start": 0.0, "stop": 1.0, "count": one}},
            "b": {"path": "stop_s", "range": {"start": 1.0, "stop": 2.0, "count": other}},
            "c": {"path": "seed", "random": {"low": 0.0, "high": 9.0, "digits": 0}},
        },
    }
    with pytest.raises(SweepError, match=f"{one * other * samples:,} runs = .*--large"):
        plan_sweep(load_sweep(document), cache)


WORDS = [
    ("channels.remote.latency_s", 2, "latency_s"),
    ("channels.remote.reporting_interval_s", 1, "remote"),
    ("channels.local.on_loss", 0, "channels"),
    ("event.1.size_pu", 2, "size_pu"),
    ("case.machines.G1.H", 1, "machines"),
    ("case.load_scale", 1, "load_scale"),
    ("master.tolerance", 1, "tolerance"),
]


@settings(max_examples=40)
@given(st.sampled_from(WORDS), st.data())
def test_a_misspelt_path_is_told_the_nearest(
    cache: Path, which: tuple[str, int, str], data: st.DataObject
) -> None:
    path, place, word = which
    words = path.split(".")
    at = data.draw(st.integers(0, len(word) - 1))
    letter = data.draw(st.sampled_from("xqz"))
    words[place] = word[:at] + letter + word[at + data.draw(st.integers(0, 1)) :]
    document = {"scenario": SCENARIO, "parameters": {"p": {"path": ".".join(words), "values": [1.0]}}}
    with pytest.raises(SweepError, match="did you mean") as caught:
        plan_sweep(load_sweep(document), cache)
    assert "\n" not in str(caught.value) and repr(words[place]) in str(caught.value)
    assert repr(word) in str(caught.value)
    assert word not in OPERATING or "case" in str(caught.value)
