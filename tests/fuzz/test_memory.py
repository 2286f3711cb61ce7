"""Memory over many lives of an instance: no growth, and valgrind finds nothing."""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path

import pytest
from fmu_blocks import blocks
from fuzz_build import build_driver, plain_compiler
from test_fuzz import SOURCES

KINDS = ("controller", "channel", "plant")
CYCLES = 100_000 if os.environ.get("INTERAREA_EVERY_FAULT") else 20_000  #: of the smallest block

pytestmark = pytest.mark.slow

VALGRIND = (
    "valgrind",
    "--error-exitcode=9",
    "--leak-check=full",
    "--errors-for-leak-kinds=all",
    "--show-leak-kinds=all",
    "--track-fds=no",
    "-q",
)


@pytest.mark.parametrize(("kind", "cycles"), [("controller", CYCLES), ("channel", 5_000), ("plant", 3_000)])
def test_create_simulate_free_does_not_grow(kind: str, cycles: int, tmp_path: Path) -> None:
    """Most for the smallest block; the FMI layer is the same for all."""
    if not sys.platform.startswith("linux"):
        pytest.skip("resident memory is read from /proc")
    said = build_driver(blocks()[kind], ("cycles.c",), plain_compiler(), tmp_path).run(cycles)
    match = re.search(r"(\d+) cycles, growth (-?\d+) kB, (-?\d+) files, (-?\d+) pieces", said)
    assert match is not None, said
    done, growth_kb, files, pieces = map(int, match.groups())
    assert (done, files, pieces) == (cycles, 0, 0)
    # one allocation in four cycles would show, its least being 32 bytes: a few pages are the C library's
    assert growth_kb <= 128, said


@pytest.mark.parametrize("kind", KINDS)
def test_valgrind_finds_nothing(kind: str, tmp_path: Path) -> None:
    if shutil.which("valgrind") is None:
        pytest.skip("valgrind is not installed (apt-get install valgrind)")
    cycles = build_driver(blocks()[kind], ("cycles.c",), plain_compiler(), tmp_path / "cycles")
    assert re.search(r"30 cycles, growth -?\d+ kB, 0 files, 0 pieces", cycles.run(30, before=VALGRIND))
    fuzz = build_driver(blocks()[kind], SOURCES, plain_compiler(), tmp_path / "fuzz")
    assert re.search(r"[45]\d\d\d calls, \d+ ok", fuzz.run(7, 4000, before=VALGRIND))
