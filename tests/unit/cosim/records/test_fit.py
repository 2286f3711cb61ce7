"""A machine played in, and its parameters fitted, against the run of the whole grid that made the record."""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from command_line import invoke

import interarea as ia
from interarea.cosim.records.fit import _jumps
from interarea.cosim.records.play_in import Bench, Terminal, _angle
from interarea.cosim.records.record import Channel, Record, RecordError

CASE = "two-area-thesis"
START = {
    "H": 1.25,
    "exciter.KA": 0.7,
    "stabilizer.K": 1.3,
    "stabilizer.T1": 0.8,
    "governor.Rp": 0.8,
    "Xd1": 1.2,
}
PLACES = ["bus1.re", "bus1.im", "branch[1-5].p", "branch[1-5].q"]


@cache
def run() -> Record:
    """Return what a run with three disturbances beyond G1 shows of G1."""
    events = [
        {"kind": "vref_pulse", "machine": "G2", "size_pu": 0.05, "start_s": 1.0, "end_s": 3.0},
        {"kind": "pm_pulse", "machine": "G3", "size_pu": 0.1, "start_s": 4.0, "end_s": 6.0},
        {"kind": "vref_pulse", "machine": "G3", "size_pu": -0.05, "start_s": 7.0, "end_s": 8.0},
    ]
    result = ia.simulate(
        {"case": CASE, "stop_s": 12.0, "controller": "none", "show": PLACES, "event": events}
    )
    with tempfile.TemporaryDirectory() as folder:
        result.save(folder)
        return ia.read_record(Path(folder) / "trajectory.parquet")


def noisy(share: float, seed: int) -> Record:
    """Return the record with noise on P and Q, a share of what they move."""
    record, rng = run(), np.random.default_rng(seed)
    values = np.array(record.values)
    for k, c in enumerate(record.channels):
        if c.quantity in ("active power", "reactive power"):
            values[:, k] += share * values[:, k].std() * rng.standard_normal(len(values))
    return Record("noisy", record.time_s.copy(), values, record.channels)


@pytest.mark.slow
def test_a_machine_alone_gives_the_powers_that_it_gave_in_the_grid() -> None:
    """Two integrators, two networks: the plant of the grid, and the machine between two ideal sources."""
    result = ia.fit(run(), CASE, "G1", rest_s=0.9)
    assert max(result.misfit) < 0.003
    assert result.parameters == ()
    off = ia.load_case(CASE).with_changes({"machines": {"G1": {"H": 8.0}}})
    assert ia.fit(run(), off, "G1", rest_s=0.9).misfit[0] > 0.05


@pytest.mark.slow
def test_six_parameters_come_back_within_their_covariance() -> None:
    case = ia.load_case(CASE)
    truth = {"H": 6.5, "exciter.KA": 200.0, "stabilizer.K": 12.4424, "stabilizer.T1": 0.1494}
    truth |= {"governor.Rp": 0.05, "Xd1": 0.3}
    for name, value in truth.items():
        change: object = value * START[name]
        for key in reversed(name.split(".")):
            change = {key: change}
        case = case.with_changes({"machines": {"G1": change}})
    result = ia.fit(noisy(0.05, 1), case, "G1", list(truth), rest_s=0.9)
    assert result.misfit[1] > 0.2
    assert max(result.fitted) < 0.06
    assert {p.name for p in result.parameters} | set(result.kept_as_is) == set(truth)
    assert len(result.parameters) >= 5
    for p in result.parameters:
        assert abs(p.value - truth[p.name]) < 4.0 * p.deviation + 0.002 * truth[p.name]
    assert json.dumps(result.as_dict())


@pytest.mark.slow
def test_what_a_record_does_not_show_is_named_and_kept() -> None:
    result = ia.fit(noisy(0.05, 2), CASE, "G1", ["H", "governor.vg_max"], rest_s=0.9)
    assert [p.name for p in result.parameters] == ["H"]
    assert "by any share of it has no visible effect" in result.kept_as_is["governor.vg_max"]
    low, high = result.parameters[0].interval
    assert low - 0.02 < 6.5 < high + 0.02


@pytest.mark.slow
def test_what_cannot_be_played_in_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = run()
    path = tmp_path / "run.parquet"
    record.to_frame().reset_index().to_parquet(path)
    for words, says in (
        (["--machine", "G9"], "no machine 'G9'"),
        (["--machine", "G1", "--parameters", "Hh"], "no field 'Hh'"),
        (["--machine", "G1", "--parameters", "D"], "G1.D is 0 in two-area-thesis"),
        (["--machine", "G1", "--parameters", "P_mw"], "P_mw: cannot be fitted"),
        (["--machine", "G2"], "no voltage angle or frequency at G2, bus2, branch[2-6]"),
        (["--machine", "G1", "--window", "0:1"], "1 s with 0.5 s of steady state, wanted: 2.5 s at least"),
    ):
        code, out, err = invoke(["fit", str(path), "--case", CASE, *words], monkeypatch)
        assert (code, out) == (2, ""), err
        assert says in err
        assert err.count("interarea: ") == 1
    refusals = [
        c.name for c in record.channels if c.quantity != "voltage" and not c.name.endswith((".re", ".im"))
    ]
    with pytest.raises(RecordError, match="rest_s = -1 s of steady state, allowed: above 0"):
        ia.fit(run(), CASE, "G1", rest_s=-1.0)
    with pytest.raises(RecordError, match="no voltage at G1, bus1, "):
        ia.fit(record.only(refusals), CASE, "G1")


