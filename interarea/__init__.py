"""Wide-area damping of inter-area oscillations: the front door."""

from __future__ import annotations

from pathlib import Path

# In a checkout the floors lie beside this folder, in an installed wheel below it: without this line a
# Python started in the checkout's root finds this folder and none of the floors.
_ROOT = Path(__file__).resolve().parent.parent
if (_ROOT / "pyproject.toml").is_file() and (_ROOT / "models" / "py.typed").is_file():
    __path__.append(str(_ROOT))
