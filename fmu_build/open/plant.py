"""Open an FMU by names, and as the `Plant` that the design rooms work on."""

from __future__ import annotations

import ctypes
import shutil
import weakref
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from interarea.models.files import new_folder

from ..errors import FmuError

Vector = npt.NDArray[np.float64]


class PlantFmu:
    """A model-exchange FMU behind the `interarea.models.blocks.linear_plant.Plant` protocol.

    Names in the order of the FMU's continuous states, Real inputs and Real
    outputs. Use it as a context manager, or call `close`; the garbage
    collector does it otherwise.
    """

    def __init__(self, path: Path | str) -> None:
        import fmpy
        from fmpy.fmi2 import FMU2Model

        self.path = Path(path)
        try:
            self.description: Any = fmpy.read_model_description(str(self.path))
        except Exception as error:
            raise FmuError(self.path.name, "open", f"not a readable FMU: {error}") from error
        if self.description.fmiVersion != "2.0" or self.description.modelExchange is None:
            raise FmuError(self.path.name, "open", "an FMI 2.0 FMU for model exchange is needed")
        if not self.description.modelExchange.providesDirectionalDerivative:
            raise FmuError(
                self.path.name, "open", "the FMU offers no directional derivatives, which `jacobians` needs"
            )
        variables = self.description.modelVariables
        derivatives = [u.variable for u in self.description.derivatives]
        self._derivatives = derivatives
        self._states = [v.derivative for v in derivatives]
        self._inputs = [v for v in variables if v.causality == "input" and v.type == "Real"]
        self._outputs = [u.variable for u in self.description.outputs if u.variable.type == "Real"]
        self.state_names: tuple[str, ...] = tuple(v.name for v in self._states)
        self.input_names: tuple[str, ...] = tuple(v.name for v in self._inputs)
        self.output_names: tuple[str, ...] = tuple(v.name for v in self._outputs)

        folder = str(new_folder())
        self._name = self.description.modelName
        self._log: list[str] = []
        log = self._log
        try:
            fmpy.extract(str(self.path), folder)
            _has_binary(self.path.name, Path(folder))
            self._fmu: Any = FMU2Model(
                guid=self.description.guid,
                modelIdentifier=self.description.modelExchange.modelIdentifier,
                unzipDirectory=folder,
                instanceName=self._name,
            )
            self._callbacks = _callbacks(log)
            self._call("instantiate", callbacks=self._callbacks)
        except FmuError:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        except Exception as error:
            shutil.rmtree(folder, ignore_errors=True)
            raise FmuError(self.path.name, "fmi2Instantiate", str(error), log_line=_last(log)) from error
        self._finalizer = weakref.finalize(self, _release, self._fmu, folder, self._callbacks)
        self._call("setupExperiment", startTime=0.0)
        self._call("enterInitializationMode")
        self._call("exitInitializationMode")
        self._call("newDiscreteStates")
        self._call("enterContinuousTimeMode")
        self._x0 = self._read_states()
        self._u0 = self._get(self._inputs)

    def operating_point(self) -> tuple[Vector, Vector]:
        """Return the states and inputs at the start, shapes (n,) and (m,)."""
        return self._x0.copy(), self._u0.copy()

    def derivatives(self, x: npt.ArrayLike, u: npt.ArrayLike) -> tuple[Vector, Vector]:
        """Return dx/dt, shape (n,), per second, and the outputs, shape (p,), at states `x` and inputs `u`.

        Raises
        ------
        FmuError : wrong lengths, values that are not finite, or a failing call.
        """
        self._move(x, u)
        dx = np.empty(len(self._states))
        self._call("getDerivatives", dx.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), dx.size)
        return dx, self._get(self._outputs)

    def jacobians(
        self, x: npt.ArrayLike | None = None, u: npt.ArrayLike | None = None
    ) -> tuple[Vector, Vector, Vector, Vector]:
        """Return A (n, n), B (n, m), C (p, n), D (p, m) at `x`, `u` (default: the operating point).

        They come from the FMU's directional derivatives, exact to rounding.

        Raises
        ------
        FmuError : as `derivatives`.
        """
        self._move(self._x0 if x is None else x, self._u0 if u is None else u)
        unknowns = [v.valueReference for v in (*self._derivatives, *self._outputs)]
        columns = [
            self._call("getDirectionalDerivative", unknowns, [v.valueReference], [1.0])
            for v in (*self._states, *self._inputs)
        ]
        n, m = len(self._states), len(self._inputs)
        J = np.array(columns, dtype=np.float64).reshape(n + m, len(unknowns)).T
        return J[:n, :n].copy(), J[:n, n:].copy(), J[n:, :n].copy(), J[n:, n:].copy()

    def close(self) -> None:
        """Free the instance and its files; repeated calls do nothing."""
        self._finalizer()

    def __enter__(self) -> PlantFmu:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _move(self, x: npt.ArrayLike, u: npt.ArrayLike) -> None:
        x, u = self._vector("x", x, len(self._states)), self._vector("u", u, len(self._inputs))
        self._call("setContinuousStates", x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), x.size)
        if u.size:
            self._call("setReal", [v.valueReference for v in self._inputs], u)

    def _vector(self, name: str, value: npt.ArrayLike, size: int) -> Vector:
        vector = np.ascontiguousarray(value, dtype=np.float64)
        if vector.shape != (size,) or not np.all(np.isfinite(vector)):
            raise FmuError(
                self._name, "set", f"{name} has shape {vector.shape}, wanted ({size},) finite values"
            )
        return vector

    def _read_states(self) -> Vector:
        x = np.empty(len(self._states))
        self._call("getContinuousStates", x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), x.size)
        return x

    def _get(self, variables: list[Any]) -> Vector:
        if not variables:
            return np.empty(0)
        return np.array(self._call("getReal", [v.valueReference for v in variables]), dtype=np.float64)

    def _call(self, method: str, *arguments: Any, **named: Any) -> Any:
        call = f"fmi2{method[0].upper()}{method[1:]}"
        self._log.clear()
        try:
            return getattr(self._fmu, method)(*arguments, **named)
        except Exception as error:
            raise FmuError(self._name, call, str(error), time_s=0.0, log_line=_last(self._log)) from error


