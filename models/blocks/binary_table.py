"""Pack named arrays into the one piece of bytes that the C blocks read (layout: block/record.h)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

MAGIC = b"IAREC001"
_HEADER = 32
_ENTRY = 64
_NAME = 40


def pack_record(arrays: Mapping[str, npt.ArrayLike | bytes]) -> bytes:
    """Return the record holding `arrays`; floats become float64, integers int32, bytes stay bytes.

    Arrays are flattened in C order. The same content gives the same bytes.

    Raises
    ------
    ValueError : a name longer than 39 ASCII characters, or a value that is neither float nor int32.
    """
    entries: list[bytes] = []
    body = bytearray()
    start = _HEADER + _ENTRY * len(arrays)
    for name, value in arrays.items():
        kind, count, raw = _encode(name, value)
        key = name.encode("ascii")
        if len(key) >= _NAME:
            raise ValueError(
                f"record: array name {name!r} has {len(key)} characters, at most {_NAME - 1} fit"
            )
        body += b"\0" * (-(start + len(body)) % 8)
        entries.append(struct.pack("<40sIIQQ", key, kind, 0, count, start + len(body)))
        body += raw
    body += b"\0" * (-(start + len(body)) % 8)
    tail = struct.pack("<Q", len(entries)) + b"".join(entries) + bytes(body)
    return MAGIC + struct.pack("<QQ", 24 + len(tail), zlib.crc32(tail)) + tail


def unpack_record(record: bytes) -> dict[str, npt.NDArray[np.float64] | npt.NDArray[np.int32] | bytes]:
    """Return the arrays of a record made by `pack_record`, flat.

    Raises
    ------
    ValueError : the bytes are no record, cut short or damaged.
    """
    if record[: len(MAGIC)] != MAGIC or len(record) < _HEADER:
        raise ValueError("record: does not begin with a record's header")
    size, check = struct.unpack_from("<QQ", record, len(MAGIC))
    tail = record[24:]
    if size != len(record) or zlib.crc32(tail) != check:
        raise ValueError(
            f"record: {len(record)} bytes, wanted {size} with checksum {check:08x}; it is damaged"
        )
    arrays: dict[str, npt.NDArray[np.float64] | npt.NDArray[np.int32] | bytes] = {}
    for k in range(struct.unpack_from("<Q", record, 24)[0]):
        key, kind, _, count, start = struct.unpack_from("<40sIIQQ", record, _HEADER + _ENTRY * k)
        name = key.rstrip(b"\0").decode("ascii")
        if kind == 3:
            arrays[name] = record[start : start + count]
        else:
            arrays[name] = np.frombuffer(
                record, dtype="<f8" if kind == 1 else "<i4", count=count, offset=start
            )
    return arrays


def _encode(name: str, value: npt.ArrayLike | bytes) -> tuple[int, int, bytes]:
    if isinstance(value, bytes):
        return 3, len(value), value
    array = np.asarray(value)
    if array.dtype.kind == "f":
        return 1, array.size, np.ascontiguousarray(array, dtype="<f8").tobytes()
    if array.dtype.kind in "iu" or array.size == 0:
        if array.size and (array.min() < -(2**31) or array.max() >= 2**31):
            raise ValueError(f"record: array {name!r} has integers beyond 32 bits")
        return 2, array.size, np.ascontiguousarray(array, dtype="<i4").tobytes()
    raise ValueError(f"record: array {name!r} has dtype {array.dtype}; float64, int32 or bytes are allowed")
