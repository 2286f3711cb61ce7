"""pytest plugin: the fixture `scenario` runs a scenario once per test run.

    def test_damped(scenario):
        run = scenario("lost_signal.toml")
        assert run.damping_ratio("inter-area") > 0.25

A file name is searched beside the test file, then in the folder where pytest runs, then among the bundled
scenarios; a dict has the keys of a scenario file. FMUs and designs are stored in ``$INTERAREA_CACHE`` or the
user's cache folder.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:  # imported when a test asks for a run: a plugin must not slow down every pytest
    from interarea.cosim.results.run import Run
    from interarea.cosim.scenario.scenario import Scenario

RunScenario = Callable[..., "Run"]


@pytest.fixture(scope="session")
def _scenario_runs() -> dict[str, Run]:
    """Runs of this session by content."""
    return {}


@pytest.fixture
def scenario(request: pytest.FixtureRequest, _scenario_runs: dict[str, Run]) -> RunScenario:
    """Return a function that runs a scenario (file, bundled name or dict) once and returns its `Run`."""

    def run(source: str | Path | Mapping[str, Any] | Scenario) -> Run:
        __tracebackhide__ = True  # a failing test shows its own lines
        from interarea.cosim.errors import ScenarioError
        from interarea.cosim.run.run import run_scenario
        from interarea.cosim.scenario.scenario import load_scenario

        if isinstance(source, str | Path):
            beside = Path(request.path).parent / source
            if not beside.is_file() and Path(source).suffix and not Path(source).exists():
                raise ScenarioError(
                    f"{source}: no such scenario file, neither beside {request.path.name} nor in {Path.cwd()}"
                )
            source = beside if beside.is_file() else source
        try:
            loaded = load_scenario(source)
        except ScenarioError as error:
            raise error.with_traceback(None) from None
        key = json.dumps([loaded.model_dump(mode="json"), _stamp(loaded)], sort_keys=True, default=str)
        if key not in _scenario_runs:
            _scenario_runs[key] = run_scenario(loaded)
        return _scenario_runs[key]

    return run


def _stamp(loaded: Scenario) -> list[str]:
    """Return the bytes of the files a scenario refers to, so that a changed file is run again."""
    paths = [
        p for p in (loaded.controller_path, Path(loaded.case_path)) if p is not None and Path(p).is_file()
    ]
    return [Path(p).read_bytes().hex() for p in paths]
