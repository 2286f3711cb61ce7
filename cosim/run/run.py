"""Run a scenario: case and controller to FMUs, FMUs and channels to a closed loop, the loop to numbers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from interarea.design.controllers.bundled import shipped_names
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.write.cache import default_cache
from interarea.fmu_build.write.package import block_fmu
from interarea.models.blocks.plant import event_parameters, plant_block

from ..errors import ScenarioError, nearest
from ..master.instances import FmuParticipant, Value
from ..master.isolated import participant_of
from ..master.master import Master
from ..results.delay_ledger import PACKET_COUNTS, delay_ledger, explain, packet_ledger
from ..results.latency_test import SelfTest
from ..results.result import Result
from ..results.ringdown import Swing, run_metrics
from ..results.run import Run
from ..scenario.channels import hold_packets
from ..scenario.scenario import Scenario, load_scenario
from ..trajectory import Trajectory
from .system import System, pairs_of, points_of, self_test_of

if TYPE_CHECKING:
    from interarea.design.controllers.bank import ControllerBank
    from interarea.design.controllers.controller import Controller
    from interarea.models.case.case import Case

Controllers = Callable[[str, Any], "Controller"]
Array = npt.NDArray[np.float64]
_PLANT, _CONTROLLER = "plant", "controller"
EVENT_SLOTS = 8  #: of the plant FMU; a scenario with more events gets one of its own


def run_scenario(
    scenario: Scenario | str | Path | Mapping[str, Any],
    *,
    case: Case | None = None,
    controller: Controller | ControllerBank | None = None,
    cache: Path | None = None,
    progress: Callable[[float, float], object] | None = None,
    controllers: Controllers | None = None,
) -> Run:
    """Run a scenario (a `Scenario`, a TOML file, a bundled name or a dict) and return what it did.

    Parameters
    ----------
    case, controller : instead of those that the scenario names.
    cache : folder of FMUs and designs; default `default_cache()`.
    progress : called with (present time, stop time), s.
    controllers : (name, case) -> Controller for wdc, cc and ftc; default designs them once into `cache`.

    Raises
    ------
    ScenarioError, CaseError : a mistake in the scenario. StepError : an FMU failed, with the results so far.
    """
    loaded = load_scenario(scenario)
    with assemble(loaded, case=case, controller=controller, cache=cache, controllers=controllers) as loop:
        trajectory = loop.master.run(progress=progress)
        return loop.result(trajectory)


def run_system(
    scenario: Scenario | str | Path | Mapping[str, Any],
    *,
    cache: Path | None = None,
    progress: Callable[[float, float], object] | None = None,
) -> Result:
    """Run any scenario: a `Run` when it has a case, else a plain `Result`. Parameters as `run_scenario`."""
    loaded = load_scenario(scenario)
    if loaded.case:
        return run_scenario(loaded, cache=cache, progress=progress)
    return system_of(loaded, cache=cache).run(progress=progress)


class Loop:
    """A scenario's FMUs, connected and ready to step: `master`; keeps the case and the scenario with it."""

    def __init__(
        self, scenario: Scenario, case: Case, swing: Swing, master: Master, channels: Sequence[str]
    ) -> None:
        self.scenario, self.case, self.swing, self.master = scenario, case, swing, master
        self.channels = tuple(channels)

    def __enter__(self) -> Loop:
        return self

    def __exit__(self, *_: object) -> None:
        self.master.close()

    def result(self, trajectory: Trajectory | None = None) -> Run:
        """Return the run so far as a `Run`."""
        done = self.master.trajectory if trajectory is None else trajectory
        delays = {n: c.delays(self.master.clock) for n, c in self.scenario.lines.items()}
        ledger = delay_ledger(self.master, delays, self.scenario.rounded)
        return Run(
            trajectory=done,
            ledger=ledger,
            packets=packet_ledger(done, self.channels),
            explanation=explain(self.master, ledger),
            scenario=self.scenario,
            case=self.case,
            swing=self.swing,
            metrics=run_metrics(
                done, self.case, self.swing, self.scenario, self.master.step_s, self.control_limit_pu
            ),
        )

    @property
    def control_limit_pu(self) -> float | None:
        """Bound of the magnitude of the control signals; None where the controller tells none."""
        controller = self.master.participants.get(_CONTROLLER)
        if not isinstance(controller, FmuParticipant) or "limit" not in controller.file.variables:
            return None
        return controller.value_of("limit")

    def self_test(self) -> SelfTest:
        """Measure the latency of every connection; compare with the ledger (module `self_test`)."""
        parts = {n: p for n, p in self.master.participants.items() if n in self.channels}
        files = {n: p.file for n, p in parts.items() if isinstance(p, FmuParticipant)}
        return self_test_of(self.master, self.scenario.lines, files, self.scenario.master.arrivals)


