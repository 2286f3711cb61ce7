"""Public functions that simulate: one scenario, many of them, and results read back."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from interarea.cosim.errors import ScenarioError, SweepError
from interarea.cosim.results.result import Result
from interarea.cosim.run.controllers import controller_of
from interarea.cosim.run.run import run_scenario, run_system
from interarea.cosim.scenario.scenario import Scenario, load_scenario
from interarea.cosim.scenario.signal_paths import ChannelTable
from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller, ControllerError
from interarea.design.linear.systems import SystemLike
from interarea.fmu_build.write.cache import default_cache
from interarea.grids import case_like
from interarea.models.arguments import kind_of
from interarea.models.mistakes import mistakes
from interarea.progress import Report, notebook_bars, silent, tell_runs
from interarea.shown import Comparison, SweepResults

if TYPE_CHECKING:
    from interarea.cosim.sweep.front import Progress
    from interarea.models.case.case import Case


class Channel(ChannelTable):
    """Delay and loss of a signal: the keys of `[channels.NAME]` in a scenario file.

    For the `channels` of a scenario given as a dict, and for `System.channel`.

    Raises
    ------
    UserError : an unknown key or an invalid value.

    Examples
    --------
    >>> Channel(signal="G2_dw", latency_s=0.1).latency_s
    0.1
    """

    def __init__(self, **keys: Any) -> None:
        try:
            super().__init__(**keys)
        except ValidationError as error:
            raise ScenarioError(*(f"Channel: {line}" for line in mistakes(error, ChannelTable))) from None


def simulate(
    scenario: str | Path | Mapping[str, Any],
    *,
    case: Case | str | Path | None = None,
    controller: Controller | ControllerBank | SystemLike | str | Path | None = None,
    progress: Callable[[float, float], object] | None = None,
) -> Result:
    """Co-simulate a scenario; return trajectory, metrics and delay ledger.

    The result of a scenario with a case is a `Run`: ``run.data``, ``run["plant.G2_dw"]``, ``run.metrics``,
    ``run.ledger``, ``run.plot()``, ``run.save(folder)``.

    Parameters
    ----------
    scenario : TOML file, bundled name (``interarea list``), or a dict of the same keys.
    case : replaces the case of the scenario: a `Case`, a bundled name or a file.
    controller : replaces that of the scenario: an object, a `control.StateSpace` (u = +K y; inputs named by
        signal, speeds in rad/s; outputs by actuator, pu), a name (``"none"``: none), a JSON file or any FMU.
    progress : called with (present time, stop time), s; without it a notebook shows a bar.

    Raises
    ------
    UserError : an error in the scenario. StepError : an FMU failed; has the trajectory so far.

    Examples
    --------
    >>> run = simulate("lost-signal")
    >>> run.stable
    True
    """
    loaded, grid = _scenario_on(scenario, case)
    if controller is not None:
        if not isinstance(controller, Controller | ControllerBank | str | Path):
            controller = Controller.of(controller)
        if not loaded.case:
            raise ScenarioError(f"{loaded.name}: a controller needs a case; name one (case = ...)")
    with notebook_bars((loaded.name,)) as report:
        if progress is None and report is not None:
            progress = partial(_tell_time, report, loaded.name)
        if not loaded.case:
            return run_system(loaded, progress=progress)
        return run_scenario(loaded, case=grid, controller=controller, progress=progress)


def _scenario_on(
    scenario: str | Path | Mapping[str, Any] | Scenario, case: Case | str | Path | None
) -> tuple[Scenario, Case | None]:
    """Return a scenario on another case than its own, and that case; None without one."""
    if case is None:
        return load_scenario(scenario), None
    grid = case_like(case)
    if isinstance(scenario, Mapping):
        scenario = {**scenario, "case": grid.name}
    loaded = load_scenario(scenario, frequency_hz=grid.frequency_hz)
    return loaded.model_copy(update={"case": grid.name}), grid


def _tell_time(report: Report, stage: str, now_s: float, end_s: float) -> None:
    report(stage, now_s / end_s, f"{now_s:.1f} of {end_s:g} s")


def compare(
    controllers: Sequence[Controller | ControllerBank | SystemLike | str | Path],
    scenario: str | Path | Mapping[str, Any] = "wide-area-damping",
    *,
    case: Case | str | Path | None = None,
    progress: Callable[[str, float], object] | None = None,
) -> Comparison:
    """Run one scenario with several controllers, and track the roots of each loop over latency.

    As the command ``interarea compare`` does.

    Parameters
    ----------
    controllers : each as in `simulate`, also ``"none"``.
    scenario, case : as in `simulate`.
    progress : called with the controller and the completed share; without it a notebook shows bars.

    Raises
    ------
    UserError : an error in the scenario or in a controller, a name given twice. StepError : an FMU failed.

    Examples
    --------
    >>> found = compare(["none", "robust"], "lost-signal")
    >>> found.to_frame().least_damping_ratio.round(3).to_dict()
    {'none': 0.081, 'robust': 0.245}
    """
    from interarea.cosim.designs.worth import worth_at
    from interarea.cosim.run.compare import compare_controllers, compared_name, folder_from

    if isinstance(controllers, str | Path | Controller | ControllerBank):
        raise ScenarioError(f"controllers: is {kind_of(controllers)}, wanted a list of controllers")
    loaded, grid = _scenario_on(scenario, case)
    several = [
        one if isinstance(one, Controller | ControllerBank | str | Path) else Controller.of(one)
        for one in controllers
    ]
    with notebook_bars([compared_name(one) for one in several]) as report:
        rows = compare_controllers(
            loaded, several, case=grid, cache=default_cache(), progress=progress or report or silent
        )
    on_case = loaded.load_case() if grid is None else grid
    late = {c.signal: c.latency_s for c in loaded.channels.values()}
    sentences = {}
    for one in several:
        try:
            judged = controller_of(one, on_case, default_cache(), folder=folder_from(loaded, one))
        except ControllerError:
            continue  # an FMU that is no controller of ours: its gains are not known
        if isinstance(judged, Controller):
            sentences[judged.name] = worth_at(on_case, judged, default_cache(), latency_s_of=late).sentence
    return Comparison(loaded, tuple(rows), sentences)


def sweep(
    spec: str | Path | Mapping[str, Any],
    *,
    out: str | Path,
    workers: int | None = None,
    scheduler: str | None = None,
    large: bool = False,
    progress: Callable[[Progress], object] | None = None,
) -> SweepResults:
    """Run a scenario over many parameters; runs with results in `out` are not repeated.

    Parameters
    ----------
    spec : sweep file, or a dict of the same keys.
    out : folder of the results.
    workers : processes; default one for each core. scheduler : address of a dask scheduler instead.
    large : confirm a very large number of runs.
    progress : called with the progress of the sweep; without it a notebook shows a bar.

    Raises
    ------
    UserError : an error in the sweep, or `out` contains another sweep.

    Examples
    --------
    >>> found = sweep(
    ...     {
    ...         "scenario": "ring-down",
    ...         "parameters": {"size": {"path": "event.1.size_pu", "values": [0.02, 0.04]}},
    ...     },
    ...     out="sweep",
    ...     workers=1,
    ... )
    >>> list(found.to_frame()["stable"])
    [True, True]
    """
    from interarea.cosim.sweep.front import run_sweep

    with notebook_bars(("runs",)) as report:
        if progress is None and report is not None:
            progress = partial(tell_runs, report)
        run_sweep(spec, Path(out), workers=workers, scheduler=scheduler, large=large, progress=progress)
    return read_sweep(out)


def read_sweep(folder: str | Path) -> SweepResults:
    """Return the results of a sweep that are in a folder.

    Raises
    ------
    UserError : no results in the folder.

    Examples
    --------
    >>> len(read_sweep("sweep").to_frame())  # the one made by `sweep`
    2
    """
    from interarea.cosim.sweep.parts import read_plan

    if not Path(folder).is_dir():
        raise SweepError(f"{folder}: no such folder, allowed: the folder of a sweep's results")
    read_plan(Path(folder))
    return SweepResults(Path(folder))
