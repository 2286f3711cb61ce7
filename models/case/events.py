"""What may happen to a plant during a run: faults, trips, steps and pulses, each at an exact time.

In a case or scenario file an event is one table:

    [[event]]
    kind = "bus_fault"
    bus = 8
    start_s = 1.0
    end_s = 1.1333333
    x_pu = 1e-4
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from .errors import CaseError, nearest, one_line

if TYPE_CHECKING:
    from .case import Case

Number = Annotated[float, Field(strict=True)]
Time = Annotated[float, Field(strict=True, ge=0.0)]
Target = Annotated[str, Field(strict=True, min_length=1)]
BusNumber = Annotated[int, Field(strict=True, ge=1)]


class _Event(BaseModel):
    """Start time in seconds from the start of the run."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    start_s: Time


class _Lasting(_Event):
    """An event that may end; without `end_s` it lasts to the end of the run."""

    end_s: Time | None = None

    @model_validator(mode="after")
    def _ends_later(self) -> Self:
        if self.end_s is not None and not self.end_s > self.start_s:
            raise ValueError(
                f"end_s = {self.end_s:g} with start_s = {self.start_s:g}, allowed: end_s > start_s"
            )
        return self


class BusFault(_Lasting):
    """Three-phase fault at `bus` through r + jx to ground, pu on the base of the case, cleared at `end_s`."""

    kind: Literal["bus_fault"] = "bus_fault"
    bus: BusNumber
    end_s: Time
    r_pu: Annotated[float, Field(strict=True, ge=0.0)] = 0.0
    x_pu: Annotated[float, Field(strict=True, ge=0.0)] = 1e-4

    @model_validator(mode="after")
    def _impedance(self) -> Self:
        if not self.r_pu + self.x_pu > 0.0:
            raise ValueError("r_pu = x_pu = 0, allowed: a fault impedance above 0, for instance x_pu = 1e-4")
        return self


class BranchTrip(_Lasting):
    """Both ends of `branch` open at `start_s`; with `end_s` they close again then."""

    kind: Literal["branch_trip"] = "branch_trip"
    branch: Target


class BranchReclose(_Event):
    """Both ends of `branch` close at `start_s`."""

    kind: Literal["branch_reclose"] = "branch_reclose"
    branch: Target


class VrefPulse(_Lasting):
    """The voltage set-point of `machine` is raised by `size_pu` from `start_s` to `end_s`."""

    kind: Literal["vref_pulse"] = "vref_pulse"
    machine: Target
    size_pu: Number
    end_s: Time


class VrefStep(_Event):
    """The voltage set-point of `machine` is raised by `size_pu` for good."""

    kind: Literal["vref_step"] = "vref_step"
    machine: Target
    size_pu: Number


class PmPulse(_Lasting):
    """The mechanical power of `machine` is raised by `size_pu` (machine base) from `start_s` to `end_s`."""

    kind: Literal["pm_pulse"] = "pm_pulse"
    machine: Target
    size_pu: Number
    end_s: Time


class PmStep(_Event):
    """The mechanical power of `machine` is raised by `size_pu` (machine base) for good."""

    kind: Literal["pm_step"] = "pm_step"
    machine: Target
    size_pu: Number


class LoadStep(_Lasting):
    """A load changes by `size_pu` of its P and Q, or by `p_pu` + j `q_pu` on the base of the case.

    The load is named by `load`, or by `bus` when one load is connected there. What is added has the
    load's own voltage characteristic and is reckoned at the load's voltage at the operating point.
    """

    kind: Literal["load_step"] = "load_step"
    load: Target | None = None
    bus: BusNumber | None = None
    size_pu: Number | None = None
    p_pu: Number | None = None
    q_pu: Number | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.load is None) == (self.bus is None):
            raise ValueError("a load_step names its target by load or by bus, allowed: exactly one of them")
        if (self.size_pu is None) == (self.p_pu is None and self.q_pu is None):
            raise ValueError("a load_step has size_pu, or p_pu and q_pu, allowed: exactly one of these forms")
        return self


class MachineTrip(_Event):
    """`machine` is disconnected from its bus at `start_s`."""

    kind: Literal["machine_trip"] = "machine_trip"
    machine: Target


class ShuntSwitch(_Lasting):
    """`shunt` is switched out (`to = "out"`) or in at `start_s`, and back at `end_s` when that is given."""

    kind: Literal["shunt_switch"] = "shunt_switch"
    shunt: Target
    to: Literal["in", "out"] = "out"


Event = Annotated[
    BusFault
    | BranchTrip
    | BranchReclose
    | VrefPulse
    | VrefStep
    | PmPulse
    | PmStep
    | LoadStep
    | MachineTrip
    | ShuntSwitch,
    Field(discriminator="kind"),
]

