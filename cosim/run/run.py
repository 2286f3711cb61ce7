"""Run a scenario: case and controller to FMUs, FMUs and channels to a closed loop, the loop to numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.open.ports import DLL_SUFFIXES, Description
from interarea.models.blocks.plant import event_parameters
from interarea.models.case.case import Case
from interarea.models.errors import Collected
from interarea.models.files import together

from ..errors import ScenarioError, StepError, nearest
from ..results.result import Result
from ..results.ringdown import Swing
from ..results.run import METRICS_FILES, Run
from ..results.trajectory_files import TrajectoryFiles, chosen
from ..scenario.names import wrong_targets
from ..scenario.scenario import FmuTable, Scenario, load_scenario
from ..scenario.signal_paths import SignalPath
from ..trajectory import Trajectory
from .artefacts import growth_at_rest
from .controllers import ControllerLike, controller_of
from .detector import add_detector, flags
from .instance import Fmus, Instance
from .scenario_warnings import designed_for_another_case, outputs_used, times_past_the_end
from .swing_signal import swing_of
from .system import CONTROLLER, PLANT, System


def run_scenario(
    scenario: Scenario | str | Path | Mapping[str, Any],
    *,
    case: Case | None = None,
    controller: ControllerLike | None = None,
    cache: Path | None = None,
    progress: Callable[[float, float], object] | None = None,
) -> Run:
    """Run a scenario (a `Scenario`, a TOML file, a bundled name or a dict) and return what it did.

    Parameters
    ----------
    case, controller : in place of those that the scenario names; a controller as `controller_of` takes it.
    cache : folder of FMUs and designs; default `default_cache()`.
    progress : called with (present time, stop time), s.

    Raises
    ------
    ScenarioError, CaseError : a mistake in the scenario. StepError : an FMU failed, with the results so far.
    A `ScenarioWarning` names what is probably unintended: `Run.warnings`.
    """
    loaded = load_scenario(scenario)
    if not loaded.case:
        raise ScenarioError(f"{loaded.name}: case is missing; run_system runs FMUs without one")
    done = run_system(loaded, case=case, controller=controller, cache=cache, progress=progress)
    assert isinstance(done, Run)
    return done


def run_system(
    scenario: Scenario | str | Path | Mapping[str, Any],
    *,
    case: Case | None = None,
    controller: ControllerLike | None = None,
    cache: Path | None = None,
    progress: Callable[[float, float], object] | None = None,
) -> Result:
    """Run any scenario: a `Run` when it has a case, else a plain `Result`. Parameters as `run_scenario`."""
    loaded = load_scenario(scenario)
    _refuse_joint(loaded)
    system = _with_warnings(system_of(loaded, case=case, controller=controller, cache=cache))
    if controller is not None and system.swing is not None:
        description = _description_of_controller(system)
        name = "none" if description is None else description.title
        system.scenario = loaded.model_copy(update={"controller": name})  # results tell what ran
    return system.run(progress=progress)


def write_run(
    scenario: Scenario | str | Path | Mapping[str, Any],
    folder: Path,
    *,
    cache: Path | None = None,
    progress: Callable[[float, float], object] | None = None,
    explorer: str = "",
) -> tuple[Result, list[Path]]:
    """Run any scenario and write its files, the trajectory while it runs: any length fits in memory.

    All files get their names at the end, or after an error none.

    The result's trajectory is what its figure needs: the whole is in the files.
    explorer : see `Run.save`.

    Raises
    ------
    As `run_system`; DestinationError : a file that cannot be written. StepError : an FMU failed, or ended
    the run; what there is up to then has been written, without metrics, and the message says where.
    """
    loaded = load_scenario(scenario)
    _refuse_joint(loaded)
    system = _with_warnings(system_of(loaded, cache=cache))

    def take(part: Trajectory) -> None:
        files.add(part)
        gathered.add(part)

    with together():
        with (
            TrajectoryFiles(folder, loaded.record, loaded.every) as files,
            system.master(sink=take) as master,
        ):
            gathered, failed = system.gathered(master), None
            try:
                master.advance(progress=progress)
            except StepError as error:
                if master.index < 0:
                    raise  # there is nothing to write
                take(master.trajectory)
                failed = error
            result = system.result(master, gathered, failed)
        written = [*files.files, *result.save_beside(folder, explorer)]
    if failed is None:
        return result, written
    for name in METRICS_FILES:
        (folder / name).unlink(missing_ok=True)  # of an earlier run
    until = f"results up to t = {float(result.trajectory.time_s[-1]):.9g} s are in {folder}"
    failed.args = (f"{failed}; {until}",)
    raise failed


def _with_warnings(system: System) -> System:
    """Give the warnings of a system; a case that is unstable at rest is one of them."""
    if PLANT in system.parts:
        growth = growth_at_rest(system.case, system.fmus.cache)
        if growth is not None and not growth.stable:
            system.warnings.append(
                f"case {system.case.name}, at the equilibrium and without a controller: {growth.text}"
            )
    return system.warned()


def _refuse_joint(scenario: Scenario) -> None:
    if scenario.master.joint:
        raise ScenarioError(
            f"{scenario.name}: master.joint = true requests one block without a master; run it by "
            "`interarea run` or cosim.export.joint.run_joint, or remove the key"
        )


def system_of(
    scenario: Scenario,
    *,
    cache: Path | None = None,
    controller: ControllerLike | None = None,
    case: Case | None = None,
    swing: Swing | None = None,
    fmus: Fmus | None = None,
) -> System:
    """Return the system of a scenario: signal -> channel -> controller -> plant, its own FMUs beside.

    controller : in place of the one it names (`controller_of`). case : in place of the one it names, as
        the runs of a sweep change it. swing : what to judge runs by; default `swing_of` the case.

    Raises
    ------
    ScenarioError, CaseError : an unknown signal, a channel to an input that does not exist, too many
        outages. GraphError : an FMU or connection that does not fit.
    """
    system = System(
        stop_s=scenario.stop_s,
        step_s=scenario.step_s,
        cache=cache,
        arrivals=scenario.master.arrivals,
        strict=scenario.strict,
        **scenario.master.options,
    )
    if fmus is not None:
        system.fmus = fmus
    system.warnings += times_past_the_end(scenario)
    wrong = Collected()
    system.scenario, system.rounded = scenario, list(scenario.rounded)
    if scenario.case:
        case = scenario.load_case() if case is None else case
        wrong.lines += wrong_targets(case, scenario.event, scenario.name)
        with wrong:
            event_parameters(case, [] if wrong.lines else scenario.event)  # refuses trips that cut the grid
        if unknown := _unknown_buses(scenario, case):
            raise ScenarioError(*wrong.lines, *unknown)  # there is no plant with these outputs
        system.events[PLANT] = list(scenario.event)
        system.plant(case, show=scenario.shows)
        which = scenario.controller_path or scenario.controller if controller is None else controller
        with wrong:
            _start_plant(system, scenario)
        with wrong:
            result = _add_controller(system, scenario, which)
            system.warnings += designed_for_another_case(result, case)
        with wrong:
            system.swing = swing or swing_of(case, system.fmus.cache, scenario.swing)
    for name, line in scenario.lines.items():
        kind = "channels" if name in scenario.channels else "concentrators"
        with wrong:
            system.line(name, line, f"{scenario.name}: {kind}.{name}")
    if scenario.case:
        with wrong:
            add_detector(system, scenario)
            _connect_signals(system, scenario)
    for name, table in scenario.fmus.items():
        with wrong:
            _add_own(system, name, scenario.folder / table.file, table)
        if table.latency_s:
            system.latency_s[name] = table.latency_s
    for path in scenario.connections:
        with wrong:
            system.connect(*path)
    with wrong:
        chosen(system.signals, scenario.record)  # refuses an unknown one here
    wrong.end(ScenarioError)
    system.event_times = list(scenario.event_times_s)
    system.at_rest = not scenario.fmus  # a case starts at its operating point; others anywhere
    return system


def _start_plant(system: System, scenario: Scenario) -> None:
    """Give the plant's parameters the start values of the scenario."""
    plant = system.parts[PLANT]
    variables = plant.file.variables
    wrong = Collected()
    for name, value in scenario.plant.items():
        if name in variables and variables[name].causality == "parameter":
            low, high = variables[name].number("min"), variables[name].number("max")
            if not (-inf if low is None else low) <= value <= (inf if high is None else high):
                ends = [] if low is None else [f"at least {low:g}"]
                ends += [] if high is None else [f"at most {high:g}"]
                wrong.lines.append(f"{scenario.name}: plant.{name} = {value:g}, allowed: {', '.join(ends)}")
            continue
        names = [v.name for v in variables.values() if v.causality == "parameter"]
        with wrong:
            _known(name, names, f"{scenario.name}: plant.{name} is not a parameter of the plant")
    wrong.end(ScenarioError)
    system.parts[PLANT] = replace(plant, start=dict(scenario.plant))


