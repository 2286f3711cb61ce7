"""The tables of a study's file, and of the file of what a publication prints, as pydantic checks them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from interarea.design.synthesis.study_designs import CcSpec, FtcSpec, WdcSpec
from interarea.models.case.events import Event
from interarea.models.table import Table

from ..errors import nearest
from ..scenario.channels import Probability, Seconds
from ..scenario.names import NAMED_CONTROLLERS

Positive = Annotated[float, Field(gt=0.0)]
Word = Annotated[str, Field(min_length=1)]
Designed = Literal["wdc", "cc", "ftc"]
Wiring = Literal["synchronous", "non-synchronous"]
Outputs = Literal["difference", "signals"]
#: sections of the report that have figures
Section = Literal[
    "system",
    "participation",
    "shapes",
    "reduction",
    "wdc",
    "delay",
    "delay_runs",
    "loss",
    "faults",
]


def latency_name(controller: str, wiring: str, value_s: float) -> str:
    """Return the name of one run with latency, such as wdc-synchronous-100ms."""
    return f"{controller}-{wiring}-{round(1e3 * value_s)}ms"


class DesignsTable(Table):
    """Specifications of controllers that differ from those of the study of the thesis."""

    wdc: WdcSpec | None = None  #: keys of the wide-area damping controller that differ
    cc: CcSpec | None = None  #: keys of the conventional controller that differ
    ftc: FtcSpec | None = None  #: keys of the fault-tolerant controller that differ


class RedesignTable(Table):
    """The WDC designed again with a latency as a Padé model in its design plant."""

    latency_s: Positive  #: the latency of the model
    on: Literal["both", "remote"]  #: delayed signals: both (synchronous feedback), or the remote one
    order: Annotated[int, Field(ge=1)]  #: states of the reduced controller
    plant_order: Annotated[int, Field(ge=1)] | None = None  #: states of the reduced plant; none: as designed


class LatencyTable(Table):
    """One controller under latency: an exact curve, and one run for each value and wiring."""

    controller: Designed  #: name of the controller
    disturbance: Word  #: disturbance of its runs: a name under `disturbance`
    #: latencies of the runs; the curve ends at the largest
    values_s: Annotated[tuple[Positive, ...], Field(min_length=1)]
    redesign: tuple[RedesignTable, ...] = ()  #: designs for a latency, one table each


class MarginTable(Table):
    """Two runs on either side of the exact synchronous margin of a controller."""

    controller: Designed  #: name of the controller: that of `latency`
    distance: Annotated[float, Field(gt=0.0, lt=1.0)]  #: of both runs from the margin, share of it
    stop_s: Positive  #: end of both runs
    events: Annotated[tuple[Event, ...], Field(min_length=1)]  #: events, so small that no limit is reached


class BurstsTable(Table):
    """Loss on the remote signal in bursts: a good and a bad state, at most one change per packet."""

    loss_good: Probability = 0.0  #: probability of packet loss in the good state
    loss_bad: Probability = 0.0  #: probability of packet loss in the bad state
    good_to_bad: Probability = 0.0  #: probability per packet of a change to the bad state
    bad_to_good: Probability = 0.0  #: probability per packet of a change to the good state


class JitterTable(Table):
    """Random latency together with loss, by Monte Carlo on the co-simulation."""

    least_s: Seconds  #: the least latency
    shape: Positive  #: shape of the gamma distribution of the additional latency
    scale_s: Positive  #: scale of that distribution; its mean is shape times scale
    loss_rate: Probability  #: probability of packet loss
    on_loss: Literal["zero", "hold"]  #: value in place of a lost packet: zero, or the last one received
    disturbance: Word  #: disturbance of the runs: a name under `disturbance`
    seeds: Annotated[int, Field(ge=1)]  #: number of runs of each controller


class PacketsTable(Table):
    """Packets on both signals: mean-square decay under loss, and runs with jitter."""

    interval_s: Positive  #: interval between packets
    latency_s: Seconds  #: latency of every packet
    #: loss rates at which the decay is reported
    loss_rates: Annotated[tuple[Probability, ...], Field(min_length=1)]
    bursts: BurstsTable  #: loss in bursts
    jitter: JitterTable  #: random latency with loss


class CyclesTable(Table):
    """Range of the clearing times, in cycles of the case's frequency."""

    shortest: Annotated[float, Field(gt=0.0, alias="from")]  #: shortest clearing time
    longest: Annotated[float, Field(gt=0.0, alias="to")]  #: longest clearing time
    tolerance: Positive  #: tolerance of the bisection


