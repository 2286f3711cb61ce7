"""A MATPOWER case file read as the program it is: tables, and the statements that scale or set parts of them.

Understood are ``mpc.NAME = literal``, ``NAME = expression``, ``[NAMES] = idx_bus`` (or idx_gen, idx_brch),
``define_constants`` and ``mpc.TABLE(rows, columns) = expression``. Everything else is refused with its line:
a statement that is passed over could change any number.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import CaseError, nearest

Table = npt.NDArray[np.float64]

#: outputs of MATPOWER's functions of column numbers, in order: (name, number)
_BUS = (
    "PQ=1 PV=2 REF=3 NONE=4 BUS_I=1 BUS_TYPE=2 PD=3 QD=4 GS=5 BS=6 BUS_AREA=7 VM=8 VA=9 BASE_KV=10 ZONE=11 "
    "VMAX=12 VMIN=13 LAM_P=14 LAM_Q=15 MU_VMAX=16 MU_VMIN=17"
)
_GEN = (
    "GEN_BUS=1 PG=2 QG=3 QMAX=4 QMIN=5 VG=6 MBASE=7 GEN_STATUS=8 PMAX=9 PMIN=10 MU_PMAX=22 MU_PMIN=23 "
    "MU_QMAX=24 MU_QMIN=25 PC1=11 PC2=12 QC1MIN=13 QC1MAX=14 QC2MIN=15 QC2MAX=16 RAMP_AGC=17 RAMP_10=18 "
    "RAMP_30=19 RAMP_Q=20 APF=21"
)
_BRANCH = (
    "F_BUS=1 T_BUS=2 BR_R=3 BR_X=4 BR_B=5 RATE_A=6 RATE_B=7 RATE_C=8 TAP=9 SHIFT=10 BR_STATUS=11 PF=14 QF=15 "
    "PT=16 QT=17 MU_SF=18 MU_ST=19 ANGMIN=12 ANGMAX=13 MU_ANGMIN=20 MU_ANGMAX=21"
)


def _numbered(text: str) -> dict[str, float]:
    return {name: float(number) for name, number in (word.split("=") for word in text.split())}


_INDICES = {"idx_bus": _numbered(_BUS), "idx_gen": _numbered(_GEN), "idx_brch": _numbered(_BRANCH)}
_FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    **{name: getattr(np, name) for name in ("sin", "cos", "tan", "sqrt", "exp", "log", "abs")},
    "acos": np.arccos,
    "asin": np.arcsin,
    "atan": np.arctan,
    "deg2rad": np.deg2rad,
}
_CONSTANTS = {"pi": math.pi, "inf": math.inf, "Inf": math.inf, "NaN": math.nan, "nan": math.nan}
_ASSIGNED = re.compile(
    r"(?P<left>\[[^\]=]*\]|[A-Za-z]\w*(?:\.\w+)*(?:\([^=]*\))?)\s*=(?!=)\s*(?P<right>.*)", re.DOTALL
)
_TOKEN = re.compile(
    r"""\s*(?: \d+\.?\d*(?:[eEdD][-+]?\d+)? | \.\d+(?:[eEdD][-+]?\d+)?   # a number
          | [A-Za-z]\w*(?:\.\w+)* | \.[*/^] | [-+*/^():,\[\]])          # a name, a sign""",
    re.VERBOSE,
)
_IDLE = re.compile(
    r"(function\b.*|end|endfunction|return|clc|clear\b.*|close all|define_constants)$", re.DOTALL
)


_MARKED = re.compile(r"[%#'\"]|\.\.\.")  # a comment, a quote or the end of a line that goes on
_SIGN = re.compile(r"([\[\]{}();,])")
_DEPTH = {"[": 1, "{": 1, "(": 1, "]": -1, "}": -1, ")": -1}


@dataclass
class MFile:
    """What a case file holds after its last statement.

    tables : name -> (rows, columns). lines : name -> line number of each row. scalars : baseMVA and the like,
    with their texts. other : names of fields that are no table of numbers -> line. changes : statements that
    changed a table.
    """

    path: Path
    tables: dict[str, Table] = field(default_factory=dict)
    lines: dict[str, list[int]] = field(default_factory=dict)
    scalars: dict[str, str | float] = field(default_factory=dict)
    other: dict[str, int] = field(default_factory=dict)
    changes: list[int] = field(default_factory=list)
    twice: dict[str, int] = field(default_factory=dict)  #: field given a second time -> line


