"""When the packets of a channel arrive, computed as packets.c does: same hash, same doubles.

A tool that wants to be there when a value changes asks here; the channel itself needs nobody.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .sizes import QUANTILES

JITTER, TABLE, STATE, LOSS = 1, 2, 3, 4  #: purposes of a random number, as in packets.c
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_SLACK_S = 1e-10  # TIME_SLACK of channel_variables.h
Array = npt.NDArray[np.float64]


def packet_random(seed: int, packets: npt.NDArray[np.int64], purpose: int) -> Array:
    """Return a number in [0, 1) for each packet number: a hash of (seed, purpose, packet)."""
    with np.errstate(over="ignore"):
        z = _mixed(np.uint64(seed) + _GOLDEN)
        z = _mixed(z + _GOLDEN * np.uint64(purpose))
        numbers = _mixed(z + _GOLDEN * packets.astype(np.uint64))
    values: Array = (numbers >> np.uint64(11)).astype(np.float64) * (1.0 / 9007199254740992.0)
    return values


def _mixed(z: Any) -> Any:
    """Return the finaliser of SplitMix64 of one or many uint64."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@dataclass(frozen=True)
class Packets:
    """Packets by number: time stamp, instant at which each comes out (s), whether it is lost."""

    stamp_s: Array
    due_s: Array
    lost: npt.NDArray[np.bool_]


def packets_of(parameters: Mapping[str, float], start_s: float, stop_s: float) -> Packets:
    """Return the packets that a channel with these FMI parameters sends from `start_s` to `stop_s`.

    Raises
    ------
    ValueError : no reporting_interval.
    """
    p = {"seed": 0.0, **parameters}
    interval = p.get("reporting_interval", 0.0)
    if not interval > 0.0:
        raise ValueError(f"reporting_interval = {interval:g}: this channel sends no packets")
    first = math.ceil((start_s - _SLACK_S) / interval)
    number = np.arange(first, math.floor((stop_s + _SLACK_S) / interval) + 1, dtype=np.int64)
    seed = int(p["seed"])
    stamp: Array = number.astype(np.float64) * interval
    table = np.array([p.get(f"quantile[{j + 1}]", 0.0) for j in range(QUANTILES)])
    at = packet_random(seed, number, TABLE) * (QUANTILES - 1)
    k = at.astype(int)
    latency = p.get("latency", 0.0) + p.get("jitter", 0.0) * packet_random(seed, number, JITTER)
    latency = latency + (table[k] + (at - k) * (table[k + 1] - table[k]))
    wait = p.get("pdc_wait", 0.0)
    due = stamp + (wait if wait > 0.0 else latency)
    lost = _lost(p, seed, number)
    return Packets(stamp, due, lost | (latency > wait + _SLACK_S) if wait > 0.0 else lost)


def _lost(p: Mapping[str, float], seed: int, number: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Follow the Markov chain of good and bad and draw each packet's fate."""
    to_bad, to_good = p.get("good_to_bad", 0.0), p.get("bad_to_good", 0.0)
    chance = (p.get("loss_good", 0.0), p.get("loss_bad", 0.0))
    draw = packet_random(seed, number, LOSS)
    if not to_bad > 0.0:
        return draw < chance[0]
    before = packet_random(seed, number[:1] - 1, STATE)
    bad = bool(number.size and before[0] * (to_bad + to_good) < to_bad)
    lost = np.zeros(number.size, dtype=bool)
    for k, move in enumerate(packet_random(seed, number, STATE)):
        bad = not move < to_good if bad else bool(move < to_bad)
        lost[k] = draw[k] < chance[bad]
    return lost
