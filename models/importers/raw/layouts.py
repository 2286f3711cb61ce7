"""Which field stands where in each version of a RAW file, and which sections follow each other.

Tables as data: a section's rows are (first version, names in order); a version uses the last row that is
not newer than itself. Read from the column headers that PSS/E writes into files of version 34 to 36 and,
for older ones, compared among the public readers and files.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

VERSIONS = (23, 26, 29, 31, 32, 33, 34, 35, 36)  #: layouts that differ; 30 is 29

_RATINGS = " ".join(f"RATE{k}" for k in range(1, 13))
_OWNERS = "O1 F1 O2 F2 O3 F3 O4 F4"
_UNIT = "ZR ZX RT XT GTAP STAT RMPCT PT PB"
_STEPS = " ".join(f"N{k} B{k}" for k in range(1, 9))
_BLOCKS = " ".join(f"S{k} N{k} B{k}" for k in range(1, 9))
_FACTS = "NAME I J MODE PDES QDES VSET SHMX TRMX VTMN VTMX VSMX IMX LINX RMPCT OWNER SET1 SET2 VSREF"
_MOTOR = "TC BC MBASE RATEKV PC PSET H A B D E RA XA XM R1 X1 R2 X2 X3 E1 SE1 E2 SE2 IA1 IA2 XAMULT"

_FIELDS: dict[str, tuple[tuple[int, str], ...]] = {
    "bus": (
        (23, "I IDE PL QL GL BL IA VM VA NAME BASKV ZONE"),
        (26, "I NAME BASKV IDE GL BL AREA ZONE VM VA OWNER"),
        (31, "I NAME BASKV IDE AREA ZONE OWNER VM VA NVHI NVLO EVHI EVLO"),
    ),
    "load": (
        (23, "I ID STATUS AREA ZONE PL QL IP IQ YP YQ OWNER SCALE INTRPT DGENP DGENQ DGENM LOADTYPE NAME"),
    ),
    "fixed shunt": ((31, "I ID STATUS GL BL NAME"),),
    "generator": (
        (23, f"I ID PG QG QT QB VS IREG MBASE {_UNIT} {_OWNERS} WMOD WPF"),
        (35, f"I ID PG QG QT QB VS IREG NREG MBASE {_UNIT} BASLOD {_OWNERS} WMOD WPF"),
    ),
    "branch": (
        (23, "I J CKT R X B RATEA RATEB RATEC RATIO ANGLE GI BI GJ BJ ST"),
        (29, "I J CKT R X B RATEA RATEB RATEC GI BI GJ BJ ST"),
        (34, f"I J CKT R X B NAME {_RATINGS} GI BI GJ BJ ST MET LEN"),
    ),
    "transformer adjustment": ((23, "I J CKT ICONT RMA RMI VMA VMI STEP TABLE CNTRL CR CX"),),
    "switching device": (
        (34, f"I J CKT X {_RATINGS} STAT NSTAT MET STYPE NAME"),
        (36, "I J CKT X SETNAME STAT NSTAT MET STYPE NAME"),
    ),
    "transformer": ((29, f"I J K CKT CW CZ CM MAG1 MAG2 NMETR NAME STAT {_OWNERS} VECGRP ZCOD"),),
    "transformer impedance": (
        (29, "R1-2 X1-2 SBASE1-2 R2-3 X2-3 SBASE2-3 R3-1 X3-1 SBASE3-1 VMSTAR ANSTAR"),
    ),
    "transformer winding": (
        (29, "WINDV NOMV ANG RATA RATB RATC COD CONT RMA RMI VMA VMI NTP TAB CR CX CNXA"),
        (34, f"WINDV NOMV ANG {_RATINGS} COD CONT RMA RMI VMA VMI NTP TAB CR CX CNXA NOD"),
        (35, f"WINDV NOMV ANG {_RATINGS} COD CONT NOD RMA RMI VMA VMI NTP TAB CR CX CNXA"),
    ),
    "area": ((23, "I ISW PDES PTOL ARNAME"),),
    "two-terminal dc": ((23, "NAME MDC RDC SETVL VSCHD VCMOD RCOMP DELTI METER DCVMIN CCCITMX CCCACC"),),
    "dc converter": (
        (23, "IP NB ANMX ANMN RC XC EBAS TR TAP TMX TMN STP IC IF IT ID XCAP"),
        (35, "IP NB ANMX ANMN RC XC EBAS TR TAP TMX TMN STP IC ND IF IT ID XCAP"),
    ),
    "VSC dc": ((29, f"NAME MDC RDC {_OWNERS}"),),
    "VSC converter": (
        (29, "IBUS TYPE MODE DCSET ACSET ALOSS BLOSS MINLOSS SMAX IMAX PWF MAXQ MINQ REMOT RMPCT"),
    ),
    "switched shunt": (
        (23, f"I MODSW VSWHI VSWLO SWREM BINIT {_STEPS}"),
        (29, f"I MODSW VSWHI VSWLO SWREM RMPCT RMIDNT BINIT {_STEPS}"),
        (32, f"I MODSW ADJM STAT VSWHI VSWLO SWREM RMPCT RMIDNT BINIT {_STEPS}"),
        (35, f"I ID MODSW ADJM STAT VSWHI VSWLO SWREM NREG RMPCT RMIDNT BINIT {_BLOCKS}"),
        (36, f"I ID MODSW ADJM STAT VSWHI VSWLO SWREM NREG RMPCT RMIDNT BINIT NAME {_BLOCKS}"),
    ),
    "multi-terminal dc": ((23, "NAME NCONV NDCBS NDCLN MDC VCONV VCMOD VCONVN"),),
    "multi-terminal converter": (
        (23, "IB NB ANGMX ANGMN RC XC EBAS TR TAP TPMX TPMN TSTP SETVL DCPF MARG CNVCOD"),
    ),
    "multi-terminal bus": ((23, "IDC IB AREA ZONE DCNAME IDC2 RGRND OWNER"),),
    "multi-terminal link": ((23, "IDC JDC DCCKT MET RDC LDC"),),
    "FACTS": ((23, _FACTS), (31, f"{_FACTS} FCREG")),
    "GNE": ((32, "NAME MODEL NTERM"),),
    "induction machine": (
        (33, f"I ID STAT SC DC AREA ZONE OWNER {_MOTOR}"),
        (36, f"I ID STAT SC DC AREA ZONE OWNER NAME {_MOTOR}"),
    ),
    "substation": ((34, "IS NAME LATI LONG SGR"),),
    "substation node": ((34, "NI NAME I STATUS VM VA"),),
}

#: sections in the order of the file: (name, first version, last version)
_ORDER = (
    ("system-wide", 34, 99),
    ("bus", 0, 99),
    ("load", 26, 99),
    ("fixed shunt", 31, 99),
    ("voltage droop", 36, 99),
    ("generator", 0, 99),
    ("rating set", 36, 99),
    ("branch", 0, 99),
    ("switching device", 34, 99),
    ("transformer adjustment", 0, 26),
    ("transformer", 29, 99),
    ("area", 0, 99),
    ("two-terminal dc", 0, 99),
    ("VSC dc", 29, 99),
    ("switched shunt", 0, 29),
    ("impedance correction", 0, 99),
    ("multi-terminal dc", 0, 99),
    ("multi-section line", 0, 99),
    ("zone", 0, 99),
    ("inter-area transfer", 0, 99),
    ("owner", 0, 99),
    ("FACTS", 0, 99),
    ("switched shunt", 31, 99),
    ("GNE", 32, 99),
    ("induction machine", 33, 99),
    ("load type", 36, 99),
    ("interface", 36, 99),
    ("interface element", 36, 99),
    ("substation", 34, 99),
)


def sections(version: int) -> tuple[str, ...]:
    """Return the names of the sections of `version` in the order of the file."""
    return tuple(name for name, first, last in _ORDER if first <= version <= last)


@cache
def fields(section: str, version: int) -> Mapping[str, int]:
    """Return name -> position of the fields of a record.

    >>> fields("transformer winding", 33)["TAB"], fields("transformer winding", 35)["TAB"]
    (13, 23)
    """
    names = next(row for first, row in reversed(_FIELDS[section]) if first <= version).split()
    return MappingProxyType({name: k for k, name in enumerate(names)})


def layout_of(revision: int | None, bus: tuple[str, ...], quoted: bool, named: str) -> tuple[int, str]:
    """Return the layout of a file and, when its header says another one, what was made of that ("" if not).

    revision : REV of the header, None when there is none. bus : words of the first bus record, `quoted`
    whether its second one stands in quotes. named : what the ends of the sections call the next ones,
    upper case.
    """
    n = len(bus)
    if n > 1 and not quoted and _is_number(bus[1]):
        version = 23  # no name in the second field
    elif n in (10, 11):
        version = _middle(revision, named)
    else:
        version = _recent(revision, n, named)
    if revision is None or _layout(revision) == version or {_layout(revision), version} == {32, 33}:
        return version, ""
    return version, f"says version {revision} and is laid out as version {version}; read as {version}"


def _middle(revision: int | None, named: str) -> int:
    """26 or 29, whose bus records look the same: their sections differ, or else the header says."""
    if not named and revision is not None and 24 <= revision <= 30:
        return 26 if revision <= 26 else 29
    return 26 if "TRANSFORMER ADJUSTMENT" in named else 29


#: version from which on a file names one of these sections
_NEW = (
    (36, ("DROOP", "RATING SET")),
    (34, ("SYSTEM-WIDE", "SWITCHING DEVICE", "SUBSTATION")),
    (32, ("GNE", "INDUCTION")),
)


def _recent(revision: int | None, n: int, named: str) -> int:
    least = next((version for version, words in _NEW if any(word in named for word in words)), 31)
    if least == 36:
        return 36
    if least == 34:
        return _with_substations(revision, named)
    if revision is not None and revision >= 34:
        return revision if revision <= 36 and n >= 10 and "BEGIN" not in named else 33
    if revision is not None and least <= revision < 34:
        return revision
    return 33 if n >= 12 else 32


def _with_substations(revision: int | None, named: str) -> int:
    """34 or 35, which no name tells apart: the header does; 36 where it names no sections that tell."""
    if revision == 36 and "GENERATOR" in named:
        return 35
    return revision if revision in (34, 35, 36) else 35


def _layout(revision: int) -> int:
    """The layout of a version: 24 and 25 are taken as 26, 27, 28 and 30 as 29, no public file tells."""
    if revision <= 23:
        return 23
    return {24: 26, 25: 26, 27: 29, 28: 29, 30: 29}.get(revision, revision)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
