"""Numerical libraries on one thread: on few cores the pools of numpy and scipy fight over small matrices."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController


def one_thread() -> AbstractContextManager[object]:
    """Limit every pool that is loaded to one thread, from this call to the end of the block.

    threadpoolctl reads the paths of all libraries as UTF-8. Where one has another name (FMUs in a cache below
    such a folder), the pools stay as the environment set them, which is one thread for every command.
    """
    from threadpoolctl import threadpool_limits

    try:
        limits: AbstractContextManager[object] = threadpool_limits(1)
    except UnicodeDecodeError:
        return nullcontext()
    return limits


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Run a block of small-matrix code with every BLAS on one thread; the pools are looked for once."""
    pools = _pools()
    with nullcontext() if pools is None else pools.limit(limits=1, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _pools() -> ThreadpoolController | None:
    """Return the pools of numpy and scipy; None where they cannot be listed, as in `one_thread`."""
    import numpy as np
    import scipy.linalg
    from threadpoolctl import ThreadpoolController

    np.linalg.eigvalsh(np.eye(2))  # loads what is to be looked for
    scipy.linalg.eigh(np.eye(2))
    try:
        return ThreadpoolController()
    except UnicodeDecodeError:
        return None
