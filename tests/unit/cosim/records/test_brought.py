"""The damping that a controller brought, from two records, against the poles of the loop."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from command_line import invoke
from test_meter import ambient, with_sine

import interarea as ia
from interarea.cosim.records.brought import brought
from interarea.cosim.records.record import Record, RecordError

sys.path.append(str(Path(__file__).parents[4] / "benchmarks" / "records"))
from damping_gained import damping, loop

CASE = "two-area-thesis"


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.1, 0.3, 1.0])
def test_the_difference_is_that_of_the_poles(gain: float) -> None:
    """Of four pairs of records the interval holds the poles' difference in two at least."""
    truth = damping(gain) - damping(0.0)
    assert truth == pytest.approx({0.1: 0.032, 0.3: 0.092, 1.0: 0.255}[gain], abs=1e-3)
    inside = 0
    for seed in range(4):
        result = brought(ambient(seed, 600.0, loop(gain)), ambient(100 + seed, 600.0, loop(0.0)))
        first = min(result.differences, key=lambda d: abs(d.frequency_hz - 0.62))
        inside += first.interval[0] <= truth <= first.interval[1]
        if gain == 0.3:
            assert first.interval[1] - first.interval[0] < 0.3
            assert ("rose by" in first.sentence) == first.shown
    assert inside >= 2


@pytest.mark.slow
def test_without_a_difference_the_record_is_said_to_be_too_short_and_forced_lines_are_left_out() -> None:
    before, after = ambient(7, 600.0, loop(0.0)), ambient(8, 600.0, loop(0.0))
    result = brought(with_sine(after, 0.7, 2.0), before)
    first = min(result.differences, key=lambda d: abs(d.frequency_hz - 0.62))
    assert any(s.kind == "forced" for s in result.swings)
    assert not first.shown
    assert first.interval[0] < 0.0 < first.interval[1]
    assert "no significant difference in the damping" in first.sentence
    assert "records of 9.98 min resolve" in first.sentence or "records of 10 min resolve" in first.sentence
    assert first.wanted_s is not None
    assert first.wanted_s > 600.0


@pytest.mark.slow
def test_the_bundled_controller_raises_the_damping_of_ten_minutes_of_load_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = {"kind": "load_noise", "size_pu": 0.01, "corner_hz": 0.5, "seed": 1, "start_s": 0.0}
    ratios, paths = [], []
    for name in ("active", "none"):
        run = ia.simulate(
            {"case": CASE, "stop_s": 600.0, "controller": "active", "event": [noise]}, controller=name
        )
        run.save(tmp_path / name)
        ratios.append(run.metrics.damping_ratio["inter-area"])
        paths.append(tmp_path / name / "trajectory.parquet")
    result = ia.meter(paths[0], beside=paths[1])
    first = result.as_dict()["differences"][0]
    assert first["shown"]
    low, high = first["interval"]
    assert low < ratios[0] - ratios[1] < high  # 0.381 - 0.081
    assert "the damping of the swing at 0.62" in result.as_dict()["sentence"]
    words = ["meter", str(paths[0]), "--beside", str(paths[1])]
    code, out, _ = invoke(words, monkeypatch)
    assert code == 0
    assert result.as_dict()["sentence"] in out
    code, out, _ = invoke([*words, "--json"], monkeypatch)
    assert json.loads(out)["sentence"] == result.as_dict()["sentence"]
    code, out, err = invoke(["meter", str(paths[0]), "--beside", str(paths[0])], monkeypatch)
    assert (code, out) == (2, "")
    assert "contain the same data" in err


@pytest.mark.slow
def test_records_without_a_common_signal_or_mode_are_refused() -> None:
    record = ambient(1, 300.0)
    with pytest.raises(RecordError, match="contain the same data, wanted: one record with the controller"):
        brought(record, record)
    channels = tuple(type(c)(f"other.{c.name}", c.quantity, c.unit, c.terminal) for c in record.channels)
    other = Record("other", record.time_s, ambient(2, 300.0).values, channels)
    with pytest.raises(RecordError, match="no channel of speed has the same name in both"):
        brought(record, other)
    with pytest.raises(RecordError, match=r"60 s .* too short for a damping ratio"):
        brought(record, ambient(3, 60.0))
