"""An FMU in a process of its own: if it crashes, the run fails with an error and the caller lives.

The parent side is a participant like any other; each call travels as a pickle over the pipes of
``python -m interarea.cosim.master.isolated`` (some 50 microseconds), so isolate what is not trusted, not
everything.
What the FMU prints and logs goes to a file that only an error quotes. A call that takes longer than the time
limit fails the run as a crash does: the process is killed.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from interarea.fmu_build.errors import FmuFileError
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.open.ports import DLL_SUFFIXES, Description
from interarea.fmu_build.write.lane_library import GroupLibrary
from interarea.models.documents import require_regular
from interarea.models.files import temporary_root
from interarea.models.processes import end_with_parent

from ..errors import ScenarioError, StepError
from .fmu_log import FmuLog, SpokenLog
from .instances import FmuParticipant, Value
from .real_code import ServedRealCode

#: in which a worker may terminate and free its FMU, and after an interrupt: one that still starts, or is
#: within a call, reads later that it is to end, and nothing may live 5 s after a signal
_PATIENCE_S, _INTERRUPTED_S = 5.0, 1.0
_log = logging.getLogger("interarea")
#: by guid: the instance in this process of an FMU that allows no other there
_single: weakref.WeakValueDictionary[str, FmuParticipant] = weakref.WeakValueDictionary()
TIME_LIMIT_S = 60.0  #: of one call, by default
#: FMI calls by the method that makes them, for errors
_CALL_OF = {
    "begin": "instantiating the FMU",
    "ready": "fmi2ExitInitializationMode",
    "advance": "fmi2DoStep",
    "receive": "reading outputs",
    "save": "fmi2GetFMUstate",
    "restore": "fmi2SetFMUstate",
    "release": "fmi2FreeFMUstate",
    "value_of": "fmi2GetReal",
}


class _Worker(ABC):
    """The process of an instance, and the calls that travel there.

    time_limit_s : longest time that one call may take, s.
    """

    kind = "FMU"
    log: FmuLog
    u: Any
    du: Any
    y: Any
    dy: Any
    bound_inputs: tuple[str, ...]
    bound_slopes: tuple[str, ...]
    stops_early: bool

    def __init__(self, name: str, path: Path, time_limit_s: float) -> None:
        if not time_limit_s > 0.0:
            raise ScenarioError(f"{name}: time_limit_s = {time_limit_s:g}, allowed: above 0")
        self.name, self.path, self.time_limit_s = name, path, time_limit_s
        self.time_s: float | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._watch: _Watch | None = None
        self._said: IO[bytes] | None = None
        self._unsent: tuple[int, list[float], list[float]] | None = None

    @abstractmethod
    def _start_values(self) -> Mapping[str, Value]:
        """Start values by name."""

    def begin(self, start_s: float, stop_s: float) -> None:
        """Start the worker (again, if it died), instantiate or reset there, enter initialisation."""
        if self._process is None or self._process.poll() is not None:
            self._spawn()
        self._unsent = None
        self.log.clear()
        self._ask("set_start", self._start_values())
        self._ask("bind", self.bound_inputs, self.bound_slopes)
        self.time_s = start_s
        self._ask("begin", start_s, stop_s)

    def ready(self) -> None:
        """Leave initialisation."""
        self._ask("ready")

    def send(self, order: int) -> None:
        """Keep the inputs for the next call, which takes them along."""
        self._unsent = (order, list(self.u), list(self.du))

    def advance(self, time_s: float, length_s: float) -> None:
        """Step from `time_s` over `length_s`."""
        self.time_s = time_s
        self._ask("advance", time_s, length_s)
        self.time_s = time_s + length_s

    def receive(self, slopes: bool) -> None:
        """Read every output, and the bound slopes if `slopes`."""
        y, dy = self._ask("receive", slopes)
        self.y[:] = y
        if slopes:
            self.dy[:] = dy

    def save(self) -> Any:
        """Copy the FMU state; it stays in the worker."""
        return self._ask("save")

    def restore(self, state: Any) -> None:
        """Go back to a saved FMU state."""
        self._ask("restore", state)

    def release(self, state: Any) -> None:
        """Free a saved FMU state; nothing to do when the worker has died."""
        if self._process is not None and self._process.poll() is None:
            self._ask("release", state)

    def last_log(self) -> str:
        """Return the last line the FMU logged or printed, or an empty string."""
        if self._said is None:
            return ""
        self._said.seek(0)
        lines = self._said.read().decode("utf-8", "replace").strip().splitlines()
        return lines[-1].strip() if lines else ""

    def close(self) -> None:
        """End the instance and its worker."""
        process, self._process = self._process, None
        if self._watch is not None:
            self._watch.end()
            self._watch = None
        if process is not None:
            assert process.stdin is not None and process.stdout is not None
            with contextlib.suppress(OSError):  # it may be dead
                process.stdin.close()  # the worker terminates and frees its FMU at the end of its input
            interrupted = isinstance(sys.exc_info()[1], KeyboardInterrupt)
            try:
                process.wait(_INTERRUPTED_S if interrupted else _PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            process.stdout.close()
        if self._said is not None:
            self._said.close()
            self._said = None

    # -- private --------------------------------------------------------------------------

    def _spawn(self) -> Any:
        self.close()
        self._said = tempfile.TemporaryFile(dir=temporary_root())  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-m", "interarea.cosim.master.isolated", str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
        )
        self._watch = _Watch(self._process)
        self._watch.start()
        return self._ask("open", self.name, str(self.path.resolve()))

    def _ask(self, method: str, *arguments: Any) -> Any:
        """Have the worker do one call and return what it gives.

        Raises
        ------
        StepError : as the call says, or the worker died in it, or it took too long and was killed.
        """
        process = self._process
        if process is None:
            raise self._died(method, "the instance has ended")
        assert process.stdin is not None and process.stdout is not None and self._watch is not None
        unsent, self._unsent = self._unsent, None
        watch = self._watch
        # how long an interpreter takes to start says nothing about the FMU
        limit_s = max(self.time_limit_s, TIME_LIMIT_S) if method == "open" else self.time_limit_s
        try:
            with watch.over(limit_s):
                pickle.dump((method, arguments, unsent, self.stops_early), process.stdin)
                process.stdin.flush()
                failed, result, news = pickle.load(process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError) as error:
            process.wait()
            if watch.fired:
                what = f"no answer within {limit_s:g} s, so its process was killed"
                raise self._died(method, what, advice="allow more with time_limit_s") from error
            raise self._died(
                method, f"the {self.kind} crashed its process ({_death(process.returncode)})"
            ) from error
        if news is not None:
            self.log.merge(news)
        if failed:
            raise result
        return result

    def _died(self, method: str, what: str, *, advice: str = "") -> StepError:
        call = _CALL_OF.get(method, "starting the worker process")
        log = self.last_log()
        return StepError(what, instance=self.name, call=call, time_s=self.time_s, last_log=log, advice=advice)


class WorkerParticipant(_Worker, FmuParticipant):
    """An instance of `file` that lives in a worker process; otherwise as `FmuParticipant`.

    time_limit_s : longest time that one call may take, s.
    """

    def __init__(
        self,
        name: str,
        file: FmuFile,
        start: Mapping[str, Value] | None = None,
        *,
        time_limit_s: float = TIME_LIMIT_S,
    ) -> None:
        _Worker.__init__(self, name, file.path, time_limit_s)
        FmuParticipant.__init__(self, name, file, start)

    def _start_values(self) -> Mapping[str, Value]:
        return {name: value for name, (_, value) in self._start.items()}

    def value_of(self, name: str) -> float:
        """Return the present value of any Real, Integer, Boolean or Enumeration variable."""
        self._variable(name)
        return float(self._ask("value_of", name))


class RealCodeParticipant(_Worker):
    """An IEEE/CIGRE DLL in a worker process, called at its own sample times; outputs are held between.

    start : values of parameters, inputs and outputs at the begin.

    Raises
    ------
    GraphError : a start value of no port. FmuFileError : a file that is no such DLL of this machine.
    """

    kind = "DLL"

    def __init__(
        self,
        name: str,
        path: Path,
        start: Mapping[str, Value] | None = None,
        time_limit_s: float | None = None,
    ) -> None:
        require_regular(path, "an IEEE/CIGRE DLL", FmuFileError)  # loading a pipe would wait for ever
        super().__init__(name, path, TIME_LIMIT_S if time_limit_s is None else time_limit_s)
        self.stops_early = False
        self.log = FmuLog(name, lambda: self.time_s)
        self._start = dict(start or {})
        self.description: Description = self._spawn()
        self._ask("set_start", self._start)
        self.bind((), ())

    def _start_values(self) -> Mapping[str, Value]:
        return self._start

    def bind(self, inputs: Sequence[str], slopes: Sequence[str]) -> None:
        """Fix the inputs that will be sent; makes the buffers."""
        self.bound_inputs, self.bound_slopes = tuple(inputs), tuple(slopes)
        self.u, self.du = [0.0] * len(inputs), [0.0] * (3 * len(inputs))
        self.y, self.dy = [0.0] * len(self.description.outputs), [0.0] * len(slopes)


def participant_of(
    name: str,
    file: FmuFile,
    start: Mapping[str, Value],
    *,
    isolate: bool = False,
    time_limit_s: float | None = None,
    group: GroupLibrary | None = None,
) -> FmuParticipant:
    """Return an instance of `file`: in this process (with `group`), or with `isolate` in one of its own.

    An FMU that can be instantiated only once per process gets one of its own, too, while this one has an
    instance of it (FMI 2.0.4, 4.3.1: canBeInstantiatedOnlyOncePerProcess).

    Raises
    ------
    ScenarioError : a time limit for what is not isolated, or none above 0.
    """
    once, guid = file.model.flag(file.interface, "canBeInstantiatedOnlyOncePerProcess"), file.model.guid
    if once and not isolate and (other := _single.get(guid)) is not None and not other.closed:
        _log.info(
            "%s: %s allows one instance per process: it runs in a separate process", name, file.path.name
        )
        isolate = True
    if isolate:
        return WorkerParticipant(
            name, file, start, time_limit_s=TIME_LIMIT_S if time_limit_s is None else time_limit_s
        )
    if time_limit_s is not None:
        raise ScenarioError(f"{name}: time_limit_s ends calls of an isolated FMU; set isolate = true")
    participant = FmuParticipant(name, file, start, group=group)
    if once:
        _single[guid] = participant
    return participant


class _Watch(threading.Thread):
    """Kills a process that is still in one call when the time for it is over; `fired` tells."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        super().__init__(daemon=True)
        self._watched = process
        self._until = math.inf
        self._ended = threading.Event()
        self.fired = False

    @contextlib.contextmanager
    def over(self, limit_s: float) -> Iterator[None]:
        """Watch one call, which may take `limit_s`."""
        self._until = time.monotonic() + limit_s
        try:
            yield
        finally:
            self._until = math.inf

    def run(self) -> None:
        """Look four times a second."""
        while not self._ended.wait(0.25):
            if time.monotonic() > self._until:
                self.fired = True
                self._watched.kill()
                return

    def end(self) -> None:
        """Stop watching."""
        self._ended.set()


