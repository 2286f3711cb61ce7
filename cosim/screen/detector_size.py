"""Number of directions of a detector's patterns: the one that identifies most of the inserted wrong signals.

With too few directions the correct signals of a large grid leave the space, so the threshold is high; with
too many a wrong signal lies in the space. The best number grows with the signals: 12 for four speeds of two
areas, 40 for ten of New England.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from interarea.design.controllers.detector_record import (
    FRAMES,
    LASTS,
    SAMPLES,
    basis_of,
    lasting,
    scores_and_suspects,
)
from interarea.models.blocks.detector import Patterns

Array = npt.NDArray[np.float64]
MARGIN = 1.3  #: of a limit over the largest of right signals
LEAST = 1.0  #: lasting score of right signals that a limit is at least made of
#: the same of `alone`: by so much more than the others G3 of two areas swings while there is a sine on G4
LEAST_ALONE = 1.5
PER_SIGNAL = (3, 2, 4, 5, 6, 8)  #: directions that are tried, of equal ones the first
MOVES_PU = 1e-3  #: span from which on a signal is tried
_BEFORE, _SEEN = 25, 150  # stamps from a disturbance to where a signal goes wrong, and of what follows
_LATE = 40  # stamps
#: what `pattern` is for: the wrong part of a signal, of the signal and the first wrong stamp
_WRONGS: tuple[Callable[[Array, int], Array], ...] = (
    lambda u, first: -u[first:],
    lambda u, first: 3.0 * u[first:],
    lambda u, first: 0.0 * u[first:],
    lambda u, first: u[first - _LATE : -_LATE],
)


def patterns_of(seen: Sequence[Array], judged: Sequence[Array], floor: float, event: int) -> Patterns:
    """Return the patterns of the runs `seen`, with the best number of directions; `judged` set the threshold.

    seen, judged : (signals, stamps) of each run with correct signals, which are sampled from each stamp of
    a sample on, since a disturbance may begin at any of them. floor : see `basis_of`. event : stamp
    of the disturbance. `alone` has no limit yet.
    """
    signals = len(seen[0])
    best: tuple[int, Patterns] | None = None
    basis = basis_of(list(_phases(seen)), floor, signals * max(PER_SIGNAL))
    for size in (signals * share for share in PER_SIGNAL):
        patterns = Patterns(basis[:, :, :size], FRAMES, 1.0, 1.0, floor, 1e9)
        right = [scores_and_suspects(c, patterns) for c in _phases(judged)]
        threshold = MARGIN * max(float(score.max()) for score, _ in right)
        lasts = MARGIN * max(LEAST, *(float(lasting(*one).max()) for one in right))
        patterns = replace(patterns, threshold=threshold, lasting=lasts)
        worth = rightly_named(judged, patterns, event)
        if best is None or worth > best[0]:
            best = worth, patterns
    assert best is not None
    return best[1]


def _phases(runs: Sequence[Array]) -> Iterator[Array]:
    """Yield each run from each stamp of a sample on."""
    return (curves[:, first:] for curves in runs for first in range(FRAMES))


def rightly_named(judged: Sequence[Array], patterns: Patterns, event: int) -> int:
    """Return how many inserted wrong signals are identified, minus those for which another is named."""
    count = 0
    for who, curves in _wrong(judged, event):
        score, suspect = scores_and_suspects(curves, patterns)
        over = score > patterns.threshold
        over[LASTS - 1 :] |= lasting(score, suspect) > patterns.lasting
        if over.any():
            count += 1 if suspect[over.argmax()] == who else -1
    return count


def _wrong(judged: Sequence[Array], event: int) -> Iterator[tuple[int, Array]]:
    """Yield each signal that moves, and the curves with it wrong, up to `_SEEN` stamps after it is."""
    first = event + _BEFORE
    last = first + _SEEN
    for curves in judged:
        for who, own in enumerate(curves):
            if not np.ptp(own[first : last - FRAMES * SAMPLES // 2]) > MOVES_PU:
                continue
            for wrong in _WRONGS:
                changed = curves.copy()
                changed[who, first:] = wrong(own, first)
                yield who, changed[:, :last]
