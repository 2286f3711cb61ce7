"""What a device file holds once it is read: kind, lines of the diagram, parameters, DYR tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

from .expression import Node, is_constant

NO_LIMIT = 1e30  #: stands for an absent limit


@dataclass(frozen=True)
class Kind:
    """What devices of one kind are given and give."""

    inputs: Mapping[str, str]  #: name -> what it is
    output: str
    references: tuple[str, ...]
    text: str
    also: tuple[str, ...] = ()  #: further outputs, which the network takes from their states
    of_port: tuple[str, ...] = ()  #: parameters that the port of its bus may use


_TERMINAL = {
    "vt": "terminal voltage, pu",
    "vd": "terminal voltage, d axis, pu",
    "vq": "terminal voltage, q axis, pu",
    "id": "current out of the machine, d axis, pu of its base",
    "iq": "current out of the machine, q axis, pu of its base",
    "pe": "electrical power, pu of the machine's base",
    "slip": "speed deviation, pu",
}
_AT_BUS = {
    "vt": "voltage of the regulated bus, pu",
    "vs": "modulation input, added at the summing point, pu",
}
KINDS: dict[str, Kind] = {
    "governor": Kind(
        {"slip": _TERMINAL["slip"], "pe": _TERMINAL["pe"]}, "pm", ("pref",), "governor and turbine"
    ),
    "compensator": Kind(dict(_TERMINAL), "vc", (), "voltage that the exciter regulates"),
    "stabilizer": Kind(
        {"pm": "mechanical power, pu of the machine's base"} | _TERMINAL, "vs", (), "power system stabilizer"
    ),
    "limiter": Kind(
        {"ifd": "field current Xad ifd, pu"} | _TERMINAL,
        "vl",
        (),
        "excitation limiter: signal added at the input of the stabilizer signal",
    ),
    "exciter": Kind(
        {
            "vc": "terminal voltage, from the compensator if there is one, pu",
            "vs": "signals added at the summing point: stabilizer, steps, modulation input, pu",
            "ifd": "field current Xad ifd, pu",
        }
        | _TERMINAL,
        "efd",
        ("vref",),
        "excitation system",
    ),
    "svc": Kind(_AT_BUS, "b", ("vref",), "susceptance of a static var compensator, pu of its base"),
    "statcom": Kind(_AT_BUS, "i", ("vref",), "reactive current of a STATCOM, pu of its base"),
    "converter": Kind(
        {
            "vt": "voltage of its bus, pu",
            "p": "active power into the network, pu of its base",
            "q": "reactive power into the network, pu of its base",
            "p_mod": "modulation of the active power, pu of its base",
            "q_mod": "modulation of the reactive reference, pu of its base",
            "vr": "direction of its voltage in the synchronous frame, real part; shorter than 1 below .1 pu",
            "vi": "direction of its voltage in the synchronous frame, imaginary part",
            "vreg": "voltage of the bus that a plant control regulates, by default its own, pu",
            "vdrop": "with plant_VCFLAG = 1 that voltage less (plant_Rc + j plant_Xc) times the current, pu",
            "pbr": "active power into the branch measured by a plant control, default its own, pu of base",
            "qbr": "reactive power into that branch, by default its own, pu of its base",
        },
        "ip",
        ("pref", "qref"),
        "active current `ip` and reactive current `iq` of a converter, pu of its base",
        ("iq",),
        ("Lvpnt0", "Lvpnt1", "Volim", "Khv", "Iolim", "REGCB", "REGCC", "Re", "Xe", "plant_Rc", "plant_Xc"),
    ),
    "hvdc": Kind(
        {
            "vdr": "dc voltage of the rectifier, pu of its base",
            "vdi": "dc voltage of the inverter, pu of its base",
            "p_mod": "modulation of the power, pu of its base",
        },
        "idc",
        ("pset", "vref"),
        "current `idc` and order `iord` of a dc link, pu, integral parts `xr` and `xi` of its angles, rad",
        ("iord", "xr", "xi"),
        ("KPR", "KPI", "MARGIN", "KM"),
    ),
    "source": Kind(
        {
            "vt": "voltage of its bus, pu",
            "p": "active power into the network, pu of its base",
            "q": "reactive power into the network, pu of its base",
            "p_mod": "modulation of the active power, pu of its base",
            "q_mod": "modulation of the reactive power or voltage reference, pu of its base",
            "vr": "voltage of its bus in the synchronous frame, real part, pu",
            "vi": "voltage of its bus in the synchronous frame, imaginary part, pu",
            "ir": "current into the network in the synchronous frame, real part, pu of its base",
            "ii": "current into the network in the synchronous frame, imaginary part, pu of its base",
        },
        "delta",
        ("pset", "vset"),
        "angle `delta`, rad, and size `e`, pu, of the voltage behind a grid-forming converter's impedance; "
        "a signal `theta` starts at the angle of the voltage of its bus, rad",
        ("e",),
        ("Re", "Xe", "Imax"),
    ),
    "vsc": Kind(
        {
            "v1": "voltage of the bus of its first end, pu",
            "p1": "active power into the network there, pu of its base",
            "v2": "voltage of the bus of its second end, pu",
            "p2": "active power into the network there, pu of its base",
            "p_mod": "modulation of the power from the first end to the second, pu of its base",
            "q_mod1": "modulation of the reactive power of the first end, or of the voltage it keeps, pu",
            "q_mod2": "the same of the second end",
        },
        "ip1",
        ("pset",),
        "active and reactive currents `ip1`, `iq1`, `ip2`, `iq2` of both ends of a dc link, pu of its base",
        ("iq1", "ip2", "iq2"),
    ),
}
AT_BUS = (
    "svc",
    "statcom",
    "converter",
    "hvdc",
    "source",
    "vsc",
)  #: kinds of devices at a bus; the others belong to a machine
OF_SVC = ("svc", "statcom")  #: kinds of the table svcs
OF_LINK = ("hvdc", "vsc")  #: kinds of devices between two buses
OF_CONVERTER = ("converter", "source")  #: kinds of the table converters
OF_MACHINE = tuple(kind for kind in KINDS if kind not in AT_BUS)
MBASE = "MBASE"  #: MVA base of the machine or of the device at a bus, known to every device
FBASE = "FBASE"  #: nominal frequency of the grid in Hz, known to every device
USUAL_HZ = 60.0  #: nominal frequency where a file has none, Hz
BASES = (MBASE, FBASE)
UNITS = ("1", "s", "pu", "pu/s", "rad", "deg", "Hz", "MVA", "1/s")


@dataclass(frozen=True)
class Line:
    """One line of the diagram: a signal and how it comes about."""

    name: str
    node: Node  #: of an element: its call
    comment: str
    number: int  #: line in the file

    @property
    def element(self) -> str:
        """Name of the element, empty for a line without states."""
        return self.node.op if self.node.op in ELEMENTS else ""

    def option(self, name: str) -> Node | None:
        """Return the element's option `name`, None when it is not given."""
        return dict(self.node.options).get(name)


