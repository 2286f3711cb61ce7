"""What the study's chapter 5 prints, loaded from `published.toml`; digits kept as printed."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

_FILE = Path(__file__).with_name("published.toml")


@dataclass(frozen=True)
class PrintedNumber:
    """A number with the digits of its print; `tolerance` is half a unit of the last digit."""

    text: str

    @property
    def value(self) -> float:
        return float(self.text)

    @property
    def tolerance(self) -> float:
        """Half a unit of the last printed digit.

        >>> PrintedNumber("0.545").tolerance
        0.0005
        """
        return 0.5 * 10.0 ** -len(self.text.partition(".")[2])

    def agrees(self, ours: float) -> bool:
        """Say whether `ours` rounds to the printed digits."""
        return abs(ours - self.value) <= self.tolerance * (1.0 + 1e-9)

    def relative_error(self, ours: float) -> float:
        """Return (ours - printed) / printed."""
        return (ours - self.value) / self.value


@lru_cache(maxsize=1)
def published() -> dict[str, Any]:
    """Return the tables `modes`, `loops`, `statement` and `figure` with their source key."""
    return tomllib.loads(_FILE.read_text(encoding="utf-8"))