def open_plant(path: Path | str) -> PlantFmu:
    """Return the FMU at `path`, initialised, as a `Plant`.

    Raises
    ------
    FmuError : no FMI 2.0 model-exchange FMU, no binary for this machine, no directional
        derivatives, or a failing initialization.
    """
    return PlantFmu(path)


def _has_binary(name: str, folder: Path) -> None:
    """Refuse an FMU that has no binary for this machine, before the loader says something about files."""
    import fmpy

    there = sorted(p.name for p in (folder / "binaries").glob("*") if p.is_dir())
    if not there or fmpy.platform in there or fmpy.platform_tuple in there:
        return
    raise FmuError(
        name,
        "open",
        f"the FMU has no binary for this machine ({fmpy.platform}); it has {', '.join(there)}. "
        "Build it for this platform too (--platforms), or run it on one of those",
    )


def _last(log: list[str]) -> str:
    return log[-1] if log else ""


def _callbacks(log: list[str]) -> Any:
    """FMI callbacks that collect the log; kept alive by the caller."""
    from fmpy import calloc, free
    from fmpy.fmi2 import (
        fmi2CallbackAllocateMemoryTYPE,
        fmi2CallbackFreeMemoryTYPE,
        fmi2CallbackFunctions,
        fmi2CallbackLoggerTYPE,
    )

    def logger(_: Any, __: bytes, ___: int, ____: bytes, message: bytes) -> None:
        log.append(message.decode("utf-8", "replace").replace("%%", "%"))

    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(logger)
    callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(calloc)
    callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
    return callbacks


def _release(fmu: Any, folder: str, callbacks: Any) -> None:
    """Free the instance, then its files; `callbacks` must live until here."""
    fmu.freeInstance()
    shutil.rmtree(folder, ignore_errors=True)
    del callbacks