_LIMITS = frozenset({"min", "max"})
#: element -> number of arguments, options
ELEMENTS: dict[str, tuple[int, frozenset[str]]] = {
    "lag": (2, _LIMITS | {"K", "rate_min", "rate_max", "rest", "freeze"}),
    "leadlag": (3, _LIMITS | {"K"}),
    "washout": (2, frozenset({"K"})),
    "rate": (3, frozenset()),
    "integrator": (1, _LIMITS | {"K", "T", "rest", "freeze"}),
    "pi": (3, _LIMITS | {"add", "feedback", "rest", "freeze"}),
    "filter2": (5, frozenset()),
}


@dataclass(frozen=True)
class Parameter:
    """A number of a device: `low` and `high` bound it, `open` says that `low` itself is not allowed."""

    name: str
    unit: str
    text: str
    low: float
    high: float
    open: bool
    default: float | None  #: None: must be given; +-NO_LIMIT: an absent limit

    @property
    def is_optional_limit(self) -> bool:
        """True for a limit that may be left away."""
        return self.default is not None and abs(self.default) >= NO_LIMIT

    def holds(self, value: float) -> bool:
        """Return whether `value` is within the range."""
        return self.low <= value <= self.high and not (self.open and value == self.low)


@dataclass(frozen=True)
class Computed:
    """A parameter that is computed at rest when it is given as `when`."""

    when: float | str
    value: Node


