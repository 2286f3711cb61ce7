"""What a channel does to the age of its signal, as the delay ledger tells it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Delays:
    """What is known of a channel instance, s: the request, the parts that meet it, and `waiting_s`, how long
    an arrival waits for the next communication point on average."""

    requested_s: float
    network_s: float
    reporting_s: float = 0.0
    jitter_mean_s: float = 0.0
    waiting_s: float = 0.0