@pytest.mark.parametrize("instant", [0.0, 0.2, 0.5, 0.77, 1.0])
def test_a_jump_has_its_instant_in_the_mean_over_a_step(instant: float) -> None:
    """What the sources follow adds up to the voltage before the jump until then, and to that after it."""
    V = np.array([1.0, 1.0, 0.6, 0.6])
    bench = Bench.__new__(Bench)
    bench.V0, bench.angle0 = 1.0, 0.0
    bench.terminal = Terminal(0.01, V, np.zeros(4), V, V, 1)
    begins, ends = bench._driven(5, {1: instant})
    seen = np.array([2.0 * np.cos(0.5 * (side[:, 0] - side[:, 1])) for side in (begins, ends)])
    assert np.mean(seen[:, 5:10]) == pytest.approx(instant * 1.0 + (1.0 - instant) * 0.6, abs=1e-12)
    assert seen[:, :5] == pytest.approx(1.0)
    assert seen[:, 10:] == pytest.approx(0.6)


def test_a_jump_is_found_in_the_step_that_has_it_and_a_swing_is_none() -> None:
    swing = 1.0 + 0.1 * np.sin(2.0 * np.pi * 2.0 * np.arange(200) * 0.01) + 0j
    assert _jumps(swing) == ()
    swing[100:110] *= 0.8 * np.exp(0.1j)
    assert _jumps(swing) == (99, 109)


@pytest.mark.slow
def test_a_record_of_a_fault_gives_parameters_within_a_thousandth() -> None:
    """The record has the fault at 1 s and 1.1 s exactly: at the end of the steps that it jumps in."""
    fault = [{"kind": "bus_fault", "bus": 9, "start_s": 1.0, "end_s": 1.1, "x_pu": 0.01}]
    start = {"H": 1.25, "exciter.KA": 0.7, "stabilizer.K": 1.3}
    truth = {"H": 6.5, "exciter.KA": 200.0, "stabilizer.K": 12.4424}
    case = ia.load_case(CASE)
    for name, value in truth.items():
        change: object = value * start[name]
        for key in reversed(name.split(".")):
            change = {key: change}
        case = case.with_changes({"machines": {"G1": change}})
    simulated = ia.simulate(
        {"case": CASE, "stop_s": 6.0, "controller": "none", "show": PLACES, "event": fault}
    )
    with tempfile.TemporaryDirectory() as folder:
        simulated.save(folder)
        record = ia.read_record(Path(folder) / "trajectory.parquet")
    result = ia.fit(record, case, "G1", list(truth), rest_s=0.9)
    assert {p.name for p in result.parameters} == set(truth)
    for p in result.parameters:
        assert p.value == pytest.approx(truth[p.name], rel=0.001)


@pytest.mark.slow
def test_a_record_of_a_fault_between_two_frames_agrees_with_its_own_machine(tmp_path: Path) -> None:
    """The fault ends between two points of the run; without parameters too the instants are fitted."""
    fault = [{"kind": "bus_fault", "bus": 9, "start_s": 1.004, "end_s": 1.1333333, "x_pu": 0.01}]
    simulated = ia.simulate(
        {"case": CASE, "stop_s": 4.0, "controller": "none", "show": PLACES, "event": fault}
    )
    simulated.save(tmp_path)
    result = ia.fit(tmp_path / "trajectory.parquet", CASE, "G1", rest_s=0.9)
    assert max(result.misfit) < 0.002
    off = ia.load_case(CASE).with_changes({"machines": {"G1": {"H": 8.0}}})
    assert ia.fit(tmp_path / "trajectory.parquet", off, "G1", rest_s=0.9).misfit[0] > 0.02


@pytest.mark.parametrize("middle_hz", [60.0, 0.0])
def test_a_frequency_and_its_deviation_add_up_to_the_same_angle(middle_hz: float) -> None:
    """0.1 Hz for 2 s: 0.2 turns."""
    time_s = np.arange(0.0, 2.01, 0.02)
    channel = Channel("f", "frequency", "Hz", "bus1")
    record = Record("own", time_s, np.full((len(time_s), 1), middle_hz + 0.1), (channel,))
    assert _angle(record, ("G1", "bus1"), 60.0)[-1] == pytest.approx(2.0 * np.pi * 0.2, rel=1e-9)
    with pytest.raises(RecordError, match=r"own: f is 50\.1 Hz, allowed: within 5 Hz of the rated 60 Hz"):
        _angle(replace(record, values=record.values - middle_hz + 50.0), ("G1", "bus1"), 60.0)
