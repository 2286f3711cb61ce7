"""Read a TOML file of the user's; what is wrong with it in one line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any


def read_toml(path: Path, error: type[Exception]) -> dict[str, Any]:
    """Return the tables of a file.

    Raises
    ------
    error : not TOML, not UTF-8, or nested too deeply; names the file. OSError : it cannot be read.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as fault:
        raise error(f"{path.name}: is no TOML: {fault}") from None
    except RecursionError:
        raise error(f"{path.name}: is no TOML: nested too deeply") from None
