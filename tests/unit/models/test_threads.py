"""Linear algebra on one thread, wherever the libraries of this process lie."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

_USED = """
import ctypes, os, sys
import numpy
from interarea.models.threads import one_blas_thread, one_thread
ctypes.CDLL(os.fsencode(sys.argv[1]))
with one_thread(), one_blas_thread():
    print(numpy.linalg.det(numpy.eye(3)))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are bytes on Linux")
def test_a_library_below_a_folder_whose_name_is_no_utf_8(tmp_path: Path) -> None:
    """As those of FMUs in a cache there; threadpoolctl 3.6 ends on it with a UnicodeDecodeError."""
    import _ctypes

    folder = Path(os.fsdecode(os.fsencode(tmp_path / "x") + b"\xff"))
    folder.mkdir()
    library = shutil.copy(_ctypes.__file__, folder / "library.so")
    done = subprocess.run([sys.executable, "-c", _USED, library], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "1.0\n"), done.stderr
