"""Eigenvalues and eigenvectors of many closed loops, distributed over the processors.

LAPACK uses one processor for matrices of this size, and a search does little else. The results do not depend
on the number of processors, because each loop is solved separately.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]
T = TypeVar("T")

#: matrices that a thread takes at a time: a call costs as much as some microseconds of one
SHARE = 16


def eigenvalues(loops: Array) -> Complex:
    """Return the eigenvalues (k, n) of stacked matrices (k, n, n)."""
    shares = [loops[k : k + SHARE] for k in range(0, len(loops), SHARE)]
    result = [each.astype(complex) for each in _distributed(np.linalg.eigvals, shares)]
    return np.concatenate([np.zeros((0, loops.shape[-1]), dtype=complex), *result])


def eigensystems(loops: Sequence[Array] | Array) -> Iterator[tuple[Complex, Complex, Complex] | None]:
    """Yield the eigenvalues (n,), right and left eigenvectors (n, n) of each matrix (n, n), l r = I.

    None for a defective one.
    """
    return _distributed(_eigensystem, loops)


def _distributed(function: Callable[[Array], T], parts: Sequence[Array] | Array) -> Iterator[T]:
    """Yield the result of each part; one alone needs no thread, which costs as much as a small matrix."""
    if len(parts) < 2:
        yield from map(function, parts)
        return
    with ThreadPoolExecutor() as pool:
        yield from pool.map(function, parts)


def _eigensystem(loop: Array) -> tuple[Complex, Complex, Complex] | None:
    values, right = (each.astype(complex) for each in np.linalg.eig(loop))
    try:
        return values, right, np.linalg.inv(right)
    except np.linalg.LinAlgError:
        return None
