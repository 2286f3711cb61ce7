"""`python -m interarea`, and the start of the command `interarea`: quick to stop from its first moment."""

import os
import signal
from types import FrameType
from typing import NoReturn


def _stop(number: int, frame: FrameType | None) -> None:
    """End at once: while modules are loaded, and after all, there is nothing to leave in order."""
    os.write(2, b"interarea: stopped\n")
    os._exit(130)


def main() -> None:
    """Run the command line."""
    signal.signal(signal.SIGINT, _stop)
    for pool in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # numpy's and scipy's fight over small matrices
        os.environ.setdefault(pool, "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # looking for some takes 10 ms
    from .cli.app import main as run

    stops: list[int] = []

    def stop(number: int, _frame: FrameType | None) -> NoReturn:
        stops.append(number)
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, stop)
    try:
        run(stops)
    finally:
        signal.signal(signal.SIGINT, _stop)


if __name__ == "__main__":
    main()
