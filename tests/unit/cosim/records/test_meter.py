"""The mode meter against what is known exactly: a linear grid that noise drives, sines, and runs."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import control
import numpy as np
import pandas as pd
import pytest
from command_line import invoke

import interarea as ia
from interarea.cosim.records import ambient as methods
from interarea.cosim.records.forced import lines_of
from interarea.cosim.records.meter import _of_mode, meter
from interarea.cosim.records.record import Record, RecordError
from interarea.cosim.records.signals import swings_of

sys.path.append(str(Path(__file__).parents[4] / "benchmarks" / "records"))
from ambient_coverage import LinearRecords
from forced_or_modal import SINE, of_least_damped, with_swing

CASE = "kundur-manual"
Z, F = 0.0323, 0.5455  # damping ratio and frequency of its inter-area mode, of which `exact` makes sure


@cache
def grid() -> control.StateSpace:
    return ia.linearise(CASE)


@cache
def records_of(case: control.StateSpace) -> LinearRecords:
    return LinearRecords(case)


def ambient(seed: int, length_s: float, case: control.StateSpace | None = None) -> Record:
    """Return speeds of the machines, every rotor driven by noise."""
    return records_of(grid() if case is None else case).record(seed, length_s)


def with_sine(record: Record, f: float, times: float, harmonics: dict[int, float] | None = None) -> Record:
    """Return a record with a sine of `times` the ambient rms of the largest signal, its mean taken out."""
    shape = np.array([1.0, 0.4, -0.7, -0.7])
    size = times * (record.values - record.values.mean(axis=1, keepdims=True)).std(axis=0)[0]
    sine = sum(
        a * np.cos(2 * np.pi * k * f * record.time_s + 1.0) for k, a in {1: 1.0, **(harmonics or {})}.items()
    )
    return Record("forced", record.time_s, record.values + size * np.outer(sine, shape), record.channels)


STEP_S, POLES = 0.1, np.array([-0.11 + 3.42j, -0.5 + 6.9j])
SHAPES = np.array([[1.0, 0.3 + 0.2j, -0.5], [0.1, -1.0, 0.6j]])


def two_modes(poles: np.ndarray) -> np.ndarray:
    """Return covariances of three signals with two modes, of rank 4: (lags, 3, 3)."""
    lags = np.arange(60)[:, None, None]
    parts = zip(poles, SHAPES, SHAPES[:, ::-1].conj(), strict=True)
    return np.asarray(sum(np.real(np.exp(p * STEP_S * lags) * np.outer(v, w)) for p, v, w in parts))


def exact() -> tuple[float, float]:
    swinging = [z for z in np.linalg.eigvals(np.asarray(grid().A)) if 3.0 < z.imag < 4.0]
    return -swinging[0].real / abs(swinging[0]), swinging[0].imag / (2 * np.pi)


@pytest.mark.slow
def test_ten_minutes_of_ambient_motion_give_the_damping_by_two_methods() -> None:
    modes = list(ia.modes(CASE).values())
    assert exact() == pytest.approx((Z, F), abs=1e-4)
    result = meter(ambient(1, 600.0), modes=modes)
    assert result.kind == "ambient"
    swing = next(s for s in result.swings if abs(s.frequency_hz - F) < 0.02)
    assert swing.kind == "modal"
    assert swing.mode == "inter-area"
    assert len({e.method for e in swing.estimates}) == 2
    for estimate in swing.estimates:
        low, high = estimate.damping_interval
        assert low < Z < high
        assert 0.003 < high - low < 0.04
        assert estimate.frequency_hz == pytest.approx(F, abs=0.01)


@pytest.mark.slow
def test_intervals_hold_what_they_promise_and_are_not_wide() -> None:
    inside, off, result = 0, [], 0
    for seed in range(60):
        swings = meter(ambient(seed, 600.0)).swings
        near = [s for s in swings if abs(s.frequency_hz - F) < 0.03 and s.estimates]
        result += bool(near)
        for s in near[:1]:
            low, high = s.estimates[0].damping_interval
            inside += low <= Z <= high
            off.append(s.estimates[0].damping_ratio - Z)
    assert result == 60
    assert inside >= 52  # of a binomial of 60 with 0.95, the chance of fewer is 0.5 %
    assert abs(np.mean(off)) < 0.003
    assert np.std(off) < 0.008


@pytest.mark.slow
@pytest.mark.parametrize(("f", "length_s"), [(0.31, 60.0), (0.545, 180.0), (0.9, 60.0)])
def test_a_line_is_forced_and_gets_no_damping_ratio(f: float, length_s: float) -> None:
    """The second is at the mode itself, where a minute is not enough to be certain."""
    result = meter(with_sine(ambient(3, length_s), f, 3.0))
    top = result.swings[0]
    assert top.kind == "forced"
    assert top.frequency_hz == pytest.approx(f, abs=0.002)
    assert top.estimates == ()
    assert "damping_ratio" not in json.dumps(result.as_dict()["swings"][0])


@pytest.mark.slow
@pytest.mark.parametrize("f", [0.28, 0.72, 1.1])
@pytest.mark.parametrize("phase", [0.0, 1.0, 2.0])
def test_a_line_does_not_ring_down(f: float, phase: float) -> None:
    """Damped poles fit a large sine closely from wherever it is largest; it does not decay."""
    quiet = ambient(1, 60.0)
    size = 5.0 * quiet.values.std(axis=0).max()
    sine = size * np.outer(np.cos(2 * np.pi * f * quiet.time_s + phase), [0.7, -0.7, -0.5, 1.0])
    result = meter(Record("sine", quiet.time_s, quiet.values + sine, quiet.channels))
    assert [(s.kind, s.estimates) for s in result.swings] == [("forced", ())]
    assert result.kind == "ambient"


@pytest.mark.parametrize("seed", range(3))
def test_a_slow_line_is_not_bent_at_the_ends_of_a_record(seed: int) -> None:
    """The filter that takes slow motion out bends a sine of 0.2 Hz there; the fit of the line is not."""
    result = meter(with_sine(ambient(seed, 60.0), 0.2, 3.0))
    assert result.swings[0].kind == "forced"
    assert result.swings[0].frequency_hz == pytest.approx(0.2, abs=0.001)


@pytest.mark.slow
@pytest.mark.parametrize("number", [66, 234])
def test_a_slow_line_three_times_the_ambient_motion_is_forced_after_a_minute(number: int) -> None:
    """Lines at 0.23 and 0.24 Hz of the benchmark: 18 points of an envelope, of which their mean is fitted."""
    record, f = with_swing(ambient(1000 + number, 60.0), SINE, np.random.default_rng((1, number)))
    top = meter(record).swings[0]
    assert (top.kind, top.frequency_hz) == ("forced", pytest.approx(f, abs=0.002))


def test_a_line_beside_a_larger_peak_of_another_pattern_is_seen() -> None:
    """The other swells in the middle of the record, 2 / length away, where two peaks of one sum are one."""
    t = np.arange(600) * 0.1
    line, f = np.cos(2 * np.pi * 0.5034 * t), 0.5375
    swell = 1.4 * np.cos(2 * np.pi * f * t) * np.exp(-(((t - 30.0) / 20.0) ** 2))
    values = np.outer(line, [1.0, -1.0, 0.0, 0.0]) + np.outer(swell, [0.0, 0.0, 1.0, -1.0])
    values += 0.05 * np.random.default_rng(1).standard_normal(values.shape)
    swings = swings_of(Record("two", t, values, ambient(1, 60.0).channels))
    hertz = [line.frequency_hz for line in lines_of(swings) if line.kind == "forced"]
    assert hertz == [pytest.approx(0.5034, abs=0.001)]


@pytest.mark.slow
def test_few_modes_with_least_damping_and_no_wide_ones_are_called_forced() -> None:
    """A wide spectrum has many independent values, the largest of which stands out in record 61."""
    ratios = np.array(of_least_damped(150, np.random.default_rng(2)))
    assert np.sum(ratios >= 12.0) <= 2  # of a binomial of 150 with 0.003, the chance of more is 1 %
    assert 1.0 < np.median(ratios) < 6.0
    assert "forced" not in {s.kind for s in meter(ambient(61, 600.0)).swings}


def test_what_stands_beside_a_ring_down_is_taken_out_of_it() -> None:
    time = 0.1 * np.arange(600)
    w, z = 2 * np.pi * F, Z
    rings = 40.0 * np.exp(-z * w * (time - 5.0)) * np.cos(w * (time - 5.0)) * (time >= 5.0)
    line = 3.0 * np.cos(2 * np.pi * 0.9 * time)
    quiet = ambient(2, 60.0)
    noise = 0.02 * (quiet.values - quiet.values.mean(axis=0))
    values = noise + np.outer(rings, [1.0, 0.7, -0.6, -0.5]) + np.outer(line, [0.2, 1.0, 0.1, -0.3])
    swings = meter(Record("both", time, values, quiet.channels)).swings
    assert {(s.kind, round(s.frequency_hz, 2)) for s in swings} == {("modal", 0.55), ("forced", 0.9)}
    (mode,) = [s for s in swings if s.kind == "modal"]
    assert mode.estimates[0].damping_ratio == pytest.approx(z, abs=0.002)


@pytest.mark.slow
def test_harmonics_that_stand_are_told_and_the_mode_beside_a_line_is_metered() -> None:
    result = meter(with_sine(ambient(4, 600.0), 0.8, 1.5, {3: 0.4}), band_hz=(0.1, 2.8))
    line = next(s for s in result.swings if s.kind == "forced")
    assert "harmonics 3 stand too" in line.why
    mode = next(s for s in result.swings if abs(s.frequency_hz - F) < 0.02)
    low, high = mode.estimates[0].damping_interval
    assert low < Z < high


@pytest.mark.parametrize("seed", range(3))
def test_sixty_seconds_of_a_mode_are_not_called_forced(seed: int) -> None:
    try:
        kinds = {s.kind for s in meter(ambient(seed, 60.0)).swings}
    except RecordError as error:
        assert "too short for a damping ratio, wanted: 120 s" in str(error)
        return
    assert "forced" not in kinds


@pytest.mark.slow
def test_a_run_rings_down_as_its_own_fit_and_its_roots_say(tmp_path: Path) -> None:
    run = ia.simulate("ring-down")
    run.save(tmp_path)
    result = meter(ia.read_record(tmp_path / "trajectory.parquet"), modes=list(ia.modes(run.case).values()))
    assert result.kind == "ring-down"
    swing = next(s for s in result.swings if s.mode == "inter-area")
    estimate = swing.estimates[0]
    assert estimate.damping_ratio == pytest.approx(run.metrics.damping_ratio["inter-area"], abs=0.002)
    low, high = estimate.damping_interval
    assert low < run.metrics.damping_ratio["inter-area"] < high
    assert high - low < 0.02


@pytest.mark.slow
def test_a_damping_ratio_that_could_be_any_is_not_given(tmp_path: Path) -> None:
    """One speed of a run with three signals lost: the interval of its pole at 0.21 Hz is -6.6 to 8.2."""
    ia.simulate("lost-signal").save(tmp_path)
    swings = ia.meter(tmp_path / "trajectory.parquet", quantity="speed", channels=["plant.G1_dw"]).swings
    widths = [e.damping_interval[1] - e.damping_interval[0] for s in swings for e in s.estimates]
    assert widths and max(widths) <= 2.0
    (none,) = [s for s in swings if not s.estimates]
    assert none.kind == "undecided" and "damping ratio not determined: -6." in none.why


def test_too_short_and_too_slow_records_are_refused_with_what_would_do() -> None:
    short = ambient(1, 60.0)
    with pytest.raises(RecordError, match=r"8 s are too short for 0\.1 Hz, wanted: 20 s at least, or a band"):
        meter(short.between(0.0, 8.0))
    slow = replace(ambient(1, 60.0), time_s=np.arange(600) * 100.0)  # ms taken as s
    with pytest.raises(RecordError, match=r"few for 2.5 Hz, .* or the unit of its times, as Time \[ms\]"):
        meter(slow)
    with pytest.raises(RecordError, match=r"10 samples a second are too few for 8 Hz, wanted: 16 at least"):
        meter(short, band_hz=(0.1, 8.0))
    with pytest.raises(RecordError, match="no channel of voltage is there"):
        meter(short, quantity="voltage")
    flat = Record("flat", short.time_s, np.ones((len(short.time_s), 4)), short.channels)
    with pytest.raises(RecordError, match=r"none of plant\.G1_dw, .* varies"):
        meter(flat)


@pytest.mark.slow
def test_the_command_prints_a_table_or_json_and_refuses_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = with_sine(ambient(5, 60.0), 0.9, 3.0)
    path = tmp_path / "speeds.parquet"
    frame = record.to_frame().reset_index()
    frame.to_parquet(path)
    code, out, _ = invoke(["meter", str(path)], monkeypatch)
    assert code == 0
    assert "forced" in out
    code, out, _ = invoke(["meter", str(path), "--json"], monkeypatch)
    assert json.loads(out)["swings"][0]["kind"] == "forced"
    for words, says in (
        (["--band", "1"], "--band '1', wanted LOW:HIGH in Hz"),
        (["--window", "0:5"], "too short for 0.1 Hz"),
        (["--unit", "VA"], "--unit 'VA', wanted WHAT=UNIT"),
        (["--channel", "plant.G9_dw"], "no channel 'plant.G9_dw'; did you mean"),
    ):
        code, out, err = invoke(["meter", str(path), *words], monkeypatch)
        assert (code, out) == (2, "")
        assert says in err
        assert err.count("interarea: ") == 1
    pd.DataFrame({"a": [1]}).to_csv(tmp_path / "x.csv")
    code, _, err = invoke(["meter", str(tmp_path / "x.csv")], monkeypatch)
    assert code == 2
    assert "no row begins with Time" in err


def test_an_ambient_mode_whose_damping_could_be_any_is_undecided() -> None:
    swings = swings_of(ambient(1, 120.0), (0.1, 2.5))
    shape = np.ones(swings.combined.shape[1], complex)
    for half, kind in ((0.9, "modal"), (1.1, "undecided"), (np.nan, "undecided")):
        estimate = methods.Estimate(methods.SUBSPACE, 0.5, (0.4, 0.6), 0.1, (0.1 - half, 0.1 + half))
        swing = _of_mode(swings, methods.AmbientMode(-0.3 + 3.1j, 0.1, shape, 8, (estimate,)), [])
        assert (swing.kind, len(swing.estimates)) == (kind, int(kind == "modal"))
        assert ("damping ratio not determined" in swing.why) == (kind != "modal")


def test_poles_nearer_than_3_percent_are_one_only_with_one_shape() -> None:
    pole, one, other = -0.5 + 6.9j, np.array([1.0, -1.0, 0.1, 0.0j]), np.array([0.1, 0.0j, 1.0, -1.0])
    rows = [(pole, one, 0.5), (1.01 * pole, -1j * one, 0.2), (1.027 * pole, other, 0.3)]
    tracks = [[methods._Entry(30, *row)] for row in rows]
    assert [track[0].share for track in methods._apart(tracks)] == [0.5, 0.3]
    # by Yule-Walker a mode is the pole of its shape, though the other is nearer
    poles, shapes = np.array([pole, 1.027 * pole]), np.stack([one, other], axis=1)
    assert methods._nearest(poles, shapes, 1.02 * pole, one) == pole
    assert methods._nearest(poles, shapes, 1.02 * pole, other) == 1.027 * pole


def test_half_an_interval_is_t_times_the_deviation_of_a_mean_of_blocks() -> None:
    """Of one pole whose value is the mean of one number a block, the deviation is known in closed form."""
    own = np.random.default_rng(7).normal(0.05, 0.01, 12)
    sums, counts = own[:, None, None, None], np.ones(12)
    covariances = methods._Covariances(sums, counts)

    def pole_of(z: complex) -> complex:
        return 5.0 * (-z + 1j * np.sqrt(1.0 - z * z))

    mean, slopes = covariances.all().item(), np.array([s.item() for s in covariances.slopes()])
    step = 1e-6
    by_ratio = (pole_of(mean + step) - pole_of(mean - step)) / (2.0 * step)
    estimate = methods._estimate("mean", pole_of(mean), by_ratio * slopes)
    low, high = estimate.damping_interval
    assert estimate.damping_ratio == pytest.approx(own.mean())
    assert 0.5 * (high - low) == pytest.approx(2.2010 * own.std(ddof=1) / np.sqrt(12), rel=1e-3)
    assert np.ptp(estimate.frequency_interval_hz) < 1e-9


def test_a_mode_is_the_mean_of_its_orders_whatever_the_phase_of_its_shapes() -> None:
    shape = np.array([1.0, -0.5j, 0.2])
    entries = [methods._Entry(6, -0.4 + 6.8j, shape, 0.3), methods._Entry(8, -0.6 + 7.0j, -2j * shape, 0.5)]
    mean = methods._Entry.mean(entries)
    assert (mean.order, mean.pole, mean.share) == (8, pytest.approx(-0.5 + 6.9j), pytest.approx(0.4))
    assert methods.squared_cosine(mean.shape, shape) == pytest.approx(1.0)
    assert np.linalg.norm(mean.shape) == pytest.approx(1.0)


def test_yule_walker_finds_the_poles_of_exact_covariances() -> None:
    """Two modes of three signals have rank 4: of the larger autoregression only their poles do not vanish."""
    seen, vectors = methods._yule_walker(two_modes(POLES), STEP_S)
    for pole, shape in zip(POLES, SHAPES, strict=True):
        k = int(np.argmin(np.abs(seen - pole)))
        assert seen[k] == pytest.approx(pole, rel=1e-6)
        assert methods.squared_cosine(vectors[:, k], shape) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("moved", [[0.1, 0.0], [0.0, 0.2j], [-0.05j, 0.1 + 0.1j]])
def test_poles_by_subspaces_follow_covariances_of_their_rank(moved: list[complex]) -> None:
    """Of covariances whose poles are moved the derivatives of the poles are these motions."""
    step, change = 1e-5, np.array(moved)
    rows = 10
    one, other = (methods._toeplitz(two_modes(POLES + s * change), rows) for s in (step, -step))
    factors = methods._Factors.of(two_modes(POLES), rows, STEP_S)
    seen, slopes = factors.slopes(4, [(one - other) / (2.0 * step), np.zeros_like(one)])
    assert len(seen) == 2
    for pole, expected in zip(POLES, change, strict=True):
        own = methods._of_pole(seen, slopes, pole)
        assert own == pytest.approx(np.array([expected, 0.0]), abs=1e-6)


def test_a_singular_value_left_out_does_not_widen_intervals() -> None:
    """Where it nears the last one kept, the derivatives of the truncated decomposition itself are without
    limit: it turns one vector into the other."""
    factors = methods._Factors.of(two_modes(POLES), 10, STEP_S)
    turn = np.outer(factors.left[:, 2], factors.right[1])
    sizes, truncated = [], []
    for near in (0.5, 0.999):
        sigma = factors.sigma.copy()
        sigma[2] = near * sigma[1]
        with_it = replace(factors, sigma=sigma)
        seen, slopes = with_it.slopes(2, [turn])
        T = (factors.left * sigma) @ factors.right + 1e-6 * sigma[1] * turn
        moved = replace(factors, **dict(zip(("left", "sigma", "right"), np.linalg.svd(T), strict=True)))
        sizes.append(abs(slopes.item()))
        truncated.append(abs(moved.poles(2)[0].item() - seen.item()) / (1e-6 * sigma[1]))
    assert sizes[1] == pytest.approx(sizes[0], rel=1e-9)
    assert truncated[1] > 100.0 * truncated[0] > 100.0 * sizes[0]


@pytest.mark.slow
def test_intervals_of_close_modes_are_as_wide_as_their_errors() -> None:
    """Half an interval of 95 % is about two deviations."""
    modes = list(ia.modes(CASE).values())
    rows: dict[str, list[tuple[float, float]]] = {methods.SUBSPACE: [], methods.YULE_WALKER: []}
    for seed in range(60):
        for swing in meter(ambient(seed, 600.0), modes=modes).swings:
            for e in swing.estimates if swing.mode.startswith("local") else ():
                assert swing.mode_damping is not None
                half = 0.5 * (e.damping_interval[1] - e.damping_interval[0])
                rows[e.method].append((e.damping_ratio - swing.mode_damping, half))
    for row in rows.values():
        off, half = np.array(row).T
        assert len(row) >= 75
        assert abs(off.mean()) < 0.003
        assert off.std() < 0.0105
        assert 1.7 < np.median(half) / off.std() < 2.35