def system_of(scenario: Scenario, *, cache: Path | None = None) -> System:
    """Return the system of a scenario without a case: its own FMUs, channels and connections.

    Raises
    ------
    ScenarioError : too many outages. GraphError : an FMU or connection that does not fit.
    """
    system = System(
        stop_s=scenario.stop_s,
        step_s=scenario.step_s,
        cache=cache,
        arrivals=scenario.master.arrivals,
        **scenario.master.options,
    )
    for name, table in scenario.fmus.items():
        file = FmuFile(scenario.folder / table.file)
        system.add(participant_of(name, file, table.start, **table.process), latency_s=table.latency_s)
    for name, channel in scenario.channels.items():
        system.channel(name, channel)
    for name, several in scenario.concentrators.items():
        system.concentrator(name, line=several)
    for path in scenario.connections:
        system.connect(*path)
    return system


@dataclass(frozen=True)
class Wiring:
    """FMU and start values of each instance, and the connections between them."""

    instances: Mapping[str, tuple[FmuFile, dict[str, Value]]]
    connections: tuple[tuple[str, str], ...]

    def master(self, scenario: Scenario, participants: Collection[FmuParticipant]) -> Master:
        """Return the master that steps `participants` (one for each instance) as `scenario` says."""
        lines = scenario.lines
        for p in participants:
            if p.name in lines:
                hold_packets(p, lines[p.name])
        return Master(
            participants,
            self.connections,
            stop_s=scenario.stop_s,
            step_s=scenario.step_s,
            marks_s=scenario.marks_s,
            latency_s={
                **{n: f.latency_s for n, f in scenario.fmus.items() if f.latency_s},
                **{n: c.least_latency_s for n, c in lines.items()},
            },
            points=points_of(lines.values(), scenario.master.arrivals, 0.0, scenario.stop_s),
            at_rest=not scenario.fmus,  # a case starts at its operating point; others anywhere
            **scenario.master.options,
        )


def assemble(
    scenario: Scenario,
    *,
    case: Case | None = None,
    controller: Controller | ControllerBank | None = None,
    cache: Path | None = None,
    controllers: Controllers | None = None,
) -> Loop:
    """Build the FMUs of a scenario and connect them: signal -> channel -> controller -> plant.

    case, controller : instead of those that the scenario names.

    Raises
    ------
    ScenarioError, CaseError : an unknown signal, a channel to an input that does not exist, too many outages;
        no case (`system_of` takes scenarios without one).
    """
    from . import artefacts

    if not scenario.case:
        raise ScenarioError(f"{scenario.name}: case is missing; run_system runs FMUs without one")
    if scenario.master.joint:
        raise ScenarioError(
            f"{scenario.name}: master.joint = true asks for one block and no master; run it by "
            "`interarea run` or cosim.export.joint.run_joint, or take it out"
        )

    folder = default_cache() if cache is None else cache
    case = scenario.load_case() if case is None else case
    slots = max(EVENT_SLOTS, len(scenario.event))
    if slots == EVENT_SLOTS:
        plant_file = artefacts.plant_fmu(case, folder)
    else:
        plant_file = block_fmu(plant_block(case, event_slots=slots), folder)
    wiring = wire(
        scenario,
        case,
        plant=FmuFile(plant_file),
        controller=_controller_file(scenario, case, folder, controller, controllers),
        channel=FmuFile(artefacts.channel_fmu(folder)) if scenario.channels else None,
        concentrators={
            n: FmuFile(artefacts.concentrator_fmu(len(c.signals), folder))
            for n, c in scenario.concentrators.items()
        },
    )
    processes = {n: fmu.process for n, fmu in scenario.fmus.items()}
    participants = [
        participant_of(n, file, start, **processes.get(n, {}))
        for n, (file, start) in wiring.instances.items()
    ]
    swing = artefacts.swing_of(case, folder, scenario.swing)
    return Loop(scenario, case, swing, wiring.master(scenario, participants), list(scenario.lines))


