"""What one page is about: a scenario, the controllers that fit its grid, its signals and operating points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.bundled import shipped_names
from interarea.design.controllers.controller import Controller
from interarea.design.errors import InfeasibleDesign, SolverError, UncertifiedDesign
from interarea.design.linear.linearise import LinearisationError, remove_reference
from interarea.design.modes.modes import ModeError
from interarea.models.bundled import bundled
from interarea.models.case.case import Case, case_names, load_case
from interarea.models.documents import DocumentError, parse_toml
from interarea.models.errors import CaseError
from interarea.models.grid.equilibrium import OperatingPoint, operating_point

from ..errors import ScenarioError
from ..run.artefacts import linear_plant
from ..run.controllers import controller_of
from ..scenario.named import require_subject
from ..scenario.names import CONTROLLER_NAMES
from ..scenario.scenario import Scenario, load_scenario

if TYPE_CHECKING:
    import control

    AnyController = Controller | ControllerBank

_DESIGN_FAILS = (InfeasibleDesign, UncertifiedDesign, SolverError, ModeError, LinearisationError, ValueError)
#: Prepared operating points besides the case's own; those without a power flow are left out.
_TIE_FLOWS_MW = (-100.0, 100.0)
_LOAD_SCALES = (0.9, 1.05)
_FIRST_LATENCY_S = 0.05  #: of the channels on the page of a case


@dataclass(frozen=True)
class Point:
    """An operating point of the page; `changes` are keys of a scenario's table `operating_point`."""

    label: str
    changes: Mapping[str, float]
    case: Case


@dataclass(frozen=True)
class Subject:
    """A scenario with all that its page can replace: `scenario` is how the page starts."""

    scenario: Scenario
    case: Case  #: as the file has it
    cache: Path
    own: Mapping[str, Controller] = field(default_factory=dict)  #: in place of those of these names

    @cached_property
    def controllers(self) -> dict[str, AnyController]:
        """Controllers that fit the grid, by the name a scenario gives them; the scenario's own first."""
        names = [self.scenario.controller, *CONTROLLER_NAMES, *shipped_names()]
        fitting: dict[str, AnyController] = {}
        for name in dict.fromkeys(names):
            if name == "none" or (name != self.scenario.controller and not self._may_fit(name)):
                continue
            try:
                which = self.own.get(name, name)
                controller = controller_of(which, self.case, self.cache, folder=self.scenario.folder)
            except _DESIGN_FAILS:
                if name == self.scenario.controller:
                    raise
                continue
            if controller is not None and (name == self.scenario.controller or self._fits(controller)):
                fitting[name] = controller
        return fitting

    def _may_fit(self, name: str) -> bool:
        """Whether it is worth looking: wdc, cc and ftc are designed for the loops of one study."""
        if name in CONTROLLER_NAMES:
            # their signals and actuator are those of the thesis' grid, and so is their specification
            return {"G2", "G4"} <= set(self.case.areas) and len(self.case.machines) == 4
        return True

    def _fits(self, controller: AnyController) -> bool:
        """Whether its signals and actuators exist, and it was made for this grid where it says for which."""
        specification = controller.design.get("specification", {})
        designed_for = specification.get("case") if isinstance(specification, Mapping) else None
        if designed_for is not None and designed_for != self.case.name:
            return False
        point = self.point
        known = {f"{m.name}_{what}" for m in self.case.machines for what in ("dw", "delta", "pe", "vt")}
        return set(controller.outputs) <= set(point.input_names) and set(controller.inputs) <= known | {
            "tie_p"
        }

    def with_controller(self, name: str) -> Scenario:
        """Return the scenario with another controller as it is, and no channels."""
        changes = {"controller": name, "controller_gain": 1.0, "controller_limit_pu": None, "channels": {}}
        return self.scenario.model_copy(update=changes)

    @cached_property
    def point(self) -> OperatingPoint:
        """The operating point of the case as the file has it."""
        return operating_point(self.case)

    @cached_property
    def channels(self) -> dict[str, tuple[str, Mapping[str, Any]]]:
        """Name -> signal and table of a channel for every signal of all controllers; the scenario's first."""
        named: dict[str, tuple[str, Mapping[str, Any]]] = {
            n: (c.signal, _channel_values(c)) for n, c in self.scenario.channels.items() if c.signal
        }
        taken = {signal for signal, _ in named.values()}
        for controller, block in self.controllers.items():
            for signal in block.inputs:
                if signal in taken:
                    continue
                role = "remote" if self.is_remote(signal, controller) else "local"
                name = role if role not in named else f"{signal}_channel"
                named[name] = signal, {"signal": signal}
                taken.add(signal)
        return named

    @cached_property
    def points(self) -> list[Point]:
        """Operating points: the scenario's, then prepared ones that have a power flow."""
        own = self.scenario.operating_point.model_dump(exclude_defaults=True)
        points = [Point("as given", own, self.scenario.load_case())]
        if own:
            return points
        changes: list[tuple[str, dict[str, float]]] = []
        if self.case.tie is not None:
            changes = [(f"tie {flow:+.0f} MW", {"tie_flow_mw": flow}) for flow in _TIE_FLOWS_MW]
        changes += [(f"load × {scale:g}", {"load_scale": scale}) for scale in _LOAD_SCALES]
        for label, change in changes:
            table = self.scenario.operating_point.model_copy(update=change)
            try:
                case = self.scenario.model_copy(update={"operating_point": table}).load_case()
                operating_point(case)
            except CaseError:
                continue
            points.append(Point(label.replace("-", "−"), change, case))
        return points

    @property
    def first(self) -> str | None:
        """The controller that the page begins its story with: the scenario's, else the first that fits."""
        return next((n for n, block in self.controllers.items() if isinstance(block, Controller)), None)

    def is_remote(self, signal: str, controller: str) -> bool:
        """Whether a signal comes from another area than the controller's actuators are in."""
        near = {self.case.areas.get(a.partition("_")[0]) for a in self.controllers[controller].outputs}
        return self.case.areas.get(signal.partition("_")[0]) not in near

    def linear(self, point: Point) -> control.StateSpace:
        """Return the plant linearised at an operating point, without the reference angle."""
        return remove_reference(linear_plant(point.case, self.cache))


