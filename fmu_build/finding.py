"""One finding of `interarea check`: where, which rule, what is wrong, how to put it right."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from interarea.models.errors import UserError


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong; `rule` names the clause or the topic of the check that it breaks."""

    rule: str
    where: str
    message: str
    fix: str

    def line(self) -> str:
        """Return the finding in one line."""
        text = f"{self.where}: {self.message} [{self.rule}] -> {self.fix}"
        return " ".join(text.split())


@dataclass(repr=False)
class Report:
    """What a check found, what it could not look at (notes, not_run), and facts about the binaries."""

    file: str
    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)
    not_run: list[str] = field(default_factory=list)  #: why a binary, or a part of it, was not run

    def __repr__(self) -> str:
        """Return the verdict and each finding in a line: what a notebook shows and pytest prints."""
        return "\n".join([f"{self.file}: {self.verdict}", *(f"  {f.line()}" for f in self.findings)])

    def add(self, rule: str, where: str, message: str, fix: str) -> None:
        """Add a finding; the same rule is reported once per place."""
        finding = Finding(rule, where, message, fix)
        if all((f.rule, f.where) != (rule, where) or f.message != message for f in self.findings):
            self.findings.append(finding)

    def has(self, rule: str, where: str) -> bool:
        """Return whether `rule` was already found broken at `where`."""
        return any(f.rule == rule and f.where == where for f in self.findings)

    @property
    def clean(self) -> bool:
        """Whether nothing was found in what was looked at; see `verdict` for whether all was."""
        return not self.findings

    @property
    def verdict(self) -> str:
        """What the check says of the whole: "findings: 3", "clean", or "not run" with the reason."""
        if self.findings:
            return f"findings: {len(self.findings)}"
        if self.not_run:
            return f"not run ({'; '.join(self.not_run)}); nothing found in what was read"
        return "clean"

    def as_dict(self) -> dict[str, Any]:
        """Return everything as JSON types."""
        return {
            "file": self.file,
            "verdict": self.verdict.split(" (")[0].split(":")[0],
            "clean": self.verdict == "clean",
            "findings": [asdict(f) for f in self.findings],
            "notes": list(self.notes),
            "not_run": list(self.not_run),
            "facts": self.facts,
        }


class CheckError(UserError):
    """The file given to the check is not there or is neither an FMU nor an SSP."""
