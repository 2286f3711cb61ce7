"""Read what a shared library is, needs and exports: ELF, PE and Mach-O, without the machine's tools.

Only the parts that the check needs; every offset is bounded by the file, so a
damaged file raises `ImageError` and nothing else.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

_MOST_SYMBOLS = 1_000_000
#: Folder of FMI 2.0 (and of FMI 3.0 style names) -> format, machine, suffix.
FOLDERS = {
    "linux32": ("ELF", "x86", ".so"),
    "linux64": ("ELF", "x86_64", ".so"),
    "win32": ("PE", "x86", ".dll"),
    "win64": ("PE", "x86_64", ".dll"),
    "darwin64": ("Mach-O", "x86_64", ".dylib"),
    "aarch64-linux": ("ELF", "arm64", ".so"),
    "aarch64-darwin": ("Mach-O", "arm64", ".dylib"),
    "aarch64-windows": ("PE", "arm64", ".dll"),
    "x86_64-linux": ("ELF", "x86_64", ".so"),
    "x86_64-windows": ("PE", "x86_64", ".dll"),
    "x86_64-darwin": ("Mach-O", "x86_64", ".dylib"),
}


class ImageError(ValueError):
    """The bytes are no shared library, or a damaged one."""


@dataclass(frozen=True)
class Image:
    """A shared library: `machine` is "x86", "x86_64", "arm64" or a number; `glibc` like (2, 17)."""

    format: str
    machine: str
    needed: tuple[str, ...]
    exports: tuple[str, ...]
    glibc: tuple[int, ...] | None = None
    search_path: str = ""

    @property
    def folders(self) -> list[str]:
        """Folders of FMUs in which such libraries lie, FMI 2.0's first; none for an unknown machine."""
        return [name for name, kind in FOLDERS.items() if kind[:2] == (self.format, self.machine)]


def read_image(content: bytes) -> Image:
    """Return the facts of a shared library.

    Raises
    ------
    ImageError : unknown format, or tables that do not lie in the file.
    """
    try:
        if content[:4] == b"\x7fELF":
            return _elf(content)
        if content[:2] == b"MZ":
            return _pe(content)
        if content[:4] in (b"\xcf\xfa\xed\xfe", b"\xce\xfa\xed\xfe"):
            return _mach_o(content)
        if content[:4] == b"\xca\xfe\xba\xbe":
            return _fat(content)
    except (struct.error, IndexError, UnicodeDecodeError, OverflowError) as error:
        raise ImageError(f"a table of the library does not lie in the file ({error})") from error
    raise ImageError("the file is no ELF, PE or Mach-O library")


def _text(content: bytes, start: int) -> str:
    end = content.find(b"\0", start)
    if not 0 <= start < len(content) or end < 0 or end - start > 4096:
        raise ImageError("a name of the library does not lie in the file")
    return content[start:end].decode("utf-8", "replace")


def _elf(c: bytes) -> Image:
    wide = c[4] == 2
    order = "<" if c[5] == 1 else ">"
    machine = struct.unpack_from(order + "H", c, 18)[0]
    segments = _elf_segments(c, order, wide)

    def offset_of(address: int) -> int:
        for kind, offset, start, length in segments:
            if kind == 1 and start <= address < start + length:
                return int(offset + address - start)
        raise ImageError(f"address {address:#x} lies in no segment")

    entries = _elf_dynamic(c, order, wide, segments)
    strings = offset_of(entries[5][0])
    needed = tuple(_text(c, strings + v) for v in entries.get(1, []))
    path = ":".join(_text(c, strings + v) for tag in (15, 29) for v in entries.get(tag, []))
    count = _elf_symbol_count(c, order, wide, offset_of, entries)
    exports = _elf_exports(c, order, wide, offset_of(entries[6][0]), strings, count)
    return Image(
        "ELF",
        {3: "x86", 62: "x86_64", 183: "arm64"}.get(machine, str(machine)),
        needed,
        exports,
        _glibc(c, order, offset_of, entries, strings),
        path,
    )


