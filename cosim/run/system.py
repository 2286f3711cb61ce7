"""Put a system together in Python and run it: participants, channels, connections, events.

    grid = System(stop_s=20.0)
    grid.plant("two-area-thesis")
    grid.controller("wdc")
    grid.channel("remote", latency_s=0.1, outages_s=[(10.0, 12.0)])
    grid.connect("plant.G2_dw", "remote", "controller.G2_dw")
    grid.connect("plant.G4_dw", "controller.G4_dw")
    grid.connect("controller.G4_vs", "plant.G4_vs")
    grid.event("vref_pulse", machine="G1", size_pu=0.05, start_s=1.0, end_s=1.2)
    result = grid.run()
    result.data  # a DataFrame; units in result.units

Any FMI 2.0 co-simulation FMU takes part with `fmu`, anything that meets `Participant` with `add`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import ValidationError

from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import Case, load_case
from interarea.models.case.events import event_of
from interarea.models.errors import CaseError

from ..clock import on_tick
from ..errors import GraphError, ScenarioError, nearest, one_line
from ..master.graph import end_of
from ..master.instances import FmuParticipant, Value
from ..master.isolated import participant_of
from ..master.master import Master
from ..participant import Participant
from ..results.delay_ledger import delay_ledger, explain, packet_ledger
from ..results.latency_test import SelfTest, self_test
from ..results.result import Result
from ..scenario.channels import ChannelLine, hold_packets
from ..scenario.concentrators import ConcentratorLine
from ..scenario.scenario import event_on_ticks, roundings
from ..trajectory import Trajectory

if TYPE_CHECKING:
    from control import StateSpace

    from interarea.design.controllers.controller import Controller

Line = ChannelLine | ConcentratorLine
_SLOTS = 8  # of events that the plant FMU of a case has


class System:
    """A system to be run from `start_s` to `stop_s`; every method that adds something returns the system.

    Parameters
    ----------
    stop_s, start_s : s.
    step_s : communication step; None: chosen from latencies, events and reporting intervals.
    cache : folder of FMUs and designs; default `default_cache()`.
    arrivals : ``exact``: packets come out of a channel at their instant, which is a communication point;
        ``grid``: at the next point there is, as the ledger then says.
    options : `Master`'s (inputs, loops, tolerance, substeps, engine).
    """

    def __init__(
        self,
        *,
        stop_s: float,
        start_s: float = 0.0,
        step_s: float | None = None,
        cache: Path | None = None,
        arrivals: Literal["exact", "grid"] = "exact",
        **options: Any,
    ) -> None:
        from interarea.fmu_build.write.cache import default_cache

        self.stop_s, self.start_s = on_tick(stop_s, "stop_s"), on_tick(start_s, "start_s")
        self.step_s = step_s
        self.options, self.arrivals = options, arrivals
        self.cache = default_cache() if cache is None else cache
        self.channels: dict[str, Line] = {}
        self.connections: list[tuple[str, str]] = []
        self.latency_s: dict[str, float] = {}
        self._participants: dict[str, Participant] = {}
        self._plants: dict[str, Case] = {}
        self._events: dict[str, list[Any]] = {}
        self._marks: list[float] = []
        self.rounded: list[str] = []  #: times that lay between two ticks of the clock, and what they became
        self._files: dict[Path, FmuFile] = {}
        self._at_rest = True  # until an instance comes in that may start anywhere

    # -- participants ---------------------------------------------------------------------

    def plant(self, case: str | Path | Case, name: str = "plant") -> System:
        """Add the plant of a case (bundled name, file or `Case`).

        Raises
        ------
        CaseError, ScenarioError
        """
        from .artefacts import plant_fmu

        loaded = case if isinstance(case, Case) else load_case(case)
        self._put(FmuParticipant(name, self._file(plant_fmu(loaded, self.cache))))
        self._plants[name] = loaded
        return self

    def controller(
        self, controller: str | Path | Controller | StateSpace, name: str = "controller"
    ) -> System:
        """Add a controller: a `Controller`, its file, any FMU (``.fmu``), or a name (wdc, cc, ftc, shipped).

        A `control.StateSpace` is taken too: u = +K y, speeds in rad/s, outputs in pu.

        A named controller is designed for the plant added before, once into the cache.

        Raises
        ------
        ScenarioError : no such controller, or no plant to design it for.
        """
        from control import StateSpace

        from interarea.design.controllers.controller import Controller

        from .artefacts import CONTROLLER_NAMES, controller_fmu, design_controller

        if isinstance(controller, str | Path) and Path(controller).suffix == ".fmu":
            return self.fmu(name, controller)
        if not self._plants:
            raise ScenarioError(f"{name}: add the plant first; its case gives the controller its base speed")
        case = next(reversed(self._plants.values()))
        if isinstance(controller, str | Path):
            from interarea.design.controllers.bundled import shipped_names

            known = (*CONTROLLER_NAMES, *shipped_names())
            if str(controller) in known:
                controller = design_controller(case, str(controller), self.cache)
            elif Path(controller).is_file():
                controller = Controller.load(Path(controller))
            else:
                raise ScenarioError(
                    f"{name} = {str(controller)!r} is neither a name nor a file; "
                    f"{nearest(str(controller), known)}"
                )
        if isinstance(controller, StateSpace):
            controller = Controller.of(controller)
        fmu = controller_fmu(controller, case.omega_b, self.cache)
        return self._put(FmuParticipant(name, self._file(fmu)))

    def fmu(
        self,
        name: str,
        file: str | Path,
        *,
        latency_s: float = 0.0,
        isolate: bool = False,
        time_limit_s: float | None = None,
        **start: Value,
    ) -> System:
        """Add any FMI 2.0 co-simulation FMU with start values for its parameters, states or inputs.

        latency_s : a promise that its inputs need at least that long to reach its outputs.
        isolate : run it in a process of its own, which it may crash (`WorkerParticipant`).
        time_limit_s : longest time one call may take there; default `TIME_LIMIT_S`.

        Raises
        ------
        GraphError : see `FmuFile` and `FmuParticipant`. ScenarioError : a time limit without isolate.
        """
        made = participant_of(name, self._file(Path(file)), start, isolate=isolate, time_limit_s=time_limit_s)
        return self.add(made, latency_s=latency_s)

    def add(self, participant: Participant, *, latency_s: float = 0.0) -> System:
        """Add a participant of any kind; `latency_s` as in `fmu`."""
        self._at_rest = False
        if latency_s:
            self.latency_s[participant.name] = latency_s
        return self._put(participant)

    def _put(self, participant: Participant) -> System:
        if participant.name in self._participants:
            raise ScenarioError(f"two instances are named {participant.name!r}; each needs a name of its own")
        self._participants[participant.name] = participant
        return self

    def channel(self, name: str, line: ChannelLine | None = None, **keys: Any) -> System:
        """Add a channel: input ``u``, outputs ``y``, ``valid``, ``age``; keys as in a scenario file.

        Raises
        ------
        ScenarioError : a key or value that a channel does not take.
        """
        from .artefacts import channel_fmu

        where = f"channels.{name}"
        if line is None:
            try:
                line = ChannelLine.model_validate(keys)
                self.rounded += roundings(keys, line, where)
            except ValidationError as error:
                text = one_line(error, lambda _: ChannelLine.model_fields)
                raise ScenarioError(f"{where}.{text}") from None
        instance = FmuParticipant(name, self._file(channel_fmu(self.cache)), line.parameters(where))
        self._put(hold_packets(instance, line))
        self.channels[name] = line
        self.latency_s[name] = line.least_latency_s
        self._marks += line.marks_s
        return self

    def concentrator(
        self,
        name: str,
        signals: Sequence[Mapping[str, Any]] = (),
        line: ConcentratorLine | None = None,
        **keys: Any,
    ) -> System:
        """Add a concentrator: inputs ``u1``.., aligned outputs ``y1``.., ``valid1``.., ``age`` and counts.

        signals : of each the keys of `SignalWay`. keys : of `ConcentratorLine`.

        Raises
        ------
        ScenarioError : a key or value that it does not take.
        """
        from .artefacts import concentrator_fmu

        if line is None:
            try:
                line = ConcentratorLine.model_validate({"signals": tuple(signals), **keys})
                self.rounded += roundings(keys, line, f"concentrators.{name}")
            except ValidationError as error:
                text = one_line(error, ConcentratorLine.keys_at)
                raise ScenarioError(f"concentrators.{name}.{text}") from None
        file = self._file(concentrator_fmu(len(line.signals), self.cache))
        self._put(hold_packets(FmuParticipant(name, file, line.parameters(name)), line))
        self.channels[name] = line
        self.latency_s[name] = line.least_latency_s
        return self

    # -- what connects and disturbs them --------------------------------------------------

    def connect(self, *path: str) -> System:
        """Connect along a path: ``"a.y", "b.u"``, or through channels ``"a.y", "remote", "b.u"``.

        Ends are checked when the master is made, channels on the way at once.
        """
        self.connections += [p for p in pairs_of(path, self.channels) if p not in self.connections]
        return self

    def event(self, kind: Any, *, plant: str | None = None, **fields: Any) -> System:
        """Add an event to a plant (default: the one there is): its kind and fields, or an event object.

        Raises
        ------
        ScenarioError, CaseError : see `interarea.models.case.events`; an unknown target.
        """
        if plant is None and len(self._plants) == 1:
            plant = next(iter(self._plants))
        if plant not in self._plants:
            if not self._plants:
                raise ScenarioError("event: there is no plant yet for it to happen to; add the plant first")
            raise ScenarioError(f"event: plant = {plant!r}; {nearest(str(plant), self._plants)}")
        try:
            found = event_of({"kind": kind, **fields}, where="event") if isinstance(kind, str) else kind
        except CaseError as error:
            raise ScenarioError(str(error)) from None
        number = 1 + sum(len(events) for events in self._events.values())
        given, found = found, event_on_ticks(found, f"event {number}")
        self.rounded += roundings(given, found, f"event {number}")
        events = [*self._events.get(plant, []), found]
        event_parameters(self._plants[plant], events)  # refuses an unknown target here
        self._events[plant] = events
        times = (found.start_s, getattr(found, "end_s", None))
        self._marks += [t for t in times if t is not None]
        return self

    def mark(self, *times_s: float) -> System:
        """Make these instants communication points, beside which signals may jump."""
        self._marks += times_s
        return self

    # -- running --------------------------------------------------------------------------

    @property
    def case(self) -> Case:
        """The case of the only plant."""
        (case,) = self._plants.values()
        return case

    def participant(self, name: str) -> Participant:
        """Return an instance by name; the error names those there are."""
        if name not in self._participants:
            raise GraphError(f"no instance {name!r}; {nearest(name, self._participants)}")
        return self._participants[name]

    @property
    def marks_s(self) -> tuple[float, ...]:
        """Instants of events and outages inside the run, s."""
        return tuple(sorted({t for t in self._marks if self.start_s < t < self.stop_s}))

    @property
    def points(self) -> tuple[int, ...]:
        """Ticks at which packets come out, where these are communication points."""
        return points_of(self.channels.values(), self.arrivals, self.start_s, self.stop_s)

    def master(self) -> Master:
        """Return a master of the system, to be stepped: a context manager that ends the instances.

        Raises
        ------
        GraphError, ScenarioError : see `Master`.
        """
        for source, target in self.connections:
            end_of(source, self._participants)
            end_of(target, self._participants)
        return Master(
            [self._with_events(p) for p in self._participants.values()],
            self.connections,
            stop_s=self.stop_s,
            start_s=self.start_s,
            step_s=self.step_s,
            marks_s=self.marks_s,
            points=self.points,
            latency_s=self.latency_s,
            at_rest=self._at_rest,
            **self.options,
        )

    def run(self, *, progress: Callable[[float, float], object] | None = None) -> Result:
        """Run to the end and return what happened.

        progress : called with (present time, stop time), s.

        Raises
        ------
        GraphError, ScenarioError; StepError : an FMU failed; the error has the results so far.
        """
        with self.master() as master:
            return self.result(master, master.run(progress=progress))

    def result(self, master: Master, trajectory: Trajectory | None = None) -> Result:
        """Return what a master of this system has done so far."""
        done = master.trajectory if trajectory is None else trajectory
        delays = {name: line.delays(master.clock) for name, line in self.channels.items()}
        ledger = delay_ledger(master, delays, self.rounded)
        return Result(
            trajectory=done,
            ledger=ledger,
            packets=packet_ledger(done, self.channels),
            explanation=explain(master, ledger),
        )

    def self_test(self, master: Master | None = None) -> SelfTest:
        """Measure the latency of every connection; compare with the ledger (module `self_test`)."""
        parts = {n: p for n, p in self._participants.items() if n in self.channels}
        files = {n: p.file for n, p in parts.items() if isinstance(p, FmuParticipant)}
        return self_test_of(self.master() if master is None else master, self.channels, files, self.arrivals)

    # -- private --------------------------------------------------------------------------

    def _file(self, path: Path) -> FmuFile:
        if path not in self._files:
            self._files[path] = FmuFile(path)
        return self._files[path]

    def _with_events(self, participant: Participant) -> Participant:
        """Return the plant with its events as start values; others as they are."""
        case, events = self._plants.get(participant.name), self._events.get(participant.name, [])
        if case is None or not events:
            return participant
        from interarea.fmu_build.write.package import block_fmu

        from .artefacts import plant_fmu

        start = event_parameters(case, events)
        if len(events) <= _SLOTS:
            file = self._file(plant_fmu(case, self.cache))
        else:
            file = self._file(block_fmu(plant_block(case, event_slots=len(events)), self.cache))
        return FmuParticipant(participant.name, file, start)


def pairs_of(path: Sequence[str], channels: Collection[str]) -> list[tuple[str, str]]:
    """Return the connections along a path from a source through `channels` to a target.

    >>> pairs_of(["a.y", "remote", "b.u"], ["remote"])
    [('a.y', 'remote.u'), ('remote.y', 'b.u')]

    Raises
    ------
    GraphError : fewer than two ends, or something on the way that is no channel.
    """
    if len(path) < 2:
        raise GraphError(f"connection {list(path)}: a source and a target are needed")
    first, *middle, last = path
    for name in middle:
        if name not in channels:
            raise GraphError(
                f"connection {list(path)}: {name!r} on the way is no channel; {nearest(name, channels)}"
            )
    ends = [f"{first}.y" if first in channels else first]
    ends += [f"{name}.{port}" for name in middle for port in ("u", "y")]
    ends.append(f"{last}.u" if last in channels else last)
    return list(zip(ends[::2], ends[1::2], strict=True))


def points_of(channels: Iterable[Line], arrivals: str, start_s: float, stop_s: float) -> tuple[int, ...]:
    """Return the ticks that are communication points because a packet comes out of a channel."""
    if arrivals == "grid":
        return ()
    return tuple(sorted({t for line in channels for t in line.arrivals(start_s, stop_s)}))


def self_test_of(
    master: Master, channels: Mapping[str, Line], files: Mapping[str, FmuFile], arrivals: str
) -> SelfTest:
    """Return the self-test of a master whose `channels` are instances of `files`."""
    lines = {name: line.steady for name, line in channels.items()}

    def fresh(name: str) -> Participant:
        return hold_packets(FmuParticipant(name, files[name], lines[name].parameters(name)), lines[name])

    return self_test(
        master,
        {name: fresh(name) for name in lines},
        delays=lambda clock: {name: line.delays(clock) for name, line in lines.items()},
        points=lambda stop_s: points_of(lines.values(), arrivals, 0.0, stop_s),
        interval_s=max([line.reporting_interval_s for line in lines.values()], default=0.0),
    )
