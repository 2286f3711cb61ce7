"""Records of a PSS/E DYR file: syntax only; which device a model is, `models/devices` knows.

A record is ``BUS 'MODEL' ID fields /`` over any number of lines. What follows the slash is comment, and so
are lines that begin with ``//`` or, outside a record, not with a number. Comment that looks like a record
(its bus number is spoiled, or its line break is lost) is named.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from ..errors import CaseError
from .raw.text import read_lines, split_record

#: user-written models that are a plain one under another name
PLAIN = {
    "REGCAU1": "REGCA1",
    "REGCBU1": "REGCB1",
    "REGCCU1": "REGCC1",
    "REECAU1": "REECA1",
    "REECBU1": "REECB1",
    "REECCU1": "REECC1",
    "REPCAU1": "REPCA1",
    "REPCTA1": "REPCA1",
    "DERAU1": "DERA1",
    "REGFMB1U": "REGFMB1",
    "WTDTAU1": "WTDTA1",
    "WTARAU1": "WTARA1",
    "WTPTAU1": "WTPTA1",
    "WTTQAU1": "WTTQA1",
    "GENTPJU1": "GENTPJ",
    "HYGOVRU": "HYGOVR",
}
_NAMES = """
    GENROU GENROE GENSAL GENSAE GENCLS GENTPJ GENTRA SEXS SCRX IEEET1 IEEET2 IEEET3 IEEET4 IEEEX1 IEEEX2
    ESDC1A ESDC2A EXDC1 EXDC2 EXAC1 EXAC1A EXAC2 EXAC3 EXAC4 ESAC1A ESAC2A ESAC3A ESAC4A ESAC5A ESAC6A
    ESAC8B AC7B AC8B DC4B ESST1A ESST2A ESST3A ESST4B ST5B ST6B EXST1 EXST2 EXST3 EXPIC1 EXELI EXBAS
    BBSEX1 TGOV1 TGOV3 GAST GAST2A GASTWD HYGOV HYGOV2 HYGOVD HYGOVR IEEEG1 IEEEG1D IEEEG2 IEEEG3 IEESGO
    WSIEG1 WSHYGP WSHYDD WEHGOV GGOV1 GGOV1D DEGOV DEGOV1 PIDGOV WPIDHY IEEEST STAB1 STAB2A STAB3 STAB4
    PSS1A PSS2A PSS2B PSS2C PSS3B PSS4B ST2CUT IEE2ST IEEEVC COMP COMPCC UEL1 UEL2 MAXEX1 MAXEX2 MNLEX1
    MNLEX2 OEL1B REGCA1 REGCB1 REGCC1 REECA1 REECB1 REECC1 REECD1 REPCA1 WTARA1 WTDTA1 WTPTA1 WTTQA1
    WT1G1 WT2G1 WT3G1 WT3E1 WT3T1 WT3P1 WT4G1 WT4E1 DERA1 DERAU1 CSVGN1 CSVGN3 CSVGN5 SVSMO1 SVSMO2
    IEELBL IEELOW IEELZN IEELAR IEELAL CIM5BL CIM6BL CLODBL CLODAL CMLDBLU2 LDSHBL LVSHBL USRMDL USRBUS
    USRLOD USRAUX GDFORM REGFMA1 REGFMB1 REGFMB1U
