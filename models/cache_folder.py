"""Where what is made once is kept: binaries, generated headers, designs."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def default_cache() -> Path:
    """Return ``$INTERAREA_CACHE``, else the user's cache folder."""
    if os.environ.get("INTERAREA_CACHE"):
        return Path(os.environ["INTERAREA_CACHE"])
    if sys.platform == "win32" and os.environ.get("LOCALAPPDATA"):
        return Path(os.environ["LOCALAPPDATA"]) / "interarea"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "interarea"
