"""The tables of a case and how a row of them is named: what the checks of a case are written for."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Annotated, TypeVar

from pydantic import ConfigDict, Field

from ..devices.language.device import OF_MACHINE
from ..devices.language.structure import Model
from ..devices.library import own_models
from ..errors import CaseError, nearest
from ..table import Table, Title
from .control_schema import BARE, Positive
from .events import Event
from .hvdc_schema import Hvdc
from .schema import Branch, Bus, Converter, Load, Machine, Shunt, Svc, Tcsc, Tie
from .vsc_schema import Vsc

Named = TypeVar("Named", Branch, Load, Machine, Shunt)

RATED_HZ = (1.0, 1000.0)  #: least and largest rated frequency: 16.7 of railways, 400 of aircraft
SOLVER_STEP_S = (1e-6, 0.1)  #: least and longest Runge-Kutta step of a plant, s
SolverStep = Annotated[float, Field(ge=SOLVER_STEP_S[0], le=SOLVER_STEP_S[1])]


class CaseTables(Table):
    """A grid with its machines, controls and loads; rows keep the order of the file."""

    model_config = ConfigDict(populate_by_name=True, ignored_types=(cached_property,))

    #: short name for files and messages
    name: Annotated[str, Field(strict=True, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    title: Title = ""  #: one line
    source: str  #: source of the data; a table of rows can have its own
    frequency_hz: Annotated[float, Field(strict=True, ge=RATED_HZ[0], le=RATED_HZ[1])]  #: rated frequency
    base_mva: Positive  #: system base of per-unit values
    solver_step_s: SolverStep | None = None  #: solver step of the plant FMU; None: its default
    #: machines whose speed difference is the swing signal; None: from the shape of the inter-area mode
    swing: Annotated[tuple[str, ...], Field(min_length=2, max_length=2)] | None = None
    sources: Mapping[str, str] = {}  #: table -> "KEY, where"
    #: user-defined device files, relative to this file, or their contents by name
    devices: Mapping[str, str] = {}
    buses: Annotated[tuple[Bus, ...], Field(min_length=1)]  #: rows by bus number
    branches: tuple[Branch, ...] = ()  #: lines and transformers by name
    shunts: tuple[Shunt, ...] = ()  #: rows by name
    loads: tuple[Load, ...] = ()  #: rows by name
    machines: Annotated[tuple[Machine, ...], Field(min_length=1)]  #: rows by name
    svcs: tuple[Svc, ...] = ()  #: static var compensators and STATCOMs by name
    tcscs: tuple[Tcsc, ...] = ()  #: thyristor controlled series capacitors by name
    converters: tuple[Converter, ...] = ()  #: converter plants by name
    hvdcs: tuple[Hvdc, ...] = ()  #: dc links with line-commutated converters by name
    vscs: tuple[Vsc, ...] = ()  #: dc links with voltage-source converters by name
    tie: Tie | None = None  #: interface whose flow operating points change
    events: tuple[Event, ...] = Field(
        default=(), alias="event"
    )  #: events of the grid itself, such as its relays: in every run, before those of a scenario

    @property
    def omega_b(self) -> float:
        """Base angular frequency, rad/s."""
        return 2.0 * math.pi * self.frequency_hz

    @property
    def areas(self) -> dict[str, int]:
        """Area of each machine."""
        return {m.name: m.area for m in self.machines}

    @property
    def links(self) -> tuple[Hvdc | Vsc, ...]:
        """Dc links of both kinds: `bus` is that of the first end, `seen_bus` of the second."""
        return (*self.hvdcs, *self.vscs)

    @property
    def at_buses(self) -> tuple[Svc | Converter | Hvdc | Vsc, ...]:
        """Devices at buses: SVCs, then converters, then dc links."""
        return (*self.svcs, *self.converters, *self.links)

    @property
    def places(self) -> tuple[str, ...]:
        """Names of the machines, then of the devices at buses: where devices have their signals."""
        return (*(m.name for m in self.machines), *(d.name for d in self.at_buses))

    @property
    def slack(self) -> Machine:
        """The machine that holds the angle reference and balances the power flow: the first of `slacks`."""
        return self.slacks[0]

    @property
    def slacks(self) -> tuple[Machine, ...]:
        """The machines that do so, one in each part of the network that branches connect."""
        return tuple(m for m in self.machines if m.slack)

    @property
    def own_devices(self) -> Mapping[str, Model]:
        """The devices of `devices` by key, which `kind` of a control may name."""
        return own_models(self.devices)

    @property
    def device_keys(self) -> set[str]:
        """Keys of the devices that machines and buses have."""
        controls = ((word, getattr(m, word)) for m in self.machines for word in OF_MACHINE)
        of_machines = {c.kind for word, c in controls if c is not None and c.kind != BARE.get(word)}
        in_lines = {"tcsc"} if self.tcscs else set()
        return of_machines | {d.control.kind for d in self.at_buses} | in_lines

    def machine(self, name: str) -> Machine:
        """Return machine `name`; CaseError with the nearest names when there is none."""
        return _named(self.machines, name, f"{self.name}: machine")

    def branch(self, name: str) -> Branch:
        """Return branch `name`; CaseError with the nearest names when there is none."""
        return _named(self.branches, name, f"{self.name}: branch")

    def load(self, name: str) -> Load:
        """Return load `name`; CaseError with the nearest names when there is none."""
        return _named(self.loads, name, f"{self.name}: load")

    def shunt(self, name: str) -> Shunt:
        """Return shunt `name`; CaseError with the nearest names when there is none."""
        return _named(self.shunts, name, f"{self.name}: shunt")


def swing_name(one: str, other: str) -> str:
    """Return the name of the speed of machine `one` less that of `other`.

    >>> swing_name("G2", "G4"), swing_name("G2", "G12")
    ('dw24', 'dw_G2_G12')
    """
    short = all(len(m) == 2 and m[0] == "G" and m[1].isdigit() for m in (one, other))
    return f"dw{one[1]}{other[1]}" if short else f"dw_{one}_{other}"


def _named(rows: Iterable[Named], name: str, what: str) -> Named:
    table = {row.name: row for row in rows}
    if name not in table:
        raise CaseError(f"{what} {name!r} does not exist; {nearest(name, table)}")
    return table[name]
