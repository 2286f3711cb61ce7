"""What the signals of a loop suffer: loss and latency, as designs ask for it and certificates state it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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

    @property
    def kind(self) -> str:
        """Whether signals are "lost", else "late", else "all" there at once.

        >>> [condition_of(code, "G4_dw", "G2_dw").kind for code in ("N", "s100", "L", "L+s100")]
        ['all', 'late', 'lost', 'lost']
        """
        return "lost" if self.lost else "late" if self.latency_s_of else "all"

    @property
    def in_words(self) -> str:
        """What is lost and what is late, in words.

        >>> Condition("L+s100", ("G2_dw",), {"G4_dw": 0.1}).in_words
        'G2_dw lost, G4_dw 100 ms late'
        >>> Condition("N").in_words
        'every signal at once'
        """
        late: dict[float, list[str]] = {}
        for signal, latency in self.latency_s_of.items():
            late.setdefault(latency, []).append(signal)
        parts = [f"{' and '.join(self.lost)} lost"] if self.lost else []
        parts += [f"{' and '.join(names)} {1e3 * value:g} ms late" for value, names in late.items()]
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
    With a `remote` signal also ``L``, it is lost, and ``ns150``, it alone is late.

    Raises ValueError for any other code.
    """
    lost: list[str] = []
    latency: dict[str, float] = {}
    for part in code.split("+"):
        kind, digits = part.rstrip("0123456789"), part.lstrip("ns")
        if part == "N":
            continue
        if part == "L" and remote is not None:
            lost.append(remote)
        elif part.startswith("L:") and part[2:] in signals:
            lost.append(part[2:])
        elif kind == "s" and digits.isdigit():
            latency = dict.fromkeys(signals, int(digits) / 1000.0)
        elif kind == "ns" and digits.isdigit() and remote is not None:
            latency = {remote: int(digits) / 1000.0}
        else:
            short = "N, L, s<ms>, ns<ms>" if remote is not None else "N, s<ms>"
            raise ValueError(
                f"condition {code!r}: parts are {short} or L:<one of {', '.join(signals)}> joined by +, "
                f"got {part!r}"
            )
    return Condition(code, tuple(lost), {k: v for k, v in latency.items() if k not in lost})
