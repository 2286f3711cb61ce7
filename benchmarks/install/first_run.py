"""How long the first runs of an installation take: a bundled scenario, caches empty and warm.

    pip wheel --no-deps --wheel-dir out/wheel . && pip install out/wheel/interarea-*.whl
    python benchmarks/install/first_run.py [--runs 5]

with the Python into which the wheel was installed, from another folder than a checkout's root. Wall and
processor time of whole processes, medians, beside the import of what a run stands on. Empty: a new cache
folder each time; byte code is compiled, as pip leaves it. Exit code 1 when the processor time, which other
work on the machine disturbs less, is above what is wanted.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

PLAIN = [sys.executable, "-m", "interarea", "run", "ring-down"]
RUN = [*PLAIN, "--out", "out"]  # trajectory, ledger, plot and report as well
LIBRARIES = "import typer, pydantic, scipy.linalg, matplotlib.backends.backend_svg, pyarrow.parquet, jinja2"
#: what is measured -> command, whether with a cache of its own, processor time wanted (s)
ROWS = {
    "its libraries imported": ([sys.executable, "-c", LIBRARIES], False, None),
    "run, caches empty": (PLAIN, True, 8.0),
    "run, caches warm": (PLAIN, False, 2.5),
    "run --out, caches empty": (RUN, True, 8.0),
    "run --out, caches warm": (RUN, False, 2.5),
}


def seconds(command: list[str], folder: Path, cache: Path) -> tuple[float, float]:
    """Return wall and processor time of a process, s."""
    settings = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    settings["INTERAREA_CACHE"] = str(cache)
    subprocess.run(command, cwd=folder, env=settings, capture_output=True, check=True)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> int:
    """Print the table; return 1 when more is taken than wanted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs
    place = find_spec("interarea.fmu_build")
    wheel = place is not None and (Path(str(place.origin)).parent / "binaries").is_dir()
    print("of a wheel" if wheel else "of a checkout, which compiles what a wheel brings")
    times: dict[str, list[tuple[float, float]]] = {what: [] for what in ROWS}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for command, _, _ in ROWS.values():  # byte code, the file system's cache
            seconds(command, folder, folder / "cache")
        for k in range(runs):
            for what, (command, empty, _) in ROWS.items():
                times[what].append(
                    seconds(command, folder, folder / (f"new {k} {what}" if empty else "cache"))
                )
    missed = False
    print(f"{'median of ' + str(runs):<24} {'wall s':>7} {'processor s':>11} {'wanted':>6}")
    for what, rows in times.items():
        wall, processor = (statistics.median(column) for column in zip(*rows, strict=True))
        limit = ROWS[what][2]
        missed |= limit is not None and not processor <= limit
        print(f"{what:<24} {wall:7.2f} {processor:11.2f} {limit or '':>6}")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
