"""`python -m interarea`, and the start of the command `interarea`, which a signal can stop at any time."""

from __future__ import annotations

import atexit
import os
import signal
import sys

TYPE_CHECKING = False  # as that of typing, which takes longer to load than all else before the handlers
if TYPE_CHECKING:
    from types import FrameType
    from typing import Any, NoReturn

_AGAIN_S = 0.05
_LOST_S = 0.3  #: after which an import that goes on has swallowed an interrupt
_ALLOCATIONS = 100_000  # between searches for cycles; after Python's own 700 they take a sixth of a run


def _stop(number: int, frame: FrameType | None) -> None:
    """End at once, while modules are loaded and after all: only temporary folders may be left to remove."""
    os.write(2, b"interarea: stopped\n")
    if (files := sys.modules.get("interarea.models.files")) is not None:
        getattr(files, "remove_own_folders", int)()  # not there while the module is being loaded
    os._exit(128 + number)


def _keep_code(stops: list[int]) -> None:
    """End with the code of the signal that stopped the command, before Python removes its modules.

    Python ends itself by SIGINT if KeyboardInterrupt has passed through code run by a C module
    (PyRun_String), even if it was handled; a running thread of such a module then ends Python by SIGABRT.
    """
    if stops:
        from contextlib import suppress

        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):  # a terminal that is gone
                stream.flush()
        os._exit(128 + stops[0])


def _signals() -> list[int]:
    """Ctrl-C, a request to end, a terminal that closes; one that is ignored (`nohup`) stays so."""
    names = ("SIGINT", "SIGTERM", "SIGHUP")
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    return [number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN]


def _interrupt(number: int) -> None:
    """Send the main thread a signal, which ends its wait (on Windows only when it continues)."""
    import threading

    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        signal.raise_signal(number)


def _outermost_import(frame: FrameType | None) -> FrameType | None:
    """Return the frame of the import under way at `frame` that began first; None if there is none."""
    outermost = None
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            outermost = frame
        frame = frame.f_back
    return outermost


def _watch(importing: FrameType, number: int) -> None:
    """Interrupt the main thread again if an import that an interrupt should have ended goes on or succeeds.

    A C module that is being loaded turns the interrupt into an ImportError, which the importing module may
    ignore. An import that succeeds is seen by a trace of the frame that asked for it: its next event is then
    no exception. One that goes on is seen after a time.
    """
    import threading

    def look() -> None:
        frame = sys._current_frames().get(threading.main_thread().ident or 0)
        while frame is not None and frame is not importing:
            frame = frame.f_back
        if frame is not None:
            _interrupt(number)

    def next_event(_frame: FrameType, event: str, _arg: Any) -> None:
        sys.settrace(None)
        if event != "exception":
            raise KeyboardInterrupt

    if (asking := importing.f_back) is not None:
        asking.f_trace, asking.f_trace_opcodes = next_event, True
        sys.settrace(lambda *_: None)  # a frame's own trace needs a global one, which asks for nothing
    later = threading.Timer(_LOST_S, look)
    later.daemon = True
    later.start()


def main() -> None:
    """Run the command line."""
    numbers = _signals()
    for number in numbers:
        signal.signal(number, _stop)
    import gc

    gc.set_threshold(_ALLOCATIONS)
    for pool in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # numpy's and scipy's fight over small matrices
        os.environ.setdefault(pool, "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # looking for some takes 10 ms
    from .cli.app import main as run

    stops: list[int] = []
    atexit.register(_keep_code, stops)  # registered first, called last

    def stop(number: int, frame: FrameType | None) -> NoReturn:
        stops.append(number)
        if (importing := _outermost_import(frame)) is not None:
            _watch(importing, number)
        raise KeyboardInterrupt

    def swallowed(lost: Any) -> None:
        """A callback from C or a finaliser discards exceptions: an interrupt there is sent again."""
        if stops and lost.exc_type is KeyboardInterrupt:
            import threading

            again = threading.Timer(_AGAIN_S, _interrupt, (stops[-1],))
            again.daemon = True
            again.start()
        else:
            sys.__unraisablehook__(lost)

    sys.unraisablehook = swallowed
    for number in numbers:
        signal.signal(number, stop)
    try:
        run(stops)
    finally:
        for number in numbers:
            signal.signal(number, _stop)


if __name__ == "__main__":
    main()
