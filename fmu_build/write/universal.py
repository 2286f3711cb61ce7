"""Universal libraries of macOS: one file that holds a library for each processor."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from ..errors import BuildError

_FAT, _THIN = 0xCAFEBABE, 0xFEEDFACF  #: first words of <mach-o/fat.h> and of a 64-bit Mach-O file
_PAGE = 14  #: log2 of the largest page of memory, 16 KiB on arm64: a slice begins on one


def universal(slices: Sequence[bytes]) -> bytes:
    """Return one library that holds `slices`, thin 64-bit Mach-O libraries, in that order.

    Raises
    ------
    BuildError : a slice that is no such library, or two for one processor.
    """
    machines = []
    for content in slices:
        if len(content) < 12 or struct.unpack_from("<I", content)[0] != _THIN:
            raise BuildError("a slice of a universal library is no 64-bit Mach-O file; compile it again")
        machines.append(struct.unpack_from("<II", content, 4))
    if len({machine for machine, _ in machines}) != len(machines):
        raise BuildError("a universal library holds one slice for each processor; two are for the same")
    header = struct.pack(">II", _FAT, len(slices))
    content, body = b"", b""
    start = _aligned(len(header) + 20 * len(slices))
    for (machine, kind), slice_ in zip(machines, slices, strict=True):
        header += struct.pack(">IIIII", machine, kind, start + len(body), len(slice_), _PAGE)
        body += slice_
        body += bytes(_aligned(len(body)) - len(body))
    return header + bytes(start - len(header)) + body


def _aligned(size: int) -> int:
    return -(-size >> _PAGE) << _PAGE
