"""What a scenario says that can be run as written but is probably unintended, a line each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.models.case.case import Case
from interarea.models.case.events import instants

from ..errors import ScenarioError, nearest
from ..scenario.scenario import Scenario


def times_past_the_end(scenario: Scenario) -> list[str]:
    """Return a line for each signal too late to tell of an event, and each event that outlasts the run."""
    first = min((t for e in scenario.event for t in instants(e)), default=0.0)
    left = scenario.stop_s - first
    lines = [
        f"{name}: a latency of {line.least_latency_s:g} s is not below the {left:g} s left after "
        f"the first event (at {first:g} s); no packet about it reaches the controller (latencies are in s)"
        for name, line in scenario.lines.items()
        if scenario.event and not line.least_latency_s < left
    ]
    for k, event in enumerate(scenario.event, start=1):
        end_s = getattr(event, "end_s", None)
        if end_s is not None and end_s > scenario.stop_s:
            lines.append(
                f"event {k} ({event.kind}): end_s = {end_s:g} lies after the run "
                f"(stop_s = {scenario.stop_s:g}); its end is not simulated"
            )
    return lines


def designed_for_another_case(controller: Controller | ControllerBank | None, case: Case) -> list[str]:
    """Return a line where the record of a controller names another case than the one it is to run with."""
    design = getattr(controller, "design", {}) or {}
    provided = design.get("specification")
    named = provided.get("case") if isinstance(provided, dict) else None
    if controller is None or not named or not isinstance(named, str) or Path(named).suffix:
        return []
    if f"{case.name}-".startswith(f"{named}-"):  # other operating points of a case have its name in front
        return []
    return [
        f"controller {controller.name}: designed for the case {named!r}, runs with {case.name!r}; its "
        "certificate does not cover this case"
    ]


def outputs_used(
    title: str, outputs: Sequence[str], inputs: Iterable[str], connections: Iterable[Sequence[str]]
) -> tuple[list[str], list[str]]:
    """Return which outputs of a controller drive the plant, and a line for each that does nothing.

    connections : of the scenario, which may use an output too.

    Raises
    ------
    ScenarioError : none of them is connected to anything: the controller could do nothing.
    """
    known = set(inputs)
    by_name = {path[0].removeprefix("controller.") for path in connections}
    driving = [name for name in outputs if name in known]
    idle = [name for name in outputs if name not in known and name not in by_name]
    if outputs and len(idle) == len(outputs):
        hints = "; ".join(f"{name!r}: {nearest(name, known)}" for name in idle)
        raise ScenarioError(
            f"controller {title}: none of its outputs is an input of the plant or in connections; {hints}"
        )
    return driving, [
        f"controller {title}: output {name!r} is not connected; {nearest(name, known)}" for name in idle
    ]
