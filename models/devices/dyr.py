"""Records of PSS/E's DYR files as devices, and devices as records: each `[dyr]` line is both."""

from __future__ import annotations

import functools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from ..errors import DeviceError, nearest
from .language.device import DyrModel
from .language.expression import evaluate
from .language.structure import Model
from .library import library

WHOLE = "DERA1"  #: a record that is a converter by itself
CURRENTS = "; --converters current models converters as constant currents"
#: of another converter: one record of each
_ORDERS = ("REECB1", "REECA1", "REECC1")
_PARTS = ((("REGCA1", "REGCB1", "REGCC1"), "is the converter itself"), (_ORDERS, "sets its currents"))
#: of a type 3 wind turbine: none of the first three, or all
_TURBINE = ("WTARA1", "WTPTA1", "WTTQA1", "WTDTA1")


class DyrRecord(Protocol):
    """One record: its model's name in capitals, its bus, its fields after the ID, and where it stands."""

    @property
    def model(self) -> str: ...
    @property
    def bus(self) -> int: ...
    @property
    def fields(self) -> Sequence[float | str]: ...
    @property
    def where(self) -> str: ...


@dataclass(frozen=True)
class DyrDevice:
    """A device, the parameters that a record gives it, and fields of the record that are not 0 and unused."""

    model: Model
    parameters: Mapping[str, float]
    unused: tuple[str, ...] = ()


@functools.cache
def dyr_models() -> dict[str, tuple[Model, DyrModel]]:
    """Return the record names that devices of the package read."""
    return {row.model: (model, row) for model in library().values() for row in model.device.dyr}


def own_records(own: Iterable[Model]) -> dict[str, tuple[Model, DyrModel]]:
    """Return the record names that a user's devices read.

    One without a `[dyr]` table reads the record of its own name, its parameters in their order.
    """
    return {row.model: (model, row) for model in own for row in _rows(model)}


def _rows(model: Model) -> tuple[DyrModel, ...]:
    """The records of a device; of the package's those that its file names, which may be none."""
    if model.device.dyr or model.device.key in library():
        return model.device.dyr
    return (DyrModel(model.device.name.upper(), tuple(p.name for p in model.device.parameters), ()),)


def fault_of_converter(records: Collection[str]) -> str:
    """Return why the records of a unit make up no converter, with the remedy; empty when they do."""
    if WHOLE in records:
        beside = sorted({*records} - {WHOLE})
        return f"has {WHOLE} and {beside[0]}, allowed: {WHOLE} alone" if beside else ""
    for models, does in _PARTS:
        seen = [model for model in models if model in records]
        if len(seen) != 1:
            has = f"no {' or '.join(models)}, which {does}" if not seen else f"{' and '.join(seen)}"
            return f"has {has}, allowed: one{CURRENTS}"
    present = [model for model in _TURBINE[:3] if model in records]
    missing = [model for model in _TURBINE if model not in records]
    if present and missing:
        has = f"{' and '.join(present)} without {' and '.join(missing)}"
        goes_on = f"--leave-out {','.join(present)} uses a turbine of constant power"
        return f"has {has}, allowed: all of {', '.join(_TURBINE)}; {goes_on}"
    return ""


def device_for_dyr(record: DyrRecord, own: Iterable[Model] = ()) -> DyrDevice:
    """Return the device of a record; `own`: a user's devices, which come first.

    Raises
    ------
    DeviceError : unknown model (with the nearest names), too few or too many fields, a field that is no
        number or out of the parameter's range, a function of the model that is not modelled.
    """
    known = dyr_models() | own_records(own)
    if record.model not in known:
        raise DeviceError(
            f"{record.where}: model {record.model!r} at bus {record.bus}; {nearest(record.model, known)}"
        )
    model, row = known[record.model]
    if len(record.fields) != len(row.fields):
        less = len(record.fields) < len(row.fields)
        hint = " (cut off? complete the record)" if less else " (is the / of the record missing?)"
        raise DeviceError(
            f"{record.where}: {record.model} has {len(record.fields)} fields, allowed: {len(row.fields)}, "
            f"{' '.join(row.fields)}{hint}"
        )
    values = _values(record, row)
    values |= {name: float(evaluate(node, values)) for name, node in row.assigned}
    parameters = {p.name: values[p.name] for p in model.device.parameters if p.name in values}
    what = f"{record.where}: {record.model}"
    for p in model.device.parameters:
        value = parameters.get(p.name, p.default)
        if value is None:
            raise DeviceError(f"{what} has no {p.name}, which {model.device.name} needs")
        rule = model.device.computed.get(p.name)
        if not (rule is not None and value == rule.when) and not p.holds(value):
            allowed = f"above {p.low:g}" if p.open else f"{p.low:g} to {p.high:g}"
            raise DeviceError(f"{what} {p.name} = {value:g}, allowed: {allowed}")
    return DyrDevice(model, parameters, _unused(values))


def _unused(values: Mapping[str, float]) -> tuple[str, ...]:
    """Names of fields -NAME that are not 0."""
    return tuple(name[1:] for name, value in values.items() if name.startswith("-") and value != 0.0)


def _values(record: DyrRecord, row: DyrModel) -> dict[str, float]:
    """The named fields of a record, unused ones (-NAME) too; those not modelled must be 0, or its own bus."""
    values: dict[str, float] = {}
    for k, (name, text) in enumerate(zip(row.fields, record.fields, strict=True), start=1):
        if name == "-":
            continue
        value, what = _number(text), f"{record.where}: {record.model} field {k}"
        if value is None:
            field = name.removeprefix("0:").removeprefix("-")
            raise DeviceError(f"{what} ({field}) = {str(text)[:40]!r}, allowed: a number")
        if not name.startswith("0"):
            values[name] = value
        elif value != 0.0 and not (name.startswith("0:BUS") and value == record.bus):
            named = f" ({name[2:]})" if name[1:] else ""
            raise DeviceError(
                f"{what}{named} = {value:g}, allowed: 0 (its function is not modelled; "
                f"--leave-out {record.model} omits it, --replace {record.model}=MODEL reads it as "
                "another)"
            )
    return values


def dyr_fields(model: Model, values: Mapping[str, float]) -> tuple[str, tuple[float, ...]]:
    """Return the record's name and fields that give a device with parameters `values`.

    Raises
    ------
    DeviceError : no record of the device's can hold these values.
    """
    for row in _rows(model):
        fits = (evaluate(node, values) == values[name] for name, node in row.assigned)
        if all(fits):
            return row.model, tuple(0.0 if n[0] in "-0" else float(values[n]) for n in row.fields)
    known = ", ".join(row.model for row in _rows(model)) or "none"
    raise DeviceError(f"{model.device.name}: no record holds these values; its records: {known}")


def _number(text: float | str) -> float | None:
    if isinstance(text, str):
        try:
            text = float(text.strip().replace("D", "E").replace("d", "e").replace("_", "?"))  # no 1_0 for 10
        except ValueError:
            return None
    return float(text) if abs(text) < 1e30 else None