def _elf_segments(c: bytes, order: str, wide: bool) -> list[tuple[int, int, int, int]]:
    """Kind, offset, address and length in the file of each segment."""
    table = struct.unpack_from(order + ("Q" if wide else "I"), c, 32 if wide else 28)[0]
    size, count = struct.unpack_from(order + "HH", c, 54 if wide else 42)
    segments = []
    for k in range(count):
        at = table + k * size
        if wide:
            kind, _, offset, address, _, in_file = struct.unpack_from(order + "IIQQQQ", c, at)
        else:
            kind, offset, address, _, in_file = struct.unpack_from(order + "IIIII", c, at)
        segments.append((kind, offset, address, in_file))
    return segments


def _elf_dynamic(
    c: bytes, order: str, wide: bool, segments: list[tuple[int, int, int, int]]
) -> dict[int, list[int]]:
    """The entries of the dynamic section by tag."""
    dynamic = next((s for s in segments if s[0] == 2), None)
    if dynamic is None:
        raise ImageError("the ELF file has no dynamic section: it is no shared library")
    step, form = (16, order + "qQ") if wide else (8, order + "iI")
    entries: dict[int, list[int]] = {}
    for at in range(dynamic[1], dynamic[1] + dynamic[3], step):
        tag, value = struct.unpack_from(form, c, at)
        if tag == 0:
            break
        entries.setdefault(tag, []).append(value)
    if 5 not in entries or 6 not in entries:
        raise ImageError("the ELF file has no table of dynamic symbols")
    return entries


def _elf_exports(c: bytes, order: str, wide: bool, table: int, strings: int, count: int) -> tuple[str, ...]:
    """Defined global symbols; absolute ones are names of versions."""
    step = 24 if wide else 16
    exports = []
    for at in range(table + step, table + count * step, step):
        if wide:
            name, info, _, section = struct.unpack_from(order + "IBBH", c, at)
        else:
            name, _, _, info, _, section = struct.unpack_from(order + "IIIBBH", c, at)
        if section not in (0, 0xFFF1) and info >> 4 in (1, 2, 10):
            exports.append(_text(c, strings + name))
    return tuple(sorted(exports))


def _elf_symbol_count(
    c: bytes, order: str, wide: bool, offset_of: Callable[[int], int], entries: dict[int, list[int]]
) -> int:
    """Number of dynamic symbols, which only the hash tables tell."""
    if 4 in entries:
        return int(min(struct.unpack_from(order + "I", c, offset_of(entries[4][0]) + 4)[0], _MOST_SYMBOLS))
    if 0x6FFFFEF5 not in entries:
        raise ImageError("the ELF file has no hash table of symbols")
    at = offset_of(entries[0x6FFFFEF5][0])
    n_buckets, first, n_words = struct.unpack_from(order + "III", c, at)
    buckets = at + 16 + n_words * (8 if wide else 4)
    chains = buckets + 4 * n_buckets
    last = max(struct.unpack_from(order + f"{n_buckets}I", c, buckets), default=0)
    if last < first:
        return int(first)
    while last < _MOST_SYMBOLS:
        end = struct.unpack_from(order + "I", c, chains + 4 * (last - first))[0]
        last += 1
        if end & 1:
            break
    return int(last)


def _glibc(
    c: bytes, order: str, offset_of: Callable[[int], int], entries: dict[int, list[int]], strings: int
) -> tuple[int, ...] | None:
    """Newest GLIBC_x.y that the version-needed table asks for."""
    tag = 0x6FFFFFFE
    if tag not in entries:
        return None
    newest: tuple[int, ...] | None = None
    at = offset_of(entries[tag][0])
    for _ in range(min(entries.get(0x6FFFFFFF, [0])[0], 1000)):
        _, count, _, aux, after = struct.unpack_from(order + "HHIII", c, at)
        inner = at + aux
        for _ in range(count):
            _, _, _, name, next_inner = struct.unpack_from(order + "IHHII", c, inner)
            version = _text(c, strings + name)
            if version.startswith("GLIBC_") and version[6:7].isdigit():
                numbers = tuple(int(n) for n in version[6:].split(".") if n.isdigit())
                newest = max(newest or numbers, numbers)
            inner += next_inner
        if after == 0:
            break
        at += after
    return newest


