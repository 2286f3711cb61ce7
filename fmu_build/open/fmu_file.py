"""An FMI 2.0 FMU as a file: checked, described, unpacked when its binary is needed."""

from __future__ import annotations

import math
import shutil
from functools import cached_property
from pathlib import Path
from typing import Any

from interarea.models.documents import require_regular
from interarea.models.files import new_folder

from ..errors import BuildError, FmuFileError
from ..finding import Report
from ..write.cache import host_machine
from ..write.compile import PLATFORMS, host_platform
from .archive import read_checked, unpack_checked
from .description import ModelDescription, ScalarVariable, read_description
from .deviations import mended
from .images import FOLDERS, ImageError, read_image
from .ports import Description, Port, Type
from .units import UnitOf
from .xml import MOST_BYTES, parse_xml

DESCRIPTION = "modelDescription.xml"
_TYPE_OF: dict[str, Type] = {
    "Real": "Real",
    "Integer": "Integer",
    "Enumeration": "Integer",
    "Boolean": "Boolean",
}
_LONGEST_NAME = 200  #: of a library; file systems take 255 with the suffix
_PARTS = {"CoSimulation": "co-simulation", "ModelExchange": "model-exchange"}


class FmuFile:
    """An FMU, checked; its files are unpacked where its `folder` is asked for, until `close` or the end.

    interface : "CoSimulation", which the master steps, or "ModelExchange".
    deviations : what breaks the standard in its description, does no harm here and was put right (`mended`).

    Raises
    ------
    FmuFileError : see `describe`; no binary for this platform.
    """

    def __init__(self, path: str | Path, interface: str = "CoSimulation") -> None:
        self.path = Path(path)
        self.interface = interface
        self.model, names, self.deviations = _looked_at(self.path, interface)
        folders = {n.split("/")[1] for n in names if n.startswith("binaries/") and n.count("/") > 1}
        self._platform = next((f for f in host_folders() if f in folders), None)
        if self._platform is None:
            raise FmuFileError(
                f"{self.path.name}: has no binary for this platform ({host_folders()[0]}); it has "
                f"{', '.join(sorted(folders)) or 'none'}. Build it for this platform too (--platforms), "
                "or run it on one of those"
            )
        self._folder: Path | None = None
        self._known: set[Path] = set()

    @property
    def warning(self) -> str:
        """A line on `deviations`; "" where there are none."""
        if not self.deviations:
            return ""
        more = f" and {len(self.deviations) - 1} more" if len(self.deviations) > 1 else ""
        return f"{self.path.name}: its {DESCRIPTION} breaks the standard: {self.deviations[0]}{more}"

    def require_conforming(self) -> None:
        """Raise FmuFileError where the description breaks the standard, harmless or not."""
        if self.deviations:
            raise FmuFileError(f"{self.warning}; it does no harm: without strict = true it runs")

    @property
    def folder(self) -> Path:
        """The unpacked FMU: this platform's binaries and the resources.

        Raises
        ------
        FmuFileError : an archive that would do harm, or is damaged.
        """
        if self._folder is None:
            self._folder = self._unpacked()
        return self._folder

    def _unpacked(self) -> Path:
        """Unpack what is used of the archive into a new folder and return that."""
        folders = (f"binaries/{self._platform}/", "resources/")
        report, folder = Report(str(self.path)), new_folder()
        whole = False
        try:
            whole = unpack_checked(self.path, folder, report, chosen_by=lambda n: n.startswith(folders))
        finally:
            if not whole:
                shutil.rmtree(folder, ignore_errors=True)
        if not whole:
            finding = report.findings[0]
            raise FmuFileError(f"{self.path.name}: not unpacked: {finding.where}: {finding.message}")
        return folder

    @cached_property
    def _library(self) -> str:
        """Path of this platform's library in the FMU."""
        name = self.model.interfaces[self.interface].get("modelIdentifier", "")
        if not 0 < len(name) <= _LONGEST_NAME or "/" in name or "\\" in name:
            raise FmuFileError(f"{self.path.name}: modelIdentifier {name[:60]!r} names no library")
        return f"binaries/{self._platform}/{name}{PLATFORMS[host_platform()].suffix}"

    @property
    def binary(self) -> Path:
        """The unpacked shared library of this platform, looked at before anything loads it.

        Raises
        ------
        FmuFileError : it is not there, no shared library, or that of another machine.
        """
        file = self.folder / self._library
        if file not in self._known:
            where = f"{self.path.name}: {self._library}"
            if not file.is_file():
                raise FmuFileError(f"{where} is not there; name the library as modelIdentifier says")
            try:
                image = read_image(file.read_bytes())
            except ImageError as error:
                raise FmuFileError(f"{where}: {error}; build the FMU again") from error
            folder = FOLDERS[host_folders()[0]]
            if image.format != folder[0] or folder[1] not in image.machine.split("+"):
                raise FmuFileError(
                    f"{where} is {image.format} for {image.machine}, this machine loads {folder[0]} for "
                    f"{folder[1]}; build the FMU for this platform"
                )
            self._known.add(file)
        return file

    def start_of(self, name: str) -> float:
        """Return the start value that modelDescription.xml gives a variable, 0 where it gives none."""
        return float(_number(self.variables[name].start, 0.0))

    def close(self) -> None:
        """Remove the unpacked files."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    @cached_property
    def variables(self) -> dict[str, ScalarVariable]:
        """Every variable that can be named, set or asked, by name; of two of one name the first."""
        known = (v for v in reversed(self.model.variables) if v.name and v.type and v.reference >= 0)
        return {v.name: v for v in known}

    @cached_property
    def enumerations(self) -> dict[str, dict[str, int]]:
        """Of each Enumeration variable: item name -> value."""
        types = self.model.types
        return {
            v.name: {item: _whole(value) for item, value in types[declared][1]["items"]}
            for v in self.model.variables
            if v.type == "Enumeration" and (declared := v.typed.get("declaredType", "")) in types
        }

    @cached_property
    def description(self) -> Description:
        """Ports, direct dependencies (ModelStructure) and abilities."""
        flags = self.model.interfaces[self.interface]
        return Description(
            inputs=tuple(_port(v, self.model) for v in self._of("input")),
            outputs=tuple(_port(v, self.model) for v in self._of("output")),
            feedthrough=self._dependencies(self.model.outputs),
            initial_feedthrough=self._dependencies(self.model.initial_unknowns),
            input_order=3 if self.model.flag(self.interface, "canInterpolateInputs") else 0,
            output_order=_whole(flags.get("maxOutputDerivativeOrder")),
            saves_state=self.model.flag(self.interface, "canGetAndSetFMUstate"),
            variable_step=self.model.flag(self.interface, "canHandleVariableCommunicationStepSize"),
            title=self.model.name or self.path.stem,
        )

    def _of(self, causality: str) -> list[ScalarVariable]:
        return [v for v in self.model.variables if v.causality == causality and v.type in _TYPE_OF]

    def _dependencies(self, unknowns: Any) -> dict[str, frozenset[str]]:
        """Output -> inputs it depends on; missing `dependencies` means all, empty ones none (FMI2, 2.2.8)."""
        names = [v.name for v in self.model.variables]
        inputs = frozenset(v.name for v in self._of("input"))
        direct: dict[str, frozenset[str]] = {v.name: inputs for v in self._of("output")}
        for unknown in unknowns:
            name = names[unknown.index - 1]
            if name in direct and unknown.dependencies is not None:
                direct[name] = frozenset(names[k - 1] for k in unknown.dependencies) & inputs
        return direct


def describe(path: Path, interface: str = "CoSimulation") -> ModelDescription:
    """Return what the modelDescription.xml of an FMU says.

    Raises
    ------
    FmuFileError : no such file, not an FMU, of another version, against the standard, without `interface`.
    """
    return _looked_at(path, interface)[0]


def _looked_at(path: Path, interface: str) -> tuple[ModelDescription, list[str], tuple[str, ...]]:
    """Return the description, the names of the archive's entries, and what was put right in the first."""
    require_regular(path, "an FMU", FmuFileError)
    report = Report(str(path))
    content = read_checked(path, DESCRIPTION, MOST_BYTES, report)
    root = None if content is None else parse_xml(content[1], DESCRIPTION, report)
    if root is None or content is None:
        finding = report.findings[0]
        where = "" if finding.where == path.name else f"{finding.where} "
        raise FmuFileError(f"{path.name}: not an FMU ({where}{finding.message})")
    version = root.get("fmiVersion")
    if version != "2.0":
        raise FmuFileError(f"{path.name}: is FMI {version}; the master steps FMI 2.0 FMUs")
    model = read_description(root)
    if interface not in model.interfaces:
        raise FmuFileError(f"{path.name}: has no {_PARTS[interface]} part, which is needed here")
    model, deviations, trouble = mended(model, interface, lambda text: _number(text, None))
    if trouble:
        raise FmuFileError(f"{path.name}: its {DESCRIPTION} breaks the standard: {trouble}")
    return model, content[0], deviations


