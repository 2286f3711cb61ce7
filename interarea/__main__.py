"""`python -m interarea`, and the start of the command `interarea`: quick to stop from its first moment."""

import os
import signal
from types import FrameType


def _stop(number: int, frame: FrameType | None) -> None:
    """End at once: while modules are loaded there is nothing to leave in order."""
    os.write(2, b"interarea: stopped\n")
    os._exit(130)


def main() -> None:
    """Run the command line."""
    signal.signal(signal.SIGINT, _stop)
    from .cli.app import main as run

    signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


if __name__ == "__main__":
    main()
