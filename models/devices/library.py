"""The devices that come with the package, and a user's own beside a case."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from ..errors import DeviceError, nearest
from .language.device import KINDS
from .language.read import device_of, read_device
from .language.structure import Model

MOST_OWN = 50  #: devices of a user's own in a case
NONE: Mapping[str, Model] = MappingProxyType({})  #: no device of a user's own
_FOLDER = Path(__file__).parent
FOLDERS = {kind: _FOLDER / f"{kind}s" for kind in KINDS}


@functools.cache
def _files() -> dict[str, Path]:
    """Return the package's device files by key, which is their name, sorted."""
    return dict(sorted((file.stem, file) for folder in FOLDERS.values() for file in folder.glob("*.toml")))


@functools.cache
def _packaged(key: str) -> Model:
    return Model(read_device(_files()[key]))


@functools.cache
def library() -> dict[str, Model]:
    """Return the package's devices by key, sorted."""
    return {key: _packaged(key) for key in _files()}


def keys_of(kind: str) -> tuple[str, ...]:
    """Return the keys of the package's devices of one kind."""
    return tuple(key for key, model in library().items() if model.device.kind == kind)


def devices_with(own: Mapping[str, Model]) -> dict[str, Model]:
    """Return the package's devices and, behind them, a user's own, by key, in the order of their numbers."""
    return library() | dict(own)


def device_model(key: str, kind: str | tuple[str, ...], own: Mapping[str, Model]) -> Model:
    """Return a device of the package or of a user, of one kind or of one of several.

    Raises
    ------
    DeviceError : there is none of that key and kind; with the nearest ones.
    """
    model = own.get(key) or (_packaged(key) if key in _files() else None)  # one file, not all
    kinds = (kind,) if isinstance(kind, str) else kind
    if model is None or model.device.kind not in kinds:
        known = [k for k, m in own.items() if m.device.kind in kinds]
        known += [k for one in kinds for k in keys_of(one)]
        raise DeviceError(f"{kinds[0]} {key!r} does not exist; {nearest(key, known)}")
    return model


def own_model(text: str, file: str) -> Model:
    """Return the device of a user's file, whose name is for messages.

    Raises
    ------
    DeviceError : the text is wrong, or has the name of a device of the package.
    """
    device = device_of(text, file)
    if device.key in _files():
        raise DeviceError(f"{file}: name = {device.name!r} is a device of the package; choose another name")
    model = Model(device)
    _ = model.order  # refuses what would take too many
    return model


def own_models(texts: Mapping[str, str]) -> Mapping[str, Model]:
    """Return a user's devices by key, sorted; `texts`: what their files hold, by name of file.

    Raises
    ------
    DeviceError : as `own_model`; too many, or two of one name.
    """
    return _own_models(tuple(texts.items()))


@functools.lru_cache(maxsize=32)
def _own_models(texts: tuple[tuple[str, str], ...]) -> Mapping[str, Model]:
    if len(texts) > MOST_OWN:
        raise DeviceError(f"{len(texts)} devices, allowed: {MOST_OWN} in a case")
    by_name: dict[str, Model] = {}
    for file, text in texts:
        model = own_model(text, file)
        other = by_name.setdefault(model.device.key, model)
        if other is not model:
            raise DeviceError(
                f"{file}: name = {model.device.name!r} is that of {other.device.file} too; rename one"
            )
    return MappingProxyType(dict(sorted(by_name.items())))
