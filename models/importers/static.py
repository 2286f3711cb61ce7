"""A grid as any file of a power flow gives it: its elements with the place where each was read.

MW, Mvar at 1 pu voltage, degrees, kV; r, x, b in pu of the base of the grid and of the bus base voltages.
Numbers of buses are those of the file; what an importer adds (the star of three windings, the terminal of a
unit with a step-up transformer) has numbers above all of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ..errors import CaseError

LOAD, SLACK, UNIT, ISOLATED = 1, 3, 2, 4  #: types of buses as in every such file


@dataclass(slots=True)
class StaticBus:
    """A bus with its stored voltage."""

    number: int
    where: str
    name: str = ""
    kv: float = 0.0  #: 0: unknown
    kind: int = LOAD
    area: int = 1
    v: float = 1.0
    angle: float = 0.0
    position: tuple[float, float] | None = None  #: latitude, longitude
    star: bool = False  #: added for a transformer of three windings; its stored voltage is not known


@dataclass(slots=True)
class StaticBranch:
    """A pi circuit with the tap at its first end."""

    name: tuple[int, ...]  #: buses of the file, for the name
    circuit: str
    first: int
    second: int
    r: float
    x: float
    b: float
    where: str
    tap: float = 1.0
    shift: float = 0.0
    on: bool = True
    transformer: bool = False
    winding: int = 0  #: of a star
    joins: bool = False  #: a closed switch or a line without impedance: its ends are one node


@dataclass(slots=True)
class StaticShunt:
    """An admittance to ground."""

    bus: int
    letter: str
    identity: str
    p: float  #: taken
    q: float  #: given
    where: str
    on: bool = True
    home: int = 0  #: the bus in the file, from which it has its name

    def __post_init__(self) -> None:
        self.home = self.home or self.bus


@dataclass(slots=True)
class StaticLoad:
    """What is taken from a bus: constant power, constant current and admittance parts (at 1 pu).

    follows : how the constant-power part follows the voltage in the dynamics, None as the user says.
    q_free : its Q is not given; the stored voltages tell it. Where they are no solution, it gives `set_q`
    Mvar or holds `set_v` pu at its bus with a current of `most_mva` at most, MVA at 1 pu.
    groups : its area, zone and owner. law : share and exponent of P, and of Q, of each term of a load record.
    """

    bus: int
    letter: str
    identity: str
    p: float
    q: float
    where: str
    ip: float = 0.0
    iq: float = 0.0
    yp: float = 0.0
    yq: float = 0.0  #: taken, so a capacitor is negative
    on: bool = True
    follows: float | None = None
    q_free: bool = False
    set_q: float | None = None
    set_v: float | None = None
    most_mva: float = math.inf
    home: int = 0  #: the bus in the file, from which it has its name
    groups: tuple[int, int, int] = (1, 1, 1)
    law: tuple[tuple[float, float, float, float], ...] | None = None

    def __post_init__(self) -> None:
        self.home = self.home or self.bus


@dataclass(slots=True)
class StaticUnit:
    """A generating unit; impedances in pu of its own base."""

    bus: int
    identity: str
    p: float
    q: float
    v: float | None  #: that it holds at its bus; None: it regulates another
    base: float
    r: float
    x: float
    where: str
    on: bool = True
    step_up: tuple[complex, float] | None = None  #: impedance, ratio of the transformer inside the unit
    renewable: bool = False
    home: int = 0  #: the bus in the file, from which it has its name

    def __post_init__(self) -> None:
        self.home = self.home or self.bus


@dataclass(slots=True)
class StaticLink:
    """A two-terminal dc line, whose converters also stand among the loads; `row` of a case without angles."""

    name: str
    where: str
    loads: tuple[StaticLoad, StaticLoad]  #: of rectifier and inverter
    volts: tuple[float, float]  #: dc voltages of both, kV
    current: float  #: kA
    row: dict[str, float]


@dataclass(slots=True)
class StaticVsc:
    """A dc line with voltage-source converters, which also stand among the loads.

    row : of a case, without powers. rating : of each converter, MVA, and A of its ac current; 0: none.
    """

    name: str
    where: str
    loads: tuple[StaticLoad, StaticLoad]  #: of the end that controls the power, and of the other
    row: dict[str, float | str]
    rating: tuple[tuple[float, float], tuple[float, float]]


@dataclass
class StaticGrid:
    """All elements of a file; buses by number in the order of the file."""

    base_mva: float
    frequency_hz: float
    source: str
    buses: dict[int, StaticBus] = field(default_factory=dict)
    branches: list[StaticBranch] = field(default_factory=list)
    shunts: list[StaticShunt] = field(default_factory=list)
    loads: list[StaticLoad] = field(default_factory=list)
    units: list[StaticUnit] = field(default_factory=list)
    links: list[StaticLink | StaticVsc] = field(default_factory=list)
    alias: dict[int, int] = field(default_factory=dict)  #: bus joined to another -> that one
    added: int = 0  #: number of the bus added last

    def bus(self, number: int, where: str) -> StaticBus:
        """Return bus `number`; CaseError at `where` when there is none."""
        if number not in self.buses:
            raise CaseError(f"{where}: bus {number} does not exist, allowed: a bus of this file")
        return self.buses[number]

    def new_bus(self, near: int, where: str, name: str, *, star: bool = False) -> StaticBus:
        """Add a bus beside bus `near` with the next number above all others."""
        beside = self.buses[near]
        number = (self.added or max(self.buses)) + 1
        bus = StaticBus(number, where, name, 0.0, LOAD, beside.area, beside.v, beside.angle, beside.position)
        bus.star = star
        self.buses[number], self.added = bus, number
        return bus
