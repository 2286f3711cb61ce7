"""Put a system together in Python and run it: participants, channels, connections, events.

    grid = System(stop_s=20.0)
    grid.plant("two-area-thesis")
    grid.controller("wdc")
    grid.channel("remote", latency_s=0.1, outages_s=[(10.0, 12.0)])
    grid.connect("plant.G2_dw", "remote", "controller.G2_dw")
    grid.connect("plant.G4_dw", "controller.G4_dw").connect("controller.G4_vs", "plant.G4_vs")
    grid.event("vref_pulse", machine="G1", size_pu=0.05, start_s=1.0, end_s=1.2)
    result = grid.run()
    result.data  # a DataFrame; units in result.units

Any FMI 2.0 co-simulation FMU takes part with `fmu`, anything that meets `Participant` with `add`. A scenario
becomes a system too (`run.system_of`): for a run, for the many of a sweep, for an archive.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar
from warnings import warn

from pydantic import ValidationError

from interarea.design.controllers.bank import ControllerBank
from interarea.design.delay.loop_modes import LoopModes
from interarea.fmu_build.open.ports import DLL_SUFFIXES
from interarea.fmu_build.write.cache import default_cache
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.concentrator import concentrator_block
from interarea.models.blocks.plant import event_parameters
from interarea.models.blocks.pmu import PmuFilter, pmu_block
from interarea.models.blocks.variables import Block
from interarea.models.case.case import Case, load_case
from interarea.models.case.events import slot_count
from interarea.models.documents import in_seconds
from interarea.models.mistakes import mistakes

from ..clock import on_tick, roundings
from ..errors import GraphError, ScenarioError, ScenarioWarning, StepError, nearest
from ..master.graph import end_of, pairs_of
from ..master.instances import FmuParticipant, Value
from ..master.isolated import RealCodeParticipant, participant_of
from ..master.master import Master
from ..master.plan import LoopPlan
from ..master.records import Sink
from ..participant import Participant
from ..results.accumulators import Accumulators, Curves
from ..results.judge import Gathered, Judge
from ..results.latency_test import SelfTest
from ..results.metrics import METRICS, RING_DOWN
from ..results.result import Result
from ..results.ringdown import Swing, control_limit_pu
from ..results.run import Run
from ..scenario.channels import ChannelLine, hold_packets, points_of
from ..scenario.concentrators import ConcentratorLine, require_effect
from ..scenario.scenario import Scenario
from .artefacts import EVENT_SLOTS
from .controllers import ControllerLike, controller_block_of, controller_of
from .events import timed_event
from .instance import Fmus, Instance, start_values
from .latency import self_test_of
from .linear_loop import Loop, linear_swings
from .outcome import fields_of_result

Line = ChannelLine | ConcentratorLine
AnyLine = TypeVar("AnyLine", ChannelLine, ConcentratorLine)
PLANT, CONTROLLER = "plant", "controller"


class System:
    """A system to be run from `start_s` to `stop_s`; every method that adds something returns the system.

    Parameters
    ----------
    stop_s, start_s : s.
    step_s : communication step; None: chosen from latencies, events and reporting intervals.
    cache : folder of FMUs and designs; default `default_cache()`.
    arrivals : ``exact``: packets come out of a channel at their instant, which is a communication point;
        ``grid``: at the next point there is, as the ledger then says.
    strict : refuse FMUs whose description breaks the standard where it does no harm; else a warning tells.
    options : `LoopPlan`'s (inputs, loops, tolerance, substeps, engine).
    """

    def __init__(
        self,
        *,
        stop_s: float,
        start_s: float = 0.0,
        step_s: float | None = None,
        cache: Path | None = None,
        arrivals: Literal["exact", "grid"] = "exact",
        strict: bool = False,
        **options: Any,
    ) -> None:
        self.stop_s, self.start_s = on_tick(stop_s, "stop_s"), on_tick(start_s, "start_s")
        self.step_s, self.options, self.arrivals = step_s, options, arrivals
        self.strict = strict
        self.fmus = Fmus(default_cache() if cache is None else cache)  #: opened files
        self.scenario: Scenario | None = None  #: that this is the system of
        self.swing: Swing | None = None  #: what runs of that scenario are judged by
        self.channels: dict[str, Line] = {}
        self.connections: list[tuple[str, str]] = []
        self.latency_s: dict[str, float] = {}
        self.warnings: list[str] = []  #: what the scenario says that is probably unintended
        self.rounded: list[str] = []  #: times that lay between two ticks of the clock, and what they became
        self.parts: dict[str, Instance] = {}
        self.others: dict[str, Participant] = {}  #: that are no FMUs: DLLs, user-defined participants
        self.plants: dict[str, Case] = {}
        self.shows: dict[str, tuple[str, ...]] = {}
        self.pmus: dict[str, PmuFilter] = {}
        self.bank: ControllerBank | None = None  #: of controllers, where the controller is one
        self.events: dict[str, list[Any]] = {}
        self.event_times: list[float] = []
        self.at_rest = True  # until an instance comes in that may start anywhere

    # -- participants ---------------------------------------------------------------------

    def plant(self, case: str | Path | Case, name: str = "plant", *, show: Sequence[str] = ()) -> System:
        """Add the plant of a case (bundled name, file or `Case`); show : outputs beside its own, by pattern.

        Raises
        ------
        CaseError, ScenarioError
        """
        loaded = case if isinstance(case, Case) else load_case(case)
        self.plants[name], self.shows[name] = loaded, (*show, *Judge.reads(loaded))
        return self.put(Instance(name, self.fmus.plant(loaded, self._slots(name), self.shows[name])))

    def controller(self, controller: ControllerLike, name: str = CONTROLLER, trust: bool = False) -> System:
        """Add a controller: an object, its file, an FMU, an IEEE/CIGRE DLL, or a name (see `controller_of`).

        A named one is designed for the plant added before, once into the cache. trust : with flags.

        Raises
        ------
        ScenarioError : no such controller, or no plant to design it for.
        """
        if isinstance(controller, str | Path) and Path(controller).suffix in DLL_SUFFIXES:
            return self.fmu(name, controller)
        if isinstance(controller, str | Path) and Path(controller).suffix == ".fmu":
            return self.put(Instance(name, self.fmus.open(Path(controller))))
        if not self.plants:
            raise ScenarioError(f"{name}: add the plant first; its case has the base speed of the loop")
        case = next(reversed(self.plants.values()))
        loaded = controller_of(controller, case, self.fmus.cache)
        if loaded is None:
            return self
        file = self.fmus.controller(loaded, case.omega_b, trust=trust)
        self.bank = loaded if isinstance(loaded, ControllerBank) else None
        block = partial(controller_block_of, loaded, case.omega_b, trust=trust)
        return self.put(Instance(name, file, block=block))

    def fmu(
        self,
        name: str,
        file: str | Path,
        *,
        start: Mapping[str, Value] | None = None,
        latency_s: float = 0.0,
        isolate: bool = False,
        time_limit_s: float | None = None,
        **values: Value,
    ) -> System:
        """Add any FMI 2.0 co-simulation FMU with start values for its parameters, states or inputs.

        An IEEE/CIGRE DLL takes part too: always in a process of its own, called at its sample times.

        start : start values by name; those whose names are no keywords of this method can be `values` too.
        latency_s : a promise that its inputs need at least that long to reach its outputs.
        isolate : run it in a process of its own, which it may crash (`WorkerParticipant`).
        time_limit_s : longest time one call may take there; default `TIME_LIMIT_S`.

        Raises
        ------
        GraphError : see `FmuFile` and `FmuParticipant`. ScenarioError : a time limit without isolate.
        """
        if Path(file).suffix in DLL_SUFFIXES:
            dll = RealCodeParticipant(name, Path(file), {**(start or {}), **values}, time_limit_s)
            return self.add(dll, latency_s=latency_s)
        process: dict[str, Any] = {"isolate": isolate, "time_limit_s": time_limit_s}
        opened = self.fmus.open(Path(file))
        begin = start_values(name, opened, start, values, latency_s=latency_s, **process)
        participant_of(name, opened, begin, **process).close()  # refuses wrong start values here
        self.at_rest = False
        if latency_s:
            self.latency_s[name] = latency_s
        return self.put(Instance(name, opened, begin, process=process))

    def add(self, participant: Participant, *, latency_s: float = 0.0) -> System:
        """Add a participant of any kind; `latency_s` as in `fmu`."""
        self.at_rest = False
        self._free(participant.name)
        if latency_s:
            self.latency_s[participant.name] = latency_s
        self.others[participant.name] = participant
        return self

    def put(self, instance: Instance) -> System:
        self._free(instance.name)
        if self.strict:
            instance.file.require_conforming()
        self.warnings += {instance.file.warning} - {"", *self.warnings}
        self.parts[instance.name] = instance
        return self

    def _free(self, name: str) -> None:
        if name in self.parts or name in self.others:
            raise ScenarioError(f"two instances are named {name!r}; each needs a unique name")

    def channel(self, name: str, line: ChannelLine | None = None, **keys: Any) -> System:
        """Add a channel: input ``u``, outputs ``y``, ``valid``, ``age``; keys as in a scenario file.

        Raises
        ------
        ScenarioError : a key or value that a channel does not take.
        """
        where = f"channels.{name}"
        return self.line(name, line or self._checked(ChannelLine, keys, where), where)

    def line(self, name: str, line: Line, where: str) -> System:
        """Add what delays signals."""
        line = line.seeded(name)
        block: Callable[[], Block]
        if isinstance(line, ChannelLine):
            file, block = self.fmus.channel(), channel_block
        else:
            signals = len(line.signals)
            file, block = self.fmus.concentrator(signals), lambda: concentrator_block(signals)
        self.put(Instance(name, file, line.parameters(where), block))
        self.channels[name] = line
        self.latency_s[name] = line.least_latency_s
        self.event_times += line.event_times_s
        return self

    def pmu(self, name: str, measures: PmuFilter) -> System:
        """Add a PMU with a filter of `pmu_filter`: inputs ``re``, ``im``, outputs ``deviation``, .."""
        self.pmus[name] = measures
        return self.put(Instance(name, self.fmus.pmu(), measures.parameters, pmu_block))

    def concentrator(
        self,
        name: str,
        signals: Sequence[Mapping[str, Any]] = (),
        line: ConcentratorLine | None = None,
        **keys: Any,
    ) -> System:
        """Add a concentrator: inputs ``u1``.., aligned outputs ``y1``.., ``valid1``.., ``age`` and counts.

        signals : of each the keys of `PathTable`. keys : of `ConcentratorLine`. ScenarioError : others.
        """
        where, table = f"concentrators.{name}", {"signals": tuple(signals), **keys}
        return self.line(name, line or self._checked(ConcentratorLine, table, where), where)

    def _checked(self, kind: type[AnyLine], keys: Mapping[str, Any], where: str) -> AnyLine:
        try:
            line = kind.model_validate(keys)
        except ValidationError as error:
            raise ScenarioError(*(f"{where}.{text}" for text in mistakes(error, kind))) from None
        require_effect({where: line})
        self.rounded += roundings(keys, line, where)
        return line

    # -- what connects and disturbs them --------------------------------------------------

    def connect(self, *path: str) -> System:
        """Connect along a path: ``"a.y", "b.u"``, or through channels ``"a.y", "remote", "b.u"``.

        Ends are checked when the master is made, channels on the way at once.
        """
        self.connections += [p for p in pairs_of(path, self.channels) if p not in self.connections]
        return self

    def event(self, kind: Any, *, plant: str | None = None, **fields: Any) -> System:
        """Add an event to a plant (default: the one there is): kind and fields as in a file, or an object.

        Raises
        ------
        ScenarioError, CaseError : see `interarea.models.case.events`; an unknown target.
        """
        if plant is None and len(self.plants) == 1:
            plant = next(iter(self.plants))
        if plant not in self.plants:
            if not self.plants:
                raise ScenarioError("event: no plant yet; add the plant first")
            raise ScenarioError(f"event: plant = {plant!r}; {nearest(str(plant), self.plants)}")
        where = f"event {1 + sum(len(events) for events in self.events.values())}"
        rated_hz = self.plants[plant].frequency_hz
        event, rounded = timed_event(kind, in_seconds(fields, lambda: rated_hz), where)
        events = [*self.events.get(plant, []), event]
        event_parameters(self.plants[plant], events)  # refuses an unknown target here
        self.events[plant] = events
        self.rounded += rounded
        self.event_times += [t for t in (event.start_s, getattr(event, "end_s", None)) if t is not None]
        return self

    def mark(self, *times_s: float) -> System:
        """Make these instants communication points, beside which signals may jump."""
        self.event_times += times_s
        return self

    # -- running --------------------------------------------------------------------------

    @property
    def case(self) -> Case:
        """The case of the only plant."""
        (case,) = self.plants.values()
        return case

    @property
    def instances(self) -> dict[str, Instance]:
        """The FMUs of the system by name; a plant has its events among its start values."""
        return {name: self._with_events(instance) for name, instance in self.parts.items()}

    def participant(self, name: str) -> Participant:
        """Return an instance by name; the error names those there are."""
        if name in self.others:
            return self.others[name]
        if name not in self.parts:
            raise GraphError(f"no instance {name!r}; {nearest(name, [*self.parts, *self.others])}")
        events = self._with_events(self.parts[name])
        return participant_of(name, events.file, events.start, **events.process)

    @property
    def signals(self) -> list[str]:
        """Every output of every FMU, as results name it."""
        return [f"{name}.{p.name}" for name, i in self.parts.items() for p in i.file.description.outputs]

    @property
    def event_times_s(self) -> tuple[float, ...]:
        """Instants of events and outages inside the run, s."""
        return tuple(sorted({t for t in self.event_times if self.start_s < t < self.stop_s}))

    @property
    def points(self) -> tuple[int, ...]:
        """Ticks at which packets come out, where these are communication points."""
        return points_of(self.channels.values(), self.arrivals, self.start_s, self.stop_s)

    @property
    def plan(self) -> LoopPlan:
        """The loop as it stands, without its participants. GraphError : an option that does not exist."""
        times: dict[str, Any] = {"stop_s": self.stop_s, "start_s": self.start_s, "step_s": self.step_s}
        times |= {"event_times_s": self.event_times_s, "points": self.points, "latency_s": self.latency_s}
        return LoopPlan(self.connections, **times, at_rest=self.at_rest, **self.options)

    def master(
        self, participants: Collection[FmuParticipant] | None = None, sink: Sink | None = None
    ) -> Master:
        """Return a master of the system, to be stepped: a context manager that ends the instances.

        participants : of the `instances`, where they are there already. sink : see `Master`.

        Raises
        ------
        GraphError, ScenarioError : see `Master`.
        """
        parts: list[Participant] = list(self.others.values())
        if participants is None:
            parts += [participant_of(n, i.file, i.start, **i.process) for n, i in self.instances.items()]
        parts += participants or ()
        by_name = {p.name: p for p in parts}
        for name, line in self.channels.items():
            hold_packets(by_name[name], line)
        for source, target in self.connections:
            end_of(source, by_name)
            end_of(target, by_name)
        return Master(self.plan, parts, sink=sink)

    def run(self, *, progress: Callable[[float, float], object] | None = None) -> Result:
        """Run to the end and return what happened.

        progress : called with (present time, stop time), s.

        Raises
        ------
        GraphError, ScenarioError; StepError : an FMU failed; it has the results so far.
        """
        with self.master() as master:
            master.advance(progress=progress)
            return self.result(master)

    def gathered(
        self, master: Master, stop_s: float | None = None, requested: Collection[str] = (*METRICS, RING_DOWN)
    ) -> Gathered:
        """Return what takes a run's points, as they come or at once; `stop_s` of the last, if not the end."""
        judge = None
        if self.scenario is not None and self.swing is not None:
            until = {"step_s": master.step_s, "stop_s": self.stop_s if stop_s is None else stop_s}
            judge = Judge(self.case, self.swing, self.scenario, **until, requested=requested)
        return Gathered(Accumulators(tuple(self.channels)), judge, Curves(master.recorded))

    def result(
        self, master: Master, gathered: Gathered | None = None, failed: StepError | None = None
    ) -> Result:
        """Return what a master has done so far, or gave to `gathered` as it ran; with a case a `Run`.

        failed : what ended the run before its time; then there are no metrics, hence no `Run`.
        """
        done = master.trajectory if gathered is None else gathered.curves.trajectory
        if gathered is None:
            gathered = self.gathered(master, float(done.time_s[-1]))
            gathered.count(done)
        common = fields_of_result(
            *(master, done, gathered.accumulators),
            pmus=self.pmus,
            channels=self.channels,
            rounded=self.rounded,
            warnings=(*self.warnings, *gathered.warnings),
            failed=failed,
        ) | {"scenario": self.scenario}
        if (judge := gathered.judge) is None or failed is not None:
            return Result(**common)
        loop, limit = self.linear_loop(), control_limit_pu(master)
        common |= {"case": self.case, "swing": judge.swing}
        return Run(**common, measure=lambda: judge.metrics(limit, linear_swings(loop)))

    def warned(self) -> System:
        """Return this system after a `ScenarioWarning` for each of its warnings."""
        for line in self.warnings:
            warn(line, ScenarioWarning, stacklevel=4)
        return self

    def linear_swings(self) -> LoopModes | str:
        """Return the swings of the system of a scenario with a case as roots of its loop, or why not."""
        return linear_swings(self.linear_loop())

    def linear_loop(self) -> Loop:
        """Return what the linear loop of the system's scenario is made of."""
        assert self.scenario is not None
        controller = self.parts.get(CONTROLLER)
        own = (self.parts[PLANT], controller, self.bank, self.fmus, tuple(self.others))
        return Loop(self.scenario, self.case, *own)

    def self_test(self, master: Master | None = None) -> SelfTest:
        """Measure the latency of every connection; compare with the ledger (module `latency_test`)."""
        files = {name: self.parts[name].file for name in self.channels}
        return self_test_of(master or self.master(), self.channels, files, self.arrivals)

    def _slots(self, plant: str) -> int:
        return max(EVENT_SLOTS, slot_count(self.events.get(plant, ())))

    def _with_events(self, instance: Instance) -> Instance:
        """Return a plant with its events as start values; others as they are."""
        name = instance.name
        if name not in self.plants:
            return instance
        events = self.events.get(name, ())
        return self.fmus.with_events(instance, self.plants[name], events, self._slots(name), self.shows[name])
