"""The record: its layout as documented in models/c/block/record.h, and what it refuses to hold."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from interarea.models.blocks.binary_table import pack_record


def decode(record: bytes) -> dict[str, object]:
    """Read a record by the text of record.h, independently of the packer."""
    magic, size, crc, count = struct.unpack_from("<8sQQQ", record)
    assert magic == b"IAREC001"
    assert size == len(record)
    assert crc == zlib.crc32(record[24:])
    entries: dict[str, object] = {}
    for k in range(count):
        name, kind, zero, n, offset = struct.unpack_from("<40sIIQQ", record, 32 + 64 * k)
        assert zero == 0
        assert offset % 8 == 0
        raw = record[offset:]
        key = name.rstrip(b"\0").decode()
        entries[key] = {
            1: lambda raw=raw, n=n: np.frombuffer(raw, "<f8", n),
            2: lambda raw=raw, n=n: np.frombuffer(raw, "<i4", n),
            3: lambda raw=raw, n=n: raw[:n],
        }[kind]()
    return entries


def test_round_trip_by_the_documented_layout() -> None:
    a = np.array([[1.5, -2.0], [np.pi, 1e300]])
    got = decode(
        pack_record({"a": a, "counts": np.array([3, -4, 5]), "text": b"abc\0", "none": np.array([])})
    )
    assert np.array_equal(got["a"], a.ravel())
    assert np.array_equal(got["counts"], [3, -4, 5])
    assert got["text"] == b"abc\0"
    assert len(got["none"]) == 0


def test_same_content_gives_same_bytes() -> None:
    arrays = {"a": np.arange(3.0), "b": b"x"}
    assert pack_record(arrays) == pack_record(dict(arrays))


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("n" * 40, np.zeros(1), "at most 39"),
        ("a", np.array([2**31]), "beyond 32 bits"),
        ("a", np.array(["text"]), "dtype"),
        ("a", np.array([1j]), "dtype"),
    ],
)
def test_what_it_refuses(name: str, value: np.ndarray, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        pack_record({name: value})
