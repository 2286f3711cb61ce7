"""A controller by its name: shipped, from a JSON file, or read back from its FMU alone."""

from __future__ import annotations

import json
import re
import zipfile
import zlib
from pathlib import Path
from typing import Any

import control
import numpy as np

from interarea.design.controllers.bundled import shipped_controller, shipped_names
from interarea.design.controllers.controller import RECORD, Controller, ControllerError, guard_of
from interarea.fmu_build.open.fmu_file import describe

from ..errors import nearest


def any_controller(name: str, omega_b: float) -> Controller:
    """Return a shipped controller, one from a JSON file, or one read from its FMU alone.

    Of an FMU the numbers are its parameters, design and certificate the record in its documentation.
    """
    if name in shipped_names():
        return shipped_controller(name)
    path = Path(name)
    if path.is_dir():
        raise ControllerError(f"controller {name}: is a folder, wanted: a JSON file or an FMU")
    if path.suffix == ".fmu":
        return _from_fmu(path, omega_b)
    if not path.exists() and not path.suffix:
        known = nearest(name, (*shipped_names(), "active", "wdc", "cc", "ftc"))
        raise ControllerError(f"controller {name!r} is neither shipped nor a file; {known}")
    return Controller.load(path)


def _from_fmu(path: Path, omega_b: float) -> Controller:
    """Read A, B, C, D (pu) and the limit from an FMU's parameters; speeds become rad/s."""
    if not path.is_file():
        raise ControllerError(f"controller FMU {path}: not found")
    description = describe(path)
    variables = description.variables
    starts = {v.name: v.number("start") or 0.0 for v in variables if v.causality == "parameter"}
    inputs = [v.name for v in variables if v.causality == "input"]
    outputs = [v.name for v in variables if v.causality == "output"]
    orders = [int(m[1]) for n in starts if (m := re.fullmatch(r"A\[(\d+),\1\]", n))]
    if not orders:
        raise ControllerError(f"controller FMU {path}: has no parameter A[1,1]: no linear controller")
    n = max(orders)

    def matrix(letter: str, rows: int, columns: int) -> Any:
        return np.array(
            [[starts[f"{letter}[{i + 1},{j + 1}]"] for j in range(columns)] for i in range(rows)]
        ).reshape(rows, columns)

    scale = np.array([omega_b if name.endswith("_dw") else 1.0 for name in inputs])
    system = control.ss(
        matrix("A", n, n),
        matrix("B", n, len(inputs)) / scale,
        matrix("C", len(outputs), n),
        matrix("D", len(outputs), len(inputs)) / scale,
        inputs=inputs,
        outputs=outputs,
    )
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
    found = re.search(f'<script type="application/json" id="{RECORD}">(.*?)</script>', page, re.DOTALL)
    if found is None:
        return {}
    try:
        return dict(json.loads(found[1]))
    except (TypeError, ValueError) as error:
        raise ControllerError(f"controller FMU {path}: its record is no JSON object ({error})") from error
