"""Freed memory stays with the process: blocks of a run are had again without new pages."""

from __future__ import annotations

import subprocess
import sys

import pytest

FAULTS = """
import resource
import numpy as np
from interarea.cosim.sweep.workers.malloc_tuning import keep_freed_memory
possible = {keep} and keep_freed_memory()
def once():
    a, b = np.ones(400_000), np.ones(300_000)
    return a[0] + b[0]
for _ in range(3):
    once()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    once()
print(int(possible), resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's malloc")
def test_blocks_that_were_freed_take_no_new_pages() -> None:
    done = subprocess.run(
        [sys.executable, "-c", FAULTS.format(keep=True)], capture_output=True, text=True, check=True
    )
    possible, faults = map(int, done.stdout.split())
    if not possible:
        pytest.skip("another C library")
    assert faults < 20 * 5_600_000 // 4096 // 10  # of all pages of all rounds, hardly any
