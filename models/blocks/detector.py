"""Which of several measured frequencies are to be trusted, as a block (semantics: detector/detector.h)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import detector_defaults as default
from .sizes import MOST_SIGNALS
from .variables import Block, Variable, VariableTable

_FOLDER = Path(__file__).resolve().parents[1] / "c"
#: what the integer output NAME_reason says, by its value
REASONS = (
    *("trusted", "lost", "range", "jump", "repeat", "apart"),
    *("pattern", "rough", "alone", "replay", "standing"),
)
WEAKEST = 0.05  #: singular value of a direction that the other signals show


@dataclass(frozen=True)
class Patterns:
    """How right signals move together (semantics: detector/pattern.h).

    basis : (signals, samples, size), orthonormal as a matrix of signals * samples rows.
    frames : stamps that each sample is a mean of. threshold : allowed score. lasting : allowed score of three
    more windows in a row than a window has samples. floor : of what is left, pu. alone : how many times the
    others' span a signal may span.
    """

    basis: npt.NDArray[np.float64]
    frames: int
    threshold: float
    lasting: float
    floor: float
    alone: float

    @property
    def numbers(self) -> tuple[int, float, float, float, float]:
        """All of it but the basis."""
        return self.frames, self.threshold, self.lasting, self.floor, self.alone

    def of(self, order: Sequence[int]) -> Patterns:
        """Return the patterns of the same signals in another order."""
        return replace(self, basis=self.basis[list(order)])

    @cached_property
    def data(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays of the record."""
        n, samples, size = self.basis.shape
        others = np.zeros((n, (n - 1) * samples, size))
        for i in range(n):
            U, singular, _ = np.linalg.svd(
                np.delete(self.basis, i, axis=0).reshape(-1, size), full_matrices=False
            )
            seen = int(np.sum(singular > WEAKEST))  # a direction that the others hardly show tells nothing
            others[i, :, :seen] = U[:, :seen]
        return {
            "pattern.size": np.array([self.frames, samples, size], dtype=np.int32),
            "pattern.all": self.basis.ravel(),
            "pattern.others": others.ravel(),
        }


def detector_block(
    signals: Sequence[str],
    name: str = "detector",
    *,
    patterns: Patterns | None = None,
    step_s: float = 0.01,
) -> Block:
    """Return the block of a detector of these signals: inputs NAME, ``NAME_age`` (s) and ``NAME_valid``.

    Boolean outputs: ``NAME_usable``, the flag is up and the signal is not isolated; ``NAME_trusted``, it is
    not isolated. Integer outputs: ``NAME_reason`` (`REASONS`) and ``isolations``, how many there were.
    patterns : how right signals move together; None: their patterns are not tested.
    FMI parameters: ``interval``, ``wait``, ``average``, ``return_time``, ``standing_time`` (s), ``moving``,
    ``standing`` (pu), ``share``, ``repeats``; of each signal ``range[i]``, ``jump[i]`` (a second),
    ``apart[i]``, ``rough[i]`` in its unit.

    Raises
    ------
    ValueError : fewer than 1 or more than 32 signals, or one named twice.
    """
    if not 1 <= len(signals) <= MOST_SIGNALS or len(set(signals)) != len(signals):
        raise ValueError(
            f"detector {name}: signals are {list(signals)}, allowed: 1 to {MOST_SIGNALS} different names"
        )
    return Block(
        kind="detector",
        name=name,
        description="Detector of wrong signals: which of several measured frequencies are to be trusted",
        table=VariableTable([*_ports(signals), *_parameters(signals, patterns)]),
        data={} if patterns is None else patterns.data,
        sources=tuple(_FOLDER / "detector" / f"{part}.c" for part in ("step", "stamps", "pattern")),
        step_s=step_s,
        model_exchange=False,
        documentation={"Behaviour": _BEHAVIOUR},
    )


def _ports(signals: Sequence[str]) -> Iterator[Variable]:
    for s in signals:
        yield Variable(s, "input", f"Signal {s} as it arrives", unit="pu", start=0.0)
    for s in signals:
        yield Variable(f"{s}_age", "input", f"Time since the stamp of {s}", unit="s", start=0.0)
    for s in signals:
        yield Variable(f"{s}_valid", "input", f"Whether {s} arrives", type="Boolean", start=True)
    for s in signals:
        text = f"{s} arrives and is not isolated"
        yield Variable(f"{s}_usable", "output", text, type="Boolean", depends_on=())
    for s in signals:
        yield Variable(f"{s}_trusted", "output", f"{s} is not isolated", type="Boolean", depends_on=())
    numbered = ", ".join(f"{k} {word}" for k, word in enumerate(REASONS))
    for s in signals:
        text = f"Why {s} cannot be used: {numbered}"
        yield Variable(f"{s}_reason", "output", text, type="Integer", depends_on=())
    yield Variable("isolations", "output", "Isolations so far", type="Integer", depends_on=())


def _parameters(signals: Sequence[str], patterns: Patterns | None) -> Iterator[Variable]:
    for key, text, unit, start in (
        ("interval", "Interval of frames", "s", default.INTERVAL_S),
        ("wait", "Longest wait for the frame of a delayed signal", "s", default.WAIT_S),
        ("average", "Time over which means are compared", "s", default.AVERAGE_S),
        (
            "return_time",
            "Time for which an isolated signal must pass every test before its first return",
            "s",
            default.RETURN_S,
        ),
        ("moving", "Least change between two frames of a signal that moves", "pu", default.MOVING_PU),
        (
            "share",
            "Share of the span of the others that is added to `apart`",
            "1",
            default.APART_SHARE,
        ),
        ("pattern", "Largest score against the patterns", "1", patterns.threshold if patterns else 1.0),
        ("lasting", "Largest lasting score against the patterns", "1", patterns.lasting if patterns else 1.0),
        ("floor", "Noise floor of the residual of a window", "pu", patterns.floor if patterns else 1.0),
        (
            "alone",
            "Largest span, as a share of the span of the other signals",
            "1",
            patterns.alone if patterns else 1e9,
        ),
        ("standing", "Span of a sustained swing that isolates all signals", "pu", default.STANDING_PU),
        ("standing_time", "Duration of that swing before it does", "s", default.STANDING_S),
    ):
        yield Variable(key, "parameter", text, unit=unit, start=start, min=0.0)
    for i, s in enumerate(signals, start=1):
        for key, text, start in (
            ("range", f"Largest magnitude of {s}", default.RANGE_PU),
            ("jump", f"Largest change of {s} in a second", default.JUMP_PU_PER_S),
            ("apart", f"Largest distance of the mean of {s} from the others", default.APART_PU),
            ("rough", f"Largest median of the second differences of {s}", default.ROUGH_PU),
        ):
            unit = "pu/s" if key == "jump" else "pu"
            yield Variable(f"{key}[{i}]", "parameter", text, unit=unit, start=start, min=0.0)
    text = "Number of consecutive repeated frames that isolates a signal"
    yield Variable("repeats", "parameter", text, type="Integer", start=default.REPEAT_FRAMES, min=1)


_BEHAVIOUR = (
    "<p>Each frame of a signal is tested for its range, its change and repetition; the means of all signals "
    "over <code>average</code>, and their roughness, are compared at equal stamps. A signal that fails is "
    "isolated until it has passed every test for <code>return_time</code>; this time doubles with each "
    "isolation. A sustained swing isolates all signals. Outputs follow from the inputs at the beginning of "
    "a step.</p>"
)
