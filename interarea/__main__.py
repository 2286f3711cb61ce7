"""`python -m interarea`, and the start of the command `interarea`: quick to stop from its first moment."""

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
_ALLOCATIONS = 100_000  # between searches for cycles; after Python's own 700 they take a sixth of a run


def _stop(number: int, frame: FrameType | None) -> None:
    """End at once: while modules are loaded, and after all, there is nothing to leave in order."""
    os.write(2, b"interarea: stopped\n")
    os._exit(128 + number)


def _keep_code(stops: list[int]) -> None:
    """End with the code of the signal that stopped the command.

    Python ends itself by SIGINT where KeyboardInterrupt has passed through code that a module in C runs
    (PyRun_String), even if it was dealt with. Where SIGINT stopped the command, that is as good.
    """
    if stops and stops[0] != signal.SIGINT:
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
    """Send the main thread a signal, which ends what it waits for (on Windows when it goes on)."""
    import threading

    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        signal.raise_signal(number)


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

    def stop(number: int, _frame: FrameType | None) -> NoReturn:
        stops.append(number)
        raise KeyboardInterrupt

    def swallowed(lost: Any) -> None:
        """A callback from C or a finaliser lets no exception through: an interrupt there comes once more."""
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
