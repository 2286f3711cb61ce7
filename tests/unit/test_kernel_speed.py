"""What stepping costs, with room for a busy machine; benchmarks/bench_master.py has the numbers."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks" / "bench_master.py"


@pytest.mark.slow
def test_the_kernel_keeps_up_with_a_plain_c_loop_and_the_loop_with_its_plant(tmp_path: Path) -> None:
    """Microseconds per step and FMU of a chain of ten, and a closed loop against its plant alone."""
    out = tmp_path / "times.json"
    command = [
        sys.executable,
        str(BENCHMARK),
        "--no-peers",
        "--chains",
        "10",
        "--rounds",
        "5",
        "--json",
        str(out),
    ]
    subprocess.run(command, check=True, capture_output=True)
    times = json.loads(out.read_text(encoding="utf-8"))
    chain, study = times["chains_us"]["10"], times["study_ms"]
    assert chain["interarea kernel, cubic inputs"] <= 0.15
    assert chain["interarea kernel, inputs held"] <= 5.0 * chain["plain C loop"]
    assert chain["interarea Python, inputs held"] <= 2.0 * 3.5
    assert study["closed loop: rerun"] <= 1.4 * study["plant alone: rerun"]