"""
MOST_WORDS = 4000  #: of one record; the longest one known has 300
#: names at which a record ends although its slash is missing
KNOWN = frozenset(_NAMES.split())


@dataclass(frozen=True, slots=True)
class DyrRecord:
    """One record: model in capitals, bus, machine or load, and its fields as they stand."""

    model: str
    bus: int
    identity: str  #: stripped, in capitals; "" where the model has none
    fields: tuple[str, ...]
    line: int
    file: str
    user: str = ""  #: USRMDL, USRLOD or USRBUS, when it came as a user-written model

    @property
    def where(self) -> str:
        """File and line."""
        return f"{self.file}:{self.line}"


@dataclass(frozen=True)
class DyrFile:
    """The records of a DYR file in order, and what else was found in it."""

    path: Path
    records: tuple[DyrRecord, ...]
    comments: int  #: lines that hold no record
    notes: tuple[str, ...]  #: one line for each missing slash


def read_dyr(path: str | Path, known: Collection[str] = KNOWN) -> DyrFile:
    """Return the records of the DYR file `path`; it may be packed with gzip or xz.

    known : names of models before which a record ends although its slash is missing.

    Raises
    ------
    CaseError : unreadable, a record without model or identifier, or cut off; with file and line.
    """
    reader = _Reader(Path(path), known)
    lines = deque(enumerate(read_lines(reader.path), 1))
    while lines:
        number, text = lines.popleft()
        behind = reader.line(number, text.strip())
        if behind is not None:
            lines.appendleft((number, behind))
    if reader.words:
        model = reader.words[1] if len(reader.words) > 1 else "record"
        raise CaseError(f"{path}:{reader.first}: {model} has no / to the end of the file (cut off?)")
    return DyrFile(reader.path, tuple(reader.records), reader.comments, tuple(reader.notes))


class _Reader:
    """What was read of a DYR file, and the words of the record that is still open."""

    def __init__(self, path: Path, known: Collection[str]) -> None:
        self.path, self.known = path, known
        self.records: list[DyrRecord] = []
        self.notes: list[str] = []
        self.comments = 0
        self.words: list[str] = []
        self.first = self.searched = 0

    def line(self, number: int, text: str) -> str | None:
        """Read one line; return what follows its slash if that is a record of its own."""
        where = f"{self.path}:{number}"
        if not text or self.is_comment(number, text):
            return None
        new, behind = split_record(text, where)
        self.first, self.searched = (self.first, self.searched) if self.words else (number, 0)
        self.words += [word for word in new if word]
        self.divide(number, len(new))
        if len(self.words) > MOST_WORDS:
            raise CaseError(
                f"{self.path}:{self.first}: {self.words[1]} has more than {MOST_WORDS} fields, allowed: "
                "fewer (is the / of the record missing?)"
            )
        if behind is None:
            return None
        if self.words:
            self.records.append(_record(self.path, self.first, self.words))
            self.words = []
        model = _second_record(behind, self.known)
        if model:
            self.notes.append(f"{where}: {model} begins after the / of another record; read as two records")
        return behind if model else None

    def is_comment(self, number: int, text: str) -> bool:
        """Whether a line is comment; one that looks like a record is noted."""
        marked = text.startswith("//")
        if not marked and (self.words or _begins_with_number(text)):
            return False
        self.comments += text != "/"
        what = "" if marked else _like_a_record(text, self.known)
        if what:
            note = f"line {number}, {what}, has no bus number: treated as comment"
            self.notes.append(f"{self.path}:{number}: {note}")
        return True

    def divide(self, number: int, new: int) -> None:
        """Close the open record before a second one among its words, of which `new` are of this line."""
        while (at := _next_record(self.words, self.known, self.searched)) is not None:
            line = number - (at < len(self.words) - new)
            self.records.append(_record(self.path, self.first, self.words[:at]))
            note = (
                f"{self.words[at + 1]} begins before the / of {self.records[-1].model}; read as two records"
            )
            self.notes.append(f"{self.path}:{line}: {note}")
            self.words, self.first, self.searched = self.words[at:], line, 0
        self.searched = len(self.words)


def _plain_words(text: str) -> list[str]:
    return text.replace(",", " ").replace("'", " ").replace('"', " ").replace("/", " / ").split()


def _like_a_record(text: str, known: Collection[str]) -> str:
    """What makes a line of comment look like a record, in words; empty when nothing does."""
    words = _plain_words(text)
    model = next((word.upper() for word in words if word.upper() in known), "")
    if model:
        return f"which names {model}"
    numbers = sum(_begins_with_number(word) for word in words)
    return "numbers with a / at the end" if numbers >= 2 and words[-1] == "/" else ""


def _second_record(text: str, known: Collection[str]) -> str:
    """The model of the record that `text`, which stands behind a slash, is; empty when it is comment."""
    words = _plain_words(text)
    whole = len(words) > 3 and words[0].isdigit() and words[1].upper() in known
    return words[1].upper() if whole else ""


def _begins_with_number(text: str) -> bool:
    word = text.replace(",", " ").replace("'", " ").split()[:1]
    return bool(word) and word[0].lstrip("+-").replace(".", "", 1).isdigit()


def _next_record(words: list[str], known: Collection[str], searched: int) -> int | None:
    """The position of a second record in `words`: a bus number before the name of a model.

    searched : so many words were looked at before.
    """
    if len(words) < 5:
        return None
    start = 5 if words[1].upper().startswith("USR") else 4
    for k in range(max(start, searched), len(words)):
        if words[k].upper() in known and words[k - 1].isdigit():
            return k - 1
    return None


def _record(path: Path, line: int, words: list[str]) -> DyrRecord:
    where = f"{path}:{line}"
    try:
        bus = abs(int(float(words[0])))
        if bus != abs(float(words[0])):
            raise ValueError
    except (ValueError, OverflowError):
        raise CaseError(f"{where}: bus = {words[0]!r}, allowed: a whole number") from None
    if len(words) < 2 or not words[1][:1].isalpha():
        got = repr(words[1]) if len(words) > 1 else "nothing"
        raise CaseError(f"{where}: model = {got}, allowed: the name of a model after the bus")
    model = words[1].upper()
    if model == "USRBUS":
        return _user(where, line, path, model, bus, "", words[2:], 6)
    if len(words) < 3:
        raise CaseError(f"{where}: {model} at bus {bus}: the identifier is missing (cut off?)")
    identity = words[2].strip().upper()
    if model in ("USRMDL", "USRLOD"):
        return _user(where, line, path, model, bus, identity, words[3:], 7 if model == "USRLOD" else 6)
    return DyrRecord(PLAIN.get(model, model), bus, identity, tuple(words[3:]), line, str(path))


def _user(
    where: str, line: int, path: Path, user: str, bus: int, identity: str, words: list[str], counts: int
) -> DyrRecord:
    """A user-written model: NAME IC IT NI NC NS NV, then NI whole numbers and NC reals."""
    if len(words) < 1 + counts:
        raise CaseError(
            f"{where}: {user} at bus {bus}: {len(words)} fields, allowed: a name and {counts} counts"
        )
    name = words[0].upper()
    try:
        expected = int(words[3]) + int(words[4])
    except ValueError:
        raise CaseError(
            f"{where}: {user} {name}: NI, NC = {words[3]!r}, {words[4]!r}, allowed: whole numbers"
        ) from None
    fields = tuple(words[1 + counts :])
    if len(fields) < expected:
        raise CaseError(
            f"{where}: {user} {name}: {len(fields)} values, allowed: {expected} as its counts say (cut off?)"
        )
    return DyrRecord(PLAIN.get(name, name), bus, identity, fields[:expected], line, str(path), user)
