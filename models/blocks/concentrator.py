"""A phasor data concentrator for several signals, as a block (semantics: concentrator/concentrator.h)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .channel import signal_fault_variables
from .packet_schedule import packet_random
from .sizes import MOST_SIGNALS, SIGNAL_FAULTS
from .variables import Block, Enumeration, Variable, VariableTable

_FOLDER = Path(__file__).resolve().parents[1] / "c"
_SLACK_S = 1e-10
_FIRST_STREAM = 16  # of the random numbers, as in concentrator.c
COUNTS = ("sent", "delivered", "dropped", "late")

ON_MISSING = Enumeration(
    "OnMissing",
    (
        ("zero", 0, "The output is zero while its signal is missing"),
        ("hold", 1, "The output keeps its last value"),
        ("hold_then_zero", 2, "As hold for hold_time, then zero"),
    ),
)


def concentrator_block(
    signals: int,
    name: str = "concentrator",
    *,
    capacity: int = 1024,
    unit: str = "pu",
    step_s: float = 0.01,
) -> Block:
    """Return the block of a concentrator of so many signals: inputs ``u1``.., outputs ``y1``.., ``valid1``...

    FMI parameters: ``reporting_interval``, ``wait``, ``latency``, ``hold_time`` (s), ``relative`` (Boolean),
    ``on_loss``, ``seed``; of each signal ``latency[i]``, ``jitter[i]`` (s), ``loss[i]``, ``lost[i].start``,
    ``lost[i].end`` (s), ``fault[i,k]`` as a channel's. Outputs besides:
    ``age`` (s) and the counts ``sent``, ``delivered``, ``dropped``, ``late`` of frames.

    Parameters
    ----------
    capacity : communication points that are remembered; the longest way / step must stay below it.

    Raises
    ------
    ValueError : fewer than 1 or more than 32 signals, a capacity below 2 or above 1 000 000.
    """
    if not 1 <= signals <= MOST_SIGNALS:
        raise ValueError(f"concentrator {name}: {signals} signals, allowed are 1 to {MOST_SIGNALS}")
    if not 2 <= capacity <= 1_000_000:
        raise ValueError(
            f"concentrator {name}: capacity is {capacity}, allowed are 2 to 1000000 communication points"
        )
    numbers = range(1, signals + 1)
    variables = [Variable(f"u{i}", "input", f"Signal {i}, measured", unit=unit, start=0.0) for i in numbers]
    variables += [
        Variable(f"y{i}", "output", f"Signal {i}, aligned", unit=unit, depends_on=(f"u{i}",)) for i in numbers
    ]
    variables.append(
        Variable("age", "output", "Time since the stamp of the newest set", unit="s", depends_on=())
    )
    variables += [
        Variable(
            f"valid{i}",
            "output",
            f"Whether the newest set contains signal {i}",
            type="Boolean",
            depends_on=(),
        )
        for i in numbers
    ]
    variables += [
        Variable(n, "output", f"Frames {what} so far", type="Integer", depends_on=())
        for n, what in zip(COUNTS, ("sent", "delivered in a set", "lost on the way", "too late"), strict=True)
    ]
    variables += [
        Variable("reporting_interval", "parameter", "Interval of stamps", unit="s", start=0.02, min=1e-4),
        Variable("wait", "parameter", "Longest wait for a set", unit="s", start=0.1, min=0.0),
        Variable(
            "latency",
            "parameter",
            "Latency from the concentrator to the receiver",
            unit="s",
            start=0.0,
            min=0.0,
        ),
        Variable("hold_time", "parameter", "Hold time of hold_then_zero", unit="s", start=0.5, min=0.0),
    ]
    for i in numbers:
        variables += [
            Variable(f"latency[{i}]", "parameter", f"Signal {i} to here", unit="s", start=0.0, min=0.0),
            Variable(f"jitter[{i}]", "parameter", "Width of its random part", unit="s", start=0.0, min=0.0),
            Variable(f"loss[{i}]", "parameter", "Probability of loss", start=0.0, min=0.0, max=1.0),
            Variable(f"lost[{i}].start", "parameter", "First stamp that is lost", unit="s", start=1e30),
            Variable(f"lost[{i}].end", "parameter", "First stamp that is not", unit="s", start=1e30),
        ]
    variables += [
        Variable(
            "relative",
            "parameter",
            "Whether the wait time starts at the first arrival",
            type="Boolean",
            start=False,
        ),
        Variable("on_loss", "parameter", "y if invalid", type="Enumeration", enumeration=ON_MISSING, start=2),
        Variable("seed", "parameter", "Which frames", type="Integer", start=0, min=0, max=2147483647),
    ]
    for i in numbers:
        for k in range(1, SIGNAL_FAULTS + 1):
            variables += signal_fault_variables(f"fault[{i},{k}]")
    channel = _FOLDER / "channel"
    return Block(
        kind="concentrator",
        name=name,
        description="Phasor data concentrator: several signals aligned by time stamp, with a wait time",
        table=VariableTable(variables),
        data={"capacity": np.array([capacity], dtype=np.int32)},
        sources=(
            _FOLDER / "concentrator" / "concentrator.c", channel / "history.c",
            channel / "signal_fault.c", _FOLDER / "block" / "random.c",
        ),
        step_s=step_s,
        model_exchange=False,
        documentation={"Behaviour": _BEHAVIOUR},
    )  # fmt: skip


@dataclass(frozen=True)
class FrameSets:
    """Sets by number: time stamp, instant at which each comes out (s), signals it has, (sets, signals)."""

    stamp_s: npt.NDArray[np.float64]
    due_s: npt.NDArray[np.float64]
    valid: npt.NDArray[np.bool_]

    @property
    def first_missing(self) -> npt.NDArray[np.bool_]:
        """Which sets lack a signal that the one before had (sets)."""
        before = np.ones_like(self.valid)
        before[1:] = self.valid[:-1]
        return np.asarray((before & ~self.valid).any(axis=1))


def frame_sets(parameters: Mapping[str, float], signals: int, start_s: float, stop_s: float) -> FrameSets:
    """Return the sets that a concentrator with these FMI parameters makes of the stamps in a run."""
    p = parameters
    interval, wait = p["reporting_interval"], p["wait"]
    first = math.ceil((start_s - _SLACK_S) / interval)
    number = np.arange(first, math.floor((stop_s + _SLACK_S) / interval) + 1, dtype=np.int64)
    stamp = number.astype(np.float64) * interval
    arrival = np.empty((number.size, signals))
    for i in range(1, signals + 1):
        stream = _FIRST_STREAM + 2 * (i - 1)
        seed = int(p.get("seed", 0))
        late = p.get(f"latency[{i}]", 0.0) + p.get(f"jitter[{i}]", 0.0) * packet_random(seed, number, stream)
        begin, end = p.get(f"lost[{i}].start", 1e30), p.get(f"lost[{i}].end", 1e30)
        gone = packet_random(seed, number, stream + 1) < p.get(f"loss[{i}]", 0.0)
        gone |= (begin <= stamp + _SLACK_S) & (stamp < end - _SLACK_S)
        arrival[:, i - 1] = np.where(gone, np.inf, stamp + late)
    opened = arrival.min(axis=1) if p.get("relative") else stamp
    released = np.minimum(arrival.max(axis=1), opened + wait)
    released_at_all = np.isfinite(released)
    stamp, released, arrival = (
        stamp[released_at_all],
        np.maximum.accumulate(released[released_at_all]),
        arrival[released_at_all],
    )
    valid = arrival <= released[:, None] + _SLACK_S
    return FrameSets(stamp, np.maximum(released, start_s) + p.get("latency", 0.0), valid)


_BEHAVIOUR = (
    "<p>Signals are sampled at k <code>reporting_interval</code>. The samples of one stamp make a set, which "
    "is released when all have arrived or when <code>wait</code> is over (after the stamp, or with "
    "<code>relative</code> after the first arrival), in the order of stamps, and comes out "
    "<code>latency</code> later. <code>valid</code>i says whether the newest set has signal i; "
    "<code>on_loss</code> decides y when not.</p>"
)
