"""The devices that come with the package, and a user's own beside a case."""

from __future__ import annotations

import functools
from pathlib import Path

from ..errors import nearest
from .errors import DeviceError
from .language.device import KINDS, Device
from .language.read import read_device
from .language.structure import Model

_HERE = Path(__file__).parent
FOLDERS = {kind: _HERE / f"{kind}s" for kind in KINDS}


@functools.cache
def library() -> dict[str, Model]:
    """Return the package's devices by key, sorted."""
    files = sorted(file for folder in FOLDERS.values() for file in folder.glob("*.toml"))
    models = [Model(read_device(file)) for file in files]
    return dict(sorted((model.device.key, model) for model in models))


def keys_of(kind: str) -> tuple[str, ...]:
    """Return the keys of the package's devices of one kind."""
    return tuple(key for key, model in library().items() if model.device.kind == kind)


def library_model(key: str, kind: str) -> Model:
    """Return a device of the package.

    Raises
    ------
    DeviceError : there is none of that key and kind; with the nearest ones.
    """
    model = library().get(key)
    if model is None or model.device.kind != kind:
        raise DeviceError(f"{kind} {key!r} does not exist; {nearest(key, keys_of(kind))}")
    return model


def own_model(path: Path) -> Model:
    """Return the device of a user's file.

    Raises
    ------
    DeviceError : the file is wrong, or has the name of a device of the package.
    """
    device: Device = read_device(path)
    if device.key in library():
        raise DeviceError(f"{path}: name = {device.name!r} is a device of the package; choose another name")
    return Model(device)
