"""What an import read, assumed and dropped, for the reader to check."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from ..errors import CaseError


@dataclass
class Report:
    """Counted remarks of one import, each with the place where it was first made.

    read : what the files hold. assumed : what they do not say or say in two ways. dropped : what plays no
    part or has no counterpart. strict : an assumption is an error.
    """

    strict: bool = False
    read: Counter[str] = field(default_factory=Counter)
    assumed: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)  #: remark -> where it was first made
    lines: list[str] = field(default_factory=list)  #: on the solution, in order

    def assume(self, what: str, where: str, count: int = 1) -> None:
        """Note an assumption; CaseError when the import is strict."""
        if self.strict:
            raise CaseError(f"{where}: {what}, which --strict does not allow")
        self.assumed[what] += count
        self.first.setdefault(what, where)

    def drop(self, what: str, where: str, count: int = 1) -> None:
        """Note what was left out."""
        self.dropped[what] += count
        self.first.setdefault(what, where)

    def as_dict(self) -> dict[str, Any]:
        """Return the report as JSON values: counts, and of a remark where it was first made."""
        remarks = {
            title: [{"what": w, "count": n, "first": self.first[w]} for w, n in counts.items()]
            for title, counts in (("assumed", self.assumed), ("dropped", self.dropped))
        }
        return {"read": dict(self.read), **remarks, "solution": list(self.lines)}

    def text(self) -> str:
        """Return the report as lines of plain text."""
        lines = ["read: " + ", ".join(f"{count} {what}" for what, count in self.read.items() if count)]
        for title, remarks in (("assumed", self.assumed), ("dropped", self.dropped)):
            for what, count in remarks.items():
                times = f"{count} x " if count > 1 else ""
                lines.append(f"{title}: {times}{what} ({'first ' if count > 1 else ''}{self.first[what]})")
        return "\n".join(lines + self.lines)