class CeilingTable(Table):
    """A change to the case at every operating point, such as ceilings of the exciters."""

    key: Word  #: short name, part of the name of the changed case
    name: Word  #: name in the table of the report
    change: Mapping[str, object] = {}  #: as `change` of a case file; empty: the case as it is


class SurvivalPointTable(Table):
    """An operating point of the fault."""

    name: Word  #: name in the table of the report
    tie_flow_mw: float = 0.0  #: change of the flow between the areas
    out: tuple[str, ...] = ()  #: branches out of service


class StabilizerTable(Table):
    """A stabilizer for comparison: K s Tw/(1 + s Tw) ((1 + s T1)/(1 + s T2))^stages, Tw = 10 s."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]  #: name in the table of the report
    machine: Word  #: machine of its speed signal and of its exciter
    K: float  #: gain, pu of voltage per pu of speed
    T1: Annotated[float, Field(ge=0.0)]  #: time constant of the numerator, s
    T2: Positive  #: time constant of the denominator, s
    stages: Annotated[int, Field(ge=0)]  #: number of lead-lags
    limit_pu: Positive  #: limit of its output


class SurvivalTable(Table):
    """Transient stability: a fault at every operating point, its critical clearing time by bisection."""

    disturbance: Word  #: a name under `disturbance` that has a bus fault
    lost_at_s: Seconds  #: time of the loss, in the runs that lose a signal
    watch_s: Positive  #: simulated time after the fault; longer if the linear loop is slow
    cycles: CyclesTable  #: range of the clearing times
    controllers: Annotated[tuple[Word, ...], Field(min_length=1)]  #: wdc, cc, ftc or any bundled one
    stabilizer: tuple[StabilizerTable, ...] = ()  #: local stabilizers for comparison, one table each
    ceiling: Annotated[tuple[CeilingTable, ...], Field(min_length=1)]  #: changes to the case, one table each
    point: Annotated[tuple[SurvivalPointTable, ...], Field(min_length=1)]  #: operating points, one table each


class RunTable(Table):
    """A co-simulation of the study."""

    name: Word  #: name of the run in figures and statements
    title: Word  #: title in the report
    controller: Word  #: none, wdc, cc, ftc or any bundled one
    disturbance: Word  #: a name under `disturbance`
    lost_at_s: Seconds | None = None  #: time of the permanent loss of the remote signal; none: no loss


class _Figure(Table):
    key: Word  #: short unique name, also that of the file
    section: Section  #: section of the report
    title: Word  #: title of the figure


class OneLineFigure(_Figure):
    """The one-line diagram with its power flow; needs every bus in `diagram`."""

    kind: Literal["one_line"]


class ParticipationFigure(_Figure):
    """Participation factors of a mode; omitted if the case has no mode of that name."""

    kind: Literal["participation"]
    mode: Word  #: name of the mode, such as `inter-area`


class ModeShapeFigure(_Figure):
    """The shape of a mode; omitted if the case has no mode of that name."""

    kind: Literal["mode_shape"]
    mode: Word  #: name of the mode, such as `inter-area`


class SingularValuesFigure(_Figure):
    """Singular values of the full and of a reduced plant."""

    kind: Literal["singular_values"]
    reduction: Word  #: a key of `reduction`


class HankelFigure(_Figure):
    """Hankel singular values of every reduction."""

    kind: Literal["hankel_values"]


class GeneralisedPlantFigure(_Figure):
    """The generalised plant of the designs, as a diagram."""

    kind: Literal["generalised_plant"]


class BodeFigure(_Figure):
    """A controller as designed and as shipped, over frequency."""

    kind: Literal["bode"]
    controller: Designed  #: name of the controller


class SensitivityFigure(_Figure):
    """S or KS of the loop of the controller `sensitivity`, and the bound by its weight."""

    kind: Literal["sensitivity"]
    function: Literal["S", "KS"]  #: function to draw


class SwingFigure(_Figure):
    """The speed difference, remote minus local, in selected runs."""

    kind: Literal["swing"]
    runs: Mapping[str, Word]  #: text of the legend -> name of the run
    marks: Mapping[str, Seconds] = {}  #: text -> time of a vertical line
    span_s: tuple[Seconds, Seconds] | None = None  #: part of the run that is shown; none: all
    micro: bool = False  #: true: axis in millionths, for small signals


class ControlFigure(_Figure):
    """The controller's output in selected runs."""

    kind: Literal["control"]
    runs: Mapping[str, Word]  #: text of the legend -> name of the run


