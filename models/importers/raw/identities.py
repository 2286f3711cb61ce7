"""Records of a RAW section that can be used: their buses are there, and no identifier comes twice."""

from __future__ import annotations

from collections.abc import Iterator

from ...errors import CaseError
from ..report import Report
from ..static import StaticGrid
from .record import Record

_BUSES = ("I", "J", "K")
#: kind of record -> the fields that tell its records apart: buses and a word
_FIELDS = {
    **dict.fromkeys(("load", "fixed shunt", "switched shunt", "generator", "induction machine"), ("I", "ID")),
    **dict.fromkeys(("branch", "switching device"), ("I", "J", "CKT")),
    "transformer": ("I", "J", "K", "CKT"),
    **dict.fromkeys(("two-terminal dc", "VSC dc", "multi-terminal dc", "FACTS"), ("NAME",)),
}
_STATUS = ("STATUS", "STAT", "ST", "MDC", "MODE")  #: the field that is 0 out of service, one a layout


def usable(records: Iterator[Record], grid: StaticGrid, report: Report) -> Iterator[Record]:
    """Yield `records` of one section as long as no identifier comes a second time.

    A record out of service at a bus that `grid` does not have is left out and counted, as PSS/E reads such
    files. A second branch between the same buses is a further circuit, which published files have (the
    145-bus one of the IEEE); that is noted.

    Raises
    ------
    CaseError : anything else that is given twice; with both lines.
    """
    first: dict[tuple[int | str, ...], str] = {}
    for record in records:
        names = _FIELDS[record.kind]
        if _is_out(record) and any(
            record.bus(name, 0) not in (0, *grid.buses) for name in _BUSES if name in record.position
        ):
            report.drop(f"{record.kind} out of service at a bus that does not exist", record.where)
            continue
        if all(name in record.position for name in names):  # until version 34 a switched shunt has none
            buses = sorted(record.bus(name, 0) for name in names if name in _BUSES)
            word = [record.identity(name) for name in names if name not in _BUSES]
            before = first.setdefault((*buses, *word), record.where)
            if before != record.where:
                _twice(record, buses, word, before, report)
        yield record


def _is_out(record: Record) -> bool:
    """Whether the status of `record` is 0; a field that is no number is left for its reader to refuse."""
    name = next((name for name in _STATUS if name in record.position), None)
    try:
        return name is not None and float(record.text(name, "1")) == 0.0
    except ValueError:
        return False


def _twice(record: Record, buses: list[int], word: list[str], before: str, report: Report) -> None:
    if len(buses) > 1:
        what = f"{record.kind} whose identifier is given twice: read as another circuit"
        report.assume(what, record.where)
        return
    place = f" at bus {buses[0]}" if buses else ""
    raise CaseError(
        f"{record.where}: {record.kind} {word[0]!r}{place} is given twice, first at {before}, allowed: each "
        "identifier once"
    )
