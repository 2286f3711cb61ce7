"""Open an FMU by names, as the `Plant` that the design rooms work on."""

from __future__ import annotations

import contextlib
import ctypes
import weakref
from collections.abc import Callable, Iterator, Sequence
from ctypes import c_double
from pathlib import Path
from types import TracebackType

import numpy as np
import numpy.typing as npt

from ..errors import FmuError, FmuFileError
from .description import ScalarVariable
from .fmi2 import CallFailed, Instance, Library
from .fmu_file import FmuFile

Vector = npt.NDArray[np.float64]


class PlantFmu:
    """A model-exchange FMU behind the `interarea.models.blocks.linear_plant.Plant` protocol.

    Names in the order of the FMU's continuous states, Real inputs and Real
    outputs. Use it as a context manager, or call `close`; the garbage
    collector does it otherwise.
    """

    def __init__(self, path: Path | str) -> None:
        self._file = file = FmuFile(path, "ModelExchange")
        self._name = file.model.name
        if not file.model.flag("ModelExchange", "providesDirectionalDerivative"):
            raise FmuFileError(
                f"{file.path.name}: the FMU offers no directional derivatives, which `jacobians` needs"
            )
        variables = file.model.variables
        self._derivatives = [variables[u.index - 1] for u in file.model.derivatives]
        self._states = [variables[int(v.typed["derivative"]) - 1] for v in self._derivatives]
        self._inputs = [v for v in variables if v.causality == "input" and v.type == "Real"]
        outputs = [variables[u.index - 1] for u in file.model.outputs]
        self._outputs = [v for v in outputs if v.type == "Real"]
        self.state_names: tuple[str, ...] = tuple(v.name for v in self._states)
        self.input_names: tuple[str, ...] = tuple(v.name for v in self._inputs)
        self.output_names: tuple[str, ...] = tuple(v.name for v in self._outputs)
        try:
            library = Library(file.model, file.interface, file.folder, file.binary)
            with self._errors():
                self._fmu = library.fresh()
        except OSError as error:
            file.close()
            raise FmuError(file.path.name, "loading the FMU", str(error)) from error
        except FmuError:
            library.close()
            file.close()
            raise
        self._finalizer = weakref.finalize(self, _release, self._fmu, file)
        with self._errors():
            self._fmu.initialise()
            self._fmu.to_continuous()
            self._x0 = self._fmu.states(len(self._states))
            self._u0 = self._fmu.get(self._inputs)

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
        with self._errors():
            dx = np.empty(len(self._states))
            self._fmu.do("GetDerivatives", _at(dx), dx.size)
            return dx, self._fmu.get(self._outputs)

    def rates_between(self, x: Vector, dx: Vector) -> Callable[[], None]:
        """Return a function that writes the rates of the states in `x` into `dx`; both (n,), in one piece.

        For a loop over many points: it raises FmuError where a call fails, and leaves inputs as they are.
        """
        dll, component, n = self._fmu.library.dll, self._fmu.component, x.size
        move, rates, at, into = dll.fmi2SetContinuousStates, dll.fmi2GetDerivatives, _at(x), _at(dx)

        def write() -> None:
            if move(component, at, n) > 1 or rates(component, into, n) > 1:
                raise FmuError(self._name, "fmi2GetDerivatives", f"failed{self._fmu.library.said()}")

        return write

    def outputs(self) -> Vector:
        """Return the outputs, shape (p,), at the states set last."""
        with self._errors():
            return self._fmu.get(self._outputs)

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
        unknowns: Sequence[ScalarVariable] = (*self._derivatives, *self._outputs)
        with self._errors():
            columns = [self._fmu.directional(unknowns, v) for v in (*self._states, *self._inputs)]
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
        with self._errors():
            self._fmu.set_states(x)
            for v, value in zip(self._inputs, u, strict=True):
                if self._fmu.set(v, value) > 1:
                    raise CallFailed("fmi2SetReal", f"refused {v.name} = {value!r}{self._fmu.library.said()}")

    def _vector(self, name: str, value: npt.ArrayLike, size: int) -> Vector:
        vector = np.ascontiguousarray(value, dtype=np.float64)
        if vector.shape != (size,) or not np.all(np.isfinite(vector)):
            raise FmuError(
                self._name, "set", f"{name} has shape {vector.shape}, wanted ({size},) finite values"
            )
        return vector

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        """Raise what a call says as an error of this FMU."""
        try:
            yield
        except CallFailed as error:
            raise FmuError(self._name, error.call, error.reason, time_s=0.0) from error


def open_plant(path: Path | str) -> PlantFmu:
    """Return the FMU at `path`, initialised, as a `Plant`.

    Raises
    ------
    FmuFileError : no FMI 2.0 model-exchange FMU, no binary for this machine, no directional derivatives.
    FmuError : a failing initialization.
    """
    return PlantFmu(path)


def _at(values: Vector) -> ctypes._Pointer[c_double]:
    return values.ctypes.data_as(ctypes.POINTER(c_double))


def _release(fmu: Instance, file: FmuFile) -> None:
    """Free the instance, then its files."""
    fmu.free()
    fmu.library.close()
    file.close()
