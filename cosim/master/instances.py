"""One FMI 2.0 co-simulation FMU as a participant, over `fmu_build.open`'s binding."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from ctypes import byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p, cast
from typing import Any, NoReturn

from interarea.fmu_build.open.description import ScalarVariable
from interarea.fmu_build.open.fmi2 import DISCARD, STATUS, WARNING, Instance, Library
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.open.ports import Description
from interarea.fmu_build.write.lane_library import GroupLibrary

from ..early_return import EarlyReturn, go_on, reached_s
from ..errors import GraphError, StepError, nearest
from .fmu_log import FmuLog

Value = float | int | bool | str
_SELDOM = ("logEvents", "logAll")  # log categories that are left off where the FMU has others


class FmuParticipant:
    """An instance of `file` named `name` with `start` values for its parameters, states or inputs.

    Enumeration parameters take the item's name or its number. The numbers pass through ctypes
    buffers made once, and each call goes to the FMU's function directly.

    group : library to use for the FMU's own binary, with which several instances can be stepped at once
        (`plant_group`); only for FMUs that were built of the same sources.

    Raises
    ------
    GraphError : a start value for an unknown variable, of the wrong type, or on an output.
    """

    def __init__(
        self,
        name: str,
        file: FmuFile,
        start: Mapping[str, Value] | None = None,
        *,
        group: GroupLibrary | None = None,
    ) -> None:
        self.name = name
        self.file = file
        self.group = group
        self.description: Description = file.description
        self.set_start(start or {})
        self._fmu: Instance | None = None
        self.log = FmuLog(name, lambda: self.now_s)
        self._initialised = False
        self.closed = False  #: ended for good
        self.time_s: float | None = None  #: where the last step ended
        self.kernel_node: Any = None  #: its mirror in the kernel, while that steps it
        self.sent_order = 0  #: of the input derivatives last sent
        self.stops_early = False  #: a step not done to its end is raised (`EarlyReturn`), not gone on with
        self.bind((), ())

    @property
    def now_s(self) -> float | None:
        """Time to which it has come, s; inside a step that of its start."""
        return self.time_s if self.kernel_node is None else float(self.kernel_node.time)

    def set_start(self, start: Mapping[str, Value]) -> None:
        """Take other start values; they hold from the next `begin`, which resets the instance."""
        self._start = {k: (self._variable(k), v) for k, v in start.items()}
        for variable, value in self._start.values():
            self._encode(variable, value)

    # -- wiring ---------------------------------------------------------------------------

    def bind(self, inputs: Sequence[str], slopes: Sequence[str]) -> None:
        """Fix the inputs that will be sent and the outputs whose slopes will be asked."""
        self.bound_inputs, self.bound_slopes = tuple(inputs), tuple(slopes)
        ports = self.description.input_of
        reals = [(i, n) for i, n in enumerate(inputs) if ports[n].type == "Real"]
        self._real_inputs = [i for i, _ in reals]
        self._other_inputs = [
            (i, ports[n].type, self._references([n])) for i, n in enumerate(inputs) if ports[n].type != "Real"
        ]
        self.u = (c_double * max(1, len(inputs)))()
        self.du = (c_double * max(1, 3 * len(inputs)))()
        self._n_u = c_size_t(len(reals))
        self._sends = bool(reals)
        self._u_vr = self._references([n for _, n in reals])
        self._u_buffer = (c_double * max(1, len(reals)))()
        self._all_real = len(reals) == len(inputs)
        self._derivatives = {order: self._derivative_arrays(reals, order) for order in (1, 2, 3)}
        outputs = self.description.outputs
        self.y = (c_double * max(1, len(outputs)))()
        real_first = all(p.type == "Real" for p in outputs)
        self._y_all_real = real_first
        self._y_reals = [j for j, p in enumerate(outputs) if p.type == "Real"]
        self._n_y = c_size_t(len(self._y_reals))
        self._y_vr = self._references([outputs[j].name for j in self._y_reals])
        self._y_buffer = (c_double * max(1, len(self._y_reals)))()
        self._y_others = [
            (j, p.type, self._references([p.name]), c_int())
            for j, p in enumerate(outputs)
            if p.type != "Real"
        ]
        self._n_dy = c_size_t(len(slopes))
        self._dy_vr = self._references(list(slopes))
        self._dy_order = (c_int * max(1, len(slopes)))(*([1] * len(slopes)))
        self.dy = (c_double * max(1, len(slopes)))()

    def _derivative_arrays(self, reals: list[tuple[int, str]], order: int) -> tuple[Any, ...]:
        """Return of all derivatives up to `order`: references, number, orders, values, places in `du`."""
        every = [(i, name, m) for i, name in reals for m in range(order)]
        count = max(1, len(every))
        orders = (c_int * count)(*[m + 1 for _, _, m in every])
        places = [3 * i + m for i, _, m in every]
        whole = places == list(range(len(every)))  # then `du` itself can be sent
        values = self.du if whole else (c_double * count)()
        references = self._references([name for _, name, _ in every])
        return references, c_size_t(len(every)), orders, values, () if whole else tuple(enumerate(places))

    def _references(self, names: list[str]) -> Any:
        return (c_uint * max(1, len(names)))(*[self.file.variables[n].reference for n in names])

    # -- life -----------------------------------------------------------------------------

    def begin(self, start_s: float, stop_s: float) -> None:
        """Instantiate (first time) or reset, set start values and enter initialisation."""
        self.log.clear()
        if self._fmu is None:
            self._instantiate()
        else:
            self._call("fmi2Reset", self._raw.fmi2Reset(self._c), None)
        self._initialised = False
        self.time_s = start_s
        setup = self._raw.fmi2SetupExperiment(self._c, 0, 0.0, start_s, 1, stop_s)
        self._call("fmi2SetupExperiment", setup, start_s)
        for variable, value in self._start.values():
            self._set(variable, value, start_s)
        self._call("fmi2EnterInitializationMode", self._raw.fmi2EnterInitializationMode(self._c), start_s)

    def ready(self) -> None:
        """Leave initialisation."""
        status = self._raw.fmi2ExitInitializationMode(self._c)
        self._call("fmi2ExitInitializationMode", status, self.time_s)
        self._initialised = True

    def resume(self, time_s: float) -> None:
        """Be ready to `restore` what any instance of the same FMU has saved at `time_s`, begun or not."""
        if self._fmu is None:
            self._instantiate()
        self._initialised = True
        self.time_s = time_s

    def change(self, values: Mapping[str, Value]) -> None:
        """Set tunable parameters of a running instance; `set_start` is for the next `begin`."""
        for name, value in values.items():
            self._set(self._variable(name), value, self.time_s or 0.0)

    def close(self) -> None:
        """Terminate and free the instance."""
        self.closed = True
        if self._fmu is None:
            return
        if self._initialised:
            self._fmu.call("Terminate")
        self._fmu.free()
        self._fmu.library.close()
        self._fmu = None

    def _instantiate(self) -> None:
        file = self.file
        binary = file.binary if self.group is None else self.group.path
        try:
            library = Library(file.model, file.interface, file.folder, binary, log=self.log)
        except (OSError, AttributeError) as error:
            raise StepError(str(error), instance=self.name, call="loading the FMU", time_s=None) from error
        fmu = library.instantiate(name=self.name, logging=True)
        if fmu is None:
            library.close()
            raise StepError(
                "returned no instance",
                instance=self.name,
                call="fmi2Instantiate",
                time_s=None,
                last_log=self.last_log(),
            )
        self._fmu = fmu
        known = [c.encode() for c in file.model.log_categories if c not in _SELDOM]
        if known:
            fmu.call("SetDebugLogging", 0, 0, None)
            fmu.call("SetDebugLogging", 1, len(known), (c_char_p * len(known))(*known))
        self._raw = library.dll
        self._c = c_void_p(fmu.component)
        # functions without declared argument types: half the time of a call
        self._do_step = self._raw["fmi2DoStep"]
        self._set_real = self._raw["fmi2SetReal"]
        self._get_real = self._raw["fmi2GetReal"]
        if self.description.input_order:
            self._set_derivatives = self._raw["fmi2SetRealInputDerivatives"]
        if self.description.output_order:
            self._get_derivatives = self._raw["fmi2GetRealOutputDerivatives"]

    @property
    def component(self) -> int:
        """Address of the FMU instance; 0 when there is none."""
        return 0 if self._fmu is None else self._fmu.component

    def address(self, function: str) -> int | None:
        """Return the address of one of the FMU's functions, None when it has no such function."""
        entry = getattr(self._raw, function, None)
        return None if entry is None else cast(entry, c_void_p).value

    # -- one step -------------------------------------------------------------------------

    def send(self, order: int) -> None:
        """Set the bound inputs, and their derivatives up to `order`."""
        self.sent_order = order
        if self._sends:
            u: Any = self.u
            if not self._all_real:
                u = self._u_buffer
                for k, i in enumerate(self._real_inputs):
                    u[k] = self.u[i]
            status = self._set_real(self._c, self._u_vr, self._n_u, u)
            if status:
                self._call("fmi2SetReal", status, self.time_s)
            if order:
                references, count, orders, values, places = self._derivatives[order]
                du = self.du
                for k, i in places:
                    values[k] = du[i]
                status = self._set_derivatives(self._c, references, count, orders, values)
                if status:
                    self._call("fmi2SetRealInputDerivatives", status, self.time_s)
        for i, kind, reference in self._other_inputs:
            value = c_int(int(self.u[i]))
            setter = self._raw.fmi2SetBoolean if kind == "Boolean" else self._raw.fmi2SetInteger
            self._call("fmi2SetInteger", setter(self._c, reference, c_size_t(1), byref(value)), self.time_s)

    def advance(self, time_s: float, length_s: float) -> None:
        """Step from `time_s` over `length_s`."""
        status = self._do_step(self._c, c_double(time_s), c_double(length_s), 1)
        if status:
            self.time_s = time_s
            if status != DISCARD:
                self._call("fmi2DoStep", status, time_s)
            else:
                self.discarded(time_s, length_s)
        self.time_s = time_s + length_s

    def discarded(self, time_s: float, length_s: float) -> None:
        """Finish a step from `time_s` over `length_s` that the FMU discarded, or raise.

        `u` and `du` are what was sent before it. Both engines come here.
        """
        self.time_s = time_s
        if self.stops_early:
            raise EarlyReturn(self.name, time_s, reached_s(self, time_s, time_s + length_s), self.last_log())
        go_on(self, self.sent_order, time_s, length_s)

    def try_step(self, time_s: float, length_s: float) -> bool:
        """Step; return False when the FMU discards the step."""
        self.time_s = time_s
        status = self._do_step(self._c, c_double(time_s), c_double(length_s), 1)
        if status != DISCARD:
            self._call("fmi2DoStep", status, time_s)
        return bool(status != DISCARD)

    def status_of(self, function: str, kind: int) -> float | None:
        """Return what fmi2GetRealStatus or fmi2GetBooleanStatus says, None when it says nothing."""
        box = c_double() if function == "fmi2GetRealStatus" else c_int()
        call = getattr(self._raw, function, None)
        if call is None or call(self._c, kind, byref(box)) > 1:
            return None
        return float(box.value)

    def receive(self, slopes: bool) -> None:
        """Read every output, and the bound slopes if `slopes`."""
        if self._y_reals:
            y: Any = self.y if self._y_all_real else self._y_buffer
            status = self._get_real(self._c, self._y_vr, self._n_y, y)
            if status:
                self._call("fmi2GetReal", status, self.time_s)
            if not self._y_all_real:
                for k, j in enumerate(self._y_reals):
                    self.y[j] = y[k]
        for j, kind, reference, box in self._y_others:
            getter = self._raw.fmi2GetBoolean if kind == "Boolean" else self._raw.fmi2GetInteger
            self._call("fmi2GetInteger", getter(self._c, reference, c_size_t(1), byref(box)), self.time_s)
            self.y[j] = float(box.value)
        if slopes and self.bound_slopes:
            status = self._get_derivatives(self._c, self._dy_vr, self._n_dy, self._dy_order, self.dy)
            if status:
                self._call("fmi2GetRealOutputDerivatives", status, self.time_s)

    def save(self) -> c_void_p:
        """Copy the FMU state."""
        state = c_void_p()
        self._call("fmi2GetFMUstate", self._raw.fmi2GetFMUstate(self._c, byref(state)), self.time_s)
        return state

    def restore(self, state: c_void_p) -> None:
        """Go back to a saved FMU state."""
        self._call("fmi2SetFMUstate", self._raw.fmi2SetFMUstate(self._c, state), self.time_s)

    def release(self, state: c_void_p) -> None:
        """Free a saved FMU state."""
        self._call("fmi2FreeFMUstate", self._raw.fmi2FreeFMUstate(self._c, byref(state)), self.time_s)

    def value_of(self, name: str) -> float:
        """Return the present value of any Real, Integer, Boolean or Enumeration variable."""
        variable = self._variable(name)
        box = c_double() if variable.type == "Real" else c_int()
        kind = "Integer" if variable.type == "Enumeration" else variable.type
        assert self._fmu is not None
        status = self._fmu.call(f"Get{kind}", self._references([name]), 1, byref(box))
        self._call(f"fmi2Get{kind}", status, self.time_s)
        return float(box.value)

    def last_log(self) -> str:
        """Return the last line the FMU logged, or an empty string."""
        return self.log[-1] if self.log else ""

    # -- private --------------------------------------------------------------------------

    def _call(self, call: str, status: int, time_s: float | None) -> None:
        """Raise unless `status` is ok or warning; count a warning."""
        if status > WARNING:
            self.fail(call, status, time_s)
        if status == WARNING:
            self.log.warned(call, time_s)

    def fail(self, call: str, status: int, time_s: float | None = None) -> NoReturn:
        """Raise the error of an FMI call that returned `status`."""
        label = STATUS[status].removeprefix("fmi2").lower() if 0 <= status < len(STATUS) else str(status)
        raise StepError(
            f"returned {label}",
            instance=self.name,
            call=call,
            time_s=self.time_s if time_s is None else time_s,
            last_log=self.last_log(),
        )

    def _variable(self, name: str) -> ScalarVariable:
        try:
            return self.file.variables[name]
        except KeyError:
            raise GraphError(
                f"{self.name} ({self.file.path.name}) has no variable {name!r}; "
                f"{nearest(name, self.file.variables)}"
            ) from None

    def _encode(self, variable: ScalarVariable, value: Value) -> Value:
        where = f"{self.name}.{variable.name}"
        if variable.causality in ("output", "calculatedParameter", "independent"):
            raise GraphError(f"{where}: has causality {variable.causality} and takes no start value")
        if variable.type == "Enumeration" and isinstance(value, str):
            items = self.file.enumerations.get(variable.name, {})
            if value not in items:
                raise GraphError(f"{where} = {value!r}: allowed are {', '.join(items)}")
            return items[value]
        if variable.type == "String":
            return str(value)
        if isinstance(value, str):
            raise GraphError(f"{where} = {value!r}: the FMU wants a number ({variable.type})")
        if variable.type != "Real" and int(value) != value:
            raise GraphError(f"{where} = {value!r}: the FMU wants a whole number ({variable.type})")
        return value

    def _set(self, variable: ScalarVariable, value: Value, time_s: float) -> None:
        encoded = self._encode(variable, value)
        kind = "Integer" if variable.type == "Enumeration" else variable.type
        box: Any
        if kind == "Real":
            box = c_double(float(encoded))
        elif kind == "String":
            box = c_char_p(str(encoded).encode())
        else:
            box = c_int(int(encoded))
        assert self._fmu is not None
        status = self._fmu.call(f"Set{kind}", self._references([variable.name]), 1, byref(box))
        self._call(f"setting {variable.name} = {value!r}", status, time_s)
