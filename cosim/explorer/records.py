"""Records that are nearly alike: one as it is, of the others how they differ (`undelta` of worker.js)."""

from __future__ import annotations

import struct

_GRAIN = 8  #: bytes: records are aligned so
_LEAST = 24  #: a shorter run of equal bytes costs more to name than to give


def delta(reference: bytes, target: bytes) -> bytes:
    """Return what turns `reference` into `target`: [u32 from, u32 length, u32 given, given bytes], repeated.

    Each piece copies `length` bytes of the reference and appends `given` bytes.
    """
    places: dict[bytes, int] = {}
    for at in range(0, len(reference) - _LEAST + 1, _GRAIN):
        places.setdefault(reference[at : at + _LEAST], at)
    out = bytearray()
    literal = bytearray()
    copied = (0, 0)
    at, ahead = 0, 0  # ahead: where the last copy would go on; there a match is looked for first
    while at < len(target):
        block = target[at : at + _LEAST]
        start = ahead if block and reference[ahead : ahead + _LEAST] == block else places.get(block, -1)
        if start < 0:
            literal += target[at : at + 1]
            at, ahead = at + 1, ahead + 1
            continue
        length = _equal(reference, start, target, at)
        out += _piece(copied, literal)
        literal = bytearray()
        copied = (start, length)
        at, ahead = at + length, start + length
    return bytes(out + _piece(copied, literal))


def _piece(copied: tuple[int, int], literal: bytearray) -> bytes:
    return struct.pack("<3I", *copied, len(literal)) + bytes(literal)


def _equal(reference: bytes, start: int, target: bytes, at: int) -> int:
    """How many bytes are equal from there on."""
    length, most = 0, min(len(reference) - start, len(target) - at)
    while length < most:
        span = min(4096, most - length)
        here, there = start + length, at + length
        if reference[here : here + span] == target[there : there + span]:
            length += span
            continue
        while reference[start + length] == target[at + length]:
            length += 1
        break
    return length
