"""The detector's tests of frames and of means: what each fires at, when, and what comes back."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmu_runner import Runner

from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.detector import REASONS, detector_block

SIGNALS = ("a", "b", "c", "d")
FRAME_S = 0.02
AMPLITUDE, MODE_HZ = 2e-3, 0.5  # 120 mHz at 60 Hz, one period is the mean's time
AGE_S = {"a": 0.1, "b": 0.0, "c": 0.06, "d": 0.0}
NOISE_PU = 1e-3 / 60.0 * np.random.default_rng(3).standard_normal((len(SIGNALS), 1000))
Sent = Callable[[float, float], float]  # stamp and true value to what is sent


@pytest.fixture(scope="module")
def detector(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_fmu(detector_block(SIGNALS), tmp_path_factory.mktemp("detector") / "detector.fmu")


def true_value(signal: str, s: float) -> float:
    """Two groups of machines swing against each other, from rest at 1 s on."""
    side = 1.0 if signal in "ab" else -0.8
    return side * AMPLITUDE * math.sin(2 * math.pi * MODE_HZ * max(s - 1.0, 0.0))


def follow(
    path: Path,
    wrong: dict[str, Sent],
    stop_s: float = 6.0,
    lost: Callable[[str, float], bool] = lambda *_: False,
    **parameters: float,
) -> dict[str, list[tuple[float, str]]]:
    """Send frames; of each signal every change of its reason, with the time of its last frame then."""
    changes: dict[str, list[tuple[float, str]]] = {s: [] for s in SIGNALS}
    with Runner(path) as run:
        run.start({"average": 2.0, "standing_time": 10.0, **parameters})
        for k in range(round(stop_s / FRAME_S)):
            t = k * FRAME_S
            for s in SIGNALS:
                stamp = max(t - AGE_S[s], 0.0)
                value = true_value(s, stamp)
                value = wrong[s](stamp, value) if s in wrong else value
                run.set_of({s: value, f"{s}_age": t - stamp, f"{s}_valid": not lost(s, t)})
            run.step(t, FRAME_S)
            for s in SIGNALS:
                reason = REASONS[run.get(f"{s}_reason")]
                before = changes[s][-1][1] if changes[s] else "trusted"
                if reason != before:
                    changes[s].append((round(t - AGE_S[s], 9), reason))
                assert run.get(f"{s}_trusted") == (reason in ("trusted", "lost"))
                assert run.get(f"{s}_usable") == (reason == "trusted")
    return changes


def test_a_swing_of_all_is_trusted(detector: Path) -> None:
    assert follow(detector, {}) == {s: [] for s in SIGNALS}


@pytest.mark.parametrize(
    ("sent", "reason", "at_s"),
    [
        # the frame after START is the first that repeats; ten of them
        (lambda s, v: true_value("b", min(s, 2.2)), "repeat", 2.2 + 10 * FRAME_S),
        (lambda s, v: v if s < 2.2 - 1e-9 else v + 0.06, "range", 2.2),
        (lambda s, v: v if s < 2.2 - 1e-9 else v + 0.006, "jump", 2.2),
        # the mean over 100 frames passes 1e-3 + .75 span at the 93rd frame (jump allows 4.8e-3)
        (lambda s, v: v if s < 3.0 - 1e-9 else v + 4.3e-3, "apart", 3.0 + 93 * FRAME_S),
    ],
)
def test_each_test_names_the_signal_at_the_stated_frame(
    detector: Path, sent: Sent, reason: str, at_s: float
) -> None:
    verdicts = follow(detector, {"b": sent})
    assert all(verdicts[s] == [] for s in "acd")
    assert verdicts["b"][0][1] == reason
    # what is compared at one stamp waits for the slowest of the signals, 0.1 s
    late_s = max(AGE_S.values()) if reason == "apart" else 0.0
    assert verdicts["b"][0][0] == pytest.approx(at_s + late_s, abs=FRAME_S + 1e-9)


def true_noise(signal: str, s: float) -> float:
    """The true value with noise of 1 mHz, the same at the same stamp."""
    k = round(s / FRAME_S)
    return true_value(signal, k * FRAME_S) + float(NOISE_PU[SIGNALS.index(signal), k])


def noisy(wrong: dict[str, Sent]) -> dict[str, Sent]:
    """Give noise to every signal that is not wrong."""
    return {t: lambda s, v, name=t: true_noise(name, s) for t in SIGNALS} | wrong  # type: ignore[misc]


def replay(signal: str, length_s: float, start_s: float = 3.0) -> Sent:
    """Send what the signal was in the `length_s` before `start_s`, again and again from then on."""
    length, begin = round(length_s / FRAME_S), round(start_s / FRAME_S)

    def sent(s: float, v: float) -> float:
        k = round(s / FRAME_S)
        return true_noise(signal, s if k < begin else (begin - length + (k - begin) % length) * FRAME_S)

    return sent


@pytest.mark.parametrize("start_s", [3.0, 3.02, 3.1, 3.18])  # frames 150 to 159: which of ten is looked for
@pytest.mark.parametrize("length_s", [0.12, 0.5, 1.5, 2.0])
def test_a_replay_is_named_by_frames_that_come_again(detector: Path, length_s: float, start_s: float) -> None:
    """The tenth frame that was there before; 2 s is the period, so that the replay is a right swing."""
    verdicts = follow(detector, noisy({"b": replay("b", length_s, start_s)}))
    at_s, reason = verdicts["b"][0]
    assert reason == "replay"
    # what is compared at one stamp waits for the slowest of the signals
    assert at_s == pytest.approx(start_s + 9 * FRAME_S + max(AGE_S.values()))
    assert all(verdicts[s] == [] for s in "acd")


def test_a_slow_replay_is_named_too(detector: Path) -> None:
    """Nine seconds are sent again: the search goes back over 512 frames."""
    verdicts = follow(detector, noisy({"b": replay("b", 9.0, 10.0)}), 12.0, standing_time=99.0)
    assert [why for _, why in verdicts["b"]] == ["replay"]
    assert all(verdicts[s] == [] for s in "acd")


def test_a_replay_of_two_names_both_and_a_cycle_of_all_names_none(detector: Path) -> None:
    both = {s: replay(s, 1.5) for s in "ab"}
    verdicts = follow(detector, noisy(both))
    assert [verdicts[s][0][1] for s in "ab"] == ["replay", "replay"]
    assert verdicts["c"] == verdicts["d"] == []
    cycle = {s: replay(s, 2.0) for s in SIGNALS}
    assert follow(detector, noisy(cycle)) == {s: [] for s in SIGNALS}


def test_a_replay_at_rest_names_nobody(detector: Path) -> None:
    """Frames without noise, all at rest: they come again in every signal, and do not move."""
    assert follow(detector, {"b": lambda s, v: 0.0}, stop_s=1.0) == {s: [] for s in SIGNALS}


def rough(random: np.random.Generator, rms: float, more_s: float = 1e9) -> Sent:
    """Noise, ten times as large from `more_s` on."""
    return lambda s, v: v + rms * (10.0 if s >= more_s - 1e-9 else 1.0) * random.standard_normal()


def test_noise_is_named_by_the_median_of_what_it_bends(detector: Path) -> None:
    """All have noise of 1 mHz; that of one is ten times as large from 3 s on."""
    random = np.random.default_rng(2)
    wrong = {s: rough(random, 1e-3 / 60.0) for s in SIGNALS}
    assert follow(detector, wrong) == {s: [] for s in SIGNALS}
    verdicts = follow(detector, {**wrong, "c": rough(random, 1e-3 / 60.0, 3.0)}, stop_s=6.0)
    assert [why for _, why in verdicts["c"]] == ["rough"]
    # half of 50 stamps, those whose bend is below the limit on top
    assert 3.0 + 25 * FRAME_S < verdicts["c"][0][0] < 3.0 + 50 * FRAME_S
    assert all(verdicts[s] == [] for s in "abd")


def test_bends_of_before_leave_nothing_in_their_mean(detector: Path) -> None:
    """All bend by 4e-3 until 3.5 s and one is lost for a while: noise at 6 s is named at the same stamp."""

    def run(before: float) -> list[tuple[float, str]]:
        def sent(name: str, s: float) -> float:
            bent = before * (s < 3.5) * (1.0 if round(s / FRAME_S) % 2 else -1.0)
            return bent + true_noise(name, s) * (10.0 if name == "c" and s >= 6.0 - 1e-9 else 1.0)

        each: dict[str, Sent] = {t: lambda s, v, name=t: sent(name, s) for t in SIGNALS}  # type: ignore[misc]
        return follow(detector, each, 8.0, lambda s, t: before > 0.0 and s == "a" and 4.0 <= t < 4.3)["c"]

    named = run(0.0)
    assert [why for _, why in named] == ["rough"]
    assert run(1e-3) == named


def test_noise_of_all_signals_is_no_wrong_one(detector: Path) -> None:
    random = np.random.default_rng(2)
    verdicts = follow(detector, {s: rough(random, 1e-2 / 60.0) for s in SIGNALS})
    assert verdicts == {s: [] for s in SIGNALS}


def test_a_few_kinks_are_not_rough(detector: Path) -> None:
    """A triangle that bends by eight times the limit at five of fifty stamps."""
    sent: Sent = lambda s, v: v + 8e-3 * (abs(s / 0.4 % 1.0 - 0.5) - 0.25) * (s > 1.0)  # noqa: E731
    assert follow(detector, {"b": sent}) == {s: [] for s in SIGNALS}


def test_a_signal_at_rest_repeats_without_harm(detector: Path) -> None:
    """Before 1 s nothing moves; a real signal repeats then as a stuck one does."""
    assert follow(detector, {"b": lambda s, v: 0.0}, stop_s=1.0)["b"] == []


def test_it_comes_back_after_the_stated_time_and_later_each_time(detector: Path) -> None:
    spikes = (2.2, 3.2, 5.2)
    sent: Sent = lambda s, v: v + 0.01 * any(abs(s - at) < 1e-9 for at in spikes)  # noqa: E731
    verdicts = follow(detector, {"d": sent}, stop_s=9.0, return_time=0.5)["d"]
    assert [why for _, why in verdicts] == 3 * ["jump", "trusted"]
    out = [t for t, why in verdicts if why == "jump"]
    back = [t for t, why in verdicts if why == "trusted"]
    assert out == pytest.approx(list(spikes), abs=1e-9)
    # the frame after a spike jumps too: from there on .5, 1 and 2 s
    assert [b - o for o, b in zip(out, back, strict=True)] == pytest.approx([0.52, 1.02, 2.02], abs=1e-9)


def test_a_lost_signal_is_no_alarm_and_is_back_at_once(detector: Path) -> None:
    verdicts = follow(detector, {}, lost=lambda s, t: s == "a" and 2.0 <= t < 2.5 - 1e-9)
    assert [why for _, why in verdicts["a"]] == ["lost", "trusted"]
    assert verdicts["a"][1][0] - verdicts["a"][0][0] == pytest.approx(0.5)
    assert all(verdicts[s] == [] for s in "bcd")


def test_two_signals_never_accuse_each_other(tmp_path: Path) -> None:
    path = build_fmu(detector_block(("a", "b")), tmp_path / "two.fmu")
    with Runner(path) as run:
        run.start()
        for k in range(300):
            run.set_of({"a": 1e-3 * math.sin(k), "b": 1e-3 * math.sin(k) + 3e-3 * (k > 100)})
            run.step(k * FRAME_S, FRAME_S)
        assert run.get("isolations") == 0


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"average": 9.0}, "average must lie in 1 to 256 intervals"),
        ({"apart[2]": 0.0}, "range, jump, apart and rough of a signal must be positive"),
    ],
)
def test_parameters_that_cannot_be(detector: Path, keys: dict[str, float], says: str) -> None:
    with Runner(detector) as run:
        with pytest.raises(FMICallException):
            run.start(keys)
        assert any(says in line for line in run.log), run.log


def test_signals_that_cannot_be() -> None:
    with pytest.raises(ValueError, match="allowed: 1 to 32 different names"):
        detector_block(["a", "a"])


def swing_of_all(size: Callable[[float], float]) -> dict[str, Sent]:
    """All signals swing as `true_value` does, by `size` of the time."""
    return {name: lambda s, v: v * size(s) for name in SIGNALS}


def test_a_swing_that_stands_takes_all_signals_out(detector: Path) -> None:
    """Ten seconds after the span has come to .6 of its last; the swing ends without the controller."""
    ends = swing_of_all(lambda s: 1.0 if s < 12.5 else math.exp(12.5 - s))
    verdicts = follow(detector, ends, 20.0, return_time=5.0)
    for name, changes in verdicts.items():
        # what is compared waits for the slowest signal, the time is that of the signal's own last frame
        assert [why for _, why in changes] == ["standing", "trusted"], name
        assert 11.5 < changes[0][0] < 12.5  # the swing begins at 1 s and has its span at 2.5 s
        assert changes[1][0] - changes[0][0] == pytest.approx(5.0, abs=FRAME_S)


@pytest.mark.parametrize(
    "size", [lambda s: 0.05, lambda s: math.exp(-0.1 * s), lambda s: 0.2 if s < 9.0 else 1.0]
)
def test_a_small_a_falling_or_a_new_swing_does_not(detector: Path, size: Callable[[float], float]) -> None:
    """It spans 2e-4, or falls to .37 of itself in ten seconds, or has risen to five times itself in them."""
    assert follow(detector, swing_of_all(size), 18.0) == {s: [] for s in SIGNALS}


@pytest.mark.parametrize(("rate_per_s", "mode_hz"), [(3e-4, 0.5), (-3e-4, 0.5), (0.0, 0.3), (3e-4, 0.3)])
def test_a_drift_is_no_swing_and_hides_none(detector: Path, rate_per_s: float, mode_hz: float) -> None:
    """The drift alone spans 6e-4 in 2 s, twice the limit; a swing of 0.3 Hz is slower than the average."""

    def drifts(swing: Callable[[float], float]) -> dict[str, Sent]:
        def sent(s: float, v: float, side: float) -> float:
            since = max(s - 1.0, 0.0)
            return since * rate_per_s + side * swing(since) * math.sin(2 * math.pi * mode_hz * since)

        sides = zip(SIGNALS, (1.0, 1.0, -0.8, -0.8), strict=True)
        return {name: lambda s, v, side=side: sent(s, v, side) for name, side in sides}  # type: ignore[misc]

    assert follow(detector, drifts(lambda s: 2e-3 * math.exp(-0.3 * s)), 25.0) == {s: [] for s in SIGNALS}
    for changes in follow(detector, drifts(lambda s: 2e-3), 20.0, return_time=60.0).values():
        assert [why for _, why in changes] == ["standing"]


def test_a_growing_swing_takes_all_signals_out(detector: Path) -> None:
    """The span of 2 s doubles in each of two averages from where it exceeds 3e-4 on; its trend is small."""
    stamps = np.arange(0.0, 14.0, FRAME_S)
    own = np.array([0.02 * math.exp(0.4 * s) * true_value("a", s) for s in stamps])
    spans = np.ptp(np.lib.stride_tricks.sliding_window_view(own, round(2.0 / FRAME_S)), axis=1)
    exceeds_s = 2.0 + FRAME_S * float((spans > 3e-4).argmax())
    verdicts = follow(detector, swing_of_all(lambda s: 0.02 * math.exp(0.4 * s)), 14.0, return_time=60.0)
    for changes in verdicts.values():
        assert [why for _, why in changes] == ["standing", "trusted"]  # it grows without them too
        assert changes[0][0] == pytest.approx(exceeds_s + 2 * 2.0, abs=5 * FRAME_S)
    slower = swing_of_all(lambda s: 0.02 * math.exp(0.3 * s))  # by 1.8
    assert follow(detector, slower, 14.0, standing_time=99.0) == {s: [] for s in SIGNALS}


def test_a_second_larger_disturbance_does_not(detector: Path) -> None:
    """The swing grows in the first average after each disturbance, and in none after it."""
    twice = swing_of_all(lambda s: (0.3 if s < 4.0 else 1.0) * math.exp(-0.1 * (s - 1.0)))
    assert follow(detector, twice, 14.0) == {s: [] for s in SIGNALS}


def disturbed_twice(first_s: float, noise_pu: float, rise: Callable[[float], float]) -> dict[str, Sent]:
    """All swing from 6 s on, when the memory is full, and more from `first_s` later on, by `rise`."""
    random = np.random.default_rng(4)

    def sent(s: float, v: float, side: float) -> float:
        since, later = max(s - 6.0, 0.0), max(s - 6.0 - first_s, 0.0)
        swing = 4.5e-4 * math.sin(math.pi * since) * math.exp(-0.1 * since)
        swing += rise(later) * math.sin(math.pi * later)
        return side * swing + noise_pu * random.standard_normal()

    sides = zip(SIGNALS, (1.0, 1.0, -0.8, -0.8), strict=True)
    return {name: lambda s, v, side=side: sent(s, v, side) for name, side in sides}  # type: ignore[misc]


@pytest.mark.parametrize("first_s", [1.0, 1.5, 2.0, 2.5, 3.0, 3.5])
@pytest.mark.parametrize("noise_pu", [0.0, 1e-3 / 60.0])
def test_two_disturbances_in_a_row_do_not(detector: Path, first_s: float, noise_pu: float) -> None:
    """A small one, then one twice to eight times as large: each doubles the swing once."""
    for size in (6e-4, 1.2e-3, 2.4e-3):
        sent = disturbed_twice(first_s, noise_pu, lambda _, size=size: size)  # type: ignore[misc]
        assert follow(detector, sent, 6.0 + first_s + 6.0) == {s: [] for s in SIGNALS}


def test_growth_counts_from_a_disturbance_on(detector: Path) -> None:
    """A beat rises to 2.9 times itself in 2 s: growth, but for the sharp bend where it begins."""

    def beat(since: float) -> float:
        return 1.2e-3 * (1.0 + 0.95 * since if since < 2.0 else 2.9) if since > 0.0 else 0.0

    disturbed = disturbed_twice(1.2, 0.0, beat)
    assert follow(detector, disturbed, 13.0) == {s: [] for s in SIGNALS}
    smooth = swing_of_all(lambda s: 0.15 * math.exp(0.4 * (s - 1.0)))
    alone = {**smooth, "a": lambda s, v: smooth["a"](s, v) + 1e-3 * (abs(s - 4.0) < 1e-9)}
    late = [follow(detector, sent, 7.0)["d"][0][0] for sent in (smooth, alone)]
    assert late[0] == late[1]  # one signal alone that bends sharply is no disturbance


def test_signals_come_back_at_once_when_the_swing_grows_without_them(detector: Path) -> None:
    """Not by what the stop itself brings, in two averages after it; once, then not for 60 s."""
    grows = swing_of_all(lambda s: 1.0 if s < 12.5 else 1.8 if s < 20.0 else 3.6)
    verdicts = follow(detector, grows, 40.0)
    for changes in verdicts.values():
        assert [why for _, why in changes] == ["standing", "trusted"]
        assert 20.0 < changes[1][0] < 22.5
