"""The table of modes of the fetched grids in grids.md; running this file fetches them and writes it."""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

PAGE = Path(__file__).resolve().parents[1] / "grids.md"
GRIDS = ("wecc-179", "npcc", "nordic-44")
_HEAD = "| grid | mode | frequency (Hz) | damping ratio | takes part most |\n|---|---|---|---|---|\n"
_LEAST = re.compile(r"^The least damped mode of all of `wecc-179` is at .*$", re.MULTILINE)


def modes_of(case: Path, band: str, below: str) -> list[dict[str, Any]]:
    """Return the modes of a case as `interarea modes --json` has them."""
    words = ["modes", str(case), "--band", band, "--below", below, "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "interarea", *words], capture_output=True, text=True, check=True
    )
    return list(json.loads(done.stdout)["modes"])


def row(mode: dict[str, Any]) -> str:
    """Return the cells of a mode; of identical machines at one bus their bus."""
    machines = list(dict.fromkeys(name.partition(".")[0] for name in mode["participation"]))
    most = machines[0]
    stem = most.rpartition("_")[0]
    if stem and machines[1].rpartition("_")[0] == stem:
        most = f"{stem} (all equal)"
    return f"{mode['name']} | {mode['frequency_hz']:.4f} | {mode['damping_ratio']:.4f} | {most}"


def tables(folder: Path) -> tuple[str, str]:
    """Import the grids into `folder`; return the rows of the table and the sentence below it."""
    rows, least = [], ""
    for grid in GRIDS:
        case = folder / f"{grid}.toml"
        subprocess.run(
            [sys.executable, "-m", "interarea", "import", grid, "--out", str(case)],
            capture_output=True,
            check=True,
        )
        for k, mode in enumerate(modes_of(case, "0.1:0.9", "0.2")):
            rows.append(f"| {f'`{grid}`' if k == 0 else ''} | {row(mode)} |".replace("|  |", "| |"))
        if grid == "wecc-179":
            mode = min(modes_of(case, "0.1:3", "0.05"), key=lambda m: m["damping_ratio"])
            machine = next(iter(mode["participation"])).partition(".")[0]
            least = (
                f"The least damped mode of all of `wecc-179` is at {mode['frequency_hz']:.4f} Hz "
                f"(damping ratio {mode['damping_ratio']:.4f}, machine {machine})."
            )
    return "\n".join(rows), least


def main() -> None:
    """Write the table and the sentence into the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    with TemporaryDirectory() as folder:
        rows, least = tables(Path(folder))
    before, _, after = PAGE.read_text(encoding="utf-8").partition(_HEAD)
    rest = after[after.index("\n\n") :]
    PAGE.write_text(before + _HEAD + rows + _LEAST.sub(least, rest), encoding="utf-8")


if __name__ == "__main__":
    main()
