"""What the signals of a loop suffer: loss and latency, as designs ask for it and certificates state it."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import TypeVar

T = TypeVar("T")
_LATE = re.compile(r"(n?s)([0-9]+)(?::(.+))?")
_LATE_ALL = re.compile(r"s[0-9]+")
_FACTOR = r"x(-?\d+(?:\.\d+)?)"
_SCALE = re.compile(rf"{_FACTOR}:(.+)")
ONE_WRONG = re.compile(rf"{_FACTOR}|{_LATE_ALL.pattern}")  #: of one signal, without its name
LONGEST_MS = 10_000  #: of a latency in a code: that of `interarea loops --latency`


@dataclass(frozen=True)
class Condition:
    """Names of lost signals, latency (s) and scale of others; a signal not named is there at once, as it is.

    A scale is the factor by which a signal is wrong: 2 twice as large, -1 of the wrong polarity.
    """

    name: str
    lost: tuple[str, ...] = ()
    latency_s_of: Mapping[str, float] = field(default_factory=dict)
    scale_of: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for signal, latency in self.latency_s_of.items():
            if not 0.0 <= latency < float("inf"):
                raise ValueError(
                    f"condition {self.name!r}: latency of {signal} is {latency!r} s; finite and not negative"
                )
        for signal, scale in self.scale_of.items():
            if not isfinite(scale):
                raise ValueError(f"condition {self.name!r}: scale of {signal} is {scale!r}; finite")

    @property
    def kind(self) -> str:
        """Whether signals are "lost", else "scaled", else "late", else "all" there at once.

        >>> [condition_of(code, "G4_dw", "G2_dw").kind for code in ("N", "s100", "L", "L+s100", "x2:G4_dw")]
        ['all', 'late', 'lost', 'lost', 'scaled']
        """
        if self.lost:
            return "lost"
        return "scaled" if self.scale_of else "late" if self.latency_s_of else "all"

    def target_of(self, targets: Mapping[str, T]) -> T | None:
        """Return what `targets` (by name of a condition, or by kind) has for this one: by its name first."""
        return targets.get(self.name, targets.get(self.kind))

    @property
    def in_words(self) -> str:
        """What is lost, what is late and what is scaled, in words.

        >>> Condition("L+s100", ("G2_dw",), {"G4_dw": 0.1}).in_words
        'G2_dw lost, G4_dw 100 ms late'
        >>> Condition("x2:G4_dw", scale_of={"G4_dw": 2.0}).in_words, Condition("N").in_words
        ('G4_dw times 2', 'every signal at once')
        """
        late: dict[float, list[str]] = {}
        for signal, latency in self.latency_s_of.items():
            late.setdefault(latency, []).append(signal)
        parts = [f"{' and '.join(self.lost)} lost"] if self.lost else []
        parts += [f"{' and '.join(names)} {1e3 * value:g} ms late" for value, names in late.items()]
        parts += [f"{signal} times {scale:g}" for signal, scale in self.scale_of.items()]
        return ", ".join(parts) or "every signal at once"


def condition_of(code: str, local: str, remote: str) -> Condition:
    """Return the condition of a short code, for one local and one remote signal.

    ``N`` normal, ``L`` remote lost, ``ns150`` non-synchronous (remote late by 150 ms),
    ``s100`` synchronous (both late by 100 ms), ``L+s100`` remote lost and local late.

    Raises ValueError for any other code.
    """
    return condition_of_many(code, (remote, local), remote=remote)


def condition_of_many(code: str, signals: Sequence[str], *, remote: str | None = None) -> Condition:
    """Return the condition of a short code for any number of signals.

    ``N`` normal, ``L:G2_dw`` that signal lost, ``s100`` every signal late by 100 ms, ``s100+L:G2_dw`` both.
    ``x2:G2_dw`` that signal twice as large, ``x-1:G2_dw`` of the wrong polarity. ``s300:G2_dw`` that signal
    alone late by 300 ms, as by a wrong time stamp; beside ``s100`` the others by 100 ms.
    With a `remote` signal also ``L``, it is lost, and ``ns150``, it alone is late. Parts have any order.

    Raises ValueError for any other code, for one that states the same thing twice, such as ``s100+s200``, and
    for a lost signal with a latency or scale of its own.
    """
    lost: dict[str, bool] = {}
    every: dict[str, float] = {}
    alone: dict[str, float] = {}
    scales: dict[str, float] = {}
    for part in code.split("+"):
        if (gone := _lost_by(part, signals, remote)) is not None:
            _set(code, lost, {gone: True}, "lost")
        elif (scaled := _SCALE.fullmatch(part)) is not None and scaled[2] in signals:
            _set(code, scales, {scaled[2]: float(scaled[1])}, "scaled")
        elif (late := _late_by(code, part, signals, remote)) is not None:
            _set(code, every if _LATE_ALL.fullmatch(part) else alone, late, "late")
        elif part != "N":
            short = "N, L, s<ms>, ns<ms>" if remote is not None else "N, s<ms>"
            raise ValueError(
                f"condition {code!r}: parts are {short}, L:<one of {', '.join(signals)}>, "
                f"s<ms>:<one of them> or x<factor>:<one of them> joined by +, got {part!r}"
            )
    if silent := [signal for signal in lost if signal in alone or signal in scales]:
        raise ValueError(
            f"condition {code!r}: {silent[0]} is lost and also late or scaled, allowed: one of these"
        )
    return Condition(code, tuple(lost), _but(every | alone, lost), _but(scales, lost))


def _set(code: str, values: dict[str, T], more: Mapping[str, T], what: str) -> None:
    """Add `more` to `values`; ValueError where a signal is there already."""
    if twice := [signal for signal in more if signal in values]:
        raise ValueError(f"condition {code!r}: {twice[0]} is {what} twice, allowed: once")
    values.update(more)


def _lost_by(part: str, signals: Sequence[str], remote: str | None) -> str | None:
    """Return the signal that a part of a code loses, None where it loses none."""
    if part == "L":
        return remote
    return part[2:] if part.startswith("L:") and part[2:] in signals else None


def _late_by(code: str, part: str, signals: Sequence[str], remote: str | None) -> dict[str, float] | None:
    """Return the latency, s, of each signal that a part of a code delays; None where it is no such part."""
    match = _LATE.fullmatch(part)
    if match is None:
        return None
    kind, milliseconds, one = match.groups()
    if not int(milliseconds) <= LONGEST_MS:
        raise ValueError(
            f"condition {code!r}: a latency of {milliseconds} ms, allowed: at most {LONGEST_MS} ms"
        )
    delayed = tuple(signals) if kind == "s" else (remote,)
    if one is not None:
        delayed = (one,) if kind == "s" and one in signals else (None,)
    return {d: int(milliseconds) / 1000.0 for d in delayed if d is not None} if None not in delayed else None


def _but(values: Mapping[str, float], lost: Collection[str]) -> dict[str, float]:
    return {signal: value for signal, value in values.items() if signal not in lost}
