"""The detector's patterns: the C against the same law in numpy, and what it names."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmu_runner import Runner

from interarea.cosim.screen.detector_design import main
from interarea.design.controllers.detector_record import (
    FRAMES,
    LASTS,
    SAMPLES,
    DetectorDesign,
    DetectorDesignError,
    basis_of,
    lasting,
    load_detector,
    scores,
    scores_and_suspects,
    shares,
)
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.detector import REASONS, Patterns, detector_block

SIGNALS = ("a", "b", "c", "d")
FRAME_S, STAMPS, WRONG = 0.02, 400, 140
FLOOR, THRESHOLD = 1e-6, 2.0
SHAPES = np.array([[1.0, 0.9, -0.8, -0.7], [1.0, -0.8, 0.1, -0.1]])  # of two modes
MODES_HZ = (0.5, 1.1)


def swing(phases: tuple[float, float], sizes: tuple[float, float] = (1e-3, 3e-4)) -> np.ndarray:
    """Two modes, damped: (signals, stamps)."""
    t = FRAME_S * np.arange(STAMPS)
    parts = [
        size * np.exp(-0.3 * t) * np.cos(2 * np.pi * f * t + phase)
        for f, phase, size in zip(MODES_HZ, phases, sizes, strict=True)
    ]
    return np.asarray(SHAPES.T @ np.array(parts))


@pytest.fixture(scope="module")
def patterns() -> Patterns:
    random = np.random.default_rng(3)
    curves = [swing(tuple(random.uniform(0, 6.3, 2)), tuple(random.uniform(0, 1e-3, 2))) for _ in range(30)]
    return Patterns(basis_of(curves, FLOOR, size=6), FRAMES, THRESHOLD, 1e9, FLOOR, 1e9)


@pytest.fixture(scope="module")
def detector(patterns: Patterns, tmp_path_factory: pytest.TempPathFactory) -> Path:
    block = detector_block(SIGNALS, patterns=patterns)
    return build_fmu(block, tmp_path_factory.mktemp("patterns") / "detector.fmu")


def named(path: Path, curves: np.ndarray) -> tuple[dict[str, str], int | None]:
    """Feed curves; the reason of each signal at the end, and the stamp at which one was named."""
    first = None
    with Runner(path) as run:
        run.start({f"apart[{i}]": 1.0 for i in range(1, 5)})
        for k in range(STAMPS):
            run.set_of(dict(zip(SIGNALS, curves[:, k], strict=True)))
            run.step(k * FRAME_S, FRAME_S)
            if first is None and run.get("isolations"):
                first = k
        return {s: REASONS[run.get(f"{s}_reason")] for s in SIGNALS}, first


WRONGS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "polarity": lambda u: -u[WRONG:],
    "scale": lambda u: 3.0 * u[WRONG:],
    "stamp": lambda u: u[WRONG - 20 : -20],
    "sine": lambda u: u[WRONG:] + 5e-4 * np.sin(0.08 * np.arange(STAMPS - WRONG)),
}


@pytest.mark.parametrize("kind", WRONGS)
@pytest.mark.parametrize("who", [0, 2])
def test_the_c_names_what_numpy_names_at_the_same_stamp(
    kind: str, who: int, detector: Path, patterns: Patterns
) -> None:
    curves = swing((0.3, 1.0))
    curves[who, WRONG:] = WRONGS[kind](curves[who])
    reasons, first = named(detector, curves)
    assert reasons == {s: "pattern" if k == who else "trusted" for k, s in enumerate(SIGNALS)}
    # window w is complete at stamp (w + SAMPLES) FRAMES - 1
    expected = (np.nonzero(scores(curves, patterns) > THRESHOLD)[0][0] + SAMPLES) * FRAMES - 1
    assert first == expected
    assert (first - WRONG) * FRAME_S < 1.0


def test_a_small_score_counts_when_it_lasts(patterns: Patterns, tmp_path: Path) -> None:
    """1.2 times the signal leaves less than the threshold; what a fault leaves is over before it counts."""
    curves = swing((0.3, 1.0))
    curves[2, WRONG:] *= 1.2
    score, suspect = scores_and_suspects(curves, patterns)
    both = replace(patterns, threshold=1.1 * score.max(), lasting=0.1 * score.max())
    path = build_fmu(detector_block(SIGNALS, patterns=both), tmp_path / "lasting.fmu")
    reasons, first = named(path, curves)
    assert reasons == {s: "pattern" if s == "c" else "trusted" for s in SIGNALS}
    before = np.nonzero(lasting(score, suspect) > both.lasting)[0][0] + LASTS - 1
    assert first == (before + SAMPLES) * FRAMES - 1
    assert LASTS * FRAMES <= first - WRONG + 1 < 2 * LASTS * FRAMES
    curves = swing((0.3, 1.0))
    curves[2, WRONG + 2 : WRONG + 10] += 1e-4  # .16 s
    score, suspect = scores_and_suspects(curves, patterns)
    assert both.threshold > score.max() > both.lasting
    assert np.sum(score > both.lasting) == LASTS - 1
    assert named(path, curves)[1] is None


def test_a_swing_that_no_run_has_shown_is_trusted(detector: Path) -> None:
    """Other sizes and phases of the same modes; and a motion of all signals of another frequency."""
    assert named(detector, swing((2.0, 4.0), (2e-3, 2e-3)))[1] is None
    together = swing((0.0, 0.0)) + 1e-3 * np.sin(0.5 * np.arange(STAMPS)) * np.array(
        [[1.0], [-1.0], [0.7], [0.8]]
    )
    assert named(detector, together)[1] is None


def test_patterns_of_another_order_are_the_same_law(patterns: Patterns) -> None:
    curves = swing((0.3, 1.0))
    curves[1, WRONG:] *= -1.0
    order = [2, 0, 3, 1]
    ours, theirs = scores(curves[order], patterns.of(order)), scores(curves, patterns)
    np.testing.assert_array_equal(ours > THRESHOLD, theirs > THRESHOLD)
    np.testing.assert_allclose(
        ours[ours > THRESHOLD], theirs[ours > THRESHOLD], rtol=1e-3
    )  # of a difference of squares


def test_what_moves_alone_is_named_where_numpy_says(patterns: Patterns, tmp_path: Path) -> None:
    """A quiet grid and a sine on one signal: no window of the others says anything."""
    strict = replace(patterns, threshold=1e6, alone=4.0)
    path = build_fmu(detector_block(SIGNALS, patterns=strict), tmp_path / "alone.fmu")
    curves = swing((0.3, 1.0), (2e-5, 0.0))
    t = FRAME_S * np.arange(STAMPS - WRONG)
    sine = 5e-4 * np.sin(4.0 * t)
    curves[2, WRONG:] += sine
    reasons, first = named(path, curves)
    assert reasons == {s: "alone" if s == "c" else "trusted" for s in SIGNALS}
    share = shares(curves, FLOOR)
    assert share.shape == (4, STAMPS - 99 - 149)
    assert first == alone_from(curves, 4.0)
    # that it may not fall is asked since it began, not of the last 3 s: later by what the swing grows
    assert 0 <= first - (np.nonzero((share > 4.0).any(axis=0))[0][0] + 99 + 149) < 25
    assert np.delete(share, 2, axis=0).max() < 4.0
    # a machine that swings alone after a fault near it: as far, for as long, but it dies out
    curves[2, WRONG:] += sine * (4.0 * np.exp(-0.6 * t) - 1.0)
    own = np.array([swings_at(curves, k) for k in range(STAMPS - 200, STAMPS)])
    assert np.all(own[:, 2] > 4.0 * (3.0 * FLOOR + np.delete(own, 2, axis=1).max(axis=1)))
    assert named(path, curves)[1] is None
    assert shares(curves, FLOOR).max() < 4.0


def test_a_drift_of_all_does_not_hide_what_moves_alone(patterns: Patterns, tmp_path: Path) -> None:
    """The drift spans 2e-3 in 2 s, as much as the sine: less their trends the others are at rest."""
    strict = replace(patterns, threshold=1e6, alone=4.0)
    path = build_fmu(detector_block(SIGNALS, patterns=strict), tmp_path / "drift.fmu")
    curves = swing((0.3, 1.0), (2e-5, 0.0)) + 1e-3 * FRAME_S * np.arange(STAMPS)
    assert named(path, curves)[1] is None
    curves[2, WRONG:] += 1e-3 * np.sin(4.0 * FRAME_S * np.arange(STAMPS - WRONG))
    assert np.ptp(curves[1, -100:]) > 0.5 * np.ptp(curves[2, -100:])
    reasons, first = named(path, curves)
    assert reasons == {s: "alone" if s == "c" else "trusted" for s in SIGNALS}
    assert first == alone_from(curves, 4.0)


def swings_at(curves: np.ndarray, k: int) -> np.ndarray:
    """Spans of the last 100 stamps less the line through every fourth of 256, if 48 of these are there."""
    at = np.arange(k, max(k - 256, -1), -4)
    rise = np.polyfit(at, curves[:, at].T, 1)[0] if len(at) >= 48 else np.zeros(len(curves))
    return np.ptp(curves[:, k - 99 : k + 1] - np.outer(rise, np.arange(100)), axis=1)


def alone_from(curves: np.ndarray, limit: float) -> int:
    """The stamp at which signal 2 has swung alone for 150, by the words of detector.h."""
    since, least, most = None, 0.0, 0.0
    for k in range(99, STAMPS):
        own = swings_at(curves, k)
        if not own[2] > limit * (3.0 * FLOOR + np.delete(own, 2).max()):
            since = None
            continue
        least, most = min(least, own[2]), max(most, own[2])
        if since is None or not least > 0.6 * most:
            since, least, most = k, own[2], own[2]
        if k - since + 1 >= 150:
            return k
    raise AssertionError("never")


def test_a_design_is_written_and_read(patterns: Patterns, tmp_path: Path) -> None:
    design = DetectorDesign("grid", "robust", SIGNALS, FRAME_S, 1e-5, patterns, 1.5, 30, 20)
    again = load_detector(design.save(tmp_path / "d.json"))
    np.testing.assert_array_equal(again.patterns.basis, patterns.basis)
    assert (again.signals, again.patterns.numbers, again.largest) == (SIGNALS, patterns.numbers, 1.5)


@pytest.mark.parametrize("text", ["", "{}", json.dumps({"schema": 1, "detector": {}, "runs": {}})])
def test_other_files_are_refused_in_a_line(text: str, tmp_path: Path) -> None:
    (tmp_path / "d.json").write_text(text)
    with pytest.raises(DetectorDesignError, match="not a detector file"):
        load_detector(tmp_path / "d.json")


def test_patterns_of_other_signals_do_not_fit(patterns: Patterns, tmp_path: Path) -> None:
    path = build_fmu(detector_block(SIGNALS[:3], patterns=patterns), tmp_path / "three.fmu")
    with pytest.raises(Exception), Runner(path):  # noqa: B017
        pass


def test_the_command_refuses_two_signals_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["two-area-thesis", "robust", "G2_dw", "G4_dw", "--out", str(tmp_path / "d.json")]) == 2
    assert "allowed: three or more that differ" in capsys.readouterr().err
