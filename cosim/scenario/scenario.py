"""A scenario: what is run, through which channels, and what happens when.

A scenario file is TOML:

    case = "two-area-thesis"           # bundled name or file
    controller = "ftc"                 # none | wdc | cc | ftc | a controller file or FMU
    stop_s = 20.0
    step_s = 0.01                      # optional
    [channels.remote]
    signal = "G2_dw"                   # plant output -> controller input of the same name
    latency_s = 0.1
    on_loss = "hold_then_zero"         # zero | hold | hold_then_zero (for hold_s)
    outages_s = [[10.0, 20.0]]
    [[event]]                          # interarea.models.case.events
    kind = "vref_pulse"
    machine = "G1"
    size_pu = 0.05
    start_s = 1.0
    end_s = 1.2

User-defined FMUs, whatever made them, with the plant or without a case:

    connections = [["plant.G2_dw", "remote", "mine.u"], ["mine.y", "plant.G4_vs"]]  # channels on the way
    [fmus.mine]
    file = "mine.fmu"                  # beside the scenario
    start = {gain = 3.0}               # optional
    latency_s = 0.0                    # optional: at least so long from input to output
    isolate = true                     # optional: in a process of its own, which it may crash
    time_limit_s = 60.0                # optional, of one call of an isolated FMU

Several signals through one concentrator (IEEE C37.247), which aligns them by time stamp:

    [concentrators.pdc]
    wait_s = 0.1                       # longest wait for a set; relative = true: from the first arrival
    latency_s = 0.02                   # from there on; also reporting_interval_s, on_loss, seed
    [[concentrators.pdc.signals]]
    signal = "G2_dw"                   # as of a channel; without it: connections to pdc.u1, from pdc.y1
    latency_s = 0.03                   # also jitter_s, loss, lost_s = [start, end]
    [[concentrators.pdc.signals]]
    signal = "G4_dw"

A PMU (IEC/IEEE 60255-118-1) at a bus in place of an output of the plant, also of a concentrator's signal:

    [channels.remote]
    signal = "G2_dw"                   # the controller's input
    pmu = {bus = 2, performance = "P"} # also quantity = frequency | rocof | v | angle, reporting_rate_hz

A channel takes besides: reporting_interval_s (packets; needed by what follows), jitter_s (uniform),
latency = {kind = "gamma", shape, scale_s} | {kind = "empirical", quantiles_s} on top of latency_s,
loss = {kind = "bernoulli", rate} | {kind = "gilbert_elliott", good_to_bad, bad_to_good, loss_good, loss_bad},
pdc_wait_s, seed; and, with or without packets, quantum.

The signal is wrong and its flag up (`signal_faults`: stuck, bias, ramp, drift, scale, polarity, time_error,
oscillating; with packets noise, spike, replay too):

    [[channels.remote.signal_faults]]
    kind = "scale"
    factor = 3.0
    start_s = 1.5                      # end_s: optional

Changes to what `case` and `controller` name, so that no copy of either is needed:

    controller_gain = 1.2              # times the controller's output, before its limit
    controller_limit_pu = 0.1
    [operating_point]                  # interarea.models.case.variants: also out = ["8-9 a"]
    tie_flow_mw = 100.0
    load_scale = 0.95
    [plant]                            # start values of the plant FMU's parameters
    "G1.exciter.Efd_max" = 5.0

A detector of wrong signals, which may travel only to be compared: `[detector]`, all its keys optional.

Optional besides: `swing = ["G2", "G4"]`, the machines whose difference of speeds the run is judged by
(default: those of the case, else the extreme ones of the inter-area mode's shape); `title`, `source`,
`[master]` (inputs, loops, tolerance, arrivals, early; `joint = true`: one block and no master) and
`[expect]`, the outcome that the gallery states and the tests assert. A signal without a channel reaches the
controller undelayed. A time may be in periods of the case's frequency: "8 cycles", "1.0 s + 8 cycles", and in
an event "start + 8 cycles". An instant is a whole number of nanoseconds; one between two is taken as the
nearer, and the delay ledger says so.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import (
    BaseModel,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from interarea.fmu_build.open.ports import DLL_SUFFIXES
from interarea.models.documents import in_seconds
from interarea.models.errors import Collected, UserError
from interarea.models.mistakes import mistakes
from interarea.models.table import ShortName, Table, Title

from ..clock import event_on_ticks, on_tick, roundings
from ..errors import ScenarioError
from ..toml_file import read_toml
from .channels import Seconds
from .concentrators import require_effect
from .detector import DetectorTable
from .expectation import Expectation
from .master_table import MasterTable
from .named import scenario_file
from .names import NAMED_CONTROLLERS, beside, grid_of, wrong_names
from .signal_paths import ChannelTable, ConcentratorTable, SignalPath, signal_faults_of, signal_paths_of

if TYPE_CHECKING:  # the file is checked before what a case takes is loaded
    from interarea.models.case.case import Case

BUNDLED = Path(__file__).parent / "bundled"
_HIDDEN = ("name", "folder", "rounded")  #: keys that no hint names
_RESERVED = ("plant", "controller")
#: outputs of the plant that it shows only when asked
_OF_NETWORK = re.compile(r"bus\d+\.(v|angle|re|im)|branch\[.*\]\.[pqi]")


class FmuTable(Table):
    """Any FMI 2.0 co-simulation FMU: file, start values, the least latency it promises."""

    file: Annotated[str, Field(min_length=1)]  #: the FMU, relative to this file
    start: Mapping[str, float | int | bool | str] = {}  #: variable -> start value
    latency_s: Seconds = 0.0  #: least delay from any input to any output
    isolate: bool = False  #: in a separate process
    time_limit_s: Annotated[float, Field(gt=0.0)] | None = None  #: of one call there

    @model_validator(mode="after")
    def _limited(self) -> Self:
        if self.time_limit_s is not None and not self.isolate:
            raise ValueError("time_limit_s ends calls of an isolated FMU; set isolate = true")
        return self

    @property
    def process(self) -> dict[str, Any]:
        """Where it runs, as `participant_of` takes it."""
        return {"isolate": self.isolate, "time_limit_s": self.time_limit_s}


class OperatingPointTable(Table):
    """Another operating point of the case: see `operating_variant`."""

    tie_flow_mw: float = 0.0  #: load moved across the tie, so that its flow grows by this
    load_scale: Annotated[float, Field(gt=0.0)] = 1.0  #: factor on every load
    out: tuple[str, ...] = ()  #: names of branches
    vary: tuple[str, ...] = ()  #: parameters changed by name, such as "inertia -20 %"


class Scenario(Table):
    """A checked scenario; `folder` is where relative file names start."""

    case: str = ""  #: the grid: bundled name (`interarea list`), or a case file beside this one
    #: none, a bundled name, a controller file, any FMU or DLL
    controller: Annotated[str, Field(min_length=1)] = "none"
    controller_gain: float = 1.0  #: factor on the controller's output, before its limit
    #: instead of the controller's own output limit
    controller_limit_pu: Annotated[float, Field(gt=0.0)] | None = None
    #: changes to the case for this scenario
    operating_point: OperatingPointTable = OperatingPointTable.model_construct()
    plant: Mapping[str, float] = {}  #: start value of parameters of the plant's FMU by name
    stop_s: Annotated[float, Field(gt=0.0)]  #: end of the run
    #: communication step; default: chosen from latencies and events
    step_s: Annotated[float, Field(gt=0.0)] | None = None
    #: name -> the path of one signal; a signal without a channel is not delayed
    channels: Mapping[ShortName, ChannelTable] = {}
    #: name -> several signals aligned by time stamp (IEEE C37.247)
    concentrators: Mapping[ShortName, ConcentratorTable] = {}
    fmus: Mapping[ShortName, FmuTable] = {}  #: name -> a user-defined FMU
    #: identifies wrong signals and withholds them from the controller
    detector: DetectorTable | None = None
    connections: tuple[tuple[str, ...], ...] = ()  #: [from, channels between, to] for user-defined FMUs
    #: reject an FMU whose description violates the standard even without consequences; default: a warning
    strict: bool = False
    #: additional outputs of the plant, by pattern: bus16.v, bus*.angle, branch[1-2].i
    show: tuple[str, ...] = ()
    record: tuple[str, ...] = ()  #: signals (INSTANCE.VARIABLE, or a pattern: plant.*) to write; default: all
    every: Annotated[int, Field(ge=1)] = 1  #: every n-th point is written, and the last
    event: tuple[Any, ...] = ()  #: faults, trips, pulses and steps, a table each
    #: [machine, machine]: speed difference that is the swing signal; default: the case's, else the
    #: extreme machines of the inter-area mode
    swing: Annotated[tuple[str, ...], Field(min_length=2, max_length=2)] | None = None
    title: Title = ""  #: one line on the purpose
    source: str = ""  #: source of the scenario
    master: MasterTable = MasterTable.model_construct()  #: how the FMUs are stepped
    expect: Expectation = Expectation.model_construct()  #: expected outcome
    name: ShortName = "scenario"  #: short, for files and messages; default: the file's name
    folder: Path = Path()
    rounded: tuple[str, ...] = ()  #: times that lay between two ticks, and what they were taken as

    @field_validator("stop_s", "step_s")
    @classmethod
    def _on_the_clock(cls, value: float | None) -> float | None:
        return None if value is None else on_tick(value, "stop_s and step_s")

    @field_validator("channels", "concentrators")
    @classmethod
    def _seeded(cls, value: Mapping[str, Any]) -> Mapping[str, Any]:
        return {name: line.seeded(name) for name, line in value.items()}

    @field_validator("event")
    @classmethod
    def _events_on_the_clock(cls, value: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(event_on_ticks(e, f"event {k}") for k, e in enumerate(value, start=1))

    @model_validator(mode="after")
    def _fits(self) -> Self:
        """Refuse what does not go together, all of it at once."""
        wrong = [*self._without_a_case(), *self._names(), *self._signal_ends(), *self._times()]
        changed = self.controller_gain != 1.0 or self.controller_limit_pu is not None
        if changed and (self.controller == "none" or self.controller.endswith((".fmu", *DLL_SUFFIXES))):
            wrong.append(
                "controller_gain and controller_limit_pu have no effect on controller = "
                f"{self.controller!r}, "
                "allowed: with a controller of this package"
            )
        wrong += [
            f"connections has {list(path)}, allowed: source, channels, target"
            for path in self.connections
            if len(path) < 2
        ]
        if wrong:
            raise ValueError("\n".join(wrong))
        return self

    def _times(self) -> Iterator[str]:
        """Yield what is wrong about instants: all lie inside the run, signals arrive in it."""
        if self.step_s is not None and not self.step_s <= self.stop_s:
            yield f"step_s = {self.step_s:g}, allowed: at most stop_s = {self.stop_s:g}"
        allowed = f"outside the run, allowed: 0 to {self.stop_s:g}"
        for k, e in enumerate(self.event, start=1):
            if not e.start_s < self.stop_s:
                yield f"event {k} ({e.kind}): start_s = {e.start_s:g} lies {allowed}"
        for name, line in self.lines.items():
            if not line.least_latency_s < self.stop_s:
                kind, late_s = "channels" if name in self.channels else "concentrators", line.least_latency_s
                yield (
                    f"{kind}.{name}: a latency of {late_s:g} s with stop_s = {self.stop_s:g}: no packet "
                    "would arrive, allowed: below stop_s (in seconds: 0.1 are 100 ms)"
                )
        for name, channel in self.channels.items():
            for start, _ in channel.outages_s:
                if not start < self.stop_s:
                    yield f"channels.{name}: an outage starts at {start:g} s, {allowed}"
        for where, faults in signal_faults_of(self.channels, self.concentrators).items():
            for fault in faults:
                if not fault.start_s < self.stop_s:
                    yield f"{where}: {fault.kind} fault starts at {fault.start_s:g} s, {allowed}"

    def _without_a_case(self) -> Iterator[str]:
        """Yield what acts on a case that is not there, or that there is nothing to run."""
        if self.case:
            return
        if not self.fmus:
            yield "case is missing (or fmus: a scenario needs a case or FMUs)"
            return
        if self.event or self.controller != "none":
            yield "event and controller need a case; user-defined FMUs belong in fmus"
        if self.plant or self.show or not self.as_in_file:
            yield "plant, show and operating_point need a case"

    def _names(self) -> Iterator[str]:
        """Yield each instance whose name is no name, or that of another."""
        seen = set(_RESERVED)
        for kind in ("fmus", "channels", "concentrators"):
            for name in getattr(self, kind):
                if not name.isidentifier() or name in seen:
                    yield (
                        f"{kind}.{name}: its name must be an identifier other than "
                        f"{' and '.join(_RESERVED)}, used once"
                    )
                seen.add(name)
        if self.detector is not None:
            yield from self.detector.wrong(self.signals, seen)
        for path in self.signals:
            if path.source in seen:
                yield f"{path.source}: the name of the PMU before {path.u} is taken, allowed: one not in use"

    def _signal_ends(self) -> Iterator[str]:
        """Yield each way that nothing travels, and each signal that travels twice."""
        ends = [(f"channels.{n}", c.signal, n) for n, c in self.channels.items()]
        for name, table in self.concentrators.items():
            for i, s in enumerate(table.signals, start=1):
                ends.append((f"concentrators.{name}.signals {i}", s.signal, f"{name}.u{i}"))
        taken: dict[str, str] = {}
        for where, signal, end in ends:
            if signal and not self.case:
                yield f"{where}: signal needs a case; connect {end} by connections"
            if not signal and not any(end in path for path in self.connections):
                yield f"{where}: signal is missing (or name {end} in connections)"
            if signal in taken:
                yield (
                    f"{where}: signal = {signal!r} is already sent through {taken[signal]}, "
                    "allowed: one channel for each signal"
                )
            if signal:
                taken.setdefault(signal, where)

    @property
    def lines(self) -> dict[str, ChannelTable | ConcentratorTable]:
        """Channels and concentrators by name: whatever delays signals and counts packets."""
        return {**self.channels, **self.concentrators}

    @property
    def signals(self) -> list[SignalPath]:
        """What travels to the controller, and how."""
        return list(signal_paths_of(self.channels, self.concentrators))

    @property
    def shows(self) -> tuple[str, ...]:
        """Outputs of the plant beside those that it shows by itself: asked for, measured, named in a way."""
        named = [w.signal for w in self.signals if w.pmu is None]
        named += [path[0].removeprefix("plant.") for path in self.connections if path[0].startswith("plant.")]
        named += [source for w in self.signals if w.pmu is not None for source, _ in w.pmu.inputs]
        return tuple(dict.fromkeys([*self.show, *(n for n in named if _OF_NETWORK.fullmatch(n))]))

    @property
    def event_times_s(self) -> tuple[float, ...]:
        """Instants of events and outages inside the run."""
        from interarea.models.case.events import instants

        times = [t for e in self.event for t in instants(e)]
        times += [t for c in self.lines.values() for t in c.event_times_s]
        return tuple(sorted({t for t in times if 0.0 < t < self.stop_s}))

    @property
    def case_path(self) -> str | Path:
        """The case as `load_case` takes it: a bundled name, or a file beside the scenario."""
        return beside(self.folder, self.case)

    @property
    def as_in_file(self) -> bool:
        """Whether the case is at the operating point of its file."""
        return self.operating_point == OperatingPointTable()

    def load_case(self) -> Case:
        """Return the case at its operating point here; CaseError as `load_case` and `operating_variant`."""
        from interarea.models.case.case import load_case
        from interarea.models.case.variants import operating_variant

        case = load_case(self.case_path)
        return case if self.as_in_file else operating_variant(case, **self.operating_point.model_dump())

    def as_stated(self, case: Case) -> Case:
        """Return `case`, which `load_case` gave, without the change of `operating_point`."""
        from interarea.models.case.case import load_case

        return case if self.as_in_file else load_case(self.case_path)

    @property
    def controller_path(self) -> Path | None:
        """The controller file, or None for a named controller."""
        if self.controller in NAMED_CONTROLLERS:
            return None
        return Path(beside(self.folder, self.controller))


def load_scenario(
    source: str | Path | Mapping[str, Any] | Scenario, *, frequency_hz: float | None = None
) -> Scenario:
    """Return the scenario of a TOML file, an SSP archive, a bundled name, or a dict of the same keys.

    frequency_hz : of the grid that takes the place of the scenario's case; "8 cycles" are of that.

    Raises
    ------
    ScenarioError : one line with file, key, value and what is allowed.
    """
    if isinstance(source, Scenario):
        return source
    if isinstance(source, Mapping):
        return _checked(dict(source), "scenario", Path(), frequency_hz)
    if not isinstance(source, str | Path):
        what = type(source).__name__
        raise ScenarioError(
            f"scenario: is of the type {what}, wanted: a file, a bundled name, or a dict of its keys"
        )
    path = scenario_file(source)
    if path.suffix.lower() == ".ssp":
        from .ssp import table_of_ssp

        table, folder = table_of_ssp(path)
        return _checked(table, str(path), folder, frequency_hz)
    table = read_toml(path, "scenario", ScenarioError)
    loaded = _checked({"name": path.stem[:64], **table}, str(path), path.parent, frequency_hz)
    require_effect(
        {f"{path}: channels.{name}": line for name, line in loaded.channels.items()}
        | {f"{path}: concentrators.{name}": line for name, line in loaded.concentrators.items()}
    )
    return loaded


def _frequency_hz(table: Mapping[str, Any], where: str, folder: Path) -> float:
    """Rated frequency of the case that a table names, which times in cycles are of."""
    named = table.get("case")
    if not isinstance(named, str) or not named:
        raise ScenarioError(f"{where}: a time in cycles is of a case's frequency; name one (case = ...)")
    try:
        return float(grid_of(folder, named).frequency_hz)
    except UserError as error:
        raise ScenarioError(*(f"{where}: {line}" for line in error.args)) from None


def _checked(content: dict[str, Any], where: str, folder: Path, frequency_hz: float | None) -> Scenario:
    errors = Collected()
    table, events = content, ()
    with errors:
        table = in_seconds(content, lambda: frequency_hz or _frequency_hz(content, where, folder))
    if errors.lines:  # cycles of some frequency, for the rest to be looked at
        table = in_seconds(content, lambda: 50.0)
    with errors:
        events = _events_of(table.get("event", []), where)
    try:
        scenario = Scenario.model_validate({"folder": folder, **table, "event": events})
    except UserError as error:
        errors.lines += error.args
    except ValidationError as error:
        errors.lines += [f"{where}: {line}" for line in mistakes(error, Scenario, hidden=_HIDDEN, times=True)]
    if errors.lines:
        errors.lines += [line for line in wrong_names(table, where, folder) if line not in errors.lines]
        raise ScenarioError(*errors.lines)
    rounded = (*scenario.rounded, *roundings(table, scenario))
    return scenario.model_copy(update={"rounded": rounded}) if rounded else scenario


def _events_of(tables: Any, where: str) -> tuple[Any, ...]:
    """Return the events of a scenario, given as tables or as events."""
    if not isinstance(tables, list | tuple):
        raise ScenarioError(f"{where}: event = {tables!r}, allowed: [[event]] tables")
    others = [(k, e) for k, e in enumerate(tables, start=1) if not isinstance(e, Mapping | BaseModel)]
    wrong = [f"{where}: event {k} = {e!r}, allowed: a table" for k, e in others]
    if wrong:
        raise ScenarioError(*wrong)
    if tables and all(isinstance(e, Mapping) for e in tables):
        from interarea.models.case.events import events_of

        return events_of(tables, where=where)
    return tuple(tables)
