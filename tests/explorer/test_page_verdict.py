"""The page's verdict is that of `cosim.results.verdict`: both on the same signals, and on a run of each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.cosim.results import verdict as v
from interarea.cosim.run.run import run_scenario

H = 0.0625  #: a power of two: windows begin and end at points to the last bit
EDGE = 4 * H
LIMIT_PU = 0.05


def random_run(rng: np.random.Generator) -> dict[str, Any]:
    """Return signals of two islands with what decays, stands and grows, and marks on the grid of points."""
    stop = float(rng.choice([4.0, 8.0, 20.0, 60.0]))
    t = np.round(np.arange(0.0, stop + H / 2, H), 10)

    def swing(size: float) -> np.ndarray:
        rate = rng.choice([-0.6, -0.1, -1e-3, 0.0, 0.02, 0.1])
        return size * np.exp(rate * t) * np.sin(2 * np.pi * rng.uniform(0.2, 1.5) * t + rng.uniform(0, 6))

    common = swing(rng.choice([0.0, 1e-4, 2e-3])) + rng.choice([0.0, 1e-4]) * t
    together = bool(rng.random() < 0.5)
    one, two = swing(1e-3), swing(rng.choice([1e-3, 1e-5]))
    speeds = [[one, two, common - one - two if together else -one - two], [swing(1e-4)]]
    if rng.random() < 0.1:
        speeds = [[0.0 * t, 0.0 * t], [0.0 * t]]
    controls = [np.clip(swing(0.03), -LIMIT_PU, LIMIT_PU) for _ in range(rng.integers(0, 3))]
    instants = np.round(rng.integers(0, int(stop / EDGE) + 20, size=4) * EDGE, 10)
    events = sorted(float(x) for x in instants[: rng.integers(0, 3)])
    outages = sorted(float(x) for x in instants[2 : 2 + rng.integers(0, 3)])
    return {
        "time": t,
        "stop": stop,
        "speeds": speeds,
        "controls": controls,
        "events": events,
        "outages": outages,
    }


def by_python(one: dict[str, Any]) -> v.Verdict:
    speeds = [x for span in one["speeds"] for x in span]
    rows, first = [], 0
    for span in one["speeds"]:
        rows.append(list(range(first, first + len(span))))
        first += len(span)
    names = [f"G{k}" for k in range(len(speeds))]
    marks = [*one["events"], *one["outages"]]
    motion = v.Motion(names, rows, one["events"], marks, one["stop"], 2.0 * np.pi * 60.0)
    controls = {f"u{k}": u for k, u in enumerate(one["controls"])}
    motion.add(one["time"], np.array(speeds), np.zeros((len(speeds), len(one["time"]))), controls)
    return motion.verdict(LIMIT_PU)


@pytest.mark.slow
def test_both_give_the_same_verdict_by_the_same_spans(node: Any) -> None:
    rng = np.random.default_rng(7)
    runs = [random_run(rng) for _ in range(300)]
    jobs = [
        {
            "decay": {
                "speeds": [[x.tolist() for x in span] for span in one["speeds"]],
                "controls": [u.tolist() for u in one["controls"]],
                "limit": LIMIT_PU,
                "h": H,
                "stop": one["stop"],
                "events": one["events"],
                "marks": [*one["events"], *one["outages"]],
            }
        }
        for one in runs
    ]
    seen: dict[str, int] = {}
    for k, (one, page) in enumerate(zip(runs, node(jobs), strict=True)):
        expected = by_python(one)
        seen[expected.name] = seen.get(expected.name, 0) + 1
        assert page["kind"] == expected.name, (expected, page)
        assert page["window"] == pytest.approx(list(expected.window_s))
        if expected.name != v.NOT_JUDGED and not page["atLimit"]:
            spans = [expected.largest, expected.before, expected.last]
            assert page["spans"] == pytest.approx(spans, rel=1e-9, abs=1e-15), (k, expected)
    assert set(seen) == {v.SETTLED, v.SLOW, v.STANDING, v.GROWING, v.NOT_JUDGED} and min(seen.values()) > 5


@pytest.mark.slow
def test_a_run_of_the_page_and_of_the_command_come_to_the_same(
    node: Any, data: dict[str, Any], tmp_path: Path
) -> None:
    """Each preset, two shorter faults and the scenarios that the page saves of them."""
    fault = data["presets"][5]["state"]
    states = [preset["state"] for preset in data["presets"]] + [
        fault | {"tc": 50},
        fault | {"tc": 50, "k": "ftc"},
    ]
    pages = node([{"judge": state} for state in states])
    texts = node([{"toml": state} for state in states])
    for k, (page, text) in enumerate(zip(pages, texts, strict=True)):
        file = tmp_path / f"{k}.toml"
        file.write_text(text.replace("joint = true", "joint = false"), encoding="utf-8")
        run = run_scenario(file)
        assert page["kind"] == run.verdict.name, (k, run.verdict)
        if page["kind"] == v.LOST:
            assert page["t"] == pytest.approx(run.verdict.lost_s, abs=0.03)
