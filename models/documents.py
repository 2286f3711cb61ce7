"""Documents of the user's, TOML and JSON: read strictly, told apart, times in cycles as seconds.

A byte-order mark is read over. Refused by place and value: numbers that arithmetic would overflow on,
integers beyond 64 bits, control characters in texts, NaN and infinity in JSON, a JSON key given twice,
tables without end.

A time is a number of seconds or terms joined by +: `1.5 s`, `100 ms`, `8 cycles`, and `start`: its table's
`start_s`.
"""

from __future__ import annotations

import ast
import json
import re
import threading
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from .errors import UserError

LARGEST_DOCUMENT = 256 << 20  #: bytes; a case takes 0.7 kB a bus (wecc-240), so this is some 380 000 buses
LARGEST = 1e30  #: size of a number; a limit that is absent counts as this
_LARGEST_INTEGER = 2**63 - 1
#: what moves or colours a terminal that the text is printed to
_PARSING = threading.Lock()
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
_SHOWN = 40  #: characters of a number in a message
_READ = 80  #: of a line that is no TOML or JSON


class DocumentError(UserError):
    """A text that is no TOML or JSON, or that has a number which none can be."""


def read_document(path: Path, expected: str) -> bytes:
    """Return the bytes of a file of the user's: a regular one, for a device or pipe may never end.

    expected : what the file should be, with its article ("a scenario file").

    Raises
    ------
    DocumentError : names the file: it is not there, a folder, no regular file, or too large.
    OSError : it cannot be read.

    >>> read_document(Path("/dev/zero"), "a scenario file")
    Traceback (most recent call last):
    interarea.models.documents.DocumentError: /dev/zero: is no regular file, wanted: a scenario file
    """
    require_regular(path, expected)
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_DOCUMENT + 1)
    except FileNotFoundError:
        raise DocumentError(f"{path}: no such file, wanted: {expected}") from None
    if len(content) > LARGEST_DOCUMENT:
        raise DocumentError(f"{path}: more than {LARGEST_DOCUMENT >> 20} MiB, allowed: less for {expected}")
    return content


def require_regular(
    path: Path, expected: str, error: type[UserError] = DocumentError, *, key: str = ""
) -> None:
    """Raise `error`, which names the file, unless `path` is a regular file or a link to one.

    key : of the table that names the file.
    """
    if path.is_file():
        return
    if path.is_dir():
        what = "is a folder"
    elif path.exists():
        what = "is no regular file"
    else:
        what = "no such file"
    named = f"{key} = {str(path)!r}" if key else f"{path}:"
    raise error(f"{named} {what}, wanted: {expected}")


def parse_toml(content: bytes | str) -> dict[str, Any]:
    """Return the tables of a text.

    >>> parse_toml("stop_s = 1e308")
    Traceback (most recent call last):
    interarea.models.documents.DocumentError: stop_s = 1e+308, allowed: numbers up to 1e+30

    Raises
    ------
    DocumentError : not TOML, not UTF-8, nested too deeply, a number that is too large.
    """
    return _parsed(content, "TOML", tomllib.loads)  # type: ignore[no-any-return]


def parse_json(content: bytes | str) -> Any:
    """Return what a JSON text holds.

    Raises
    ------
    DocumentError : not JSON, not UTF-8, nested too deeply, a number that is too large or none.
    """
    return _parsed(content, "JSON", _strict_json)


def parse_python(text: bytes | str, mode: str = "exec") -> Any:
    """Return the tree of a text, as `ast.parse` does, one thread at a time.

    Before Python 3.12 threads that parse at once end in "AST constructor recursion depth mismatch".
    """
    with _PARSING:
        return ast.parse(text, mode=mode)


def _parsed(content: bytes | str, language: str, read: Callable[[str], Any]) -> Any:
    text = content if isinstance(content, str) else _decoded(content, language)
    text = text.removeprefix("\ufeff")
    try:
        document = read(text)
        _check_values(document, "")
    except RecursionError:
        raise DocumentError(f"not valid {language}: nested too deeply") from None
    except DocumentError:
        raise
    except ValueError as error:  # that of the language, of an integer of thousands of digits
        raise DocumentError(f"not valid {language}: {error}{_read_there(str(error), text)}") from None
    return document


