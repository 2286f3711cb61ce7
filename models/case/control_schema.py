"""Rows of a case that describe controls: the keys of each are those of its device file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator, ConfigDict, Field, ValidationInfo
from pydantic_core import PydanticCustomError

from ..devices.language.device import OF_CONVERTER, OF_SVC
from ..devices.language.structure import Model
from ..devices.library import NONE, device_model
from ..devices.rows import numbers_of, row_of
from ..errors import DeviceError
from ..table import Table

Number = Annotated[float, Field(strict=True)]
Positive = Annotated[float, Field(strict=True, gt=0.0)]
NonNegative = Annotated[float, Field(strict=True, ge=0.0)]


class Row(Table):
    """One row of a case table: frozen, unknown keys refused, numbers finite."""

    model_config = ConfigDict(populate_by_name=True)

    source: str = ""  #: "KEY, place" if it differs from the source of the table


class Control(Row):
    """A device of a machine: `kind` names its file, the parameters are attributes; None: an absent limit."""

    model_config = ConfigDict(extra="allow")

    kind: str  #: name of a file of `models/devices`, or of one of `devices` of the case

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters by name, as given."""
        return dict(self.__pydantic_extra__ or {})


#: kinds without a device: the field voltage, the mechanical power stay as they are
BARE = {"exciter": "constant", "governor": "none"}


def control_model(word: str, control: Control, own: Mapping[str, Model]) -> Model | None:
    """Return the device of a control, None where there is none.

    word : exciter, stabilizer, ... own : the case's own devices (`CaseTables.own_devices`).
    """
    return None if BARE.get(word) == control.kind else device_model(control.kind, word, own)


def control_numbers(
    model: Model, control: Control, mbase: float, frequency_hz: float
) -> dict[str, float | str]:
    """Return the numbers of a control with a device: absent limits as +-1e30, what is computed as a word."""
    return numbers_of(model.device, control.parameters, mbase, frequency_hz)


def _control(word: str, kind: str | None) -> Any:
    def read(value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, Control):
            return value
        if not isinstance(value, dict):
            raise ValueError(f"{value!r}, allowed: a table with kind and the values of that kind")
        provided = {key: v for key, v in value.items() if key not in ("kind", "source")}
        chosen = value.get("kind", kind)
        if chosen is None:
            raise PydanticCustomError("control", ".kind is missing")
        rest = {"kind": chosen} | ({"source": value["source"]} if "source" in value else {})
        if chosen == BARE.get(word):
            if provided:
                text = f".{next(iter(provided))}: a {chosen} {word} has no values"
                raise PydanticCustomError("control", "{text}", {"text": text})
            return rest
        try:
            if not isinstance(chosen, str):
                raise DeviceError(f"{word} {chosen!r} does not exist")
            kinds = {"svc": OF_SVC, "converter": OF_CONVERTER}.get(word, word)
            return rest | row_of(device_model(chosen, kinds, info.context or NONE).device, provided)
        except DeviceError as error:
            text = str(error)
            text = text if text[0] in ".:" else f".kind: {text}"
            raise PydanticCustomError("control", "{text}", {"text": text}) from None

    return BeforeValidator(read)


Exciter = Annotated[Control, _control("exciter", None)]
Governor = Annotated[Control, _control("governor", None)]
Stabilizer = Annotated[Control, _control("stabilizer", "speed")]
#: of a device at a bus
BusControl = Annotated[Control, _control("svc", None)]
ConverterControl = Annotated[Control, _control("converter", None)]
Compensator = Annotated[Control, _control("compensator", None)]
Limiter = Annotated[Control, _control("limiter", None)]
