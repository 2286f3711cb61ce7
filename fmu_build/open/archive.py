"""Open an archive that may be hostile: nothing is written before every entry was looked at.

Refused are entries that would leave the folder, links, encrypted entries and
bombs (too many entries, too many bytes, too high a ratio); the byte counts of
the archive's directory are not believed, unpacking counts for itself.
"""

from __future__ import annotations

import errno
import stat
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path, PurePosixPath

from ..finding import Report

MOST_ENTRIES = 20_000
MOST_BYTES = 2 << 30  #: unpacked, all entries together
MOST_RATIO = 500  #: unpacked to packed, of entries above 16 MB
_RATIO_FROM = 16 << 20
_PIECE = 1 << 20
_METHODS = {zipfile.ZIP_STORED: "store", zipfile.ZIP_DEFLATED: "deflate"}
_WINDOWS_NAMES = {"con", "prn", "aux", "nul", *(f"{d}{k}" for d in ("com", "lpt") for k in range(1, 10))}
_HOSTILE = "archive"
_GENERATED = b'generationTool="interarea '
#: errors of the system that an entry's name causes
_OF_NAMES = {
    *(errno.ENAMETOOLONG, errno.EINVAL, errno.EISDIR, errno.ENOTDIR, errno.EEXIST, errno.ENOENT),
    *(errno.EILSEQ, None),
}


def built_by_this_package(fmu: Path) -> bool:
    """Whether the description of an FMU names this program; True of what cannot be read: opening says why."""
    try:
        with zipfile.ZipFile(fmu) as archive, archive.open("modelDescription.xml") as text:
            return _GENERATED in text.read(4096)
    except (OSError, KeyError, zipfile.BadZipFile, RuntimeError, zlib.error):
        return True


def unpack_checked(
    path: Path, folder: Path, report: Report, *, chosen_by: Callable[[str], bool] | None = None
) -> bool:
    """Unpack `path` into `folder`; return False, with findings, if it must not or cannot be unpacked.

    Parameters
    ----------
    folder : an existing, empty folder.
    report : receives findings about entries; some of them do not stop the unpacking.
    chosen_by : of an entry's name, whether it is unpacked; default: all are.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            if not _begins_with_the_file(entries, path, report) or not _entries_are_harmless(entries, report):
                return False
            _check_entries(entries, report)
            chosen = [e for e in entries if chosen_by is None or chosen_by(e.filename)]
            return _unpack(archive, chosen, folder, report)
    except (
        zipfile.BadZipFile,
        EOFError,
        ValueError,
        OverflowError,
        RuntimeError,
    ) as error:
        report.add(_HOSTILE, path.name, f"not a readable zip archive: {error}", "make the archive again")
        return False


def read_checked(path: Path, name: str, most: int, report: Report) -> tuple[list[str], bytes] | None:
    """Return the names of an archive's entries and the content of entry `name`, which nothing unpacks.

    None, with findings, if the archive must not be unpacked, has no such entry, or one above `most` bytes.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            if not _begins_with_the_file(entries, path, report) or not _entries_are_harmless(entries, report):
                return None
            with archive.open(name) as entry:
                content = entry.read(most + 1)
    except KeyError:
        report.add(_HOSTILE, name, "is not in the archive", "pack it at the root")
        return None
    except Exception as error:  # zlib.error, struct.error, ... of damaged data
        _raise_of_the_machine(error)
        report.add(_HOSTILE, path.name, f"not a readable zip archive: {error}", "make the archive again")
        return None
    if len(content) > most:
        report.add(_HOSTILE, name, f"has more than {most} bytes", "write a smaller file")
        return None
    return [e.filename for e in entries], content


def _begins_with_the_file(entries: list[zipfile.ZipInfo], path: Path, report: Report) -> bool:
    """Whether nothing stands before the first entry.

    A reader looks for the directory from the end: of an archive of archives that is cut short it finds that
    of the last one inside.
    """
    first = min((e.header_offset for e in entries), default=0)
    if first > 0:
        report.add(
            _HOSTILE,
            path.name,
            f"{first} bytes before the first entry: truncated, or appended to another file",
            "make the archive again",
        )
    return first == 0


