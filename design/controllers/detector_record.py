"""What a detector of wrong signals was designed as: how right signals move together, with its record.

A window of all signals after a disturbance lies near a subspace of few directions; a wrong signal leaves it,
and the window without that signal does not (identification by reconstruction [Dunia1996]).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from interarea.models.blocks.detector import Patterns
from interarea.models.detector_defaults import AVERAGE_S, DETECTOR_WRITER, INTERVAL_S
from interarea.models.documents import DocumentError, read_document
from interarea.models.errors import UserError
from interarea.models.files import write_whole

Array = npt.NDArray[np.float64]
FRAMES, SAMPLES = 4, 12  #: stamps a sample, samples a window
#: windows in a row that a score lasts for, one more than contain a fault of .16 s (DETECTOR_EVENT in C)
LASTS = SAMPLES + 3
_SCHEMA = 3
_SPAN = round(AVERAGE_S / INTERVAL_S)  # stamps that a span is taken over
HELD, _OF_TREND = 256, 4  #: stamps that the trend is taken of; DETECTOR_STAMPS, DETECTOR_TREND in C
_ALONE, _STEADY = _SPAN * 3 // 2, 0.6  # stamps that a signal swings alone for; STEADY of stamps.c


class DetectorDesignError(UserError):
    """No detector can be designed of this, or a file is none."""


@dataclass(frozen=True)
class DetectorDesign:
    """A detector for some signals of a grid, and what it was made and judged of.

    signals : names, in the order of the patterns. interval_s : between their frames. noise_pu : standard
    deviation of each frame in the runs. largest : largest score of right signals in the judged runs.
    made_of, judged_by : runs.
    """

    case: str
    controller: str
    signals: tuple[str, ...]
    interval_s: float
    noise_pu: float
    patterns: Patterns
    largest: float
    made_of: int
    judged_by: int

    def save(self, path: str | Path) -> Path:
        """Write the JSON file that ``[detector] file`` names; return its path."""
        p = self.patterns
        table = {
            "schema": _SCHEMA,
            "detector": {"case": self.case, "controller": self.controller, "signals": list(self.signals)},
            "interval_s": self.interval_s,
            "noise_pu": self.noise_pu,
            "frames": p.frames,
            "threshold": p.threshold,
            "lasting": p.lasting,
            "floor": p.floor,
            "alone": p.alone,
            "largest": self.largest,
            "runs": {"made_of": self.made_of, "judged_by": self.judged_by},
            "basis": p.basis.tolist(),
        }
        return write_whole(Path(path), (json.dumps(table, allow_nan=False) + "\n").encode())


def load_detector(path: str | Path) -> DetectorDesign:
    """Read a detector's file.

    Raises
    ------
    DetectorDesignError : no such file, no regular one, or not one of `DetectorDesign.save`.
    """
    try:
        table: Any = json.loads(read_document(Path(path), "the file of a detector"))
        of, runs = table["detector"], table["runs"]
        basis = np.array(table["basis"], dtype=np.float64)
        if table["schema"] != _SCHEMA or basis.ndim != 3 or len(basis) != len(of["signals"]):
            raise ValueError("another schema, or a basis of other signals")
        limits = (float(table[key]) for key in ("threshold", "lasting", "floor", "alone"))
        patterns = Patterns(basis, int(table["frames"]), *limits)
        return DetectorDesign(
            *(str(of["case"]), str(of["controller"]), tuple(map(str, of["signals"]))),
            *(float(table["interval_s"]), float(table["noise_pu"]), patterns),
            *(float(table["largest"]), int(runs["made_of"]), int(runs["judged_by"])),
        )
    except DocumentError as error:
        raise DetectorDesignError(f"{error}; {DETECTOR_WRITER}") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        why = f"no key {error}" if isinstance(error, KeyError) else error
        raise DetectorDesignError(f"{path}: not a detector file ({why}); {DETECTOR_WRITER}") from None


def windows(curves: Array, frames: int, samples: int) -> Array:
    """Return every window (windows, signals, samples) of curves (signals, stamps): means, newest last."""
    signals, stamps = curves.shape
    count = stamps // frames
    means = curves[:, : count * frames].reshape(signals, count, frames).mean(axis=2)
    return np.stack([means[:, k : k + samples] for k in range(count - samples + 1)])


def basis_of(curves: Sequence[Array], floor: float, size: int) -> Array:
    """Return the `size` directions that windows of curves have in common, each window of length 1.

    As many windows again are constant and equal in all signals: so the grid is long after a disturbance, at
    an offset that the curves need not reach. floor : windows shorter than ten of it are left out.
    """
    sampled = np.concatenate([windows(c, FRAMES, SAMPLES) for c in curves])
    length = np.sqrt((sampled**2).sum(axis=(1, 2)))
    rows = (sampled / np.maximum(length, 1e-300)[:, None, None])[length > 10.0 * floor]
    flat = rows.reshape(len(rows), -1)
    settled = np.full(flat.shape[1], np.sqrt(len(flat) / flat.shape[1]))
    _, vectors = np.linalg.eigh(flat.T @ flat + np.outer(settled, settled))
    return np.asarray(vectors[:, ::-1][:, :size]).reshape(*sampled.shape[1:], size)


def scores(curves: Array, patterns: Patterns) -> Array:
    """Return the score of each window (models/c/detector/pattern.h) of curves (signals, stamps)."""
    return scores_and_suspects(curves, patterns)[0]


def scores_and_suspects(curves: Array, patterns: Patterns) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return the score of each window of curves (signals, stamps), and without which signal least is left."""
    n, samples, size = patterns.basis.shape
    x = windows(curves, patterns.frames, samples)
    V = patterns.basis.reshape(-1, size)
    others = patterns.data["pattern.others"].reshape(n, -1, size)
    left = np.array([_left(np.delete(x, i, axis=1), others[i]) for i in range(n)])
    least = left.min(axis=0)
    score = np.sqrt(np.maximum(_left(x, V) ** 2 - least**2, 0.0)) / (patterns.floor + 3.0 * least)
    return np.asarray(score), np.asarray(left.argmin(axis=0))


