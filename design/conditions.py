"""What the signals of a loop suffer: loss and latency, as designs ask for it and certificates state it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Condition:
    """Names of lost signals, and the latency (s) of others; a signal not named is there at once."""

    name: str
    lost: tuple[str, ...] = ()
    latency_s_of: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for signal, latency in self.latency_s_of.items():
            if not 0.0 <= latency < float("inf"):
                raise ValueError(
                    f"condition {self.name!r}: latency of {signal} is {latency!r} s; finite and not negative"
                )


def condition_of(code: str, local: str, remote: str) -> Condition:
    """Return the condition of a short code, for one local and one remote signal.

    ``N`` normal, ``L`` remote lost, ``ns150`` non-synchronous (remote late by 150 ms),
    ``s100`` synchronous (both late by 100 ms), ``L+s100`` remote lost and local late.

    Raises ValueError for any other code.
    """
    lost: tuple[str, ...] = ()
    latency: dict[str, float] = {}
    for part in code.split("+"):
        digits = part.lstrip("ns")
        if part == "N":
            continue
        if part == "L":
            lost = (remote,)
        elif digits.isdigit() and part[: -len(digits)] in ("s", "ns"):
            late = (remote,) if part.startswith("ns") else (local, remote)
            latency = dict.fromkeys(late, int(digits) / 1000.0)
        else:
            raise ValueError(f"condition {code!r}: parts are N, L, s<ms> or ns<ms> joined by +, got {part!r}")
    return Condition(code, lost, {k: v for k, v in latency.items() if k not in lost})
