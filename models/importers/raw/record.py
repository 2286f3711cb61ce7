"""One record of a PSS/E file: its words, read by the name of the field, and where it stands."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from ...errors import CaseError


@dataclass(frozen=True, slots=True)
class Record:
    """The words of one line under the names that the layout gives them.

    An empty or absent field takes the default of the call; without one it is an error. Every error names
    file, line, kind of record, field, what stands there and what is allowed.
    """

    kind: str
    words: tuple[str, ...]
    where: str  #: file:line
    position: Mapping[str, int] = field(repr=False)
    parts: tuple[Record, ...] = ()  #: the further lines of a record of several lines

    def has(self, name: str) -> bool:
        """Return whether field `name` is given."""
        k = self.position.get(name)
        return k is not None and k < len(self.words) and self.words[k] != ""

    def text(self, name: str, default: str | None = None) -> str:
        """Return field `name` as it stands."""
        k = self.position.get(name)
        if k is not None and k < len(self.words) and (self.words[k] or default is None):
            return self.words[k]
        if default is not None:
            return default
        raise CaseError(
            f"{self.where}: {self.kind} record: {name} (field {(k or 0) + 1}) is missing, {len(self.words)} "
            "fields are there (cut off?)"
        )

    def number(self, name: str, default: float | None = None) -> float:
        """Return field `name` as a finite number; `1.5D2` is 150."""
        k = self.position.get(name, -1)
        word = self.words[k] if 0 <= k < len(self.words) else ""
        if not word:
            if default is not None:
                return default
            word = self.text(name)
        try:
            value = float(word.lower().replace("d", "e"))
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or "_" in word:
            raise self.wrong(name, repr(word), "a finite number")
        return value

    def whole(self, name: str, default: int | None = None) -> int:
        """Return field `name` as a whole number; `1.0` is 1."""
        value = self.number(name, default)
        if value != int(value):
            raise self.wrong(name, f"{value:g}", "a whole number")
        return int(value)

    def code(self, name: str, default: int, allowed: tuple[int, ...]) -> int:
        """Return field `name`, which must be one of `allowed`."""
        value = self.whole(name, default)
        if value not in allowed:
            raise self.wrong(name, str(value), ", ".join(map(str, allowed)))
        return value

    def bus(self, name: str, default: int | None = None) -> int:
        """Return field `name` as the number of a bus; a minus, which marks the metered end, is dropped."""
        k = self.position.get(name, -1)
        word = self.words[k] if 0 <= k < len(self.words) else ""
        if len(word) > 8 and not word.lstrip("+-").replace(".", "").isdigit() and any(map(str.isalpha, word)):
            raise CaseError(
                f"{self.where}: {self.kind} record: {name} = {word!r} names a bus, allowed: a number "
                "(write the file with bus numbers, not with extended names)"
            )
        return abs(self.whole(name, default))

    def identity(self, name: str, default: str = "1") -> str:
        """Return field `name` as an identifier: `'1 '` is `1`, `'a'` is `A`, `1.0` stays as it is."""
        word = self.text(name, default).strip().upper() or default
        if "," in word or "'" in word:
            raise self.wrong(name, repr(word), "an identifier of two characters (is a quote lost?)")
        return word

    def wrong(self, name: str, got: str, allowed: str) -> CaseError:
        """Return the error for field `name`."""
        k = self.position.get(name)
        place = "" if k is None else f" (field {k + 1})"
        return CaseError(f"{self.where}: {self.kind} record: {name}{place} = {got}, allowed: {allowed}")

    def refused(self, reason: str) -> CaseError:
        """Return the error for a record that cannot be taken at all."""
        return CaseError(f"{self.where}: {self.kind} record: {reason}")