def _decoded(content: bytes, language: str) -> str:
    if what := not_utf8(content[:4096]):
        raise DocumentError(f"not valid {language}: {what}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise DocumentError(
            f"not valid {language}: byte 0x{content[error.start]:02x} in line {line} is not UTF-8, "
            "wanted: text saved as UTF-8"
        ) from None


def not_utf8(content: bytes) -> str:
    """Return what bytes plainly are that are no text in UTF-8, "" where that is not plain.

    >>> not_utf8("Time,G1".encode("utf-16"))
    'is UTF-16, wanted: UTF-8 (an editor or a spreadsheet saves it so)'
    """
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "is UTF-16, wanted: UTF-8 (an editor or a spreadsheet saves it so)"
    if content.startswith(b"PK\x03\x04"):
        return "is a zip archive, as a workbook of a spreadsheet is, wanted: text"
    return "is binary, wanted: text" if b"\0" in content else ""


#: error and line at it -> what to do; the first that holds
_HINTS = (
    (r"overwrite|declare", r"", "an id given twice?"),
    (r"", r"^\s*\{", "this looks like JSON"),
    (r"", r"[\u201c-\u201f\u2018-\u201b\u00ab\u00bb]", 'straight quotes are wanted: "'),
    (r"", r"[\u00a0\u2000-\u200d\u202f\u3000]", "a plain space is wanted there"),
    (r"hex|[Ee]scape", r"\\", "in a path / is wanted, or quotes of the kind '"),
    (r"Illegal character", r"[\"']", "a quote is not closed"),
    (r"", r"=\s*(True|False)\b", "true and false are written small"),
    (r"", r"=\s*-?\d+,\d", "a decimal point is wanted"),
    (r"after a key", r"^[\w.\s-]+:", "a key and its value are joined by ="),
    (r"Invalid value", r"=\s*[A-Za-z./~]", "a text stands in quotes"),
    (r"", r"\r.", "line ends of Unix or Windows are wanted"),
    (r"double quotes|trailing comma", r"[,}\]]", "no comma stands before } or ]"),
)


