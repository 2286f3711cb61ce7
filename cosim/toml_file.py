"""Read a TOML file of the user's; what is wrong with it in one line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from interarea.models.documents import DocumentError, other_kind, parse_toml, read_document


def read_toml(path: Path, kind: str, error: type[Exception]) -> dict[str, Any]:
    """Return the tables of a file.

    kind : "scenario", "sweep", "study" or "design", for who gives a file of another kind.

    Raises
    ------
    error : no regular file, an archive, not TOML, not UTF-8, nested too deeply, or plainly of another kind;
        names the file. OSError : it cannot be read.
    """
    try:
        content = read_document(path, f"a {kind} file")
    except DocumentError as fault:
        raise error(str(fault)) from None
    if content.startswith(b"PK\x03\x04"):
        raise error(
            f"{path}: is not TOML but an archive, such as an FMU or SSP (`interarea check`), "
            f"wanted: a {kind} file"
        )
    try:
        table = parse_toml(content)
    except DocumentError as fault:
        raise error(f"{path}: {fault}") from None
    other = other_kind(table, kind)
    if other is not None:
        raise error(f"{path}: {other}")
    return table


def case_beside(keys: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the keys of a design, its `case` as a path where it names a file of the folder."""
    case = keys.get("case")
    if isinstance(case, str) and case.endswith(".toml") and (folder / case).is_file():
        return {**keys, "case": str(folder / case)}
    return dict(keys)
