"""What a word of a command names, told before what reads it is loaded: imports take seconds, names do not."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from interarea.models.bundled import bundled, bundled_elsewhere, meant
from interarea.models.case.document import case_names
from interarea.models.detector_defaults import DETECTOR_WRITER
from interarea.models.documents import require_regular
from interarea.models.errors import CaseError
from interarea.models.importers.published import FORMATS, not_alone

from ..errors import ScenarioError, nearest


def scenario_file(source: str | Path) -> Path:
    """Return the file of a bundled scenario, or that a path means; it is not read.

    Raises
    ------
    ScenarioError : neither bundled nor a file, with the nearest names, or no regular file.
    """
    path, names = Path(source), bundled("scenario")
    if path.suffix or path.exists():
        if not path.exists():
            raise ScenarioError(f"{path}: no such scenario file{meant(str(path), 'scenario')}")
        require_regular(path, "a scenario file", ScenarioError)
        return path
    if path.name not in names:
        if (other := bundled_elsewhere(str(source), "scenario")) is not None:
            raise ScenarioError(f"{source} {other}")
        hint = meant(str(source), "scenario") or f"; {nearest(str(source), names)}"
        raise ScenarioError(f"scenario {str(source)!r} is neither a file nor bundled{hint}")
    return names[path.name]


def design_file(source: str | Path, *, also: Iterable[str] = ()) -> Path:
    """Return the file of a bundled design, or that a path means; ScenarioError as `scenario_file`.

    also : names that would do as well, for the message.
    """
    path, names = Path(source), bundled("design")
    if str(source) in names:
        return names[str(source)]
    if not path.suffix and not path.exists():
        what = bundled_elsewhere(str(source), "design")
        hint = meant(str(source), "design") or f"; {nearest(str(source), [*names, *also])}"
        what = what or f"is neither a file nor bundled{hint}"
        raise ScenarioError(f"design {str(source)!r} {what}")
    require_regular(path, f"a design file{meant(str(source), 'design')}", ScenarioError)
    return path


def study_file(name: str) -> Path:
    """Return the file of a bundled study, or that a name ending in .toml means.

    Raises
    ------
    ScenarioError : neither, with the nearest studies and grids, or no regular file.
    """
    path, names = Path(name), bundled("study")
    if name in names:
        return names[name]
    if name.endswith(".toml"):
        hint = meant(name, "study") or meant(name, "case")
        require_regular(path, f"a file of a study or a case{hint}", ScenarioError)
        return path
    if (other := bundled_elsewhere(name, "study")) is not None:
        raise ScenarioError(f"{name} {other}")
    if path.is_file():
        raise ScenarioError(
            f"{name}: not a study (.toml) and not a grid, allowed: {FORMATS}{not_alone(path)}"
        )
    hint = meant(name, "study") or f"; {nearest(name, [*names, *case_names()])}"
    raise ScenarioError(f"study {name!r} is not a bundled study, grid or file{hint}")


def require_subject(name: str) -> None:
    """Require a scenario or a case, bundled or a file; ScenarioError as `scenario_file`."""
    cases, scenarios = case_names(), bundled("scenario")
    if name in scenarios or name in cases:
        return
    if not Path(name).exists():
        raise ScenarioError(
            f"{name!r} is neither a file nor a bundled scenario or case; "
            f"{nearest(name, [*scenarios, *cases])}"
        )
    require_regular(Path(name), "a scenario or case file", ScenarioError)


def require_text(name: str) -> None:
    """Require a regular file, which is not read. Raises CaseError."""
    require_regular(Path(name), "a text file", CaseError)


def require_detector(name: str) -> None:
    """Require a regular file, which is not read. Raises ScenarioError."""
    require_regular(Path(name), f"the file of a detector; {DETECTOR_WRITER}", ScenarioError)