def host_folders() -> tuple[str, ...]:
    """Return the folders below ``binaries/`` whose libraries this machine can load, the best first.

    Raises
    ------
    FmuFileError : a platform that no binary is made for.
    """
    try:
        own = PLATFORMS[host_platform()].folder
    except BuildError as error:
        raise FmuFileError(str(error)) from error
    system, _, processor = host_machine().partition("-")
    named = f"{processor}-{'windows' if system == 'win32' else system}"  # as in FMI 3.0
    # a Mac's own folder before the universal library, which holds both processors'
    return tuple(dict.fromkeys((named, own) if named == "aarch64-darwin" else (own, named)))


def _port(v: ScalarVariable, d: ModelDescription) -> Port:
    return Port(
        name=v.name,
        type=_TYPE_OF[v.type],
        unit=None if v.unit is None else d.unit_table.get(v.unit, UnitOf(v.unit)),
        start=_number(v.start, 0.0),
        nominal=_nominal(v),
        discrete=v.type != "Real" or v.variability == "discrete",
        description=v.description,
    )


def _number(text: str | None, default: Any) -> Any:
    """Return a number or a Boolean as written; `default` where there is none or it is none."""
    truth = {"true": 1.0, "false": 0.0}.get((text or "").strip().lower())
    if truth is not None:
        return truth
    try:
        return float(text) if text is not None else default
    except ValueError:
        return default


def _whole(text: str | None) -> int:
    """Return a whole number as written, 0 where there is none or it is none."""
    value = float(_number(text, 0.0))
    return int(value) if math.isfinite(value) else 0


def _nominal(v: ScalarVariable) -> float:
    """Return the size of a variable, 1 where none that could be one is given."""
    size = abs(float(_number(v.typed.get("nominal"), 1.0)))
    return size if 0.0 < size < math.inf else 1.0