@dataclass(frozen=True)
class _Statement:
    line: int  #: on which it begins
    text: str  #: without comments, its lines parted by newlines


def read_m_file(path: Path, lines: list[str]) -> MFile:
    """Return what the statements of a MATPOWER case leave behind.

    Raises
    ------
    CaseError : a statement that is not understood, a table of uneven rows, brackets that stay open; with file
        and line.
    """
    result = MFile(path)
    names: dict[str, Any] = dict(_CONSTANTS)
    for statement in _statements(path, lines):
        where = f"{path}:{statement.line}"
        text = statement.text.strip()
        if _IDLE.match(text):
            if text == "define_constants":
                for row in _INDICES.values():
                    names |= row
            continue
        match = _ASSIGNED.fullmatch(text)
        if match is None:
            raise _refused(where, text)
        left, right = match["left"].strip(), match["right"].strip()
        if left.startswith("["):
            _take_indices(left, right, names, where, text)
        elif re.split(r"[.(]", left)[0] != "mpc":
            if not left.isidentifier():
                raise _refused(where, text)
            names[left] = _value(right, names, result, where, text)
        elif "(" in left:
            _change(left, right, names, result, where, text, statement.line)
        else:
            _take_field(left.partition(".")[2], right, names, result, statement, text)
    return result


def _refused(where: str, text: str) -> CaseError:
    shown = " ".join(text.split())
    table = re.match(r"mpc\.(\w+)", shown)
    what = f"changes mpc.{table.group(1)} by code" if table else "is code"
    return CaseError(
        f"{where}: {shown[:80]!r} {what} that is not supported, allowed: mpc.NAME = [numbers], names "
        "of columns from idx_bus, idx_gen, idx_brch, and sums, products and quotients of columns with "
        "numbers (write the numbers themselves into the table)"
    )


def _statements(path: Path, lines: list[str]) -> list[_Statement]:
    """Cut a file at the ends of lines and semicolons outside brackets; `...` goes on in the next line."""
    statements: list[_Statement] = []
    pieces: list[str] = []  # of the statement, which may be a table of 100 MB: never joined before its end
    begun, first, depth = False, 0, 0
    for number, raw in _outside_block_comments(lines):
        line, goes_on = _code(raw, f"{path}:{number}")
        for part, sign in _parts(line):
            first = first if begun else number
            pieces.append(part)
            depth += _DEPTH.get(sign, 0)
            if depth < 0:
                raise CaseError(
                    f"{path}:{number}: a {sign} without its opening sign, allowed: one for each opened"
                )
            if sign in (";", ",") and depth == 0:
                statements.append(_Statement(first, "".join(pieces)))
                pieces, begun = [], False
            else:
                pieces.append(sign)
                begun |= (part + sign).strip() != ""
        if depth:
            pieces.append("\n")
        elif not goes_on:
            statements.append(_Statement(first, "".join(pieces)))
            pieces, begun = [], False
    text = "".join(pieces)
    if depth or text.strip():
        what = (re.match(r"[\w.]+", text.strip()) or ["a statement"])[0]
        raise CaseError(
            f"{path}:{len(lines)}: {what} begins in line {first} and does not end (truncated file?)"
        )
    return [statement for statement in statements if statement.text.strip()]