def _read_there(error: str, text: str) -> str:
    """Return what was read where a language's error is, and what to do, as the end of a message."""
    match = re.search(r"line (\d+),? column (\d+)", error)
    lines = text.split("\n")
    if match is None or int(match[1]) > len(lines):
        return ""
    first = max(0, int(match[2]) - _READ // 2)  # a line of numbers may be long
    line = lines[int(match[1]) - 1][first : first + _READ]
    hints = (to_do for wrong, there, to_do in _HINTS if re.search(wrong, error) and re.search(there, line))
    shown = "".join(c if c.isprintable() else repr(c)[1:-1] for c in line.strip())
    hint = next(hints, "")
    return (f", got: {shown}" if shown else "") + (f"; {hint}" if hint else "")


def _strict_json(text: str) -> Any:
    return json.loads(text, parse_constant=_no_constant, object_pairs_hook=unique_keys)


def _no_constant(word: str) -> float:
    raise DocumentError(f"not valid JSON: {word} is no number")


def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of JSON; DocumentError where a key is given twice. For `object_pairs_hook`."""
    document = dict(pairs)
    if len(document) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in document if keys.count(key) > 1)
        raise DocumentError(f"not valid JSON: the key {twice!r} is given twice")
    return document


def _check_values(value: Any, where: str) -> None:
    if isinstance(value, dict):
        for key, item in value.items():
            _check_values(item, f"{where}.{key}" if where else str(key))
    elif isinstance(value, list):
        for k, item in enumerate(value, start=1):
            _check_values(item, f"{where} {k}")
    elif isinstance(value, str) and (match := _CONTROL.search(value)):
        raise DocumentError(
            f"{where}: control character U+{ord(match[0]):04X} at {match.start() + 1}, allowed: text without"
        )
    elif isinstance(value, int) and not abs(value) <= _LARGEST_INTEGER:
        digits = str(abs(value))
        text = digits if len(digits) <= _SHOWN else f"{digits[:_SHOWN]}... ({len(digits)} digits)"
        raise DocumentError(f"{where} = {text}, allowed: integers of 64 bits")
    elif isinstance(value, float) and LARGEST < abs(value) < float("inf"):
        raise DocumentError(f"{where} = {value:g}, allowed: numbers up to {LARGEST:g}")


#: kind -> (keys of which one is in every file of it and in no other kind, the command that takes it)
KINDS: Mapping[str, tuple[frozenset[str], str]] = {
    "study": (frozenset({"published", "disturbance"}), "interarea study"),
    "claims": (frozenset({"statement", "correction"}), "interarea study, as `claims` in its file"),
    "sweep": (frozenset({"parameters"}), "interarea sweep"),
    "design": (frozenset({"conditions", "ask"}), "interarea design"),
    "case": (frozenset({"machines", "buses", "branches", "base", "change"}), "interarea modes"),
    "device": (frozenset({"diagram"}), "interarea device"),
    "scenario": (frozenset({"stop_s", "event", "channels", "connections"}), "interarea run"),
}


def other_kind(table: Mapping[str, Any], expected: str) -> str | None:
    """Return what `table` is, as the end of a sentence about its file, where it plainly is not a `expected`.

    >>> other_kind({"case": "two-area-thesis", "stop_s": 20.0}, "sweep")
    'is a scenario (`interarea run`), wanted: a sweep'
    >>> other_kind({}, "sweep")
    'is empty, wanted: a sweep'
    >>> other_kind({"parameters": {}, "stop_s": 1.0}, "sweep") is None
    True
    """
    if not table:
        return f"is empty, wanted: a {expected}"
    keys = set(table)
    if expected in KINDS and keys & KINDS[expected][0]:
        return None
    for kind, (signs, command) in KINDS.items():
        if kind != expected and keys & signs:
            return f"is a {kind} (`{command}`), wanted: a {expected}"
    return None


def toml_kind(content: bytes, expected: str) -> str | None:
    """Return what `other_kind` says of a text that is TOML; None where it is none."""
    try:
        table = parse_toml(content)
    except DocumentError:
        return None
    return other_kind(table, expected) if table else None


_TERM = re.compile(r"(?P<number>\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)\s*(?P<unit>ms|s|cycles?)")


def in_seconds(table: Mapping[str, Any], frequency_hz: Callable[[], float]) -> dict[str, Any]:
    """Return a table with every time in seconds; words that are no time stay, to be refused.

    frequency_hz : asked only where cycles are named, Hz.

    >>> in_seconds({"event": [{"start_s": 1.0, "end_s": "start + 6 cycles"}]}, lambda: 60.0)
    {'event': [{'start_s': 1.0, 'end_s': 1.1}]}
    >>> in_seconds({"latency_s": "100 ms"}, lambda: 60.0)
    {'latency_s': 0.1}
    """
    return {key: _moved(key, value, table, frequency_hz) for key, value in table.items()}


def is_time(key: str) -> bool:
    """Whether a key's unit is s."""
    return key.endswith("_s") and not key.endswith(("_per_s", "_rad_s"))


def _moved(key: str, value: Any, table: Mapping[str, Any], frequency_hz: Callable[[], float]) -> Any:
    if isinstance(value, Mapping):
        return in_seconds(value, frequency_hz)
    if isinstance(value, list | tuple):
        return type(value)(_moved(key, part, table, frequency_hz) for part in value)
    if isinstance(value, str) and is_time(key):
        return _seconds(value, table, frequency_hz)
    return value


def _seconds(text: str, table: Mapping[str, Any], frequency_hz: Callable[[], float]) -> str | float:
    total = 0.0
    for part in text.split("+"):
        word = part.strip()
        if word == "start" and table.get("start_s") != text:
            start = table.get("start_s")
            start = _seconds(start, table, frequency_hz) if isinstance(start, str) else start
            if not isinstance(start, int | float) or isinstance(start, bool):
                return text
            total += start
        elif match := _TERM.fullmatch(word):
            number = float(match["number"])
            per_s = {"s": 1.0, "ms": 1e3}.get(match["unit"]) or frequency_hz()
            total += number / per_s
        else:
            return text
    return total
