"""What the server that forks workers loads first; only that server imports this module.

When the main process is killed while it starts a worker, the new process, or the server, reads a message that
ends too early. Nobody waits for that worker any more, so it ends without a traceback. An error in a worker's
own work never comes here: `multiprocessing` reports it before.
"""

from __future__ import annotations

import pickle
import sys
from types import TracebackType


def _end_quietly(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    if not issubclass(kind, (EOFError, pickle.UnpicklingError)):
        sys.__excepthook__(kind, error, trace)


sys.excepthook = _end_quietly