def _add_own(system: System, name: str, path: Path, table: FmuTable) -> None:
    """Add an FMU or DLL of the user's."""
    if path.suffix in DLL_SUFFIXES:
        system.fmu(name, path, start=table.start, time_limit_s=table.time_limit_s)
    else:
        file = system.fmus.own(name, path)
        system.put(Instance(name, file, dict(table.start), process=table.process))


def _add_controller(
    system: System, scenario: Scenario, which: ControllerLike
) -> Controller | ControllerBank | None:
    """Add a controller, changed as the scenario says, and return it as it was before; None of an FMU or DLL.

    A named one is designed for the case as the file has it: another operating point changes no design.
    """
    if isinstance(which, str | Path):
        if Path(which).suffix in (".fmu", *DLL_SUFFIXES):
            system.controller(which)
            return None
        controller = controller_of(which, scenario.as_stated(system.case), system.fmus.cache)
    else:
        controller = controller_of(which, system.case, system.fmus.cache)
    provided = controller
    gain, limit = scenario.controller_gain, scenario.controller_limit_pu
    if controller is not None and (gain != 1.0 or limit is not None):
        if not isinstance(controller, Controller):
            raise ScenarioError(
                f"{scenario.name}: controller_gain and controller_limit_pu change one controller, "
                f"{scenario.controller!r} is a bank; change its members"
            )
        controller = system.fmus.scaled(controller, gain, limit)
    if controller is not None:
        system.controller(controller, trust=scenario.detector is not None)
    return provided


