"""Text of a PSS/E file: packed or plain, any common encoding and line end, cut into the words of a record."""

from __future__ import annotations

import bz2
import gzip
import lzma
import re
import zlib
from pathlib import Path
from typing import Any

from ...documents import require_regular
from ...errors import CaseError, reason

LARGEST_BYTES = 1 << 30  #: of the unpacked text; a packed file can claim any size
LONGEST_LINE = 20_000  #: characters; PSS/E itself writes less than 2000
_PACKED: dict[bytes, Any] = {b"\x1f\x8b": gzip.open, b"\xfd7": lzma.open, b"BZ": bz2.open}
_WORD = re.compile(
    r"""'((?:[^']|'(?![\s,/]|$))*)'   # a quote closes only before blank, comma, slash or the end:
      | "((?:[^"]|"(?![\s,/]|$))*)"   # names hold apostrophes
      | (,) | (/) | ([^,/\s]+)""",
    re.VERBOSE,
)

#: what a comment behind a record or the end of a section does not look like: a bus, a word and two numbers
_HIDDEN = re.compile(r"\d\s*,\s*('[^']*'|[-+.\d]+)\s*,\s*[-+]?[.\d][-+.\deEdD]*\s*,\s*[-+]?[.\d]")


def read_lines(path: Path) -> list[str]:
    """Return the lines of the text file `path`, unpacked if it is gzip, xz or bzip2 (told by its content).

    UTF-8 with or without mark, UTF-16 with mark, else code page 1252; lines end in CR LF, LF or CR.

    Raises
    ------
    CaseError : the file cannot be read, is damaged, larger than 1 GiB or not text.
    """
    require_regular(path, "a text file", CaseError)
    try:
        with path.open("rb") as plain:
            start = plain.read(6)
        packed = next((opener for magic, opener in _PACKED.items() if start.startswith(magic)), None)
        with packed(path, "rb") if packed else path.open("rb") as file:
            content = file.read(LARGEST_BYTES + 1)
    except (OSError, EOFError, lzma.LZMAError, zlib.error, ValueError) as error:
        raise CaseError(f"{path}: cannot be read: {reason(error)}") from None
    if len(content) > LARGEST_BYTES:
        raise CaseError(f"{path}: more than {LARGEST_BYTES >> 20} MiB of text, allowed: less")
    return _decoded(path, content).replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _decoded(path: Path, content: bytes) -> str:
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings = ["utf-16"]
    else:
        zero = content.find(b"\0")
        if zero >= 0:
            line = content.count(b"\n", 0, zero) + 1
            raise CaseError(f"{path}:{line}: a zero byte: not a text file")
        encodings = ["utf-8-sig", "cp1252", "latin-1"]
    for encoding in encodings:
        try:
            return content.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise CaseError(
        f"{path}: has a mark of UTF-16 but is not UTF-16, allowed: UTF-8, UTF-16 with mark, code page 1252"
    )


def split_words(text: str, where: str) -> tuple[str, ...]:
    """Return the words of a line: commas or blanks part them, quotes bind them, `/` ends the record.

    Two commas in a row leave an empty word, which means the default. `where` names the line in errors.

    >>> split_words("1, 'A/B, C ',, 2.5  'O'NEIL' / comment", "")
    ('1', 'A/B, C', '', '2.5', "O'NEIL")
    """
    words, behind = split_record(text, where)
    if behind is not None and _HIDDEN.search(behind):
        raise CaseError(
            f"{where}: a record follows the / that ends this one, allowed: comment; put it on a separate "
            f"line: {behind.strip()[:40]}"
        )
    return words


def split_record(text: str, where: str) -> tuple[tuple[str, ...], str | None]:
    """Return the words of a line as `split_words`, and the text behind the `/` outside quotes, or None."""
    if len(text) > LONGEST_LINE:
        raise CaseError(f"{where}: a line of {len(text)} characters, allowed: at most {LONGEST_LINE}")
    if "'" not in text and '"' not in text:
        head, slash, rest = text.partition("/")
        return _split_plain(head), rest if slash else None
    words: list[str] = []
    after_comma = True
    for word in _WORD.finditer(text):
        single, double, comma, slash, bare = (group or "" for group in word.groups())
        if slash:
            return tuple(words), text[word.end() :]
        if comma:
            if after_comma:
                words.append("")
            after_comma = True
            continue
        _check_quotes(bare, single, double, where)
        words.append(bare or (single or double).strip())
        after_comma = False
    return tuple(words), None


def _check_quotes(bare: str, single: str, double: str, where: str) -> None:
    """Refuse a word whose quotes are not a pair round it; one of the three is the word."""
    if bare[:1] in ("'", '"'):
        raise CaseError(f"{where}: a quote ({bare[:1]}) is not closed: {bare[:40]}")
    word, quote = (double, '"') if double else (bare or single, "'")
    if word[-1:] == quote or (single or double)[:1] == quote or bare[-1:] == '"':
        raise CaseError(f"{where}: a quote too many or too few, in {word[:40]}")


def _split_plain(text: str) -> tuple[str, ...]:
    words: list[str] = []
    for part in text.split(","):
        pieces = part.split()
        if len(pieces) == 1:
            words.append(pieces[0])
        elif pieces:
            words.extend(pieces)
        else:
            words.append("")
    while words and not words[-1]:
        words.pop()
    return tuple(words)
