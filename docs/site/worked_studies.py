"""The tables of worked_studies.md: runs studies of grids by one command and writes their rows."""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from interarea.cosim.grid_study.page import sentence

PAGE = Path(__file__).resolve().parents[1] / "worked_studies.md"
#: bundled, and some that are downloaded where they are published; others are given by name
GRIDS = (
    *("two-area-thesis", "kundur-pss", "new-england", "nets-nyps", "npcc", "nordic-44", "wecc-179"),
    "wecc-240",
)
_TABLE = re.compile(r"(?<=<!-- studies -->\n).*?(?=<!-- end of studies -->)", re.DOTALL)
_HEAD = (
    "| grid: buses, machines | weakest inter-area mode | asked "
    "| local stabilizers: machines, inter-area, worst swing | loops | inter-area | worst swing "
    "| faults: lost, do not decay, of | clearing time (cycles), mean, worst "
    "| nothing lost: loop, own-signal rival |\n"
    f"|{'---|' * 10}\n"
)


def run_study(grid: str, minutes: float, folder: Path) -> dict[str, Any]:
    """Return what study.json of a grid holds, run into `folder` unless it is there."""
    done = folder / "study.json"
    if not done.is_file():
        words = ["study", grid, "--minutes", f"{minutes:g}", "--out", str(folder), "--quiet"]
        ended = subprocess.run([sys.executable, "-m", "interarea", *words], check=False)
        if ended.returncode not in (0, 1):  # 1: what is asked is not held
            raise SystemExit(f"interarea {' '.join(words)}: exit code {ended.returncode}")
    return dict(json.loads(done.read_text(encoding="utf-8")))


def row(name: str, study: Mapping[str, Any]) -> str:
    """Return the row of a study; a dash for each part that it has not."""
    inter_area = [m for m in study["modes"]["modes"] if m["name"].startswith("inter-area")]
    weakest = min(inter_area, key=lambda m: float(m["damping_ratio"]), default=None)
    certificate = study.get("certificate")
    cells = [
        f"`{name}`: {study['buses']}, {study['machines']}",
        "–" if weakest is None else f"{weakest['frequency_hz']:.2f} Hz, {weakest['damping_ratio']:.3f}",
        f"{study['asked']['inter_area']:.3f}" if "asked" in study else "–",
        _local(study.get("local")),
        _loops(study),
        *(_reached(certificate) if certificate else ["–"] * 4),
        _nothing_lost(study.get("worth")),
    ]
    return f"| {' | '.join(cells)} |\n"


def _reached(certificate: Mapping[str, Any]) -> list[str]:
    held = [f"{certificate['inter_area']:.3f}", f"{certificate['worst_swing']:.3f}"]
    faults = certificate["acceptance"]
    if faults is None:
        return [*held, "not run", "–"]
    mean, worst = faults["clearing_mean_change_cycles"], faults["clearing_worst_change_cycles"]
    changes = "–" if mean is None else f"{mean:+.1f}, {worst:+.1f}"
    return [*held, f"{len(faults['lost'])}, {len(faults['standing'])}, {faults['cases']}", changes]


def _nothing_lost(worth: Mapping[str, Any] | None) -> str:
    """Return the inter-area damping of the loop and of the best that sees own signals; a dash for none."""
    rows = [None if worth is None else worth.get(name) for name in ("whole", "rival")]
    return ", ".join("–" if row is None else f"{row['inter_area']:.3f}" for row in rows) if any(rows) else "–"


def _loops(study: Mapping[str, Any]) -> str:
    loops = ", ".join(part["actuator"] for part in study.get("parts", ())) or "–"
    installed = (study.get("local") or {}).get("installed")
    return f"{loops}; beside the stabilizers of {', '.join(installed)}" if installed else loops


def _local(local: Mapping[str, Any] | None) -> str:
    if local is None or local["certificate"] is None:
        return "–"
    held = local["certificate"]
    machines = ", ".join(one["machine"] for one in local["stabilizers"])
    return f"{machines}: {held['inter_area']:.3f}, {held['worst_swing']:.3f}"


def words(name: str, study: Mapping[str, Any]) -> str:
    """Return the conclusion of a study, or why it has none, and what it had no time for, as a list item."""
    problem = str(study["problem"]).removeprefix(f"{study['case']}: ")
    lines = [f"The study stopped: {problem}."] if study["problem"] else []
    if "local" in study:
        lines.append(sentence(study["local"]["sentence"]))
    if violations := (study.get("certificate") or {}).get("violations"):
        lines.append(f"Violated by the loop: {'; '.join(_kinds(violations))}.")
    if study["no_time_for"]:
        first, count = study["no_time_for"][0], len(study["no_time_for"])
        lines.append(f"{count} parts not computed within the time limit, first: {first}.")
    return f"- `{name}`: {' '.join(lines) or 'All requirements are met.'}\n"


def _kinds(violations: Sequence[str]) -> list[str]:
    """Return the first violation of each kind, and the number of similar ones."""
    kinds: dict[str, list[str]] = {}
    for line in violations:
        known = ("inter-area damping is", "non-linear faults", "fault at", "allowed decrease")
        kinds.setdefault(next((kind for kind in known if kind in line), line), []).append(line)
    return [lines[0] + (f" (and {len(lines) - 1} similar)" if lines[1:] else "") for lines in kinds.values()]


def tables(studies: Mapping[str, Mapping[str, Any]], before: str) -> str:
    """Return the table of studies and a sentence for each; grids without a study keep what `before` has."""
    rows = {m[1]: m[0] for m in re.finditer(r"^\| `(.+?)`:.*\n", before, re.MULTILINE)}
    lines = {m[1]: m[0] for m in re.finditer(r"^- `(.+?)`:.*\n", before, re.MULTILINE)}
    rows |= {name: row(name, study) for name, study in studies.items()}
    lines |= {name: words(name, study) for name, study in studies.items()}
    return f"{_HEAD}{''.join(rows.values())}\n{''.join(lines.values())}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the studies and write their tables into the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("grids", nargs="*", default=GRIDS, help=f"default: {' '.join(GRIDS)}")
    parser.add_argument("--out", type=Path, required=True, help="folder of studies; those there are kept")
    parser.add_argument("--minutes", type=float, default=20.0, help="of each study")
    options = parser.parse_args(arguments)
    studies = {grid: run_study(grid, options.minutes, options.out / grid) for grid in options.grids}
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(_TABLE.sub(lambda part: tables(studies, part[0]), text), encoding="utf-8")


if __name__ == "__main__":
    main()
