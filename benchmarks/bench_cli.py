"""How soon the command line answers: ratios to what it is built on and to peers, in one run.

    python benchmarks/bench_cli.py [--runs 9]

Each line is the median of processes started in turn, so that a busy moment hits all of them. Peers that are
not installed are left out; `modes` is measured with its linear model in the cache. Exit code 1 when a ratio
is above what is wanted.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PYTHON = sys.executable
#: scenarios with a mistake: in a key, in a name that the schema does not know, in the language
MISTAKES = {
    "KEY": 'case = "two-area-thesis"\nstop_s = 2.0\nstp_s = 0.01\n',
    "NAME": 'case = "two-area-thesis"\ncontroller = "robst"\nstop_s = 2.0\n',
    "TOML": 'case = "two-area-thesis"\nstop_s = = 2.0\n',
}
#: name -> (command, what it is measured against, wanted ratio)
BASES = {
    "typer, rich": [PYTHON, "-c", "import typer, rich"],
    "typer, rich, pydantic": [PYTHON, "-c", "import typer, rich, pydantic"],
    # `import pydantic` loads next to nothing of it; what the check of a table with one number takes
    "typer, rich, one pydantic model": [
        *(PYTHON, "-c"),
        "import typer, rich; from pydantic import create_model; create_model('T', x=float)(x=1.0)",
    ],
    "scipy.linalg, pandas": [PYTHON, "-c", "import scipy.linalg, pandas"],
}
OURS = {
    "interarea --version": ("typer, rich", 1.5),
    "interarea --help": ("typer, rich", 1.5),
    "interarea list": ("typer, rich", 1.5),
    **{f"interarea run {name}.toml --out out": ("typer, rich, pydantic", 1.5) for name in MISTAKES},
    "interarea modes two-area-thesis": ("scipy.linalg, pandas", 2.0),
}
PEERS = {"andes": ["andes", "--version"], "fmpy": [PYTHON, "-m", "fmpy", "--help"]}


def seconds(command: list[str], folder: Path) -> float:
    """Return how long a process takes, s; its exit code does not matter."""
    start = time.perf_counter()
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    subprocess.run(command, capture_output=True, cwd=folder, check=False, env=environment)
    return time.perf_counter() - start


def main() -> int:
    """Print the table; return 1 when a ratio is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=9)
    runs = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, text in MISTAKES.items():
            (folder / f"{name}.toml").write_text(text, encoding="utf-8")
        commands = dict(BASES)
        commands |= {ours: [PYTHON, "-m", *ours.split()] for ours in OURS}
        for module, command in PEERS.items():
            if importlib.util.find_spec(module):
                beside = Path(PYTHON).with_name(Path(command[0]).name)
                full = [str(beside) if beside.exists() else command[0], *command[1:]]
                commands[" ".join(command).replace(f"{PYTHON} -m ", "")] = full
        for command in commands.values():  # byte code, cache, page cache
            seconds(command, folder)
        times: dict[str, list[float]] = {what: [] for what in commands}
        for _ in range(runs):
            for what, command in commands.items():
                times[what].append(seconds(command, folder))
    medians = {what: statistics.median(values) for what, values in times.items()}
    missed = False
    print(f"{'command':<40} {'median s':>9} {'ratio':>6} {'wanted':>6}  against")
    for what, median in medians.items():
        if what not in OURS:
            print(f"{what:<40} {median:9.3f}")
            continue
        base, limit = OURS[what]
        ratio = median / medians[base]
        missed |= not ratio <= limit
        print(f"{what:<40} {median:9.3f} {ratio:6.2f} {limit:6.1f}  {base}")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
