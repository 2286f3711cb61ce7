"""A sweep in a script as a newcomer writes it: no guard about the main module, or read from a pipe."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import interarea as ia
print("main", flush=True)
sizes = {"path": "event.1.size_pu", "values": [0.02, 0.04]}
found = ia.sweep({"scenario": "ring-down", "parameters": {"size": sizes}}, out="found", workers=2)
print(found.summary["stable"])
"""


@pytest.mark.slow
@pytest.mark.parametrize("piped", [False, True], ids=["script", "stdin"])
def test_workers_leave_the_script_alone_that_started_them(piped: bool, tmp_path: Path, cache: Path) -> None:
    (tmp_path / "mine.py").write_text(SCRIPT, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, *([] if piped else ["mine.py"])],
        input=SCRIPT if piped else None,
        cwd=tmp_path,
        env={**os.environ, "INTERAREA_CACHE": str(cache)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["main", "2"], done.stderr
    assert "Traceback" not in done.stderr
