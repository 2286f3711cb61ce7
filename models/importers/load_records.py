r"""Load records of a DYR file: how loads follow the voltage.

IEELBL (a load), IEELOW, IEELZN, IEELAR (of an owner, zone, area), IEELAL (all), the narrower first:

.. math:: P = P_0 (a_1 V^{n_1} + a_2 V^{n_2} + a_3 V^{n_3})(1 + a_7 \Delta f), \quad
          Q = Q_0 (a_4 V^{n_4} + a_5 V^{n_5} + a_6 V^{n_6})(1 + a_8 \Delta f),

V relative to the voltage at rest, where the load is that of the power flow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import zip_longest

from ..errors import CaseError
from .dyr import DyrRecord
from .raw.record import Record
from .report import Report
from .static import StaticLoad

_FIELDS = (*(f"a{k}" for k in range(1, 9)), *(f"n{k}" for k in range(1, 7)))
#: the narrowest first: model -> whether a record of it, (bus or number, identifier), is of a load
_SCOPES: dict[str, Callable[[StaticLoad, int, str], bool]] = {
    "IEELBL": lambda load, number, identity: (load.home, load.identity) == (number, identity),
    "IEELOW": lambda load, number, _: load.groups[2] == number,
    "IEELZN": lambda load, number, _: load.groups[1] == number,
    "IEELAR": lambda load, number, _: load.groups[0] == number,
    "IEELAL": lambda load, number, _: True,
}
MODELS = frozenset(_SCOPES)


def take_load_records(records: Iterable[DyrRecord], loads: Sequence[StaticLoad], report: Report) -> None:
    """Give each load in service the law of the narrowest record that is of it.

    Raises
    ------
    CaseError : fields missing or in excess, a negative exponent, shares without a sum; with file and line.
    """
    ordered = sorted((r for r in records if r.model in _SCOPES), key=lambda r: list(_SCOPES).index(r.model))
    free = [load for load in loads if load.letter == "L" and load.follows is None]
    taken: set[int] = set()
    for record in ordered:
        law, of = _law(record, report), _SCOPES[record.model]
        own = [load for load in free if of(load, record.bus, record.identity)]
        if not own and record.model == "IEELBL":
            report.assume("load record of a load that is not in the grid: ignored", record.where)
        for load in own:
            if id(load) not in taken:
                load.law = law
        taken |= {id(load) for load in own}
        report.read[record.model] += 1


def _law(record: DyrRecord, report: Report) -> tuple[tuple[float, float, float, float], ...]:
    """Share and exponent of P, and of Q, of as many terms as one of them has."""
    if len(record.fields) != len(_FIELDS):
        raise CaseError(
            f"{record.where}: {record.model} has {len(record.fields)} fields, allowed: {len(_FIELDS)}, a1 to "
            "a8 and n1 to n6 (is the / of the record missing?)"
        )
    fields = Record(record.model, record.fields, record.where, {name: k for k, name in enumerate(_FIELDS)})
    v = [fields.number(name) for name in _FIELDS]
    if v[6] or v[7]:
        report.assume(f"{record.model}: frequency dependence of loads (a7, a8) ignored", record.where)
    P = _shares(record, "P", v[0:3], v[8:11], report)
    Q = _shares(record, "Q", v[3:6], v[11:14], report)
    return tuple((*p, *q) for p, q in zip_longest(P, Q, fillvalue=(0.0, 2.0)))


def _shares(
    record: DyrRecord, what: str, shares: Sequence[float], exponents: Sequence[float], report: Report
) -> list[tuple[float, float]]:
    """Share and exponent of the terms of P or Q that are there, the shares with a sum of 1."""
    where, total = f"{record.where}: {record.model}", sum(shares)
    if not abs(total) > 1e-6:
        raise CaseError(f"{where}: the shares of {what} are {list(shares)}, allowed: a sum of 1")
    if not abs(total - 1.0) <= 1e-3:
        report.assume(f"{record.model}: shares of {what} scaled to a sum of 1", record.where)
    terms = [(share / total, n) for share, n in zip(shares, exponents, strict=True) if share]
    for _, exponent in terms:
        if not exponent >= 0.0:
            raise CaseError(f"{where}: an exponent of {exponent:g}, allowed: 0 or above")
    return terms
