"""One step of the sweep: modes proven complete, without control and with the bundled controller; clearing
times of one fault; and what a signal of another area is worth there. Each is found again in the cache.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from interarea.design.controllers.controller import Controller
from interarea.design.delay.late_plant import LatePlant
from interarea.design.linear.sparse_plant import SparsePlant
from interarea.design.modes.all_modes import COMMON, AllModes, all_modes
from interarea.design.modes.growth import growth_of_plant
from interarea.design.robust.smoothed_objective import BandOffsets
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash
from interarea.models.case.case import Case
from interarea.models.case.variants import operating_variant
from interarea.models.errors import InterareaError, UserError
from interarea.models.grid.powerflow import PowerFlow, solve_powerflow

from ..designs.design_file import load_design
from ..designs.design_tables import FaultPlace
from ..designs.fault_runs import FaultRun, FaultRuns, longest_stable
from ..designs.first_swing import after_clearing
from ..errors import machine_error
from ..grid_study.choices import Choices
from ..grid_study.link_study import EFFORT
from ..grid_study.link_worth import AFAR, OWN, LinkDesigns, signals_of_set
from ..grid_study.weak_modes import GridModes, weak_modes
from ..run.artefacts import sparse_linear_plant
from ..run.controllers import controller_of
from .replaced import replaced

#: grid -> the bundled controller that is tried at every share; the fault is the first of its design
CONTROLLERS = {
    "two-area-thesis": "wide_area",
    "new-england": "new_england",
    "nets-nyps": "nets_nyps",
    "wecc-240": "wecc_240",
}
#: Hz: swings of machines with a fifth of their inertia are twice as fast as those of the grid
BAND_HZ = (0.1, 5.0)
BELOW = 0.4  #: damping ratio up to which modes are looked for
LATENCY_S = 0.15  #: of every signal of the bundled controller
LINK_MS = 200  #: latency of the signal from another area, of which the worth is asked
_LONGEST_CYCLES, _RESOLUTION_CYCLES, _FAULT_S, _STOP_S = 60.0, 0.25, 1.0, 8.0
_MAC_LEAST = 0.5  #: likeness of two shapes below which a mode is not the same


@dataclass(frozen=True)
class Swing:
    """A mode. shape : speed of each machine of the grid without inverters, the largest being 1."""

    name: str
    frequency_hz: float
    damping_ratio: float
    shape: Mapping[str, complex]

    def likeness(self, other: Swing) -> float:
        """Return the modal assurance criterion of two shapes, 0 to 1 where one is a multiple of the other."""
        a, b = (np.array([one.shape[m] for m in self.shape]) for one in (self, other))
        size = float(np.vdot(a, a).real * np.vdot(b, b).real)
        return float(abs(np.vdot(a, b)) ** 2 / size) if size else 0.0


@dataclass(frozen=True)
class StepModes:
    """The modes of one step. counted : by the argument principle; None: no proof, with its reason.

    growing : what grows, whole spectrum, in words; empty where nothing does.
    """

    states: int
    swings: tuple[Swing, ...]
    controls: int  #: modes of controls in the same region
    counted: int | None
    growing: str
    problem: str = ""

    @property
    def complete(self) -> bool:
        """Whether as many modes are there as the independent count says."""
        return self.counted == len(self.swings) + self.controls

    @property
    def worst(self) -> Swing | None:
        """The swing that is damped least."""
        return min(self.swings, key=lambda one: one.damping_ratio, default=None)

    def following(self, before: Swing | None) -> Swing | None:
        """Return the swing whose shape is nearest to that of `before`; None where none is near."""
        if before is None:
            return None
        nearest = max(self.swings, key=before.likeness, default=None)
        return nearest if nearest is not None and before.likeness(nearest) >= _MAC_LEAST else None


class GridSteps:
    """The steps of one grid. fault, controller : what is tried at each."""

    def __init__(self, case: Case, cache: Path) -> None:
        self.case, self.cache = case, cache
        self.flow = solve_powerflow(case)
        self.controller_name = CONTROLLERS.get(case.name, "")
        self.controller = self._bundled()
        self.fault = self._fault()
        self._code = code_hash(__name__)

    def _bundled(self) -> Controller | None:
        controller = (
            controller_of(self.controller_name, self.case, self.cache) if self.controller_name else None
        )
        return controller if isinstance(controller, Controller) else None

    def _fault(self) -> FaultPlace:
        """Return the first fault of the bundled design, else one at the branch that carries most power."""
        table = load_design(self.controller_name).acceptance if self.controller_name else None
        if table is not None:
            return table.fault[0]
        return fault_of(self.case, self.flow)

    def at(self, kind: str, share: float) -> Case:
        """Return the grid of one step."""
        return replaced(self.case, kind, share)

    def moved_pu(self, case: Case) -> float:
        """Return by how much the power flow of a step moves a voltage, which it must not, pu."""
        return float(np.max(np.abs(solve_powerflow(case).voltages - self.flow.voltages)))

    def modes(self, case: Case, controller: Controller | None = None) -> StepModes:
        """Return the modes of a step, with all signals of a controller `LATENCY_S` late."""
        known = None if controller is None else controller.as_dict()
        key = content_hash(case.hash, known, LATENCY_S, BAND_HZ, BELOW, self._code)
        stored = cached_json(self.cache, "inverter-modes", key, lambda: self._modes(case, controller))
        return StepModes(**stored | {"swings": tuple(_swing(one) for one in stored["swings"])})

    def clearing(self, case: Case, controller: Controller | None = None) -> float:
        """Return the longest time of the fault that keeps synchronism, cycles; `LATENCY_S` late."""
        known = None if controller is None else controller.as_dict()
        fault = self.fault.model_dump(mode="json")
        key = content_hash(case.hash, known, LATENCY_S, fault, self._code)

        def compute() -> float:
            with FaultRuns(case, self.cache) as runs:

                def are_stable(cycles: Mapping[int, float]) -> dict[int, bool]:
                    tried = [self._run(case, n, controller) for n in cycles.values()]
                    return {
                        k: angle < np.pi for k, angle in zip(cycles, runs.largest_angles(tried), strict=True)
                    }

                return longest_stable([0], are_stable, 1.0, _LONGEST_CYCLES, _RESOLUTION_CYCLES)[0]

        return float(cached_json(self.cache, "inverter-clearing", key, compute))

    def link(self, case: Case) -> dict[str, Any]:
        """Return what one loop reaches with its own signal and with one of another area too, `LINK_MS` late.

        Damping of all inter-area modes at the step alone: ``own``, ``afar``; or ``problem``.
        """
        key = content_hash(case.hash, LINK_MS, EFFORT, self._code)
        return dict(cached_json(self.cache, "inverter-link", key, lambda: self._link(case)))

    def _modes(self, case: Case, controller: Controller | None) -> dict[str, Any]:
        plant = sparse_linear_plant(case, self.cache)
        loop = None
        if controller is not None:
            late = dict.fromkeys(controller.inputs, LATENCY_S)
            loop = LatePlant(plant, controller.system, late, omega_b=case.omega_b, high_hz=BAND_HZ[1])
        try:
            modes = all_modes(plant, case.areas, band_hz=BAND_HZ, below=BELOW, loop=loop)
        except UserError as error:
            growth = growth_of_plant(plant, loop)
            return asdict(
                StepModes(plant.nstates, (), 0, None, "" if growth.stable else growth.text, str(error))
            )
        growth = growth_of_plant(plant, loop, [mode.eigenvalue for mode in modes.modes])
        swings = [self._as_dict(mode) for mode in modes.modes if _swings(mode.name)]
        return {
            "states": plant.nstates if loop is None else loop.nstates,
            "swings": swings,
            "controls": len(modes.modes) - len(swings),
            "counted": modes.counted,
            "growing": "" if growth.stable else growth.text,
        }

    def _as_dict(self, mode: Any) -> dict[str, Any]:
        shape = {m.name: [mode.shape[m.name].real, mode.shape[m.name].imag] for m in self.case.machines}
        return {
            "name": mode.name,
            "frequency_hz": mode.frequency_hz,
            "damping_ratio": mode.damping_ratio,
            "shape": shape,
        }

    def _run(self, case: Case, cycles: float, controller: Controller | None) -> FaultRun:
        clear_s = _FAULT_S + cycles / case.frequency_hz
        events = after_clearing(case, self.fault.bus, self.fault.trip, _FAULT_S, clear_s)
        return FaultRun(events, _STOP_S, controller, LATENCY_S)

    def _link(self, case: Case) -> dict[str, Any]:
        try:
            plant = sparse_linear_plant(case, self.cache)
            modes = all_modes(plant, case.areas, band_hz=BAND_HZ, below=BELOW)
            weak = weak_modes(_grid(case, plant, modes), self._choices())
            sees, missing = signals_of_set(weak, weak.sets[0])
            if AFAR in missing or OWN in missing:
                return {"problem": "; ".join(missing.values())}
            at = 2.0 * np.pi * weak.weakest.frequency_hz
            nodes = {0.0: -0.3, 0.6 * at: -0.3, 0.9 * at: 0.0, 1.2 * at: 0.0, 2.5 * at: -0.05, 4.0 * at: -0.1}
            designs = LinkDesigns(
                weak, {"base": case}, BandOffsets(tuple(nodes), tuple(nodes.values())), (), self.cache
            )
            own = designs.designed(sees[OWN])
            afar = designs.designed(sees[AFAR], LINK_MS, own)
            own = designs.best_own(sees[OWN], [own, afar])
        except InterareaError as error:
            if machine_error(error) is not None:
                raise
            return {"problem": str(error)}
        return {
            "actuator": weak.sets[0].actuators[0],
            "own": designs.row(OWN, sees[OWN], 0, own).least,
            "afar": designs.row(AFAR, sees[AFAR], LINK_MS, afar, own).least,
        }

    def _choices(self) -> Choices:
        exciters = tuple(f"{m.name}_vs" for m in self.case.machines if m.exciter.kind != "constant")
        return Choices(grid=self.case.name, most_actuators=1, effort=EFFORT, actuators=exciters)


def fault_of(case: Case, flow: PowerFlow) -> FaultPlace:
    """Return a fault at the branch that carries most power and whose trip leaves the grid whole.

    Raises UserError where every branch cuts the grid.
    """
    loaded = sorted(
        (b for b in case.branches if b.in_service), key=lambda b: -abs(flow.flow(b.name, b.from_bus))
    )
    for branch in loaded:
        try:
            operating_variant(case, out=[branch.name])
        except UserError:
            continue
        return FaultPlace(bus=branch.from_bus, trip=branch.name)
    raise UserError(f"{case.name}: the trip of any branch separates the grid; no branch can clear a fault")


def _grid(case: Case, plant: SparsePlant, modes: AllModes) -> GridModes:
    return GridModes(case, plant, modes, growth_of_plant(plant, known=[m.eigenvalue for m in modes.modes]))


def _swings(name: str) -> bool:
    """Whether a mode of this name is of the machines against each other.

    >>> _swings("local area 1.2"), _swings("control 3"), _swings("common frequency")
    (True, False, False)
    """
    return not name.startswith(("control", COMMON))


def _swing(known: Mapping[str, Any]) -> Swing:
    return Swing(**{**known, "shape": {m: complex(*z) for m, z in known["shape"].items()}})


def traced(steps: Sequence[StepModes]) -> list[Swing | None]:
    """Return the weakest inter-area mode of the first step, then at each step the swing of nearest shape."""
    first = [one for one in steps[0].swings if one.name.startswith("inter-area")]
    place: Swing | None = min(first, key=lambda one: one.damping_ratio, default=None)
    result = [place]
    for step in steps[1:]:
        result.append(step.following(place))
        place = result[-1] or place
    return result