class LatenciesFigure(_Figure):
    """The runs over latency with one wiring, one panel each."""

    kind: Literal["latencies"]
    wiring: Wiring  #: synchronous: both signals late; non-synchronous: the remote one
    reference: Word  #: the run without latency


class LatencyDampingFigure(_Figure):
    """Damping over latency: exact, and fitted to the runs."""

    kind: Literal["latency_damping"]


Figure = Annotated[
    OneLineFigure
    | ParticipationFigure
    | ModeShapeFigure
    | SingularValuesFigure
    | HankelFigure
    | GeneralisedPlantFigure
    | BodeFigure
    | SensitivityFigure
    | SwingFigure
    | ControlFigure
    | LatenciesFigure
    | LatencyDampingFigure,
    Field(discriminator="kind"),
]


class StudyTable(Table):
    """A study: one case, its controllers by the methods of the thesis, what is run, drawn and judged."""

    title: Word  #: title of the report
    case: Word  #: bundled name, or a case file relative to this one
    published: str  #: the publication to compare with: key of a source, place
    stop_s: Positive  #: end of the runs
    step_s: Positive  #: communication step of the runs
    remote: Word  #: the remote signal
    local: Word  #: the signal measured at the actuator
    swing: Word  #: name of the difference remote minus local
    controllers: Annotated[tuple[Designed, ...], Field(min_length=1)]  #: controllers to design
    sensitivity: Designed  #: controller whose S, KS and weighted norms are reported
    claims: str | None = None  #: file of printed claims, relative to this one; none: no verdicts
    design: DesignsTable = DesignsTable()  #: differences from the specifications of the thesis
    #: order of a reduced plant -> its outputs: their `difference`, or both `signals`
    reduction: Mapping[str, Outputs]
    disturbance: Mapping[str, tuple[Event, ...]]  #: name -> events, as in a scenario
    latency: LatencyTable  #: a controller under latency
    margin: MarginTable  #: runs on either side of the latency margin
    packets: PacketsTable | None = None  #: loss and jitter; none: omitted
    survival: SurvivalTable | None = None  #: faults at every operating point; none: omitted
    scenario: Annotated[tuple[RunTable, ...], Field(min_length=1)]  #: runs, one table each
    figure: tuple[Figure, ...] = ()  #: figures, one table each
    diagram: Mapping[str, tuple[float, float]] = {}  #: bus number -> [x, y] in the one-line diagram

    @property
    def runs(self) -> list[str]:
        """Names of the scenarios and of the runs with latency."""
        late = self.latency
        return [row.name for row in self.scenario] + [
            latency_name(late.controller, wiring, value)
            for wiring in ("synchronous", "non-synchronous")
            for value in late.values_s
        ]

    @model_validator(mode="after")
    def _names_what_is_there(self) -> Self:
        wrong = [
            *_strange("sensitivity", [self.sensitivity], self.controllers),
            *_strange("latency.controller", [self.latency.controller], self.controllers),
            *self._of_margin(),
            *self._disturbances(),
            *self._runners(),
            *(line for k, row in enumerate(self.figure, 1) for line in self._of_figure(k, row)),
        ]
        for key, names in (
            ("scenario", [row.name for row in self.scenario]),
            ("figure", [row.key for row in self.figure]),
        ):
            wrong += [f"{key}: {name!r} is there twice, allowed: once" for name in _twice(names)]
        if wrong:
            raise ValueError("\n".join(wrong))
        return self

    def _of_margin(self) -> Iterator[str]:
        if self.margin.controller != self.latency.controller:
            yield (
                f"margin.controller = {self.margin.controller!r}, allowed: {self.latency.controller!r}, "
                "whose margin `latency` looks for"
            )

    def _disturbances(self) -> Iterator[str]:
        """Yield each disturbance that is not there; that of `survival` has a bus fault."""
        named = {f"scenario {k}": row.disturbance for k, row in enumerate(self.scenario, 1)}
        named["latency"] = self.latency.disturbance
        if self.packets is not None:
            named["packets.jitter"] = self.packets.jitter.disturbance
        if self.survival is not None:
            named["survival"] = self.survival.disturbance
        for where, name in named.items():
            yield from _strange(f"{where}.disturbance", [name], self.disturbance)
        events = self.disturbance.get(named.get("survival", ""), ())
        if events and not any(event.kind == "bus_fault" for event in events):
            yield f"survival.disturbance = {named['survival']!r} has no bus_fault whose clearing can be moved"

    def _runners(self) -> Iterator[str]:
        """Yield each controller of a run that is not bundled."""
        for k, row in enumerate(self.scenario, 1):
            yield from _strange(f"scenario {k}.controller", [row.controller], NAMED_CONTROLLERS)
        if self.survival is not None:
            known = [name for name in NAMED_CONTROLLERS if name != "none"]
            yield from _strange("survival.controllers", self.survival.controllers, known)
            names = [*self.survival.controllers, *(row.name for row in self.survival.stabilizer)]
            yield from (f"survival: {n!r} is there twice, allowed: once" for n in _twice(names))

    def _of_figure(self, k: int, row: Figure) -> Iterator[str]:
        """Yield what a figure shows that is not there."""
        runs = [*getattr(row, "runs", {}).values(), *filter(None, [getattr(row, "reference", None)])]
        yield from _strange(f"figure {k}: run", runs, self.runs)
        if isinstance(row, BodeFigure):
            yield from _strange(f"figure {k}: controller", [row.controller], self.controllers)
        if isinstance(row, SingularValuesFigure):
            yield from _strange(f"figure {k}: reduction", [row.reduction], self.reduction)