def wire(
    scenario: Scenario,
    case: Case,
    *,
    plant: FmuFile,
    controller: FmuFile | None,
    channel: FmuFile | None,
    concentrators: Mapping[str, FmuFile] | None = None,
    own: Mapping[str, FmuFile] | None = None,
) -> Wiring:
    """Return which instances of the FMUs a scenario needs, with which start values, connected how.

    concentrators : the FMU of each that the scenario has.
    own : instance -> FMU of the user's; default: opened where the scenario says.

    Raises
    ------
    ScenarioError, CaseError : as `assemble`.
    """
    instances: dict[str, tuple[FmuFile, dict[str, Value]]] = {
        _PLANT: (plant, {**_plant_start(scenario, plant), **event_parameters(case, scenario.event)})
    }
    signals = [p.name for p in plant.description.outputs]
    connections: list[tuple[str, str]] = []
    wanted: tuple[str, ...] = ()
    if controller is not None:
        instances[_CONTROLLER] = (controller, {})
        # beside its Real signals a supervisor has flags of validity, and tells which member is active
        wanted = tuple(p.name for p in controller.description.inputs if p.type == "Real")
        inputs = plant.description.input_of
        for port in (p for p in controller.description.outputs if p.type == "Real"):
            _known(
                port.name,
                inputs,
                f"controller {controller.description.title}: output {port.name!r} is no input of the plant",
            )
            connections.append((f"{_CONTROLLER}.{port.name}", f"{_PLANT}.{port.name}"))
    for name, table in scenario.channels.items():
        if channel is None:
            raise ScenarioError(f"{scenario.name}: channels.{name} needs the FMU of a channel, got none")
        instances[name] = (channel, table.parameters(f"{scenario.name}: channels.{name}"))
    for name, several in scenario.concentrators.items():
        if name not in (concentrators or {}):
            raise ScenarioError(f"{scenario.name}: concentrators.{name} needs its FMU, got none")
        instances[name] = ((concentrators or {})[name], several.parameters(name))
    for signal, u, y, valid in scenario.signals:  # the others are connected by scenario.connections
        name, _, end = u.partition(".")
        where = f"channels.{name}.signal" if end == "u" else f"concentrators.{name}: signal"
        where = f"{scenario.name}: {where} = {signal!r}"
        _known(signal, signals, f"{where} is no output of the plant")
        connections.append((f"{_PLANT}.{signal}", u))
        if controller is not None:
            _known(signal, wanted, f"{where} is no input of controller {controller.description.title}")
            connections.append((y, f"{_CONTROLLER}.{signal}"))
            if f"{signal}_valid" in controller.description.input_of:
                connections.append((valid, f"{_CONTROLLER}.{signal}_valid"))
    fed = {signal for signal, *_ in scenario.signals}
    fed |= {path[-1].removeprefix(f"{_CONTROLLER}.") for path in scenario.connections}
    for signal in wanted:
        if signal not in fed:
            _known(
                signal,
                signals,
                f"controller {scenario.controller}: input {signal!r} is no output of the plant",
            )
            connections.append((f"{_PLANT}.{signal}", f"{_CONTROLLER}.{signal}"))
    for name, fmu in scenario.fmus.items():
        file = FmuFile(scenario.folder / fmu.file) if own is None else own[name]
        instances[name] = (file, dict(fmu.start))
    for path in scenario.connections:
        connections += [pair for pair in pairs_of(path, scenario.channels) if pair not in connections]
    return Wiring(instances, tuple(connections))


def _plant_start(scenario: Scenario, plant: FmuFile) -> dict[str, Value]:
    """Start values of the plant's parameters that the scenario gives."""
    known = [v.name for v in plant.variables.values() if v.causality == "parameter"]
    for name in scenario.plant:
        _known(name, known, f"{scenario.name}: plant.{name} is no parameter of the plant")
    return dict(scenario.plant)


def _known(name: str, known: Iterable[str], what: str) -> None:
    if name not in known:
        raise ScenarioError(f"{what}; {nearest(name, known)}")


def _controller_file(
    scenario: Scenario,
    case: Case,
    cache: Path,
    controller: Controller | ControllerBank | None,
    controllers: Controllers | None,
) -> FmuFile | None:
    """Return the FMU of the controller, which may be anybody's, or None."""
    from . import artefacts

    path = scenario.controller_path
    if controller is None and path is not None and path.suffix == ".fmu":
        return FmuFile(path)
    if controller is None:
        controller = controller_of(scenario, case, cache, controllers)
    return None if controller is None else FmuFile(artefacts.controller_fmu(controller, case.omega_b, cache))


def controller_of(
    scenario: Scenario, case: Case, cache: Path, controllers: Controllers | None
) -> Controller | ControllerBank | None:
    """Return the controller a scenario names, changed as it says, or None.

    It is that of the case as the file has it: another operating point changes no design.
    """
    named = _named_controller(scenario, scenario.as_given(case), cache, controllers)
    gain, limit = scenario.controller_gain, scenario.controller_limit_pu
    if named is None or (gain == 1.0 and limit is None):
        return named
    from interarea.design.controllers.controller import Controller

    if not isinstance(named, Controller):
        raise ScenarioError(
            f"{scenario.name}: controller_gain and controller_limit_pu change one controller, "
            f"{scenario.controller!r} is a bank; change its members"
        )
    return named.scaled(gain, limit)


def _named_controller(
    scenario: Scenario, case: Case, cache: Path, controllers: Controllers | None
) -> Controller | ControllerBank | None:
    if scenario.controller == "none":
        return None
    path = scenario.controller_path
    if path is not None:
        from interarea.design.controllers.bank import load_controller

        if not path.is_file():
            raise ScenarioError(
                f"{scenario.name}: controller = {scenario.controller!r} is neither a name nor a file, "
                f"allowed: none, wdc, cc, ftc, active, a controller file, or shipped: "
                f"{', '.join(shipped_names())}"
            )
        return load_controller(path)
    if scenario.controller == "active":
        from .artefacts import active_bank

        return active_bank(case, cache)
    if controllers is not None:
        return controllers(scenario.controller, case)
    from . import artefacts

    return artefacts.design_controller(case, scenario.controller, cache)


def packet_counts(participant: Any) -> dict[str, float]:
    """Return what a channel counted; empty for an instance that counts nothing."""
    known = participant.file.variables
    return {name: participant.value_of(name) for name in (*PACKET_COUNTS, "age") if name in known}
