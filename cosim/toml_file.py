"""Read a TOML file of the user's; what is wrong with it in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from interarea.models.documents import DocumentError, other_kind, parse_toml, read_document


def read_toml(path: Path, wanted: str, error: type[Exception]) -> dict[str, Any]:
    """Return the tables of a file.

    wanted : "scenario", "sweep", "study" or "design", for who gives a file of another kind.

    Raises
    ------
    error : no regular file, an archive, not TOML, not UTF-8, nested too deeply, or plainly of another kind;
        names the file. OSError : it cannot be read.
    """
    try:
        content = read_document(path, f"a {wanted} file")
    except DocumentError as fault:
        raise error(str(fault)) from None
    if content.startswith(b"PK\x03\x04"):
        raise error(
            f"{path}: is no TOML but an archive, as an FMU or SSP is (`interarea check`), "
            f"wanted: a {wanted} file"
        )
    try:
        table = parse_toml(content)
    except DocumentError as fault:
        raise error(f"{path}: {fault}") from None
    other = other_kind(table, wanted)
    if other is not None:
        raise error(f"{path}: {other}")
    return table