def subject_of(
    source: str | Path | Scenario, cache: Path, own: Mapping[str, Controller] | None = None
) -> Subject:
    """Return what `source`, a scenario or a case by bundled name or file, is about.

    own : controllers of a case's page in place of those of these names.

    Raises
    ------
    ScenarioError, CaseError : no such thing, a mistake in it, or a scenario without a case.
    """
    if isinstance(source, Scenario):
        return _of_scenario(source, cache)
    name = str(source)
    require_subject(name)
    if name in bundled("scenario") or not _is_case(Path(source)):
        return _of_scenario(load_scenario(source), cache)
    case = load_case(source)
    alone = Subject(_scenario_of_case(name, case), case, cache, own or {})
    first = alone.first
    if first is None:
        return alone
    channels = {
        n: {**table, "latency_s": _FIRST_LATENCY_S}
        for n, (signal, table) in alone.channels.items()
        if signal in alone.controllers[first].inputs
    }
    return Subject(_scenario_of_case(name, case, controller=first, channels=channels), case, cache, own or {})


def _of_scenario(scenario: Scenario, cache: Path) -> Subject:
    if not scenario.case:
        raise ScenarioError(
            f"{scenario.name}: case is missing; a page contains the C code of this package, not "
            "third-party FMUs"
        )
    if parts := [n for n in ("concentrators", "detector", "fmus", "connections") if getattr(scenario, n)]:
        raise ScenarioError(
            f"{scenario.name}: {', '.join(parts)}: a page contains one plant, one controller and "
            "a channel for each of its signals; remove these, or run the scenario with `interarea run`"
        )
    if any(path.pmu for path in scenario.signals):
        raise ScenarioError(
            f"{scenario.name}: a page contains no PMU; remove it, or run the scenario with `interarea run`"
        )
    return Subject(scenario, load_case(scenario.case_path), cache)


def _is_case(path: Path) -> bool:
    if path.name in case_names() and not path.suffix:
        return True
    if not path.is_file():
        return False
    try:
        table = parse_toml(path.read_bytes())
    except DocumentError:
        return False  # the scenario's reader says what is wrong
    return "case" not in table and bool({"machines", "base", "change"} & set(table))


def _scenario_of_case(name: str, case: Case, **loop: Any) -> Scenario:
    """The scenario a page of a case starts with: a pulse on a voltage set-point where there is one."""
    table: dict[str, Any] = {"name": case.name, "case": name, "stop_s": 20.0, "step_s": 0.01, **loop}
    machines = [m.name for m in case.machines if m.exciter.kind != "constant"]
    if machines:
        pulse = {"kind": "vref_pulse", "machine": machines[0], "size_pu": 0.1, "start_s": 1.0, "end_s": 1.2}
        table["event"] = [pulse]
    elif case.machines:
        pulse = {
            "kind": "pm_pulse", "machine": case.machines[0].name, "size_pu": 0.1, "start_s": 1.0, "end_s": 1.2
        }  # fmt: skip
        table["event"] = [pulse]
    return load_scenario(table)


def _channel_values(channel: Any) -> dict[str, Any]:
    """Return the keys of a channel's table that differ from their defaults."""
    table: dict[str, Any] = channel.model_dump(mode="json", exclude_defaults=True)
    return table
