"""Identifiers of a RAW file: one that is given twice is refused, or a further circuit beside the first."""

from __future__ import annotations

from collections.abc import Iterator

from ...errors import CaseError
from ..report import Report
from .record import Record

_BUSES = ("I", "J", "K")
#: kind of record -> the fields that tell its records apart: buses and a word
_FIELDS = {
    **dict.fromkeys(("load", "fixed shunt", "switched shunt", "generator", "induction machine"), ("I", "ID")),
    **dict.fromkeys(("branch", "switching device"), ("I", "J", "CKT")),
    "transformer": ("I", "J", "K", "CKT"),
    **dict.fromkeys(("two-terminal dc", "VSC dc", "multi-terminal dc", "FACTS"), ("NAME",)),
}


def once(records: Iterator[Record], report: Report) -> Iterator[Record]:
    """Yield `records` of one section as long as no identifier comes a second time.

    A second branch between the same buses is a further circuit, which published files have (the 145-bus one
    of the IEEE); that is noted.

    Raises
    ------
    CaseError : anything else that is given twice; with both lines.
    """
    first: dict[tuple[int | str, ...], str] = {}
    for record in records:
        names = _FIELDS[record.kind]
        if all(name in record.position for name in names):  # until version 34 a switched shunt has none
            buses = sorted(record.bus(name, 0) for name in names if name in _BUSES)
            word = [record.identity(name) for name in names if name not in _BUSES]
            before = first.setdefault((*buses, *word), record.where)
            if before != record.where:
                _twice(record, buses, word, before, report)
        yield record


def _twice(record: Record, buses: list[int], word: list[str], before: str, report: Report) -> None:
    if len(buses) > 1:
        what = f"{record.kind} whose identifier is given twice taken as a further circuit"
        report.assume(what, record.where)
        return
    place = f" at bus {buses[0]}" if buses else ""
    raise CaseError(
        f"{record.where}: {record.kind} {word[0]!r}{place} is given twice, first at {before}, allowed: each "
        "identifier once"
    )
