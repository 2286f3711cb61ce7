"""Text of PSS/E files: words, quotes, ends of records, packing, encodings, line ends."""

from __future__ import annotations

import bz2
import gzip
import lzma
from pathlib import Path

import pytest

from interarea.models.errors import CaseError
from interarea.models.importers.raw.record import Record
from interarea.models.importers.raw.text import LONGEST_LINE, read_lines, split_record, split_words

WORDS = [
    ("1,'a/b, c ',,2.0 / rest", ("1", "a/b, c", "", "2.0")),
    ("1, 'a' 2 3,4", ("1", "a", "2", "3", "4")),
    (" 1 'GEN ROU' 1  8.0 /", ("1", "GEN ROU", "1", "8.0")),
    ("1\t2,\t 3", ("1", "2", "3")),
    (",,5", ("", "", "5")),
    ("'O'NEIL  ' 2", ("O'NEIL", "2")),
    ('"DC 1", 1, \'B" C\'', ("DC 1", "1", 'B" C')),
    ("'A&B*C', 1 /* note */", ("A&B*C", "1")),
    ("1.0/", ("1.0",)),
    ("''", ("",)),
]


@pytest.mark.parametrize(("text", "words"), WORDS)
def test_words_of_a_line(text: str, words: tuple[str, ...]) -> None:
    assert split_words(text, "") == words


def test_a_slash_ends_a_record_only_outside_quotes() -> None:
    assert split_record("1 'A/B' 2", "") == (("1", "A/B", "2"), None)
    assert split_record("1 'A/B' 2 / 3", "") == (("1", "A/B", "2"), " 3")
    assert split_record("/", "") == ((), "")


def test_an_open_quote_and_an_endless_line_are_named() -> None:
    with pytest.raises(CaseError, match=r"^f:3: a quote \('\) is not closed: 'ABC"):
        split_words("1, 'ABC, 2", "f:3")
    with pytest.raises(CaseError, match=r"^f:3: a line of \d+ characters"):
        split_words("1," * LONGEST_LINE, "f:3")


@pytest.mark.parametrize("pack", [bytes, gzip.compress, lzma.compress, bz2.compress])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_packed_or_plain_any_encoding_and_line_end(tmp_path: Path, pack, end: str, encoding: str) -> None:
    path = tmp_path / "grid.any"
    path.write_bytes(pack(end.join(["1,'Malmö'", "2", ""]).encode(encoding)))
    assert read_lines(path) == ["1,'Malmö'", "2", ""]


def test_what_is_no_text_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "grid.raw"
    path.write_bytes(b"0, 100\n1, 2\0\n")
    with pytest.raises(CaseError, match=r"grid\.raw:2: a zero byte"):
        read_lines(path)
    path.write_bytes(gzip.compress(b"0, 100\n" * 50)[:-20])
    with pytest.raises(CaseError, match=r"grid\.raw: cannot be read"):
        read_lines(path)
    with pytest.raises(CaseError, match="no such file"):
        read_lines(tmp_path / "none.raw")


def record(*words: str) -> Record:
    return Record("load", words, "g.raw:7", {"I": 0, "ID": 1, "PL": 2, "QL": 3})


def test_fields_by_name() -> None:
    row = record("-3", "a ", "1.5D2", "")
    assert (row.bus("I"), row.identity("ID"), row.number("PL"), row.number("QL", 4.0)) == (3, "A", 150.0, 4.0)
    assert (
        record("2.0").whole("I") == 2 and not record("2").has("ID") and record("1", " ").identity("ID") == "1"
    )


FIELDS = [
    (
        lambda: record("1", "1", "x").number("PL"),
        r"^g\.raw:7: load record: PL \(field 3\) = 'x', allowed: a fi",
    ),
    (lambda: record("1", "1", "1_0").number("PL"), r"PL \(field 3\) = '1_0'"),
    (lambda: record("1", "1", "nan").number("PL"), r"PL \(field 3\) = 'nan', allowed: a finite number"),
    (lambda: record("1").number("PL"), r"PL \(field 3\) is missing, 1 fields are there \(cut off\?\)"),
    (lambda: record("1.5").whole("I"), r"I \(field 1\) = 1.5, allowed: a whole number"),
    (lambda: record("7").code("I", 1, (0, 1)), r"I \(field 1\) = 7, allowed: 0, 1"),
    (lambda: record("NORTH   230.00").bus("I"), r"I = 'NORTH   230.00' names a bus, allowed: a number"),
]


@pytest.mark.parametrize(("read", "message"), FIELDS)
def test_a_wrong_field_is_named_with_file_line_and_what_is_allowed(read, message: str) -> None:
    with pytest.raises(CaseError, match=message):
        read()
