"""The page on what the commands write: `written.toml` says what each file and key is, runs show it."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pyarrow.parquet as pq

from interarea.design.controllers import bundled

WRITTEN = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
SHORT = 60  #: characters of an example


def keys_of(file: Path) -> dict[str, Any]:
    """Return key -> first value of a written file: keys of JSON and columns of tables."""
    if file.suffix == ".json":
        return dict(_flat(json.loads(file.read_text(encoding="utf-8"))))
    if file.suffix == ".csv":
        with file.open(encoding="utf-8", newline="") as lines:
            head, first = list(csv.reader(lines))[:2]
        return dict(zip(head, first, strict=True))
    table = pq.read_table(file).slice(0, 1).to_pydict()
    return {name: values[0] for name, values in table.items()}


def _flat(value: Any, before: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        value = value[0]
    if isinstance(value, Mapping) and value:
        for key, part in value.items():
            yield from _flat(part, f"{before}.{key}" if before else str(key))
    else:
        yield before, value


def covered_by(key: str, keys: Mapping[str, str]) -> str | None:
    """Return the entry that tells a key: its own, a pattern, or that of what it lies in."""
    for name in keys:
        parts = name.split(".")
        words = key.split(".")[: len(parts)]
        if len(words) == len(parts) and all(map(fnmatchcase, words, parts)):
            return name
    return None


def entry_of(path: str, command: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the entry of a file that a command wrote, by its path in the folder."""
    return next((file for file in command["file"] if fnmatchcase(path, file["path"])), None)


#: commands that take seconds, with the files of which the page has its examples
SAMPLES = {
    "run": ["run", "lost-signal"],
    "compare": ["compare", "none", "--scenario", "wide-area-damping"],
    "sweep": ["sweep", "{folder}/sweep.toml"],
    "screen": ["screen", "two-area-thesis", "--bus", "8"],
}
SWEEP = """scenario = "wide-area-damping"
parameters.latency = { path = "channels.*.latency_s", values = [0.1] }
trajectories.keep = "all"
"""


def samples_in(folder: Path) -> dict[str, Path]:
    """Return the folder of each command of `SAMPLES`, and that of two certificates of `robust`."""
    return {name: folder / name for name in (*SAMPLES, "design")}


def write_samples(folder: Path) -> dict[str, Path]:
    """Run the commands of `SAMPLES`; return `samples_in(folder)`."""
    (folder / "sweep.toml").write_text(SWEEP, encoding="utf-8")
    for name, words in SAMPLES.items():
        arguments = [word.format(folder=folder) for word in words]
        command = [sys.executable, "-m", "interarea", *arguments, "--out", str(folder / name)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{' '.join(arguments)}: {done.stderr}")
    record = json.loads(Path(bundled.__file__).with_name("robust.json").read_text(encoding="utf-8"))
    (folder / "design").mkdir()
    text = json.dumps(record["certificate"])
    (folder / "design" / "certificate.json").write_text(text, encoding="utf-8")
    anew = [sys.executable, "-m", "interarea", "certify", "robust", "--json"]  # what the record lacks yet
    done = subprocess.run(anew, capture_output=True, text=True, check=True)
    certificate = {key: value for key, value in json.loads(done.stdout).items() if key != "acceptance"}
    (folder / "design" / "anew.json").write_text(json.dumps(certificate), encoding="utf-8")
    return samples_in(folder)


def written_page() -> Iterator[str]:
    """Every file that a command writes, with its keys and an example of each.

    ``$INTERAREA_DOCS_SAMPLES`` names a folder in which `write_samples` has run before.
    """
    yield "# Written files"
    yield ""
    yield (
        "For those who read results by a program. After this page you know every file that a command "
        "writes, with every key and column. A file is complete or absent; numbers have all their digits. "
        "The examples are from a run of each command when this page was built; in names `*` matches any text."
    )
    before = os.environ.get("INTERAREA_DOCS_SAMPLES")
    with TemporaryDirectory() as place:
        samples = samples_in(Path(before)) if before else write_samples(Path(place))
        for command in WRITTEN["command"]:
            folder = samples.get(command["name"])
            yield from ("", f"## interarea {command['name']}", "")
            yield from ("| file | content |", "|---|---|")
            yield from (f"| `{file['path']}` | {file['what']} |" for file in command["file"])
            for file in command["file"]:
                if "keys" in file:
                    yield from _key_table(file, folder)
    yield from ("", "## The cache", "")
    yield (
        "Reusable results are in the user's cache folder (`INTERAREA_CACHE` names another). The name of each "
        "file is a hash of its inputs; its SHA-256 is stored with it. Anything may be deleted at any time; "
        "`interarea cache` shows and trims it."
    )
    yield from ("", "| folder | content |", "|---|---|")
    yield from (f"| `{name}` | {words} |" for name, words in WRITTEN["cache"].items())
    yield from ("", "Next: [guarantees for a full disk or a dead process](../promises.md).")


def _key_table(file: Mapping[str, Any], folder: Path | None) -> Iterator[str]:
    keys = {} if folder is None else keys_of(next(iter(sorted(folder.glob(file["path"])))))
    examples: dict[str, str] = {}
    for key, value in keys.items():
        name = covered_by(key, file["keys"])
        text = value if isinstance(value, str) else json.dumps(value, default=str)
        if name is not None and text and len(text) <= SHORT:
            examples.setdefault(name, f"`{text}`".replace("|", "\\|"))
    yield from ("", f"### {file['path']}", "", "| key | example | meaning |", "|---|---|---|")
    yield from (f"| `{name}` | {examples.get(name, '')} | {words} |" for name, words in file["keys"].items())