def _entries_are_harmless(entries: list[zipfile.ZipInfo], report: Report) -> bool:
    """Whether unpacking can be tried at all."""
    before = len(report.findings)
    if len(entries) > MOST_ENTRIES:
        report.add(
            _HOSTILE,
            "entries",
            f"{len(entries)} entries, at most {MOST_ENTRIES} are taken",
            "pack fewer files",
        )
        return False
    total = sum(e.file_size for e in entries)
    if total > MOST_BYTES:
        report.add(
            _HOSTILE, "entries", f"unpacks to {total} bytes, at most {MOST_BYTES} are taken", "pack less data"
        )
    for entry in entries:
        name = _printable(entry.orig_filename)
        parts = entry.orig_filename.replace("\\", "/").split("/")
        kind = stat.S_IFMT(entry.external_attr >> 16)
        if ".." in parts or parts[0] == "" or (len(parts[0]) == 2 and parts[0][1] == ":"):
            report.add(_HOSTILE, name, "the entry leaves the folder it is unpacked to", "use relative paths")
        if "\0" in entry.orig_filename:
            report.add(_HOSTILE, name, "the entry's name has a zero byte", "rename the entry")
        if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            what = "a link" if kind == stat.S_IFLNK else "a device or pipe"
            report.add(_HOSTILE, name, f"the entry is {what}, not a file", "pack the file itself")
        if entry.flag_bits & 1:
            report.add(_HOSTILE, name, "the entry is encrypted", "pack it without a password")
        if entry.file_size > _RATIO_FROM and entry.file_size > MOST_RATIO * max(entry.compress_size, 1):
            report.add(
                _HOSTILE,
                name,
                f"{entry.compress_size} bytes unpack to {entry.file_size}: more than {MOST_RATIO} times",
                "pack real data; this looks like an archive bomb",
            )
    return len(report.findings) == before


def _check_entries(entries: list[zipfile.ZipInfo], report: Report) -> None:
    """Rules of the standard and of file systems that do not stop the unpacking."""
    seen: dict[str, str] = {}
    for entry in entries:
        name = _printable(entry.orig_filename)
        if "\\" in entry.orig_filename:
            report.add("FMI2 2.1 archive paths", name, "the path has a backslash", "use / between folders")
        if entry.compress_type not in _METHODS:
            report.add(
                "FMI2 2.1 archive compression",
                name,
                f"compression method {entry.compress_type}; only deflate and store are allowed",
                "pack with deflate",
            )
        key = entry.filename.rstrip("/").lower()
        if key in seen:
            report.add(
                _HOSTILE,
                name,
                f"the name is also that of {seen[key]!r} (file systems may ignore case)",
                "give each entry a name of its own",
            )
        seen[key] = name
        if any(part.split(".")[0].lower() in _WINDOWS_NAMES for part in entry.filename.split("/")):
            report.add(_HOSTILE, name, "Windows reserves this file name", "rename the entry")


def _unpack(archive: zipfile.ZipFile, entries: list[zipfile.ZipInfo], folder: Path, report: Report) -> bool:
    root = folder.resolve()
    budget = MOST_BYTES
    for entry in entries:
        target = root / PurePosixPath(entry.filename.replace("\\", "/"))
        if not target.resolve().is_relative_to(root):
            report.add(_HOSTILE, entry.filename, "the entry leaves the folder", "use relative paths")
            return False
        try:
            if entry.is_dir():
                target.mkdir(parents=True, exist_ok=True)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            left = min(budget, entry.file_size)
            with archive.open(entry) as source, target.open("wb") as file:
                while piece := source.read(_PIECE):
                    left -= len(piece)
                    if left < 0:
                        report.add(
                            _HOSTILE, entry.filename, "has more bytes than the archive says", "pack it again"
                        )
                        return False
                    file.write(piece)
            budget -= entry.file_size
        except (zipfile.BadZipFile, EOFError, RuntimeError, OSError) as error:
            _raise_of_the_machine(error)
            report.add(_HOSTILE, entry.filename, f"cannot be unpacked: {error}", "pack it again")
            return False
        except Exception as error:  # zlib.error, lzma.LZMAError, ... of damaged data
            _raise_of_the_machine(error)
            report.add(_HOSTILE, entry.filename, f"is damaged: {error}", "pack it again")
            return False
    return True


_ZLIB_NO_MEMORY = "Error -4 "  #: Z_MEM_ERROR, which the module zlib tells by its number only


def _raise_of_the_machine(error: Exception) -> None:
    """Raise what no archive causes: nothing is known of it then."""
    if isinstance(error, zlib.error) and str(error).startswith(_ZLIB_NO_MEMORY):
        raise MemoryError from error
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno not in _OF_NAMES):
        raise error


def _printable(name: str) -> str:
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in name)[:200]
