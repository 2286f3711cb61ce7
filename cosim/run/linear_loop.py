"""The swings of a system as roots of its linear loop: exact delay, packets and losses in the mean.

What a ring-down can only estimate is known here, so it is what `run`, sweeps, maps and the test fixture
report, as certificates do. Where the loop is not linear, or no longer the one that was linearised, the reason
is reported.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import ControllerError, matrices_of_parameters
from interarea.design.delay.loop_modes import DelayedPath, LoopFunction, LoopModes, open_loop_modes
from interarea.design.linear.linearise import bus_frequencies, remove_reference, speeds_in_rad
from interarea.design.linear.matrices import LinearMatrices
from interarea.design.modes.modes import modes_of
from interarea.models.errors import InterareaError

from ..errors import machine_error
from ..results.ringdown import fit_window
from ..scenario.channels import BernoulliLoss, ChannelLine, GilbertElliottLoss
from ..scenario.concentrators import ConcentratorLine
from ..scenario.signal_paths import SignalPath, signal_faults_of
from .artefacts import linearised, matrices_of_fmu

if TYPE_CHECKING:
    from interarea.models.case.case import Case

    from ..scenario.scenario import Scenario
    from .instance import Fmus, Instance

_MOST_STATES = 400  #: of a plant whose eigenvectors are worth their time
_MOST_CACHED = 500
#: events after which the loop is another one for good, unless they end
_LASTING = {
    "branch_trip",
    "branch_reclose",
    "machine_trip",
    "device_trip",
    "hvdc_block",
    "shunt_switch",
    "frequency_shed",
    "frequency_trip",
    "load_step",
    "vref_step",
    "pm_step",
}


class NotLinearError(InterareaError, ValueError):
    """Why the swings of a system are not the roots of a linear loop."""


@dataclass(frozen=True)
class Loop:
    """What a linear loop is made of: scenario, case, instances; `bank` where the controller is one.

    fmus : opened files, with the linear plants and swings found before. others : instances that are no FMUs.
    """

    scenario: Scenario
    case: Case
    plant: Instance
    controller: Instance | None
    bank: ControllerBank | None
    fmus: Fmus
    others: tuple[str, ...] = ()

    @property
    def results(self) -> dict[Any, Any]:
        """Linear plants and swings found before, by what they are of."""
        return self.fmus.loops


def linear_swings(loop: Loop) -> LoopModes | str:
    """Return the swings of a loop in its ring-down window (`fit_window`), or why they are not known.

    Raises
    ------
    BuildError : an error of the machine, of which nothing follows for the loop.
    """
    try:
        return _swings(loop)
    except InterareaError as error:  # a mode without a name, poles too close together: a ring-down is left
        if machine_error(error) is not None:
            raise
        return str(error)


def _swings(loop: Loop) -> LoopModes:
    scenario, part = loop.scenario, loop.controller
    start, stop = fit_window(scenario)
    if loop.others:
        raise NotLinearError(f"{', '.join(loop.others)} may have any effect")
    _refuse(scenario, start, stop)
    paths = {path.signal: _sent(loop, path, start) for path in scenario.signals}
    buses = {path.signal: path.pmu.bus for path in scenario.signals if path.pmu is not None}
    lost = frozenset(name for name, path in paths.items() if path.lost)
    if part is None:
        buses = {}  # of which nobody hears
        key: tuple[Any, ...] = ("swings", str(loop.plant.file.path))
    else:
        matrices = tuple((k, v) for k, v in part.start.items() if k[:2] in ("A[", "B[", "C[", "D["))
        sent = (*paths.items(), *buses.items())
        key = ("swings", str(loop.plant.file.path), str(part.file.path), matrices, sent)
    if len(loop.results) > _MOST_CACHED:
        loop.results.clear()
    if key not in loop.results:
        grid, modes = _linear(loop, buses)
        if part is None:
            loop.results[key] = open_loop_modes(np.linalg.eigvals(grid.A).astype(complex), modes)
        else:
            loop.results[key] = LoopFunction(grid, _controller(loop, part, lost)).modes(paths, modes)
    cached: LoopModes = loop.results[key]
    return cached


def _refuse(scenario: Scenario, start: float, stop: float) -> None:
    """Raise NotLinearError where the loop is not that of plant, controller and channels at the start."""
    for event in scenario.event:
        end = getattr(event, "end_s", None)
        if event.kind in _LASTING and event.start_s < stop and (end is None or end > start):
            raise NotLinearError(f"the grid is changed by the {event.kind} at {event.start_s:g} s")
    for where, faults in signal_faults_of(scenario.channels, scenario.concentrators).items():
        for fault in faults:
            if fault.start_s < stop and fault.until_s > start:
                raise NotLinearError(f"{where}: the signal is wrong ({fault.kind})")
    if scenario.fmus:
        raise NotLinearError(f"{', '.join(scenario.fmus)} may have any effect")
    if scenario.connections:
        raise NotLinearError("connections of its own")
    moved = [name for name in scenario.plant if not name.startswith("solver.")]
    if moved:
        raise NotLinearError(f"plant.{moved[0]} was changed")


def _linear(loop: Loop, buses: Mapping[str, int]) -> tuple[LinearMatrices, dict[str, complex]]:
    """The plant without reference angle, speeds in rad/s, and its swing modes, 1/s.

    buses : signal -> bus whose frequency it is.
    """
    case, file = loop.case, loop.plant.file
    key = ("plant", str(file.path), *buses.items())
    if key not in loop.results:
        states = len(file.model.derivatives)
        if states > _MOST_STATES:
            raise NotLinearError(f"{states} states are more than {_MOST_STATES}")
        cached = file.path.is_relative_to(loop.fmus.cache)  # a sweep's plants of one run each are not
        linear = matrices_of_fmu(file.path, loop.fmus.cache) if cached else linearised(file.path)
        assert linear.output_start is not None
        names = [p.name for p in file.description.outputs if p.type == "Real"]
        outputs = dict(zip(names, map(float, linear.output_start), strict=True))
        relative = remove_reference(bus_frequencies(linear, outputs, buses, case.omega_b))
        modes = {name: mode.eigenvalue for name, mode in modes_of(relative, case.areas).items()}
        loop.results[key] = (speeds_in_rad(relative, case.omega_b), modes)
    known: tuple[LinearMatrices, dict[str, complex]] = loop.results[key]
    return known


def _controller(loop: Loop, part: Instance, lost: frozenset[str]) -> LinearMatrices:
    """The linear controller that acts while these signals are lost, speeds in rad/s."""
    if loop.bank is not None:
        return loop.bank.acting(lost).matrices
    starts = {v.name: part.file.start_of(v.name) for v in part.file.model.variables if "[" in v.name}
    starts |= {k: float(v) for k, v in part.start.items() if k in starts}
    ports = part.file.description
    inputs = [p.name for p in ports.inputs if p.type == "Real"]
    outputs = [p.name for p in ports.outputs if p.type == "Real"]
    try:
        return matrices_of_parameters(starts, inputs, outputs, loop.case.omega_b)
    except ControllerError as error:
        raise NotLinearError(f"{part.file.path.name} is not a linear controller") from error


def _sent(loop: Loop, path: SignalPath, at_s: float) -> DelayedPath:
    """How a signal gets to the controller from `at_s` on, with the PMU where it has one."""
    delayed = _path(loop.scenario.lines[path.u.partition(".")[0]], path.u, at_s)
    if path.pmu is None:
        return delayed
    if path.pmu.quantity != "frequency":
        raise NotLinearError(
            f"{path.source} measures {path.pmu.quantity}: linear loops model its frequency only"
        )
    return replace(delayed, measured=path.pmu.filter(loop.case.frequency_hz, path.interval_s, path.source))


def _path(line: ChannelLine | ConcentratorLine, end: str, at_s: float) -> DelayedPath:
    """How a signal gets to the controller from `at_s` on; random latencies by their mean."""
    delays = line.delays()
    loss, lost = 0.0, False
    if isinstance(line, ConcentratorLine):
        row = line.signals[int(end.partition(".u")[2]) - 1]
        loss = row.loss
        lost = row.lost_s is not None and row.lost_s[0] <= at_s < row.lost_s[1]
    else:
        lost = any(start <= at_s < stop for start, stop in line.outages_s)
        if isinstance(line.loss, BernoulliLoss):
            loss = line.loss.rate
        elif isinstance(line.loss, GilbertElliottLoss):
            bad = line.loss.good_to_bad / (line.loss.good_to_bad + line.loss.bad_to_good)
            loss = bad * line.loss.loss_bad + (1.0 - bad) * line.loss.loss_good
    return DelayedPath(
        delays.network_s + delays.jitter_mean_s,
        line.reporting_interval_s,
        loss,
        "zero" if line.on_loss == "zero" else "hold",
        lost,
    )
