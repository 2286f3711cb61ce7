"""An FMI 2.0 co-simulation FMU as a file: unpacked once, described for the master."""

from __future__ import annotations

import shutil
import xml.etree.ElementTree as ET
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import fmpy
import fmpy.model_description as md

from interarea.models.files import new_folder

from ..errors import GraphError
from ..participant import Description, Port, Type, UnitOf

_TYPE_OF: dict[str, Type] = {
    "Real": "Real",
    "Integer": "Integer",
    "Enumeration": "Integer",
    "Boolean": "Boolean",
}
BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True)
class FmuVariable:
    """What a start value or a recorded variable needs to know of an FMU variable."""

    name: str
    reference: int
    type: str  #: Real, Integer, Boolean, Enumeration, String
    causality: str
    unit: str | None


class FmuFile:
    """An FMU, checked, unpacked into a temporary folder that `close` (or the end of the process) removes.

    Raises
    ------
    GraphError : no such file, not an FMU, not FMI 2.0, no co-simulation, no binary for this platform.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.model, self._root = read_description(self.path)
        with zipfile.ZipFile(self.path) as archive:
            folders = {
                n.split("/")[1] for n in archive.namelist() if n.startswith("binaries/") and n.count("/") > 1
            }
        if fmpy.platform not in folders:
            raise GraphError(
                f"{self.path.name}: has no binary for this platform ({fmpy.platform}); "
                f"it has {', '.join(sorted(folders)) or 'none'}; rebuild it, or run on one of those"
            )
        self._folder: Path | None = None

    @property
    def folder(self) -> Path:
        """The unpacked FMU."""
        if self._folder is None:
            self._folder = new_folder()
            with zipfile.ZipFile(self.path) as archive:
                archive.extractall(self._folder)
        return self._folder

    def start_of(self, name: str) -> float:
        """Return the start value that modelDescription.xml gives a variable, 0 where it gives none."""
        return next(_number(v.start, float, 0.0) for v in self.model.modelVariables if v.name == name)

    def close(self) -> None:
        """Remove the unpacked files."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    @cached_property
    def variables(self) -> dict[str, FmuVariable]:
        """Every variable by name."""
        return {
            v.name: FmuVariable(v.name, v.valueReference, v.type, v.causality, _unit_name(v))
            for v in self.model.modelVariables
        }

    @cached_property
    def enumerations(self) -> dict[str, dict[str, int]]:
        """Of each Enumeration variable: item name -> value."""
        return {
            v.name: {item.name: int(item.value) for item in v.declaredType.items}
            for v in self.model.modelVariables
            if v.type == "Enumeration" and v.declaredType is not None
        }

    @cached_property
    def units(self) -> dict[str, UnitOf]:
        """Definitions of units by name."""
        return {u.name: _unit_of(u) for u in self.model.unitDefinitions}

    @cached_property
    def log_categories(self) -> tuple[str, ...]:
        """Names of the log categories the FMU declares."""
        return tuple(c.get("name", "") for c in self._root.findall("LogCategories/Category"))

    @cached_property
    def description(self) -> Description:
        """Ports, direct dependencies (ModelStructure) and abilities."""
        units = self.units
        inputs = tuple(_port(v, units) for v in self._of("input"))
        outputs = tuple(_port(v, units) for v in self._of("output"))
        cs = self.model.coSimulation
        return Description(
            inputs=inputs,
            outputs=outputs,
            feedthrough=self._dependencies("Outputs"),
            initial_feedthrough=self._dependencies("InitialUnknowns"),
            input_order=3 if cs.canInterpolateInputs else 0,
            output_order=int(cs.maxOutputDerivativeOrder or 0),
            saves_state=bool(cs.canGetAndSetFMUstate),
            variable_step=bool(cs.canHandleVariableCommunicationStepSize),
            title=self.model.modelName or self.path.stem,
        )

    def _of(self, causality: str) -> list[Any]:
        return [v for v in self.model.modelVariables if v.causality == causality and v.type in _TYPE_OF]

    def _dependencies(self, section: str) -> dict[str, frozenset[str]]:
        """Output -> inputs it depends on; missing `dependencies` means all, empty ones none (FMI2, 2.2.8)."""
        names = [v.name for v in self.model.modelVariables]
        inputs = frozenset(v.name for v in self._of("input"))
        found: dict[str, frozenset[str]] = {v.name: inputs for v in self._of("output")}
        for unknown in self._root.findall(f"ModelStructure/{section}/Unknown"):
            name = names[int(unknown.get("index", "0")) - 1]
            listed = unknown.get("dependencies")
            if name in found and listed is not None:
                found[name] = frozenset(names[int(k) - 1] for k in listed.split()) & inputs
        return found


def read_description(path: Path) -> tuple[Any, ET.Element]:
    """Return fmpy's model description of a co-simulation FMU 2.0 and the XML it came from.

    Raises
    ------
    GraphError : no such file, not an FMU, of another version, against the standard, without co-simulation.
    """
    if not path.is_file():
        raise GraphError(f"{path}: no such FMU file")
    try:
        with zipfile.ZipFile(path) as archive:
            root = ET.fromstring(archive.read("modelDescription.xml"))
    except (zipfile.BadZipFile, zlib.error, KeyError, ET.ParseError) as error:
        raise GraphError(f"{path.name}: not an FMU ({error})") from error
    version = root.get("fmiVersion")
    if version != "2.0":
        raise GraphError(f"{path.name}: is FMI {version}; the master steps FMI 2.0 FMUs")
    try:
        model = fmpy.read_model_description(str(path))
    except md.ValidationError as error:
        raise GraphError(
            f"{path.name}: its modelDescription.xml breaks the standard: {error.problems[0]}"
        ) from error
    if model.coSimulation is None:
        raise GraphError(f"{path.name}: has no co-simulation part; the master steps co-simulation FMUs")
    return model, root


def _unit_name(variable: Any) -> str | None:
    if variable.unit:
        return str(variable.unit)
    declared = variable.declaredType
    return str(declared.unit) if declared is not None and declared.unit else None


def _unit_of(unit: Any) -> UnitOf:
    base = unit.baseUnit
    if base is None:
        return UnitOf(unit.name)
    exponents = tuple(int(getattr(base, name) or 0) for name in BASE_UNITS)
    return UnitOf(unit.name, exponents, float(base.factor), float(base.offset))


def _port(v: Any, units: dict[str, UnitOf]) -> Port:
    name = _unit_name(v)
    return Port(
        name=v.name,
        type=_TYPE_OF[v.type],
        unit=None if name is None else units.get(name, UnitOf(name)),
        start=_number(v.start, float, 0.0),
        nominal=abs(_number(v.nominal, float, 1.0)) or 1.0,
        discrete=v.type != "Real" or v.variability == "discrete",
        description=v.description or "",
    )


def _number(text: str | None, kind: Callable[[str], float], default: float) -> float:
    if text is None:
        return default
    if text.lower() in ("true", "false"):
        return 1.0 if text.lower() == "true" else 0.0
    return kind(text)
