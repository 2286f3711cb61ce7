"""Syntax of DYR files: ends of records, quotes, comments, user-written models, missing slashes."""

from __future__ import annotations

import gzip
import lzma
from pathlib import Path

import pytest

from interarea.models.errors import CaseError
from interarea.models.importers.dyr import DyrFile, read_dyr


def read(folder: Path, text: str) -> DyrFile:
    path = folder / "grid.dyr"
    path.write_text(text)
    return read_dyr(path)


ENDS = [
    "1 'GENCLS' 1 6.5 0.0 /",
    "1 'GENCLS' 1 6.5 0.0/",
    "1,'GENCLS','1 ',6.5,0.0 / classical, 2 'SEXS' 1",
    "1 'GENCLS' 1\n  6.5\n\n 0.0\n/",
    "1 GENCLS 1 6.5 0.0 /",
    "1 'gencls' \"1\"   6.5   0.0    /",
    "\ufeff1 'GENCLS' 1\n// a comment inside\n6.5 0.0 /",
    "  1\t'GENCLS'\t1\t6.5\t0.0\t/\r\n",
]


@pytest.mark.parametrize("text", ENDS)
def test_one_record_in_many_forms(tmp_path: Path, text: str) -> None:
    (record,) = read(tmp_path, text).records
    assert (record.model, record.bus, record.identity, record.fields) == ("GENCLS", 1, "1", ("6.5", "0.0"))
    assert record.where.endswith("grid.dyr:1")


def test_comments_are_counted_and_records_keep_their_lines(tmp_path: Path) -> None:
    text = (
        "// head\nLine.Toggle 1 2\n1 'GENCLS' 'a ' 6 0 /\n\n* note\n-7 'SEXS' A 0.1 10\n 100 0.1 -5 5 / end\n"
    )
    file = read(tmp_path, text)
    assert file.comments == 3 and file.notes == ()
    assert [(r.model, r.bus, r.identity, r.line) for r in file.records] == [
        ("GENCLS", 1, "A", 3),
        ("SEXS", 7, "A", 6),
    ]


def test_a_missing_slash_splits_before_a_known_model_and_is_told(tmp_path: Path) -> None:
    text = "1 'GENCLS' 1 6.5 0.0\n2 'GENCLS' 1 7.5 0.0 /\n3 'GENCLS' 1 8.5 0 4 'SEXS' 1 .1 10 100 .1 -5 5 /\n"
    file = read(tmp_path, text)
    assert [(r.model, r.bus, len(r.fields), r.line) for r in file.records] == [
        ("GENCLS", 1, 2, 1),
        ("GENCLS", 2, 2, 2),
        ("GENCLS", 3, 2, 3),
        ("SEXS", 4, 6, 3),
    ]
    assert [note.split(": ", 1)[1][:22] for note in file.notes] == [
        "GENCLS begins before t",
        "SEXS begins before the",
    ]


USER = [
    (
        "5 'USRMDL' 1 'REGCAU1' 101 1 1 3 2 4  1  0.1 0.2 0.3 /",
        ("REGCA1", 5, "1", ("1", "0.1", "0.2", "0.3")),
    ),
    ("5 'USRMDL' 1 'MINE' 1 1 0 2 1 1 0.5 0.6 /", ("MINE", 5, "1", ("0.5", "0.6"))),
    (
        "5 'USRLOD' * 'CMLDBLU2' 12 1 2 3 27 146 48  1 2 .1 .2 .3 /",
        ("CMLDBLU2", 5, "*", ("1", "2", ".1", ".2", ".3")),
    ),
    ("5 'USRBUS' 'FRQTPA' 504 0 1 2 0 0  1 0.1 0.2 /", ("FRQTPA", 5, "", ("1", "0.1", "0.2"))),
    ("0 'IEELAL' * 1 0 0 1 0 0 0 0 2 0 0 2 0 0 /", ("IEELAL", 0, "*", tuple("10010000200200"))),
]


@pytest.mark.parametrize(("text", "expected"), USER)
def test_user_written_models_are_stripped(tmp_path: Path, text: str, expected: tuple) -> None:
    (record,) = read(tmp_path, text).records
    assert (record.model, record.bus, record.identity, record.fields) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 'GENCLS' 1 6.5\n", r"grid\.dyr:1: GENCLS has no / to the end of the file \(cut off\?\)"),
        ("1 /\n", r"grid\.dyr:1: model = nothing, allowed: the name of a model"),
        ("1 2 3 /\n", r"grid\.dyr:1: model = '2', allowed: the name of a model"),
        ("1 'GENCLS' /\n", r"grid\.dyr:1: GENCLS at bus 1: the identifier is missing"),
        ("1 'GENCLS 1 6.5 0 /\n", r"grid\.dyr:1: a quote \('\) is not closed: 'GENCLS"),
        (
            "5 'USRMDL' 1 'M' 1 1 0 3 1 1 0.5 0.6 /",
            r"grid\.dyr:1: USRMDL M: 2 values, allowed: 3 as its counts",
        ),
        (
            "5 'USRMDL' 1 'M' 1 1 x 3 1 1 0.5 /",
            r"grid\.dyr:1: USRMDL M: NI, NC = 'x', '3', allowed: whole numbers",
        ),
        ("5 'USRMDL' 1 'M' 1 1 /", r"grid\.dyr:1: USRMDL at bus 5: 3 fields, allowed: a name and 6 counts"),
    ],
)
def test_a_wrong_record_is_named_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(CaseError, match=message):
        read(tmp_path, text)


@pytest.mark.parametrize("pack", [gzip.compress, lzma.compress])
def test_packed_files_are_read_as_they_are(tmp_path: Path, pack) -> None:
    path = tmp_path / "grid.dyr.xz"
    path.write_bytes(pack(ENDS[0].encode()))
    assert len(read_dyr(path).records) == 1
