"""An IEEE/CIGRE DLL as the worker process holds it: called at its sample times, outputs held between."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from interarea.fmu_build.errors import FmuFileError
from interarea.fmu_build.open.ports import Description, Port
from interarea.fmu_build.open.real_code import ERROR, OK, TEXT, RealCode, RealCodeLibrary, text_of

from ..errors import GraphError, StepError
from ..polynomials import Polynomial, value_at
from .fmu_log import SpokenLog
from .instances import Value

_SLACK = 1e-9  #: of a sample time: instants this close are the same


class ServedRealCode:
    """The instance in the worker. Inputs follow the polynomials that the master hands over."""

    def __init__(self, name: str, path: str) -> None:
        self.name = name
        self.library = library = RealCodeLibrary(Path(path))
        step_s = library.info.sample_time
        if not step_s > 0.0:
            raise FmuFileError(f"{path}: its sample time is {step_s:g} s, allowed: above 0")
        inputs = tuple(Port(p.name, description=p.description) for p in library.inputs if p.type != TEXT)
        outputs = (p for p in library.outputs if p.type != TEXT)
        held = tuple(Port(p.name, discrete=True, description=p.description) for p in outputs)
        title = text_of(library.info.name)
        self.description = Description(inputs, held, {}, input_order=3, saves_state=True, title=title)
        self.stops_early = False
        self.log = SpokenLog(name, lambda: self._model.raw.time)
        self._begun = False
        self.y: list[float] = []
        self.dy = ()  #: outputs are held

    def set_start(self, start: Mapping[str, Value]) -> None:
        """Make a new instance with values of parameters, inputs and outputs."""
        self.close()
        try:
            self._model = RealCode(self.library, start)
        except FmuFileError as error:
            raise GraphError(f"{self.name}: {error}") from None

    def bind(self, inputs: tuple[str, ...], slopes: tuple[str, ...]) -> None:
        """Fix the inputs that will be sent."""
        self._bound = inputs

    def begin(self, start_s: float, stop_s: float) -> None:
        """Begin what `set_start` has made."""
        self._begun = True
        self._origin, self._sample = start_s, 0
        self._poly: dict[str, Polynomial] = {}
        self._call("Model_FirstCall", start_s)
        self._call("Model_CheckParameters")

    def ready(self) -> None:
        """Start at the inputs of the begin, and call it there for the first time."""
        self._call("Model_Initialize")
        self._call("Model_Outputs")

    def take(self, order: int, u: list[float], du: list[float]) -> None:
        """Take inputs and their derivatives up to `order`."""
        for k, name in enumerate(self._bound):
            d1, d2, d3 = (du[3 * k + m] if m < order else 0.0 for m in range(3))
            self._poly[name] = (u[k], d1, d2, d3)
            self._model.inputs[name] = u[k]

    def advance(self, time_s: float, length_s: float) -> None:
        """Call the DLL at each of its sample times up to the end of the step."""
        step = self.library.info.sample_time
        while (at := self._origin + (self._sample + 1) * step) <= time_s + length_s + _SLACK * step:
            for name, polynomial in self._poly.items():
                self._model.inputs[name] = value_at(polynomial, at - time_s)
            self._call("Model_Outputs", at)
            self._sample += 1

    def receive(self, slopes: bool) -> None:
        """Read the outputs; they have no slopes."""
        self.y = [self._model.outputs[p.name] for p in self.description.outputs]

    def save(self) -> tuple[Any, ...]:
        """Return a copy of the state."""
        return self._model.snapshot(), self._sample, dict(self._poly)

    def restore(self, state: tuple[Any, ...]) -> None:
        """Go back to a copy."""
        snapshot, self._sample, poly = state
        self._poly = dict(poly)
        self._model.restore(snapshot)

    def release(self, state: Any) -> None:
        """Nothing to free."""

    def close(self) -> None:
        """End the instance that has begun, if any."""
        if self._begun:
            self._model.call("Model_Terminate")
        self._begun = False

    def _call(self, name: str, time_s: float | None = None) -> None:
        code, text, at = self._model.call(name, time_s), self._model.text(), self._model.raw.time
        if code >= ERROR:
            raise StepError(f"return code {code}", instance=self.name, call=name, time_s=at, last_log=text)
        if code > OK and text:
            self.log.add(OK, text)