@dataclass(frozen=True)
class Check:
    """A condition between parameters, and what to do when it does not hold."""

    text: str
    node: Node
    remedy: str

    @property
    def says(self) -> str:
        """What an error says after the values."""
        plain = all(part.op in ("name", "number") for part in self.node.args)
        return f", allowed: {self.text}; {self.remedy}" if plain else f"; {self.remedy}"


def _compared(node: Node) -> Iterator[str]:
    """Yield each name that stands beside a number in == or !=, as often as it does."""
    if node.op in ("==", "!=") and {part.op for part in node.args} == {"name", "number"}:
        yield from node.names
        return
    for part in (*node.args, *(part for _, part in node.options)):
        yield from _compared(part)


@dataclass(frozen=True)
class DyrModel:
    """A record of a DYR file: its fields in order, and what is fixed or follows.

    A field is a parameter's or another name, "-" (ignored), "0" or "0:NAME" (must be 0;
    "0:BUS" may be its own bus).
    """

    model: str
    fields: tuple[str, ...]
    assigned: tuple[tuple[str, Node], ...]


@dataclass(frozen=True)
class Device:
    """A device as its file says; lines in the order of the file, constants already put in."""

    name: str
    kind: str
    title: str
    sources: tuple[str, ...]
    oracle: str  #: what it was checked against; empty: nothing
    notes: str
    lines: tuple[Line, ...]
    parameters: tuple[Parameter, ...]
    references: tuple[str, ...]
    fixed: tuple[tuple[str, Node], ...]  #: references that are not solved for: their value at rest
    computed: Mapping[str, Computed]
    checks: tuple[Check, ...]
    dyr: tuple[DyrModel, ...]
    file: str
    text: str = field(repr=False, default="")

    @property
    def key(self) -> str:
        """Name as `kind` of a case has it."""
        return self.name.lower()

    @property
    def output(self) -> str:
        """Name of the output."""
        return KINDS[self.kind].output

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of all outputs."""
        return (self.output, *KINDS[self.kind].also)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Inputs that its kind has."""
        return tuple(KINDS[self.kind].inputs)

    @cached_property
    def constants(self) -> frozenset[str]:
        """Names whose value is fixed when the case is read."""
        return frozenset(p.name for p in self.parameters) | {*BASES}

    @cached_property
    def by_name(self) -> dict[str, Parameter]:
        """Parameters by name."""
        return {p.name: p for p in self.parameters}

    @cached_property
    def switches(self) -> frozenset[str]:
        """Parameters that the equations only compare with numbers by == or !=: they are whole numbers."""
        trees = [*(line.node for line in self.lines), *(node for _, node in self.fixed)]
        trees += [c.value for c in self.computed.values()]
        everywhere, compared = Counter[str](), Counter[str]()
        for tree in trees:
            everywhere.update(tree.names)
            compared.update(_compared(tree))
        return frozenset(name for name, count in compared.items() if count == everywhere[name]) & {
            *self.by_name
        }

    def constant(self, node: Node) -> bool:
        """Return whether `node` holds parameters and numbers only."""
        return is_constant(node, self.constants)

    def always_positive(self, node: Node) -> bool:
        """Return whether the ranges alone say that the parameter or number `node` is above 0."""
        if node.op == "number":
            return node.value > 0.0
        if node.op == "pick":
            return all(self.always_positive(part) for part in node.args[1:])
        p = self.by_name.get(node.name) if node.op == "name" else None
        return p is not None and (p.low > 0.0 or (p.low == 0.0 and p.open))
