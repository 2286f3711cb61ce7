"""The FMUs of a system: which file each instance is of, opened once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.open.own import open_own
from interarea.models.blocks.detector import Patterns
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.blocks.variables import Block
from interarea.models.case.case import Case

from ..errors import GraphError
from ..master.instances import Value
from .artefacts import EVENT_SLOTS, channel_fmu, concentrator_fmu, detector_fmu, plant_fmu, pmu_fmu
from .controllers import controller_fmu


@dataclass(frozen=True)
class Instance:
    """An FMU in a system: its file, the start values it gets, where it runs (as `participant_of` takes it).

    block : makes what the FMU is made of; None for FMUs of others.
    """

    name: str
    file: FmuFile
    start: Mapping[str, Value] = field(default_factory=dict)
    block: Callable[[], Block] | None = None
    process: Mapping[str, Any] = field(default_factory=dict)


def start_values(
    name: str,
    file: FmuFile,
    start: Mapping[str, Value] | None,
    values: Mapping[str, Value],
    **options: object,
) -> dict[str, Value]:
    """Return the start values of instance `name` that a call gave as a mapping and as keywords.

    options : keywords of the call that are no start values.

    Raises
    ------
    GraphError : a value given twice; an option whose name is that of a variable, so that either may be meant.
    """
    if start is not None and not isinstance(start, Mapping):
        raise GraphError(
            f"{name}: start = {start!r}, allowed: start values by name; of a variable called start: "
            f"start={{'start': {start!r}}}"
        )
    start_of = dict(start or {})
    if twice := sorted(start_of.keys() & values.keys()):
        raise GraphError(f"{name}: {twice[0]} is given twice, in start and as a keyword; give it once")
    for option, value in options.items():
        if value and option in file.variables and option not in start_of:
            raise GraphError(
                f"{name}: {option} = {value!r} is an option here, and {file.path.name} has a variable of "
                f"that name; give the variable in start={{{option!r}: ...}}, with its start value "
                f"{file.variables[option].start} where the option is meant"
            )
    return start_of | dict(values)


class Fmus:
    """Opened FMUs for the instances of systems, each file once."""

    def __init__(self, cache: Path) -> None:
        self.cache = cache
        self.loops: dict[Any, Any] = {}  #: linear plants and what swings with them (`linear_loop`)
        self._files: dict[Path, FmuFile] = {}
        self._controllers: dict[tuple[int, bool], tuple[Controller | ControllerBank, FmuFile]] = {}
        self._scaled: dict[tuple[int, float, float | None], tuple[Controller, Controller]] = {}
        self._plants: dict[tuple[str, int, tuple[str, ...]], Block] = {}

    def plant(self, case: Case, event_slots: int, more: tuple[str, ...] = ()) -> FmuFile:
        """Return the plant of a case; `more`: outputs beside those that it shows by itself."""
        return self.built(plant_fmu(case, self.cache, event_slots=event_slots, more=more))

    def plant_block(self, case: Case, event_slots: int, more: tuple[str, ...] = ()) -> Block:
        """Return what the plant of a case is made of, the same object for the same."""
        key = (case.hash, event_slots, more)
        if key not in self._plants:
            self._plants[key] = plant_block(case, event_slots=event_slots, more=more)
        return self._plants[key]

    def with_events(
        self, plant: Instance, case: Case, events: Sequence[Any], slots: int, more: tuple[str, ...]
    ) -> Instance:
        """Return the instance of a plant with its events among its start values."""
        start = {**plant.start, **event_parameters(case, events)}
        file = plant.file if slots == EVENT_SLOTS else self.plant(case, slots, more)
        return Instance(plant.name, file, start, lambda: self.plant_block(case, slots, more))

    def pmu(self) -> FmuFile:
        """Return the PMU."""
        return self.built(pmu_fmu(self.cache))

    def channel(self) -> FmuFile:
        """Return the channel."""
        return self.built(channel_fmu(self.cache))

    def concentrator(self, signals: int) -> FmuFile:
        """Return the concentrator of so many signals."""
        return self.built(concentrator_fmu(signals, self.cache))

    def detector(self, signals: Sequence[str], patterns: Patterns | None = None) -> FmuFile:
        """Return the detector of these signals."""
        return self.built(detector_fmu(signals, self.cache, patterns))

    def controller(
        self, controller: Controller | ControllerBank, omega_b: float, *, trust: bool = False
    ) -> FmuFile:
        """Return the FMU of a controller; `omega_b` in rad/s. trust : see `controller_block_of`."""
        key = (id(controller), trust)
        if key not in self._controllers:
            file = self.built(controller_fmu(controller, omega_b, self.cache, trust=trust))
            self._controllers[key] = (controller, file)
        return self._controllers[key][1]

    def scaled(self, controller: Controller, gain: float, limit_pu: float | None) -> Controller:
        """Return a controller with another gain and limit, the same object for the same."""
        key = (id(controller), gain, limit_pu)
        if key not in self._scaled:
            self._scaled[key] = (controller, controller.scaled(gain, limit_pu))
        return self._scaled[key][1]

    def own(self, name: str, path: Path) -> FmuFile:
        """Return an FMU of the user's, instance `name`."""
        return self.open(path)

    def open(self, path: Path) -> FmuFile:
        """Open a file, once."""
        if path not in self._files:
            self._files[path] = FmuFile(path)
        return self._files[path]

    def built(self, path: Path) -> FmuFile:
        """Open a file that was built into the cache, once."""
        if path not in self._files:
            self._files[path] = open_own(path, self.cache)
        return self._files[path]

    def close(self) -> None:
        """Close all files."""
        for file in self._files.values():
            file.close()
        self._files.clear()
        self._controllers.clear()