def _connect_signals(system: System, scenario: Scenario) -> None:
    """Connect what a scenario leaves to names: signals through channels, the others directly."""
    plant = system.parts[PLANT].file.description
    signals, inputs = [p.name for p in plant.outputs], plant.input_of
    description = _description_of_controller(system)
    title, requested, taken = "", [], {}
    if description is not None:
        # beside its Real signals a supervisor has flags of validity, and tells which member is active
        title, taken = description.title, description.input_of
        requested = [p.name for p in description.inputs if p.type == "Real"]
        outputs = [p.name for p in description.outputs if p.type == "Real"]
        driving, warnings = outputs_used(title, outputs, inputs, scenario.connections)
        system.connections += [(f"{CONTROLLER}.{name}", f"{PLANT}.{name}") for name in driving]
        system.warnings += warnings
    wrong = Collected()
    for path in scenario.signals:  # the others are connected by scenario.connections
        signal, y, valid = path.signal, path.y, path.valid
        where = _where(scenario, signal, path.u)
        with wrong:
            _connect_source(system, path, signals, where)
        witness = scenario.detector is not None and signal not in requested
        if description is not None and not witness and (path.pmu is not None or signal in signals):
            with wrong:
                _known(signal, requested, f"{where} is not an input of controller {title}")
            system.connections.append((y, f"{CONTROLLER}.{signal}"))
            system.connections += flags(signal, valid, taken, scenario.detector is not None)
    direct = list(_without(requested, _fed(scenario)))
    with wrong:
        _require_outputs(direct, signals, title)
    system.connections += [(f"{PLANT}.{signal}", f"{CONTROLLER}.{signal}") for signal in direct]
    wrong.end(ScenarioError)


def _require_outputs(inputs: Iterable[str], signals: Sequence[str], title: str) -> None:
    """Raise ScenarioError unless the plant has what a controller sees: one line for all that it lacks."""
    lost = [name for name in inputs if name not in signals]
    if len(lost) > 1:
        raise ScenarioError(
            f"controller {title}: inputs {', '.join(lost[:4])}{', ...' if len(lost) > 4 else ''} are not "
            "outputs of the plant, wanted: a controller of this case (`interarea list` shows the case "
            "of each)"
        )
    for name in lost:
        _known(name, signals, f"controller {title}: input {name!r} is no output of the plant")


def _description_of_controller(system: System) -> Description | None:
    """Return the ports of the controller, an FMU or a DLL; None where there is none."""
    if CONTROLLER in system.others:
        return system.others[CONTROLLER].description
    part = system.parts.get(CONTROLLER)
    return None if part is None else part.file.description


def _unknown_buses(scenario: Scenario, case: Case) -> list[str]:
    """Return a line for each PMU at a bus that the case does not have."""
    buses = [b.number for b in case.buses]
    return [
        f"{scenario.name}: {path.u.partition('.')[0]}: pmu.bus = {path.pmu.bus} does not exist; "
        f"{nearest(str(path.pmu.bus), map(str, buses))}"
        for path in scenario.signals
        if path.pmu is not None and path.pmu.bus not in buses
    ]


def _connect_source(system: System, path: SignalPath, signals: Iterable[str], where: str) -> None:
    """Connect what a path begins with: an output of the plant, or a PMU, which is added."""
    pmu = path.pmu
    if pmu is None:
        _known(path.signal, signals, f"{where} is not an output of the plant")
        system.connections.append((f"{PLANT}.{path.signal}", path.u))
        return
    system.pmu(path.source, pmu.filter(system.case.frequency_hz, path.interval_s, where))
    system.connections += [(f"{PLANT}.{source}", f"{path.source}.{u}") for source, u in pmu.inputs]
    system.connections.append((f"{path.source}.{pmu.output}", path.u))


def _without(names: Iterable[str], others: set[str]) -> list[str]:
    return [name for name in names if name not in others]


def _where(scenario: Scenario, signal: str, end: str) -> str:
    """Return how an error names the way of a signal that begins at input `end` of a line."""
    name, _, port = end.partition(".")
    place = f"channels.{name}.signal" if port == "u" else f"concentrators.{name}: signal"
    return f"{scenario.name}: {place} = {signal!r}"


def _fed(scenario: Scenario) -> set[str]:
    """Return the controller's inputs that the scenario connects: by a way for the signal or by name."""
    by_name = {path[-1].removeprefix(f"{CONTROLLER}.") for path in scenario.connections}
    return by_name | {own_path.signal for own_path in scenario.signals}


def _known(name: str, names: Iterable[str], what: str) -> None:
    """Raise ScenarioError where `name` is not among `names`, with the nearest of them."""
    if name not in names:
        raise ScenarioError(f"{what}; {nearest(name, names)}")
