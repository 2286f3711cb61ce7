"""Controllers that come with the package: JSON files in `controllers/`, each with how it was made."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .bank import ControllerBank
    from .controller import Controller

FOLDER = Path(__file__).resolve().parent
BANK = "bank_"  #: before the name of a bank in that of its file


def shipped_names() -> list[str]:
    """Return the names of the shipped controllers, banks not among them."""
    return sorted(path.stem for path in FOLDER.glob("*.json") if not path.stem.startswith(BANK))


def shipped_banks() -> list[str]:
    """Return the names of the shipped banks of controllers."""
    return sorted(path.stem.removeprefix(BANK) for path in FOLDER.glob(f"{BANK}*.json"))


def shipped_bank(name: str) -> ControllerBank:
    """Return a shipped bank. Raises ControllerError for a name that is not shipped."""
    from .bank import ControllerBank
    from .controller import ControllerError

    if name not in shipped_banks():
        raise ControllerError(f"bank {name!r} is not bundled, allowed: {', '.join(shipped_banks())}")
    return ControllerBank.load(FOLDER / f"{BANK}{name}.json")


def shipped_controller(name: str) -> Controller:
    """Return a shipped controller.

    Raises ControllerError for a name that is not shipped.
    """
    from .controller import Controller, ControllerError  # control takes a second: names alone need it not

    if name not in shipped_names():
        raise ControllerError(f"controller {name!r} is not bundled, allowed: {', '.join(shipped_names())}")
    return Controller.load(FOLDER / f"{name}.json")
