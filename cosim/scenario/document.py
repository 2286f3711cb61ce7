"""A scenario as the table of its file: what was given, and with all that was left to be found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .scenario import Scenario


def scenario_document(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario as the table of its file: what was given, the seeds it draws from, nothing more."""
    return scenario.model_dump(
        mode="json", exclude_unset=True, exclude_none=True, exclude={"folder", "rounded"}
    )


def resolved_document(scenario: Scenario) -> dict[str, Any]:
    """Return the table of a scenario that runs the same from any folder: files by their whole paths."""
    table = scenario_document(scenario)
    for key, path in (("case", scenario.case_path), ("controller", scenario.controller_path)):
        if isinstance(path, Path) and path.exists():
            table[key] = str(path.absolute())
    if scenario.detector is not None and scenario.detector.file:
        table["detector"]["file"] = str((scenario.folder / scenario.detector.file).absolute())
    for name, row in table.get("fmus", {}).items():
        row["file"] = str((scenario.folder / scenario.fmus[name].file).absolute())
    return table