EVENT_KINDS = (
    "bus_fault",
    "branch_trip",
    "branch_reclose",
    "vref_pulse",
    "vref_step",
    "pm_pulse",
    "pm_step",
    "load_step",
    "machine_trip",
    "shunt_switch",
)
_ONE: TypeAdapter[Any] = TypeAdapter(Event)


def event_of(table: Mapping[str, Any], *, where: str) -> Any:
    """Return the Event that one `[[event]]` table describes; `where` names it in errors.

    >>> event_of({"kind": "branch_trip", "branch": "8-9 a", "start_s": 1.0}, where="event 1").branch
    '8-9 a'

    Raises
    ------
    CaseError : unknown kind (with the nearest ones), missing or unknown key, time that is no time.
    """
    kind = table.get("kind") if isinstance(table, Mapping) else None
    if kind not in EVENT_KINDS:
        raise CaseError(f"{where}: kind = {kind!r}; {nearest(kind, EVENT_KINDS)}")
    try:
        return _ONE.validate_python(dict(table))
    except ValidationError as error:
        text = one_line(error, lambda loc: [str(part) for part in loc if part != kind])
        raise CaseError(f"{where} ({kind}): {text}") from None


def events_of(tables: Iterable[Mapping[str, Any]], *, where: str) -> tuple[Any, ...]:
    """Return the events of all `[[event]]` tables; errors count from 1."""
    return tuple(event_of(table, where=f"{where}: event {k}") for k, table in enumerate(tables, start=1))


def target_index(case: Case, event: Any) -> int:
    """Return the position of the event's target among the rows of its table in `case`.

    Raises
    ------
    CaseError : no such target (with the nearest names), a bus with none or several loads, a Vref event at a
        machine with constant excitation.
    """
    if event.kind == "load_step" and event.bus is not None:
        return _load_at(case, event.bus)
    if event.kind == "bus_fault":
        numbers = [bus.number for bus in case.buses]
        if event.bus not in numbers:
            raise CaseError(
                f"{case.name}: {event.kind}: bus {event.bus} does not exist; {nearest(event.bus, numbers)}"
            )
        return numbers.index(event.bus)
    table = next(t for t in ("branch", "machine", "load", "shunt") if hasattr(event, t))
    names = [row.name for row in getattr(case, "branches" if table == "branch" else f"{table}s")]
    name = getattr(event, table)
    if name not in names:
        raise CaseError(f"{case.name}: {event.kind}: {table} {name!r} does not exist; {nearest(name, names)}")
    if event.kind.startswith("vref") and case.machine(name).exciter.kind == "constant":
        raise CaseError(
            f"{case.name}: {event.kind}: machine {name!r} has constant excitation, so no voltage set-point, "
            "allowed: a machine whose exciter regulates"
        )
    return names.index(name)


def _load_at(case: Case, bus: int) -> int:
    here = [k for k, load in enumerate(case.loads) if load.bus == bus]
    if len(here) != 1:
        buses = sorted({load.bus for load in case.loads})
        raise CaseError(
            f"{case.name}: load_step: bus {bus} has {len(here)} loads, allowed: one load ({buses}), "
            "or load = NAME"
        )
    return here[0]


def check_events(case: Case, events: Iterable[Any]) -> None:
    """Check that every target exists and that no set of trips cuts the network in pieces.

    Raises
    ------
    CaseError : as `target_index`; or the event whose trip leaves buses without a path to the rest.
    """
    switching: list[tuple[float, int, str, bool]] = []
    for k, event in enumerate(events, start=1):
        target_index(case, event)
        if event.kind == "branch_trip":
            switching.append((event.start_s, k, event.branch, False))
            if event.end_s is not None:
                switching.append((event.end_s, k, event.branch, True))
        elif event.kind == "branch_reclose":
            switching.append((event.start_s, k, event.branch, True))
    from .checks import islands_of  # shares the types of a case with this module

    closed = {b.name: b.in_service for b in case.branches}
    for time in sorted({s[0] for s in switching}):
        here = [s for s in switching if s[0] == time]
        for _, _, branch, closes in here:
            closed[branch] = closes
        parts = islands_of(case, closed)
        if len(parts) > 1:
            names = ", ".join(f"{k} ({branch!r})" for _, k, branch, closes in here if not closes)
            cut = ", ".join(str(bus) for bus in sorted(parts[1])[:10])
            raise CaseError(
                f"{case.name}: event {names} at {time:g} s cuts buses {cut} off, "
                "allowed: trips that leave one connected network (a machine leaves by machine_trip)"
            )