def lasting(score: Array, suspect: npt.NDArray[np.int64]) -> Array:
    """Return the least score of each `LASTS` windows in a row, and 0 where they suspect different signals."""
    windows_of, suspects = (np.lib.stride_tricks.sliding_window_view(v, LASTS) for v in (score, suspect))
    return np.where(np.ptp(suspects, axis=1) == 0, windows_of.min(axis=1), 0.0)


def shares(curves: Array, floor: float) -> Array:
    """Return by how many times each signal swings more than the others, of curves (signals, stamps).

    The least over half as many stamps again as a swing is taken over: for so long it lasts before it counts.
    0 where its swing does not stay in that time.
    """
    swing = swings(curves)
    others = np.array([np.delete(swing, i, axis=0).max(axis=0) for i in range(len(swing))])
    share = swing / (3.0 * floor + others)
    lasts, own = (np.lib.stride_tricks.sliding_window_view(v, _ALONE, axis=1) for v in (share, swing))
    return np.where(own.min(axis=2) > _STEADY * own.max(axis=2), lasts.min(axis=2), 0.0)


def swings(curves: Array, every: int = 1) -> Array:
    """Return the span of each signal less its trend, of curves (signals, stamps), from the first span on.

    The trend is the line through every fourth of the last 256 stamps; none before three quarters of them.
    every : stamps from one span to the next.
    """
    ends = np.arange(_SPAN, curves.shape[1] + 1, every)
    early = [_spans(curves[:, None, :end])[:, 0] for end in ends[ends < HELD]]
    result = np.array(early).reshape(len(early), len(curves)).T
    late = ends[ends >= HELD]
    if not len(late):
        return result
    held = np.lib.stride_tricks.sliding_window_view(curves, HELD, axis=1)[:, late[0] - HELD :: every]
    return np.concatenate([result, _spans(held)], axis=1)


def _spans(held: Array) -> Array:
    """Return the spans of the last stamps of windows (signals, windows, at most HELD), less their trends."""
    of_trend = held[..., ::-_OF_TREND]
    at = np.arange(of_trend.shape[2]) - 0.5 * (of_trend.shape[2] - 1)
    known = 4 * _OF_TREND * len(at) >= 3 * HELD
    trend = of_trend @ at / (-_OF_TREND * (at @ at)) if known else np.zeros(held.shape[:2])
    return np.asarray(np.ptp(held[..., -_SPAN:] - trend[..., None] * np.arange(_SPAN), axis=2))


def _left(x: Array, V: Array) -> Array:
    flat = x.reshape(len(x), -1)
    return np.asarray(np.sqrt(np.maximum((flat**2).sum(axis=1) - ((flat @ V) ** 2).sum(axis=1), 0.0)))
