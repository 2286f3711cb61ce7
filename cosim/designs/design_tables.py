"""Tables inside a design file: operating points, parts, stages of the search, guard, faults."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations, pairwise
from typing import Annotated

from pydantic import AfterValidator, Field, field_validator, model_validator

from interarea.design.delay.signal_conditions import ONE_WRONG, Condition, condition_of_many
from interarea.design.robust.smoothed_objective import BandOffsets
from interarea.design.robust.stages import Stage
from interarea.models.blocks.controller import Guard
from interarea.models.case.case import Case
from interarea.models.table import Table

Positive = Annotated[float, Field(gt=0.0)]


def _rising(nodes: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    for (low, _), (high, _) in pairwise(nodes):
        if not high > low:
            raise ValueError(f"has {high:g} rad/s after {low:g} rad/s, allowed: rising ones")
    return nodes


#: (rad/s, damping), straight between the nodes
Offsets = Annotated[tuple[tuple[float, float], ...], AfterValidator(_rising)]


def _identifier(name: str) -> str:
    if not name.isidentifier():
        raise ValueError(f"is {name!r}, allowed: letters, digits and _")
    return name


Identifier = Annotated[str, AfterValidator(_identifier)]
Ratio = Annotated[float, Field(ge=-1.0, lt=1.0)]


class PointTable(Table):
    """One operating point, as a change to the case (`models.case_variants`)."""

    name: str  #: of the operating point
    tie_flow_mw: float = 0.0  #: load moved across the tie, so that its flow grows by this
    out: tuple[str, ...] = ()  #: branches out of service
    load_scale: Positive = 1.0  #: factor on every load
    #: parameters changed by name: "exciter gain -30 %", "inertia of area 2 -30 %", "tie reactance +20 %",
    #: "loads of constant power", "no stabilizer at G3", "no governors", ...
    vary: tuple[str, ...] = ()
    #: (rad/s, damping) required here in addition to `offset` of the design; none: nothing
    more: Offsets = ()
    #: (least damping ratio of any swing mode, of the inter-area mode) that the certificate asks here, instead
    #: of what `ask` and `target` say
    ask: tuple[Ratio, Ratio] | None = None


class AskTable(Table):
    """Requirements of the certificate at every operating point under every condition."""

    worst_swing: Ratio = 0.0  #: least damping ratio of any swing mode
    inter_area: Ratio = 0.0  #: least damping ratio of the inter-area mode
    #: largest H-infinity norm of K (I - G K)^-1 at any operating point, pu per rad/s
    effort: Positive = float("inf")
    fastest_pole: Positive = float("inf")  #: largest magnitude of the controller's poles, rad/s
    #: what any one mode may lose, nothing being lost, of its damping ratio without control, or of 0.1 where
    #: that is less
    given_away: Positive = float("inf")
    synchronism: bool = False  #: after the fault of `fault`, at every operating point

    def check(self, least_cap: float, slowest_pole: float) -> None:
        """Raise ValueError if no controller within the bounds of the search can meet the requirements."""
        contradictions = (
            ("ask.effort", self.effort, "every effort_cap", least_cap, self.effort >= least_cap),
            (
                "ask.fastest_pole",
                self.fastest_pole,
                "slowest_pole",
                slowest_pole,
                self.fastest_pole > slowest_pole,
            ),
        )
        for requested, value, by, bound, agreed in contradictions:
            if not agreed:
                raise ValueError(
                    f"{requested} = {value:g} contradicts {by} ({bound:g}): the certificate would fail"
                )


class TargetTable(Table):
    """Targets under one kind of condition, instead of `ask` and `offset`, which apply to all."""

    #: `all` signals there at once, some `late`, `lost` or `scaled`; or the code of one of the `conditions`,
    #: whose target comes before that of its kind
    under: str
    #: (rad/s, damping) that the search wants under it on top of `offset` of the design; none: as much
    more: Offsets = ()
    worst_swing: Ratio = 0.0  #: least damping ratio of any swing mode that the certificate asks for
    inter_area: Ratio = 0.0  #: least damping ratio of the inter-area mode that it asks for


class PartTable(Table):
    """One actuator of a decentralised controller: its inputs and its order, including a washout."""

    actuator: str  #: input of the plant that this part controls
    signals: tuple[str, ...] = Field(min_length=1)  #: inputs of this part
    order: Annotated[int, Field(ge=1, le=20)] = 4  #: states of this part, including its washout


class MemberTable(Table):
    """A controller of a bank for a subset of signals; points, limits, search as in the design."""

    name: Identifier  #: of the member: letters, digits and _
    #: it acts if these arrive, and not all of those of a member before it
    signals: tuple[str, ...] = Field(min_length=1)
    #: as in the design, for its own signals
    conditions: tuple[str, ...] = Field(min_length=1)
    order: Annotated[int, Field(ge=1, le=20)] = 6  #: states for each actuator
    #: (rad/s, damping) as `offset` of the design; none: that of the design
    offset: Offsets = ()
    #: cap of the effort as `effort_cap` of the design; none: that of the design
    effort_cap: tuple[tuple[Positive, Positive], ...] = ()
    first_swing: bool = True  #: whether [first_swing] of the design applies
    worst_swing: Ratio = 0.0  #: least damping ratio of any swing mode that its certificate asks for
    inter_area: Ratio = 0.0  #: least damping ratio of the inter-area mode that it asks for


class BankTable(Table):
    """A bank instead of one controller: the design's own acts with all its signals, else a `member`.

    A supervisor follows the validity flags of the signals and fades from one to the other; it has the guard.
    """

    #: in order of preference, after the design's own controller
    member: tuple[MemberTable, ...] = Field(min_length=1)
    fade_s: Annotated[float, Field(ge=0.0)] = 0.05  #: time constant of the fade, 0: immediate
    #: time with an invalid flag before the signal counts as lost
    loss_s: Annotated[float, Field(ge=0.0)] = 0.0
    #: time with a valid flag before the signal counts as restored
    return_s: Annotated[float, Field(ge=0.0)] = 1.0

    def check(self, signals: Sequence[str], guard: GuardTable | None) -> None:
        """Raise ValueError for members with signals outside the design, and a guard that follows a flow."""
        for member in self.member:
            if strange := sorted(set(member.signals) - set(signals)):
                raise ValueError(
                    f"bank member {member.name} uses unknown signals {strange}, allowed: {', '.join(signals)}"
                )
        if guard is not None and guard.follows is not None:
            raise ValueError(
                f"guard.follows = {guard.follows!r}: not possible in a bank, its supervisor follows no flow"
            )


class StageTable(Table):
    """One stage of the search, which continues from the result of the previous one."""

    conditions: tuple[str, ...] = ()  #: conditions of the design to use; none: all
    points: tuple[str, ...] = ()  #: operating points; none: all
    #: sharpness of the smoothed worst damping, one value after the other
    rho: tuple[Positive, ...] = Field((60.0, 120.0, 300.0), min_length=1)
    steps: Annotated[int, Field(ge=1)] = 40  #: of the descent at each value of `rho`, at most
    #: (rad/s, damping) as `offset` of the design, in this stage alone; none: that of the design
    offset: Offsets = ()
    #: s of processor time of each start, after which it begins no step; none: no bound
    longest_s: Positive | None = None

    def stage(self) -> Stage:
        """Return the stage for the search."""
        offsets = BandOffsets(*zip(*self.offset, strict=True)) if self.offset else None
        longest_s = float("inf") if self.longest_s is None else self.longest_s
        return Stage(self.points, self.conditions, self.rho, self.steps, offsets, longest_s)


class GuardTable(Table):
    """Side of the output limit that is lowered in a first swing (`models.blocks.controller.Guard`)."""

    #: output -> signal, a speed, that tells of the swing; or several, whose mean does: the guard goes on when
    #: one of them is lost
    watched: dict[str, str | tuple[str, ...]] = Field(min_length=1)
    sides: dict[str, Annotated[float, Field(ge=-1.0, le=1.0)]]  #: above 0: the upper limit is lowered
    threshold: Positive  #: rad/s
    #: time constant of the washout before it, so that a lasting deviation does not hold the limit shut
    washout_s: Positive = 10.0
    lowpass_s: Positive = 1.0  #: time constant of the low pass on the watched signal
    #: output of the plant, a power flow, with whose sign the sides turn, such as `tie_p`; none: they stand
    follows: str | None = None
    flow_pu: Positive = 0.1  #: slow course of that flow at which the sides are whole

    def of(self, signals: Collection[str]) -> GuardTable | None:
        """Return the guard for a controller with these signals only; None if it watches none of them."""
        watched = {y: tuple(s for s in self._signals(y) if s in signals) for y in self.watched}
        rows = {y: seen[0] if len(seen) == 1 else seen for y, seen in watched.items() if seen}
        if not rows or (self.follows is not None and self.follows not in signals):
            return None
        return self.model_copy(update={"watched": rows, "sides": {y: self.sides[y] for y in rows}})

    def _signals(self, output: str) -> tuple[str, ...]:
        seen = self.watched[output]
        return (seen,) if isinstance(seen, str) else seen

    def guard(self) -> Guard:
        """Return the guard of the controller."""
        return Guard(**self.model_dump())


Exponent = Annotated[float, Field(ge=0.0)]


def require_points(key: str, names: Sequence[str], points: Sequence[str]) -> None:
    """Raise ValueError if `names`, of a table's `key`, has a name that is not an operating point of the
    design."""
    if unknown := [name for name in names if name not in points]:
        raise ValueError(f"{key} has {unknown}; the design's are {', '.join(points)}")


def require_distinct(key: str, names: Sequence[str]) -> None:
    """Raise ValueError if a name occurs twice."""
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"{key}: has {twice} twice, allowed: each name once")


class FaultPlace(Table):
    """A three-phase fault at a bus, cleared by itself or by the trip of a branch."""

    bus: int  #: number of the faulted bus
    trip: str | None = None  #: branch whose trip clears the fault; without it the fault clears itself

    def __str__(self) -> str:
        return f"bus {self.bus}" + ("" if self.trip is None else f", {self.trip} tripped")


class AcceptanceTable(Table):
    """Faults that a controller must survive: every combination is run.

    ceilings : (least, most) field voltage of every exciter that has limits, pu, in addition to those of the
    case. loads : exponents of P and Q of every load, in addition to those of the case.
    latency_s : of every signal. No signal is lost, then each except `never_lost` in turn at `lost_s`; then
    each is wrong in each way of `wrong`.
    clear_cycles : of the fault, periods of the case's frequency.
    """

    fault: tuple[FaultPlace, ...] = Field(min_length=1)  #: the faults, each run at every operating point
    #: operating points of the faults; none: all of the design. A certificate names the others
    points: tuple[str, ...] = ()
    #: (least, most) field voltage of every exciter with limits, pu; in addition to those of the case
    ceilings: tuple[tuple[float, float], ...] = ()
    #: exponents of P and Q of every load, such as 1 and 2: P of constant current, Q of constant impedance; as
    #: the case has them too
    loads: tuple[tuple[Exponent, Exponent], ...] = ()
    #: of every signal, one run for each value
    latency_s: tuple[Annotated[float, Field(ge=0.0)], ...] = Field((0.1,), min_length=1)
    clear_cycles: Positive = 8.0  #: duration of the fault, periods of the case's frequency
    start_s: Positive = 1.0  #: start of the fault
    lost_s: Positive = 1.5  #: start of the loss, or of the wrong signal
    #: signals that are not lost or wrong in the faults; a certificate names them first
    never_lost: tuple[str, ...] = ()
    #: how each signal is wrong in turn while marked as valid: x0 and x3 by its scale, x-1 of the wrong
    #: polarity, s300 by a time stamp 300 ms too new
    wrong: tuple[str, ...] = ()
    #: end of each run; at least 60 s if the linear loop has a root slower than 0.05 1/s
    stop_s: Positive = 10.0
    x_pu: Positive = 1e-4  #: reactance of the fault to earth
    longest_cycles: Positive = 30.0  #: clearing times are searched from 1 cycle to this
    resolution_cycles: Positive = 0.15  #: resolution of a clearing time

    @field_validator("wrong")
    @classmethod
    def _codes(cls, wrong: tuple[str, ...]) -> tuple[str, ...]:
        for one, other in combinations([wrong_condition(code, "SIGNAL") for code in wrong], 2):
            if (one.scale_of, one.latency_s_of) == (other.scale_of, other.latency_s_of):
                raise ValueError(f"wrong has {one.in_words.removeprefix('SIGNAL ')!r} twice, allowed: once")
        return wrong

    @field_validator("ceilings")
    @classmethod
    def _order(cls, ceilings: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        for least, most in ceilings:
            if not least < most:
                raise ValueError(f"ceilings has [{least:g}, {most:g}], allowed: the first below the second")
        return ceilings

    @model_validator(mode="after")
    def _within_the_run(self) -> AcceptanceTable:
        for key, instant in (("start_s", self.start_s), ("lost_s", self.lost_s)):
            if not instant < self.stop_s:
                raise ValueError(f"{key} = {instant:g}, allowed: before stop_s = {self.stop_s:g}")
        return self

    def check(self, points: Sequence[str]) -> None:
        """Raise ValueError if `points` has a name that is not an operating point of the design."""
        require_points("acceptance.points", self.points, points)

    def of(self, signals: Collection[str]) -> AcceptanceTable:
        """Return the acceptance for a controller with these signals only."""
        never_lost = tuple(name for name in self.never_lost if name in signals)
        return self.model_copy(update={"never_lost": never_lost})

    def check_signals(self, signals: Sequence[str]) -> None:
        """Raise ValueError if `never_lost` has a name that is not a signal of the controller."""
        if strange := sorted(set(self.never_lost) - set(signals)):
            raise ValueError(
                f"acceptance: never_lost names {', '.join(strange)}; the controller's signals are "
                f"{', '.join(signals)}"
            )

    def looked_at(self, cases: Mapping[str, Case]) -> dict[str, Case]:
        """Return the operating points of `cases` at which faults are run."""
        return {point: case for point, case in cases.items() if not self.points or point in self.points}


def wrong_condition(code: str, signal: str) -> Condition:
    """Return the condition of one wrong signal; ValueError for another code, or a correct one."""
    if not ONE_WRONG.fullmatch(code):
        raise ValueError(f"wrong has {code!r}, allowed: x<factor> such as x-1 or s<ms> such as s300")
    if float(code[1:]) == (1.0 if code[0] == "x" else 0.0):
        raise ValueError(f"wrong has {code!r}, which leaves a signal as it is; omit it")
    return condition_of_many(f"{code}:{signal}", (signal,))
