"""Wrong names that a run would tell, told before it is loaded: nothing here takes numpy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from interarea.design.controllers.bundled import FOLDER, shipped_names
from interarea.models.documents import parse_json, require_regular
from interarea.models.errors import Collected

from ..errors import ScenarioError
from ..scenario.names import grid_of, no_controller, two_machines, wrong_targets
from ..scenario.scenario import Scenario

_EXPECTED = {"case": "a case file", "controller": "a JSON file, an FMU or an IEEE/CIGRE DLL"}


def refuse_wrong_names(scenario: Scenario) -> None:
    """Raise what a run would of names that the case and the bundled controllers tell, before it loads numpy.

    Nothing where its FMUs may know of more that is wrong, which the run tells at once.

    Raises
    ------
    CaseError, ScenarioError : as `system_of`.
    """
    place, path = scenario.case_path, scenario.controller_path
    _require_regular_files(scenario)
    if not scenario.case or (isinstance(place, Path) and place.exists()):
        return
    case = grid_of(scenario.folder, scenario.case) if scenario.as_in_file else scenario.load_case()
    wrong = Collected()
    wrong.lines += wrong_targets(case, scenario.event, scenario.name)
    missing = path is not None and path.suffix != ".fmu" and not path.exists()
    wrong.lines += [no_controller(str(path))] if missing else []
    if scenario.swing is not None:
        with wrong:
            two_machines(scenario.swing, [m.name for m in case.machines])
    for name, channel in scenario.channels.items():
        with wrong:
            channel.parameters(f"{scenario.name}: channels.{name}")
    if wrong.lines and _checked_without_fmus(scenario, case, missing):
        raise ScenarioError(*wrong.lines)


def _require_regular_files(scenario: Scenario) -> None:
    """Raise ScenarioError where a case, controller or FMU that is named is a folder, a device or a pipe."""
    named = {"case": scenario.case_path, "controller": scenario.controller_path}
    named |= {f"fmus.{name}.file": scenario.folder / table.file for name, table in scenario.fmus.items()}
    for key, path in named.items():
        if isinstance(path, Path) and path.exists():
            require_regular(path, _EXPECTED.get(key, "an FMU"), ScenarioError, key=key)


def _checked_without_fmus(scenario: Scenario, case: Any, missing: bool) -> bool:
    """Whether no FMU has to be asked for what else is wrong; missing : there is no such controller."""
    keys = ("plant", "show", "record", "connections", "fmus", "concentrators")
    if scenario.master.joint or any(getattr(scenario, key) for key in keys):
        return False
    speeds, paths = {f"{m.name}_dw" for m in case.machines}, scenario.signals
    if not all(path.pmu is None and path.signal in speeds for path in paths):
        return False
    if missing or scenario.controller == "none":
        return True
    if scenario.controller not in shipped_names():
        return False
    inputs = set(parse_json((FOLDER / f"{scenario.controller}.json").read_bytes())["inputs"])
    return {path.signal for path in paths} <= inputs <= speeds
