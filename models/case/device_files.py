"""Devices of a user's own in a case: files beside it by name, in memory what they hold."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..devices.errors import DeviceError
from ..devices.language.read import device_text
from ..devices.language.structure import Model
from ..devices.library import own_models
from ..errors import CaseError

_ALLOWED = 'allowed: a list of device files such as ["my_avr.toml"], or a table of what they hold by name'


def with_device_texts(table: Mapping[str, Any], folder: Path, where: str) -> dict[str, Any]:
    """Return `table` with what the files of its list `devices` hold, by name, in place of that list.

    folder : in which relative names are looked for. where : names the table in errors.

    Raises
    ------
    CaseError : no list of names, or a file that cannot be read.
    """
    names = table.get("devices")
    if not isinstance(names, list | tuple):
        return dict(table)
    texts: dict[str, str] = {}
    for name in names:
        if not isinstance(name, str | Path) or not str(name).endswith(".toml"):
            raise CaseError(f"{where}: devices: {str(name)[:80]!r}, allowed: the name of a .toml file")
        try:
            texts[str(name)] = device_text(folder / name)
        except DeviceError as error:
            raise CaseError(f"{where}: devices: {error}") from None
    return {**table, "devices": texts}


def devices_of(texts: Any, where: str) -> Mapping[str, Model]:
    """Return the devices of a case by key; `texts`: its entry `devices`, `where` names the case in errors.

    Raises
    ------
    CaseError : not such an entry, or a device file that is wrong.
    """
    if not isinstance(texts, Mapping) or not all(isinstance(v, str) for kv in texts.items() for v in kv):
        raise CaseError(f"{where}: devices = {str(texts)[:60]!r}, {_ALLOWED}")
    try:
        return own_models(texts)
    except DeviceError as error:
        raise CaseError(f"{where}: devices: {error}") from None
