"""What runs of faults take of the memory outside of Python: given back with each run."""

from __future__ import annotations

import ctypes
import gc
import sys

import pytest

from interarea.cosim.designs.fault_runs import FaultRun, FaultRuns
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case
from interarea.synthesis import load_controller

STATE_BYTES = 20_000  # of a plant's saved state: a loop of plant and controller saves one each step


class _Heap(ctypes.Structure):
    """`struct mallinfo2` of glibc; the eighth number is what is in use."""

    _fields_ = [(f"n{k}", ctypes.c_size_t) for k in range(10)]


def in_use() -> int:
    """Return the bytes in use on the heap of C."""
    if not sys.platform.startswith("linux") or not hasattr(libc := ctypes.CDLL(None), "mallinfo2"):
        pytest.skip("only glibc tells how much is in use")
    libc.mallinfo2.restype = _Heap
    gc.collect()
    return int(libc.mallinfo2().n7)


@pytest.mark.slow
def test_runs_give_back_the_states_of_their_loops() -> None:
    case, controller = load_case("two-area-thesis"), load_controller("robust")
    pulse = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.1, "end_s": 0.2}
    runs = [FaultRun((pulse,), 0.5, controller)] * 8
    used = []
    for _ in range(4):
        with FaultRuns(case, default_cache()) as there:
            there.outcomes(runs, [None] * len(runs))
        used.append(in_use())
    assert used[3] - used[1] < len(runs) * STATE_BYTES
