"""C of the tests compiled by zig, which keeps in the cache what it makes of a platform's libraries."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from interarea.fmu_build.write.cache import COMPILERS_OWN
from interarea.fmu_build.write.compile import PLATFORMS, SYSTEM_LIBRARIES

LINUX = PLATFORMS["linux64"].targets[0]
_LAG = Path(__file__).parent / "conformance" / "blocks" / "lag_dll.c"


def zig_cc(words: Sequence[str], cache: Path, target: str = LINUX) -> None:
    """Run zig's C compiler on absolute paths.

    It compiles a platform's libraries for each set of flags, and once more when its own folder is below the
    current one: a hundred seconds of processor for Windows.
    """
    own = (cache / COMPILERS_OWN).absolute()
    folders = {"GLOBAL": own / SYSTEM_LIBRARIES, "LOCAL": own / "objects"}
    folders["LOCAL"].mkdir(parents=True, exist_ok=True)
    environment = {**os.environ} | {f"ZIG_{kind}_CACHE_DIR": str(path) for kind, path in folders.items()}
    command = [sys.executable, "-m", "ziglang", "cc", "-target", target, *words]
    subprocess.run(command, check=True, env=environment, cwd=folders["LOCAL"], capture_output=True)


def lag_dll(defect: str, folder: Path, cache: Path, *more: str) -> Path:
    """Return the lag of `lag_dll.c` compiled for Linux with a defect; `more`: flags in place of its code."""
    path = folder / f"{defect.lower()}.so"
    number = "NONE" if more else defect
    flags = ["-shared", "-fPIC", "-w", "-O1", *more, "-rtlib=none", f"-DDEFECT={number}", f"-DIS_{number}"]
    zig_cc([*flags, str(_LAG), "-o", str(path), "-lm"], cache)
    return path
