"""What may happen to a plant during a run, each at an exact time: faults, trips, steps, ramps, pulses, and
what relays do.

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
from typing import Annotated, Any, Literal, Self

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from ..errors import CaseError, Collected, nearest
from ..mistakes import mistakes
from ..table import Table

Number = Annotated[float, Field(strict=True)]
Time = Annotated[float, Field(strict=True, ge=0.0)]
Target = Annotated[str, Field(strict=True, min_length=1)]
BusNumber = Annotated[int, Field(strict=True, ge=1)]


class _Event(Table):
    """Start time in seconds from the start of the run."""

    start_s: Time  #: start


class _Lasting(_Event):
    """An event that may end; without `end_s` it lasts to the end of the run."""

    end_s: Time | None = None  #: end; default: it persists

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
    bus: BusNumber  #: number of the faulted bus
    end_s: Time
    r_pu: Annotated[float, Field(strict=True, ge=0.0)] = 0.0  #: resistance of the fault to earth
    x_pu: Annotated[float, Field(strict=True, ge=0.0)] = 1e-4  #: reactance of the fault to earth

    @model_validator(mode="after")
    def _impedance(self) -> Self:
        if not self.r_pu + self.x_pu > 0.0:
            raise ValueError("r_pu = x_pu = 0, allowed: a fault impedance above 0, for instance x_pu = 1e-4")
        return self


class BranchTrip(_Lasting):
    """Both ends of `branch` open at `start_s`; with `end_s` they close again then."""

    kind: Literal["branch_trip"] = "branch_trip"
    branch: Target  #: its name, such as `7-8 a`


class BranchReclose(_Event):
    """Both ends of `branch` close at `start_s`."""

    kind: Literal["branch_reclose"] = "branch_reclose"
    branch: Target  #: its name, such as `7-8 a`


class VrefPulse(_Lasting):
    """The voltage set-point of `machine` is raised by `size_pu` from `start_s` to `end_s`."""

    kind: Literal["vref_pulse"] = "vref_pulse"
    machine: Target  #: name of the machine
    size_pu: Number  #: change of its voltage reference
    end_s: Time


class _Ramp(Table):
    """A change that may take its time."""

    #: duration of the ramp from 0, in equal steps of at most 20 ms; 0: a step
    rise_s: Time = 0.0


class VrefStep(_Event, _Ramp):
    """The voltage set-point of `machine` is raised by `size_pu` permanently."""

    kind: Literal["vref_step"] = "vref_step"
    machine: Target  #: name of the machine
    size_pu: Number  #: change of its voltage reference


class PmPulse(_Lasting):
    """The mechanical power of `machine` is raised by `size_pu` (machine base) from `start_s` to `end_s`."""

    kind: Literal["pm_pulse"] = "pm_pulse"
    machine: Target  #: name of the machine
    size_pu: Number  #: change of its mechanical power, of the machine's base
    end_s: Time


class PmStep(_Event, _Ramp):
    """The mechanical power of `machine` is raised by `size_pu` (machine base) permanently.

    Where it has a governor this is the governor's set-point.
    """

    kind: Literal["pm_step"] = "pm_step"
    machine: Target  #: name of the machine
    size_pu: Number  #: change of its mechanical power, of the machine's base


class _AtLoad(Table):
    """A load, named by itself or by its bus."""

    load: Target | None = None  #: name of the load; or `bus`
    bus: BusNumber | None = None  #: where the load is; or `load`

    @model_validator(mode="after")
    def _one_name(self) -> Self:
        if (self.load is None) == (self.bus is None):
            kind = getattr(self, "kind", "")
            raise ValueError(f"a {kind} names its target by load or by bus, allowed: exactly one of them")
        return self


class LoadStep(_Lasting, _Ramp, _AtLoad):
    """A load changes by `size_pu` of its P and Q, or by `p_pu` + j `q_pu` on the base of the case.

    The load is named by `load`, or by `bus` when one load is connected there. What is added has the
    load's own voltage characteristic and is reckoned at the load's voltage at the operating point.
    Below 0 load is shed.
    """

    kind: Literal["load_step"] = "load_step"
    size_pu: Number | None = None  #: share of the load that is added, both powers; or `p_pu`, `q_pu`
    p_pu: Number | None = None  #: change of active power, of the system base
    q_pu: Number | None = None  #: change of reactive power, of the system base

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if self.end_s is not None and not self.start_s + self.rise_s <= self.end_s:
            raise ValueError(
                f"rise_s = {self.rise_s:g} from {self.start_s:g} to {self.end_s:g} s, "
                "allowed: start_s + rise_s <= end_s"
            )
        if (self.size_pu is None) == (self.p_pu is None and self.q_pu is None):
            raise ValueError("a load_step has size_pu, or p_pu and q_pu, allowed: exactly one of these forms")
        return self


class Oscillation(_Lasting):
    """A voltage set-point, a mechanical power or a load swings about its value from `start_s` on.

    A sine moves in equal stairs of at most 20 ms, 24 a period or more, whose first harmonic is the sine's.
    """

    kind: Literal["oscillation"] = "oscillation"
    on: Literal["voltage_reference", "mechanical_power", "load"]  #: target of the oscillation
    machine: Target | None = None  #: name of the machine; of a load `load` or `bus`
    load: Target | None = None  #: name of the load; or `bus`
    bus: BusNumber | None = None  #: where the load is; or `load`
    frequency_hz: Annotated[float, Field(strict=True, ge=1e-4, le=10.0)]  #: of its first harmonic
    #: amplitude, as in `vref_step`, `pm_step`, `load_step`; for a load also `p_pu`, `q_pu`
    size_pu: Number | None = None
    p_pu: Number | None = None  #: amplitude of a load's active power, of the system base
    q_pu: Number | None = None  #: amplitude of a load's reactive power, of the system base
    shape: Literal["sine", "square"] = "sine"  #: sine, or square wave that starts with its upper value
    harmonics: tuple[Number, ...] = ()  #: amplitudes of harmonics 2, 3, ... of a sine, shares of the first

    @model_validator(mode="after")
    def _acts(self) -> Self:
        if (self.machine is None) == (self.on != "load"):
            other = "load or bus" if self.on == "load" else "machine"
            raise ValueError(f"an oscillation on {self.on} names its target by {other}")
        if self.on != "load" and (self.size_pu is None or self._of_load != (None,) * 4):
            raise ValueError(f"an oscillation on {self.on} has size_pu, no load, bus, p_pu, q_pu")
        if self.shape == "square" and self.harmonics:
            raise ValueError("a square wave has harmonics of its own, allowed: shape = 'sine' with harmonics")
        if not self.frequency_hz * (1 + len(self.harmonics)) <= 10.0:
            count = 1 + len(self.harmonics)
            raise ValueError(f"harmonic {count} of {self.frequency_hz:g} Hz, allowed: up to 10 Hz")
        if self.on == "load":
            _load_step(self)
        return self

    @property
    def _of_load(self) -> tuple[Any, ...]:
        return self.load, self.bus, self.p_pu, self.q_pu

    @property
    def steady(self) -> Any:
        """The event that holds its size."""
        if self.on == "load":
            return _load_step(self)
        kind: type[VrefStep | PmStep] = VrefStep if self.on == "voltage_reference" else PmStep
        return kind.model_validate(
            {"machine": self.machine, "size_pu": self.size_pu, "start_s": self.start_s}
        )

    @property
    def waves(self) -> tuple[tuple[str, float, float], ...]:
        """Shape, frequency (Hz) and share of the size of each wave that it consists of."""
        shares = (1.0, *self.harmonics)
        return tuple((self.shape, k * self.frequency_hz, share) for k, share in enumerate(shares, start=1))


class LoadNoise(_Lasting):
    """Loads fluctuate randomly and independently about their values, both powers in proportion.

    A stationary Ornstein-Uhlenbeck process every 20 ms, of normal distribution, its spectrum flat up to
    `corner_hz`. It follows from the seed, the load's number in the case and the time alone.
    """

    kind: Literal["load_noise"] = "load_noise"
    load: Target | None = None  #: name of the load, or `bus`; without both: every load
    bus: BusNumber | None = None  #: where the load is; or `load`
    size_pu: Annotated[float, Field(strict=True, gt=0.0, le=1.0)]  #: standard deviation, share of the load
    #: frequency at which its spectrum is half
    corner_hz: Annotated[float, Field(strict=True, ge=1e-3, le=5.0)] = 0.5
    seed: Annotated[int, Field(strict=True, ge=0, le=2147483647)] = 0  #: of its random numbers

    @model_validator(mode="after")
    def _acts(self) -> Self:
        if self.load is not None or self.bus is not None:
            _load_step(self)
        return self

    @property
    def steady(self) -> Any:
        """The event that holds its size at the load; itself where it acts on every load."""
        return self if self.load is None and self.bus is None else _load_step(self)

    @property
    def waves(self) -> tuple[tuple[str, float, float], ...]:
        """As of `Oscillation`."""
        return (("noise", self.corner_hz, 1.0),)


def _load_step(event: Any) -> LoadStep:
    """The load step of the target and size of an event; its message alone where they are none."""
    keys = ("load", "bus", "size_pu", "p_pu", "q_pu", "start_s")
    try:
        return LoadStep.model_validate({key: getattr(event, key, None) for key in keys})
    except ValidationError as error:
        text = str(error.errors()[0]["ctx"]["error"])
        raise ValueError(text.replace("a load_step", f"the {event.kind}")) from None


class MachineTrip(_Event):
    """`machine` is disconnected from its bus at `start_s`."""

    kind: Literal["machine_trip"] = "machine_trip"
    machine: Target  #: name of the machine


class DeviceTrip(_Event):
    """`device`, an SVC, STATCOM or dc link, is disconnected at `start_s`, a series capacitor bypassed."""

    kind: Literal["device_trip"] = "device_trip"
    device: Target  #: name of the SVC, STATCOM, series capacitor, converter or dc link


class HvdcBlock(_Lasting):
    """A dc link is blocked at `start_s`; with `end_s` it restarts then with its previous control state.

    Both converters carry no current, filters stay; the dc current of line-commutated ones dies away within
    10 ms, the dc voltage of voltage-source ones stands.
    """

    kind: Literal["hvdc_block"] = "hvdc_block"
    device: Target  #: name of the dc link


class ShuntSwitch(_Lasting):
    """`shunt` is switched out (`to = "out"`) or in at `start_s`, and back at `end_s` if given."""

    kind: Literal["shunt_switch"] = "shunt_switch"
    shunt: Target  #: name of the shunt
    to: Literal["in", "out"] = "out"  #: switched in or out


class _FrequencyRelay(_Lasting):
    """A frequency relay at the bus of what it disconnects.

    It looks every 5 ms at the angle of the bus voltage; what that turned since, over the time, goes through
    a lag of `filter_s`. Beyond `threshold_hz` it picks up, drops out when the frequency comes back or the
    voltage is below 0.3 pu, and after `delay_s` tells the breaker, which opens `breaker_s` later, for good.
    """

    #: below the rated frequency: acts under it, above: over it
    threshold_hz: Annotated[float, Field(strict=True, gt=0.0)]
    delay_s: Time = 0.0  #: time beyond the threshold before the relay acts
    breaker_s: Time = 0.1  #: from the relay's order until the breaker is open
    filter_s: Time = 0.05  #: time constant of the measurement of the relay
    start_s: Time = 0.0  #: start of operation
    end_s: Time | None = None  #: end of operation; default: end of the run


class FrequencyShed(_FrequencyRelay, _AtLoad):
    """An under- or over-frequency relay that sheds the share `size_pu` of a load.

    Stages of one load are events of their own; their shares are all of what the load drew at the start.
    """

    kind: Literal["frequency_shed"] = "frequency_shed"
    size_pu: Annotated[float, Field(strict=True, gt=0.0, le=1.0)]  #: share of the load, both powers


class FrequencyTrip(_FrequencyRelay):
    """An under- or over-frequency relay that disconnects `machine`."""

    kind: Literal["frequency_trip"] = "frequency_trip"
    machine: Target  #: name of the machine


Event = Annotated[
    BusFault
    | BranchTrip
    | BranchReclose
    | VrefPulse
    | VrefStep
    | PmPulse
    | PmStep
    | LoadStep
    | Oscillation
    | LoadNoise
    | MachineTrip
    | DeviceTrip
    | HvdcBlock
    | ShuntSwitch
    | FrequencyShed
    | FrequencyTrip,
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
    "oscillation",
    "load_noise",
    "machine_trip",
    "device_trip",
    "hvdc_block",
    "shunt_switch",
    "frequency_shed",
    "frequency_trip",
)


def instants(event: Any) -> tuple[float, ...]:
    """Return when something begins or ends that is known before the run, s; nothing of a relay."""
    if isinstance(event, _FrequencyRelay):
        return ()
    rises = (event.start_s + event.rise_s,) if getattr(event, "rise_s", 0.0) > 0.0 else ()
    end = getattr(event, "end_s", None)
    return (event.start_s, *rises, *(() if end is None else (end,)))


def slot_count(events: Iterable[Any]) -> int:
    """Return how many slots of a plant they need: one each, and one for each harmonic of an oscillation."""
    return sum(len(getattr(event, "waves", (None,))) for event in events)


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
    if kind is None:
        for key in map(str, table if isinstance(table, Mapping) else ()):
            if (hint := nearest(key, ["kind"])).startswith("did"):
                raise CaseError(f"{where}: {key} = {table[key]!r}: no such key; {hint}")
        raise CaseError(f"{where}: kind is missing; {nearest(kind, EVENT_KINDS)}")
    if kind not in EVENT_KINDS:
        raise CaseError(f"{where}: kind = {kind!r}; {nearest(kind, EVENT_KINDS)}")
    try:
        return _ONE.validate_python(dict(table))
    except ValidationError as error:
        raise CaseError(
            *(f"{where} ({kind}): {line}" for line in mistakes(error, Event, times=True))
        ) from None


def events_of(tables: Iterable[Mapping[str, Any]], *, where: str) -> tuple[Any, ...]:
    """Return the events of all `[[event]]` tables; errors count from 1 and name all that is wrong."""
    events, collected = [], Collected()
    for k, table in enumerate(tables, start=1):
        with collected:
            events.append(event_of(table, where=f"{where}: event {k}"))
    collected.end(CaseError)
    return tuple(events)