def _pe(c: bytes) -> Image:
    head = struct.unpack_from("<I", c, 60)[0]
    if c[head : head + 4] != b"PE\0\0":
        raise ImageError("the file begins like a DOS program and is none of Windows")
    machine, n_sections = struct.unpack_from("<HH", c, head + 4)
    optional_size, flags = struct.unpack_from("<HH", c, head + 20)
    if not flags & 0x2000:
        raise ImageError("the PE file is no DLL")
    optional = head + 24
    wide = struct.unpack_from("<H", c, optional)[0] == 0x20B
    directories = optional + (112 if wide else 96)
    sections = []
    for k in range(n_sections):
        virtual, address, size, offset = struct.unpack_from("<IIII", c, optional + optional_size + 40 * k + 8)
        sections.append((address, max(virtual, size), offset))

    def offset_of(address: int) -> int:
        for start, length, offset in sections:
            if start <= address < start + length:
                return int(offset + address - start)
        raise ImageError(f"address {address:#x} lies in no section")

    export_at, import_at = (
        struct.unpack_from("<I", c, directories)[0],
        struct.unpack_from("<I", c, directories + 8)[0],
    )
    exports, needed = [], []
    if export_at:
        table = offset_of(export_at)
        count, _, names = struct.unpack_from("<III", c, table + 24)
        for k in range(min(count, _MOST_SYMBOLS)):
            exports.append(_text(c, offset_of(struct.unpack_from("<I", c, offset_of(names) + 4 * k)[0])))
    if import_at:
        for k in range(4096):
            fields = struct.unpack_from("<IIIII", c, offset_of(import_at) + 20 * k)
            if not any(fields):
                break
            needed.append(_text(c, offset_of(fields[3])))
    name = {0x14C: "x86", 0x8664: "x86_64", 0xAA64: "arm64"}.get(machine, hex(machine))
    return Image("PE", name, tuple(needed), tuple(sorted(exports)))


def _mach_o(c: bytes) -> Image:
    wide = c[0] == 0xCF
    machine, _, _, count, size = struct.unpack_from("<IIIII", c, 4)
    at = 32 if wide else 28
    end = at + size
    needed, exports = [], []
    for _ in range(count):
        if at + 8 > end:
            raise ImageError("the load commands do not fit their declared size")
        command, length = struct.unpack_from("<II", c, at)
        if length < 8:
            raise ImageError("a load command has an impossible size")
        if command in (0xC, 0x80000018, 0x8000001F):  # load, weak, re-exported library
            needed.append(_text(c, at + struct.unpack_from("<I", c, at + 8)[0]))
        if command == 2:
            symbols, n, strings, _ = struct.unpack_from("<IIII", c, at + 8)
            step = 16 if wide else 12
            for k in range(min(n, _MOST_SYMBOLS)):
                name, kind = struct.unpack_from("<IB", c, symbols + k * step)
                # external, not private external, not undefined, no debugging entry
                if kind & 1 and not kind & 0x10 and kind & 0xE and not kind & 0xE0:
                    exports.append(_text(c, strings + name).removeprefix("_"))
        at += length
    name = {7: "x86", 0x01000007: "x86_64", 0x0100000C: "arm64"}.get(machine, hex(machine))
    own = {"__dso_handle", "_mh_dylib_header"}  # of the linker
    return Image("Mach-O", name, tuple(needed), tuple(sorted(set(exports) - own)))


def _fat(c: bytes) -> Image:
    """Universal binary: the machines of all slices, needs and exports of the first."""
    count = struct.unpack_from(">I", c, 4)[0]
    if not 1 <= count <= 16:
        raise ImageError("the universal binary has an impossible number of slices")
    slices = []
    for k in range(count):
        offset, size = struct.unpack_from(">II", c, 8 + 20 * k + 8)
        slices.append(_mach_o(c[offset : offset + size]))
    machines = "+".join(s.machine for s in slices)
    return Image("Mach-O", machines, slices[0].needed, slices[0].exports)