def _outside_block_comments(lines: list[str]) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, without those between ``%{`` and ``%}``."""
    hidden = 0
    for number, raw in enumerate(lines, 1):
        marker = raw.strip()
        hidden = max(hidden + (marker in ("%{", "#{")) - (marker in ("%}", "#}")), 0)
        if not hidden:
            yield number, raw


def _code(raw: str, where: str) -> tuple[str, bool]:
    """A line without its comment, and whether it goes on in the next one; text in quotes is left empty."""
    if not _MARKED.search(raw):
        return raw, False
    code, k = "", 0
    while k < len(raw):
        c = raw[k]
        if c in "%#":
            break
        if raw.startswith("...", k):
            return code, True
        if c in "'\"" and not (code and (code[-1].isalnum() or code[-1] in ")]}_.'")):
            end = raw.find(c, k + 1)
            if end < 0:
                raise CaseError(f"{where}: a quote ({c}) is not closed: {raw[k : k + 40]}")
            inside = re.sub(r"[^\w .+-]", "_", raw[k + 1 : end])
            code, k = f"{code}'{inside}'", end + 1
            continue
        code, k = code + c, k + 1
    return code, False


def _parts(line: str) -> list[tuple[str, str]]:
    """The text before each bracket, comma and semicolon outside quotes, with that sign; the last with ""."""
    if "'" not in line:
        pieces = [*_SIGN.split(line), ""]
        return list(zip(pieces[::2], pieces[1::2], strict=True))
    parts, text, quoted = [], "", False
    for c in line:
        quoted ^= c == "'"
        if not quoted and c in "[]{}();,":
            parts.append((text, c))
            text = ""
        else:
            text += c
    return [*parts, (text, "")]


def _take_indices(left: str, right: str, names: dict[str, Any], where: str, text: str) -> None:
    """Give the names on the left the column numbers that MATPOWER's function on the right gives."""
    provided = left.strip("[] \n").replace(",", " ").split()
    outputs = _INDICES.get(right)
    if outputs is None or len(provided) > len(outputs):
        raise _refused(where, text)
    for name, value in zip(provided, outputs.values(), strict=False):
        if name != "~":
            names[name] = value


def _take_field(
    name: str, right: str, names: dict[str, Any], result: MFile, statement: _Statement, text: str
) -> None:
    """Take ``mpc.NAME = literal``."""
    where = f"{result.path}:{statement.line}"
    if name in result.tables or name in result.scalars or name in result.other:
        result.twice[name] = statement.line
        result.tables.pop(name, None)
    if right.startswith("["):
        if not right.endswith("]") or right.count("[") > 1:
            raise _refused(where, text)
        result.tables[name], result.lines[name] = _table(name, right, names, result, statement)
    elif right.startswith(("{", "struct")) or "." in name:
        result.other[name] = statement.line
    elif right.startswith("'"):
        result.scalars[name] = right.strip("'")
    else:
        result.scalars[name] = float(_value(right, names, result, where, text))


def _table(
    name: str, right: str, names: dict[str, Any], result: MFile, statement: _Statement
) -> tuple[Table, list[int]]:
    """The rows of ``mpc.NAME = [...]`` and the line of each; an element may be ``135/sqrt(3)``."""
    path = result.path
    rows: list[list[float]] = []
    at: list[int] = []
    before = statement.text[: statement.text.index("[")].count("\n")
    for k, line in enumerate(right[1:-1].split("\n"), statement.line + before):
        for part in line.split(";"):
            words = part.replace(",", " ").split()
            if not words:
                continue
            row = [_number(word, names, result, f"{path}:{k}: mpc.{name}") for word in words]
            rows.append(row)
            at.append(k)
    if not rows:
        return np.zeros((0, 0)), []
    columns = Counter(map(len, rows)).most_common(1)[0][0]
    for k, row in zip(at, rows, strict=True):
        if len(row) != columns:
            raise CaseError(
                f"{path}:{k}: mpc.{name}: {len(row)} columns, allowed: {columns} as in its other rows (a "
                "number or the end of a line lost?)"
            )
    return np.array(rows), at


def _number(word: str, names: dict[str, Any], result: MFile, what: str) -> float:
    try:
        if "_" not in word:
            return float(word)
    except ValueError:
        pass
    try:
        return float(_value(word, names, result, "", ""))
    except (ValueError, TypeError, CaseError):
        raise CaseError(f"{what}: {word!r} is not a number") from None


def _change(
    left: str, right: str, names: dict[str, Any], result: MFile, where: str, text: str, line: int
) -> None:
    """Do ``mpc.TABLE(rows, columns) = expression``."""
    name, _, inside = left.partition("(")
    table = result.tables.get(name.partition(".")[2])
    if table is None or not left.endswith(")"):
        raise _refused(where, text)
    value = _value(right, names, result, where, text)
    at = _Reader(f"({inside}", names, result, where, text).place(table)
    try:
        table[at] = value
    except (IndexError, ValueError):
        raise _refused(where, text) from None
    result.changes.append(line)


def _value(text: str, names: dict[str, Any], result: MFile, where: str, whole: str) -> Any:
    reader = _Reader(text, names, result, where, whole)
    value = reader.sum()
    if reader.next() != "":
        raise _refused(where, whole)
    return value