def _strange(what: str, names: Iterable[str], known: Iterable[str]) -> Iterator[str]:
    there = list(known)
    for name in names:
        if name not in there:
            yield f"{what} = {name!r}; {nearest(name, there)}"


def _twice(names: list[str]) -> list[str]:
    return sorted({name for name in names if names.count(name) > 1})


#: a number with the digits of its print: half a unit of the last one is its tolerance
Printed = Annotated[str, Field(pattern=r"^[-+]?\d*\.?\d+$")]


class PrintedModeTable(Table):
    """A mode as it is printed."""

    printed_as: Word  #: name in the publication
    mode: Word  #: our name of the mode, such as `inter-area`
    exchanged: str | None = None  #: our name in an alternative reading, with two rows exchanged
    frequency_hz: Printed  #: in quotes, with the printed digits
    damping_ratio: Printed  #: in quotes, with the printed digits


class PrintedLoopTable(Table):
    """A loop as it is printed, with its selection index."""

    actuator: Word  #: machine of the actuator
    signal: Word  #: signal, such as `dw24`
    index: Printed  #: in quotes, with the printed digits
    meant: Printed | None = None  #: intended value, if the printed one is impossible
    note: str = ""  #: reason, printed with the number


class StatementTable(Table):
    """A printed statement: it agrees if all parts hold, in part if some do, else differs."""

    where: Word  #: place in the publication
    check: Word  #: short unique name, used by pages
    says: Word  #: the statement, paraphrased
    #: name -> path into study.json: keys and positions between slashes, `key=value` a row, `@x` the nearest
    evidence: Mapping[str, Word]
    parts: Annotated[tuple[Word, ...], Field(min_length=1)]  #: comparisons of the evidence
    ours: Word  #: our result; `{name:.3f}` inserts evidence
    why: str = ""  #: reason of the difference
    always: bool = False  #: true: print `why` also if it agrees


class CorrectionTable(Table):
    """A correction of the printed text."""

    where: Word  #: place in the publication
    holds: Word  #: correct statement


class ClaimsTable(Table):
    """Claims of a publication, for verdicts by a study's results."""

    source: str = ""  #: key of the source
    where: str = ""  #: part of the publication
    modes: tuple[PrintedModeTable, ...] = ()  #: table of modes, one entry per row
    loops: tuple[PrintedLoopTable, ...] = ()  #: table of loops, one entry per row
    statement: tuple[StatementTable, ...] = ()  #: statements, one table each
    correction: tuple[CorrectionTable, ...] = ()  #: corrections of the text, one table each
