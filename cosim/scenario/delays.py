"""What a channel does to the age of its signal, as the delay ledger tells it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass


@dataclass(frozen=True)
class Delays:
    """What is known of a channel instance, s: the request, the parts that meet it, and `waiting_s`, how long
    an arrival waits for the next communication point on average; of a PMU its group delay `measuring_s`."""

    requested_s: float
    network_s: float
    reporting_s: float = 0.0
    jitter_mean_s: float = 0.0
    waiting_s: float = 0.0
    seed: int | None = None  #: of the random numbers, where anything is random
    measuring_s: float = 0.0

    def seed_of(self, name: str) -> str:
        """Return in words which random numbers channel `name` takes, "" where nothing is random."""
        if self.seed is None:
            return ""
        return f"seed {self.seed}{', made of its name' if self.seed == derived_seed(0, name) else ''}"


def derived_seed(seed: int, name: str) -> int:
    """Return the seed of channel `name` in a run with `seed`: 31 bits, different for each channel.

    A channel whose table gives no seed has that of seed 0, so that no two channels lose the same packets.
    """
    return int.from_bytes(hashlib.sha256(f"{seed}/{name}".encode()).digest()[:4], "little") % 2**31
