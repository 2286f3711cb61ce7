"""What a run was made from, kept beside its results: the resolved scenario, versions, seeds, commit."""

from __future__ import annotations

import hashlib
import json
import platform
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from interarea.fmu_build.write.cache import numerics_versions
from interarea.fmu_build.write.description_xml import product_version
from interarea.models.case.write_toml import toml_text
from interarea.models.files import write_whole

from ..scenario.document import resolved_document
from ..scenario.names import NAMED_CONTROLLERS

if TYPE_CHECKING:
    from interarea.models.case.case import Case

    from ..scenario.scenario import Scenario

_PACKAGE = Path(__file__).resolve().parents[2]


def record_of(scenario: Scenario, case: Case | None) -> dict[str, Any]:
    """Return as JSON values what the numbers of a run depend on.

    Of the package and of the scenario's folder the commit where they are git checkouts, with ``-dirty``
    where files differ from it; of files the SHA-256.
    """
    path = scenario.controller_path
    files = {"controller": path} | {n: scenario.folder / f.file for n, f in scenario.fmus.items()}
    return {
        "scenario": scenario.name,
        "case": None if case is None else {"name": case.name, "hash": case.hash},
        "controller": scenario.controller,
        "files_sha256": {n: _sha256(f) for n, f in files.items() if f is not None and f.is_file()},
        "seeds": {n: line.seed for n, line in scenario.lines.items() if line.random},
        "versions": {"interarea": product_version(), "python": platform.python_version()}
        | numerics_versions(),
        "commit": _commits(scenario.folder),
    }


def scenario_text(scenario: Scenario) -> str:
    """Return the resolved scenario as TOML: `interarea run` of it runs the same again, from any folder."""
    lines = ["# The scenario that was run, with its random seeds; files have full paths."]
    path = scenario.controller_path
    if scenario.controller not in NAMED_CONTROLLERS and (path is None or not path.exists()):
        lines.append("# The controller was given from Python as an object: replace it by its file.")
    return "\n".join(lines) + "\n" + toml_text(resolved_document(scenario))


def write_record(folder: Path, scenario: Scenario, record: Mapping[str, Any]) -> list[Path]:
    """Write scenario.toml and run.json, which holds the record of `record_of`, into a folder; return them."""
    files = [folder / "scenario.toml", folder / "run.json"]
    write_whole(files[0], scenario_text(scenario))
    write_json(record, files[1])
    return files


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _commits(folder: Path) -> dict[str, str | None]:
    """Return the commits of the package and of a scenario's folder, which may be a checkout inside it."""
    own, folder = _commit(_PACKAGE), folder.resolve()
    inside = folder.is_relative_to(_PACKAGE)
    between = [
        p for p in (folder, *folder.parents) if inside and p.is_relative_to(_PACKAGE) and p != _PACKAGE
    ]
    same = inside and not any((p / ".git").exists() for p in between)
    return {"interarea": own, "scenario": own if same else _commit(folder)}


def _commit(folder: Path) -> str | None:
    """Return the commit that a folder is a checkout of; None where it is none, or there is no git."""
    command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None if done.returncode == 0 else None


def write_json(value: object, path: Path) -> None:
    """Write a value of JSON types, one line a leaf."""
    write_whole(path, json.dumps(value, indent=1, allow_nan=False) + "\n")
