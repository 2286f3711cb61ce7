"""Memory that a process frees stays its own: what one run of many gives back, the next needs again."""

from __future__ import annotations

import ctypes
import sys

_TRIM, _MMAP = -1, -3  # M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of glibc's malloc.h
_LARGEST, _SPARE = 1 << 25, 1 << 28  # bytes: the most glibc takes, and what may lie free at the heap's end


def keep_freed_memory() -> bool:
    """Let this process keep the blocks that it frees, up to 32 MiB each; return whether that is possible.

    By default glibc hands blocks of 128 KiB and more back to the system at once; getting them again, page by
    page, takes about a millisecond in each run of a sweep.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):  # another C library
        return False
    return bool(mallopt(_MMAP, _LARGEST)) and bool(mallopt(_TRIM, _SPARE))
