"""FMUs with one thing changed, for the tests of the check: `mutated(fmu, out, edit)`."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

Entries = dict[str, bytes]


def mutated(fmu: Path, out: Path, edit: Callable[[Entries], None]) -> Path:
    """Write `fmu` to `out` with its entries (name -> bytes) changed by `edit`."""
    with zipfile.ZipFile(fmu) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    edit(entries)
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            info = zipfile.ZipInfo("x")
            info.filename = name  # ZipInfo would turn a backslash into a slash on some platforms
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, content)
    return out


def in_description(old: str, new: str, count: int = 1) -> Callable[[Entries], None]:
    """Return an edit that replaces the first `count` places of `old` in modelDescription.xml."""

    def edit(entries: Entries) -> None:
        text = entries["modelDescription.xml"].decode()
        assert old in text, f"{old!r} is not in the description"
        entries["modelDescription.xml"] = text.replace(old, new, count).encode()

    return edit
