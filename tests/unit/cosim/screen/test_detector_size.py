"""How many directions the patterns of a detector keep."""

from __future__ import annotations

import numpy as np
import pytest

from interarea.cosim.screen.detector_size import LEAST, MARGIN, PER_SIGNAL, patterns_of, rightly_named
from interarea.design.controllers.detector_record import (
    FRAMES,
    SAMPLES,
    basis_of,
    lasting,
    scores,
    scores_and_suspects,
    windows,
)
from interarea.models.blocks.detector import Patterns

SIGNALS, STAMPS, EVENT, FRAME_S = 6, 300, 100, 0.02
FLOOR = 1e-6
MODES_HZ = (0.4, 0.6, 0.8, 0.95, 1.1, 1.3, 1.5)


def runs(count: int, seed: int) -> list[np.ndarray]:
    """Seven damped modes of six signals, each run with other sizes and phases."""
    shapes = np.random.default_rng(1).standard_normal((SIGNALS, len(MODES_HZ)))
    random = np.random.default_rng(seed)
    t = FRAME_S * np.clip(np.arange(STAMPS) - EVENT, 0, None)
    results = []
    for _ in range(count):
        phases, sizes = random.uniform(0, 6.3, len(MODES_HZ)), random.uniform(5e-4, 2e-3, len(MODES_HZ))
        waves = [
            s * np.exp(-0.2 * t) * np.sin(2 * np.pi * f * t + p)
            for f, p, s in zip(MODES_HZ, phases, sizes, strict=True)
        ]
        results.append(np.where(np.arange(STAMPS) < EVENT, 0.0, shapes @ np.array(waves)))
    return results


def shifted(signals: list[np.ndarray]) -> list[np.ndarray]:
    """The same runs, sampled from their first stamp on, from their second, third and fourth."""
    return [c[:, k:] for c in signals for k in range(4)]


def of_size(size: int, seen: list[np.ndarray], judged: list[np.ndarray]) -> Patterns:
    free = Patterns(basis_of(shifted(seen), FLOOR, size), FRAMES, 1.0, 1.0, FLOOR, 1e9)
    largest = max(float(scores(c, free).max()) for c in shifted(judged))
    least = [float(lasting(*scores_and_suspects(c, free)).max()) for c in shifted(judged)]
    lasts = MARGIN * max(LEAST, *least)
    return Patterns(free.basis, FRAMES, MARGIN * largest, lasts, FLOOR, 1e9)


@pytest.mark.slow
def test_the_size_is_the_one_that_names_most_wrong_signals() -> None:
    seen, judged = runs(20, 2), runs(2, 3)
    worth = {k: rightly_named(judged, of_size(SIGNALS * k, seen, judged), EVENT) for k in PER_SIGNAL}
    chosen = patterns_of(seen, judged, FLOOR, EVENT)
    k = chosen.basis.shape[2] // SIGNALS
    assert worth[k] == max(worth.values()) > 0
    assert chosen.lasting == pytest.approx(of_size(k * SIGNALS, seen, judged).lasting)
    # of seven modes the sine and the cosine: twelve directions, enough for two areas, are too few
    assert chosen.basis.shape[2] > 12
    assert worth[k] > rightly_named(judged, of_size(12, seen, judged), EVENT)
    # of each run the largest score of all instants in a sample that its disturbance may begin at
    of_phases = [max(float(scores(c[:, k:], chosen).max()) for c in judged) for k in range(FRAMES)]
    assert max(of_phases) == pytest.approx(chosen.threshold / MARGIN)
    assert min(of_phases) < 0.95 * max(of_phases)


def test_a_frequency_that_has_settled_at_an_offset_is_in_the_patterns() -> None:
    """The runs swing about 0 and hardly show it: .2 % of an offset is left, without such windows half."""
    seen = runs(20, 2)
    window = np.full((SIGNALS, SAMPLES, 1), 1.0 / np.sqrt(SIGNALS * SAMPLES))

    def left(basis: np.ndarray) -> float:
        return float(np.sqrt(1.0 - ((window * basis).sum(axis=(0, 1)) ** 2).sum()))

    flat = np.concatenate([windows(c, FRAMES, SAMPLES) for c in seen]).reshape(-1, SIGNALS * SAMPLES)
    _, vectors = np.linalg.eigh(flat.T @ flat)
    without = vectors[:, ::-1][:, : 3 * SIGNALS].reshape(SIGNALS, SAMPLES, -1)
    assert left(basis_of(seen, FLOOR, 3 * SIGNALS)) < 0.01 < 0.4 < left(without)


def test_another_name_counts_against_a_size() -> None:
    """The same patterns with the signals in another order name others in their place."""
    seen, judged = runs(20, 2), runs(1, 3)
    patterns = of_size(4 * SIGNALS, seen, judged)
    order = np.roll(np.arange(SIGNALS), 1)
    moved = [c[order] for c in judged]
    assert rightly_named(moved, patterns.of(order), EVENT) == rightly_named(judged, patterns, EVENT) > 0
    confused = Patterns(patterns.basis[order], FRAMES, 1e-9, 1e9, FLOOR, 1e9)
    assert rightly_named(judged, confused, EVENT) < 0