class _Reader:
    """Reads an expression of numbers, names and parts of tables by its grammar; anything else is refused."""

    def __init__(self, text: str, names: dict[str, Any], result: MFile, where: str, whole: str) -> None:
        self.names, self.result, self.where, self.whole = names, result, where, whole
        self.tokens: list[tuple[str, bool]] = []  #: with whether a blank stands before
        k = 0
        text = text.strip()
        while k < len(text):
            match = _TOKEN.match(text, k)
            if match is None:
                raise self.no()
            self.tokens.append((match.group().strip(), match.group()[:1].isspace()))
            k = match.end()
        self.k = 0

    def no(self) -> CaseError:
        """Return the error that refuses the statement."""
        return _refused(self.where, self.whole)

    def next(self) -> str:
        """Return the token that comes; "" at the end."""
        return self.tokens[self.k][0] if self.k < len(self.tokens) else ""

    def take(self, expected: str = "") -> str:
        """Return the token that comes and go on; refuse another than `expected`."""
        token = self.next()
        if not token or (expected and token != expected):
            raise self.no()
        self.k += 1
        return token

    def sum(self) -> Any:
        """Sums of products; a sign binds like a product."""
        value = self.product()
        while self.next() in ("+", "-"):
            value = value + self.product() if self.take() == "+" else value - self.product()
        return value

    def product(self) -> Any:
        """Products and quotients; `*` and `/` of two tables would be those of matrices and are refused."""
        value = self.power()
        while self.next() in ("*", "/", ".*", "./"):
            sign, other = self.take(), self.power()
            if "." not in sign and np.ndim(other) and (np.ndim(value) or "/" in sign):
                raise self.no()
            with np.errstate(all="ignore"):
                value = value * other if "*" in sign else np.divide(value, other)
        return value

    def power(self) -> Any:
        """Signs and powers."""
        if self.next() in ("+", "-"):
            return self.power() if self.take() == "+" else -self.power()
        value = self.atom()
        while self.next() in ("^", ".^"):
            sign, other = self.take(), self.atom()
            if sign == "^" and (np.ndim(value) or np.ndim(other)):
                raise self.no()
            value = value**other
        return value

    def atom(self) -> Any:
        """Numbers, names, function calls, parts of tables, sums in brackets."""
        token = self.take()
        if token == "(":
            value = self.sum()
            self.take(")")
            return value
        if token[0].isdigit() or token[0] == ".":
            return float(token.lower().replace("d", "e"))
        if token.startswith("mpc."):
            return self.of_case(token.partition(".")[2])
        if token in _FUNCTIONS and self.next() == "(":
            self.take()
            value = _FUNCTIONS[token](self.sum())
            self.take(")")
            return value
        if token not in self.names:
            if token[0].isalpha():
                statement = " ".join(self.whole.split())[:80]
                raise CaseError(
                    f"{self.where}: {statement}: {token} is not known; {nearest(token, self.names)}"
                )
            raise self.no()
        return self.names[token]

    def of_case(self, name: str) -> Any:
        """``mpc.baseMVA`` or a part of a table."""
        if name in self.result.tables:
            table = self.result.tables[name]
            if self.next() != "(":
                return table
            part = table[self.place(table)]
            return float(part[0, 0]) if part.size == 1 else part.copy()
        value = self.result.scalars.get(name)
        if not isinstance(value, float):
            raise self.no()
        return value

    def place(self, table: Table) -> Any:
        """``(rows, columns)`` as an index of `table`."""
        self.take("(")
        rows = self.span(table.shape[0])
        self.take(",")
        columns = self.span(table.shape[1])
        self.take(")")
        return np.ix_(rows, columns)

    def span(self, size: int) -> list[int]:
        """``:``, a number, ``2:4`` or ``[3 4]`` as positions from 0."""
        if self.next() == ":":
            self.take()
            return list(range(size))
        if self.next() == "[":
            self.take()
            values: list[Any] = []
            while self.next() != "]":
                values.append(self.atom())
                if self.next() == ",":
                    self.take()
            self.take()
        else:
            values = [self.sum()]
            if self.next() == ":":
                self.take()
                values = list(np.arange(values[0], self.sum() + 0.5))
        if not all(np.ndim(one) == 0 and one == int(one) and 1 <= one <= size for one in values):
            raise self.no()
        return [int(one) - 1 for one in values]
