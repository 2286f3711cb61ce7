"""What an import gives."""

from __future__ import annotations

from dataclasses import dataclass

from ..case.case import Case
from .report import Report
from .stored import Solution


@dataclass(frozen=True)
class Imported:
    """An imported grid: the case, what was read, assumed and dropped, and its stored solution."""

    case: Case
    report: Report
    solution: Solution
    unrest: tuple[str, ...] = ()  #: why controls cannot rest where their machines start, a line each
