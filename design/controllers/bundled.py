"""Controllers that come with the package: JSON files in `controllers/`, each with how it was made."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .controller import Controller

FOLDER = Path(__file__).resolve().parent


def shipped_names() -> list[str]:
    """Return the names of the shipped controllers."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def shipped_controller(name: str) -> Controller:
    """Return a shipped controller.

    Raises ControllerError for a name that is not shipped.
    """
    from .controller import Controller, ControllerError  # control takes a second: names alone need it not

    if name not in shipped_names():
        raise ControllerError(f"controller {name!r} is not shipped, allowed: {', '.join(shipped_names())}")
    return Controller.load(FOLDER / f"{name}.json")
