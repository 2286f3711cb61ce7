"""The detector of a scenario: its keys, the signals that it compares, the FMU parameters they become."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from interarea.models.detector_defaults import (
    APART_PU,
    APART_SHARE,
    AVERAGE_S,
    JUMP_PU_PER_S,
    MOVING_PU,
    RANGE_PU,
    REPEAT_FRAMES,
    RETURN_S,
    ROUGH_PU,
    STANDING_PU,
    STANDING_S,
    WAIT_S,
)
from interarea.models.table import Table

from .signal_paths import SignalPath

if TYPE_CHECKING:  # tables are checked before what runs them, numpy with it, is loaded
    from ..master.instances import Value

DETECTOR = "detector"  #: name of its instance
_MOST_STAMPS = 256  # that a mean is taken over (detector.h)
Positive = Annotated[float, Field(gt=0.0)]


class DetectorTable(Table):
    """Which signals are trusted (semantics: models/c/detector/detector.h); input: all signals in packets.

    A signal that no input of the controller takes is a witness: it is compared with the others.
    """

    #: of `design_detector`, relative to this file: patterns of correct signals; default: not tested
    file: Annotated[str, Field(examples=["detector.json"])] = ""
    range_pu: Annotated[float, Field(gt=0.0, examples=[0.05])] = RANGE_PU  #: largest magnitude of a signal
    #: its largest change in a second
    jump_pu_per_s: Annotated[float, Field(gt=0.0, examples=[0.24])] = JUMP_PU_PER_S
    #: consecutive frames, equal or as earlier ones, that fail the test while others move
    repeat_frames: Annotated[int, Field(ge=1)] = REPEAT_FRAMES
    #: largest distance of a signal's mean from the median of the others
    apart_pu: Annotated[float, Field(gt=0.0, examples=[0.001])] = APART_PU
    #: share of the others' span that is added to this distance
    apart_share: Annotated[float, Field(ge=0.0)] = APART_SHARE
    #: largest median of the second differences of a signal, plus twice that of the others
    rough_pu: Annotated[float, Field(gt=0.0, examples=[0.0001])] = ROUGH_PU
    #: time over which means are taken: a period of the slowest swing, or more
    average_s: Positive = AVERAGE_S
    #: time without a failed test before a signal is trusted again; twice as long each further time
    return_s: Annotated[float, Field(ge=0.0, examples=[5.0])] = RETURN_S
    #: span of a swing that takes all signals out when it stands, whatever its cause; ambient noise with 4 mHz
    #: rms between areas reaches .71 of it in 24 hours (docs/wrong_signals.md)
    standing_pu: Annotated[float, Field(gt=0.0, examples=[0.0003])] = STANDING_PU
    standing_s: Positive = STANDING_S  #: duration of such a swing before they are withheld
    wait_s: Annotated[float, Field(ge=0.0)] = WAIT_S  #: signals later than this are not waited for

    def wrong(self, paths: Sequence[SignalPath], names: Collection[str]) -> Iterator[str]:
        """Yield why these signals cannot be compared; names : of other instances."""
        if DETECTOR in names:
            yield f"detector: the name of its instance, {DETECTOR!r}, is taken, allowed: one not in use"
        if not paths:
            yield "detector: no signal has a channel or a concentrator, allowed: at least one"
        without = [w.signal for w in paths if not w.interval_s]
        if without:
            yield (
                f"detector: {', '.join(without)} is sent without packets, allowed: set reporting_interval_s "
                "of its channel"
            )
        other = [w.signal for w in paths if w.pmu is not None and w.pmu.quantity != "frequency"]
        if other:
            yield f"detector: {', '.join(other)} is not a frequency, allowed: speeds (dw) and frequencies"
        yield from self._wrong_packets(sorted({w.interval_s for w in paths if w.interval_s}))

    def _wrong_packets(self, intervals: Sequence[float]) -> Iterator[str]:
        if len(intervals) > 1:
            each = " and ".join(f"{t:g} s" for t in intervals)
            yield f"detector: packets come every {each}, allowed: one reporting interval for all signals"
        elif intervals and not intervals[0] <= self.average_s <= _MOST_STAMPS * intervals[0] * (1 + 1e-9):
            yield (
                f"detector: average_s = {self.average_s:g} with packets every {intervals[0]:g} s, allowed: "
                f"1 to {_MOST_STAMPS} packets"
            )

    def parameters(self, paths: Sequence[SignalPath]) -> dict[str, Value]:
        """Return the parameters of the FMU for these signals."""
        quantum = max(w.quantum for w in paths)
        start: dict[str, Value] = {
            "interval": paths[0].interval_s,
            "wait": self.wait_s,
            "average": self.average_s,
            "return_time": self.return_s,
            "moving": max(MOVING_PU, 4.0 * quantum),  # the rounded top of a swing repeats, and is not stuck
            "share": self.apart_share,
            "standing": self.standing_pu,
            "standing_time": self.standing_s,
            "repeats": self.repeat_frames,
        }
        for i in range(1, len(paths) + 1):
            start |= {
                f"range[{i}]": self.range_pu,
                f"jump[{i}]": self.jump_pu_per_s,
                f"apart[{i}]": self.apart_pu,
                f"rough[{i}]": max(self.rough_pu, 4.0 * quantum),  # rounding bends too
            }
        return start


def few_signals(paths: Sequence[SignalPath]) -> list[str]:
    """Return a line where so few signals are compared that none can be named."""
    if len(paths) >= 3:
        return []
    return [
        f"detector: it has {len(paths)} signals and cannot identify the wrong one of two that disagree, "
        "so only range, jump and repetition are tested; add channels of further signals"
    ]