def _death(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


class _Served(FmuParticipant):
    """The instance in the worker."""

    def __init__(self, name: str, path: str) -> None:
        super().__init__(name, FmuFile(Path(path)))
        self.log = SpokenLog(name, lambda: self.now_s)

    def close(self) -> None:
        """End the instance, and the file that this process has opened."""
        super().close()
        self.file.close()

    def take(self, order: int, u: list[float], du: list[float]) -> None:
        """Send what the parent had set."""
        for buffer, values in ((self.u, u), (self.du, du)):
            for k, value in enumerate(values):
                buffer[k] = value
        self.send(order)


def _done(
    served: _Served | ServedRealCode, states: dict[int, Any], method: str, arguments: tuple[Any, ...]
) -> Any:
    """Do one call of the parent; states stay here, by number."""
    if method == "save":
        number = 1 + max(states, default=0)
        states[number] = served.save()
        return number
    if method == "restore":
        return served.restore(states[arguments[0]])
    if method == "release":
        return served.release(states.pop(arguments[0]))
    result = getattr(served, method)(*arguments)
    return (list(served.y), list(served.dy)) if method == "receive" else result


def serve(calls: IO[bytes], answers: IO[bytes]) -> None:
    """Answer calls until their end; then end the instance."""
    served: _Served | ServedRealCode | None = None
    states: dict[int, Any] = {}
    try:
        while True:
            try:
                method, arguments, unsent, stops_early = pickle.load(calls)
            except EOFError:
                return
            try:
                if method == "open" and arguments[1].endswith(DLL_SUFFIXES):
                    served = ServedRealCode(*arguments)
                    result = served.description
                elif method == "open":
                    served, result = _Served(*arguments), None
                else:
                    assert served is not None
                    served.stops_early = stops_early
                    if unsent is not None:
                        served.take(*unsent)
                    result = _done(served, states, method, arguments)
                answer: tuple[bool, Any] = (False, result)
            except Exception as error:
                answer = (True, error)
            news = None if served is None else served.log.news()
            pickle.dump((*answer, news), answers)
            answers.flush()
    finally:
        if served is not None:
            served.close()


def main() -> None:
    """Serve over standard input and output; what the FMU prints goes to standard error."""
    end_with_parent(int(sys.argv[1]))  # it may hang in a call
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    serve(sys.stdin.buffer, answers)


if __name__ == "__main__":
    main()
