"""A controller or a bank of them read back from its FMU alone."""

from __future__ import annotations

import json
import re
import zipfile
import zlib
from pathlib import Path
from typing import Any

from interarea.design.controllers.bank import ControllerBank, bank_of_record
from interarea.design.controllers.controller import (
    RECORD,
    Controller,
    ControllerError,
    guard_of,
    matrices_of_parameters,
)
from interarea.fmu_build.open.description import ModelDescription
from interarea.fmu_build.open.fmu_file import describe
from interarea.models.blocks.binary_table import unpack_record
from interarea.models.documents import require_regular

_ARRAYS = "resources/model.bin"  #: of a supervisor: the matrices of its members


def controller_from_fmu(path: Path, omega_b: float) -> Controller | ControllerBank:
    """Return the linear controller, or the bank behind a supervisor, that an FMU is; speeds become rad/s.

    The numbers are its parameters or its resources, design and certificate the record in its documentation.

    Raises
    ------
    ControllerError : no such file, or the FMU of something else.
    """
    require_regular(path, "the FMU of a controller", ControllerError)
    description = describe(path)
    weights = any(v.name.endswith(".weight") for v in description.variables)
    return (_bank if weights else _linear)(path, description, omega_b)


def _bank(path: Path, description: ModelDescription, omega_b: float) -> ControllerBank:
    """Read a bank from the supervisor FMU that `ControllerBank.block` made."""
    variables = {v.name: v for v in description.variables}
    inputs = [n for n, v in variables.items() if v.causality == "input" and f"{n}_valid" in variables]
    outputs = [n for n, v in variables.items() if v.causality == "output" and v.type == "Real"]
    members = [n.removesuffix(".weight") for n in variables if n.endswith(".weight") and "der(" not in n]
    with zipfile.ZipFile(path) as archive:
        try:
            arrays = unpack_record(archive.read(_ARRAYS))
        except (KeyError, ValueError, zipfile.BadZipFile, zlib.error) as error:
            raise ControllerError(f"controller FMU {path}: {_ARRAYS}: {error}") from error
    numbers = {n: v.number("start") or 0.0 for n, v in variables.items() if v.causality == "parameter"}
    return bank_of_record(description.name, members, inputs, outputs, arrays, numbers, omega_b)


def _linear(path: Path, description: ModelDescription, omega_b: float) -> Controller:
    """Read A, B, C, D (pu) and the limit from an FMU's parameters."""
    variables = description.variables
    starts = {v.name: v.number("start") or 0.0 for v in variables if v.causality == "parameter"}
    inputs = [v.name for v in variables if v.causality == "input"]
    outputs = [v.name for v in variables if v.causality == "output"]
    try:
        system = matrices_of_parameters(starts, inputs, outputs, omega_b)
    except ControllerError as error:
        raise ControllerError(f"controller FMU {path}: {error}") from None
    record = record_of_fmu(path)
    return Controller(
        description.name,
        system,
        starts["limit"],
        record.get("design") or {"method": "read from the FMU"},
        record.get("certificate"),
        None if record.get("guard") is None else guard_of(record["guard"]),
    )


def record_of_fmu(path: Path) -> dict[str, Any]:
    """Return design and certificate as the documentation of a controller FMU holds them; {} without a record.

    Raises ControllerError where the record is there and cannot be read.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if "documentation/index.html" not in archive.namelist():
                return {}
            page = archive.read("documentation/index.html").decode("utf-8")
    except (zipfile.BadZipFile, zlib.error, UnicodeDecodeError) as error:
        raise ControllerError(f"controller FMU {path}: its documentation is damaged ({error})") from error
    match = re.search(f'<script type="application/json" id="{RECORD}">(.*?)</script>', page, re.DOTALL)
    if match is None:
        return {}
    try:
        return dict(json.loads(match[1]))
    except (TypeError, ValueError) as error:
        raise ControllerError(f"controller FMU {path}: its record is not a JSON object ({error})") from error
