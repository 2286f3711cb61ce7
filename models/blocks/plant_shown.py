"""What the plant shows: outputs and locals, all of a small grid, of a large one what is asked for."""

from __future__ import annotations

import difflib
import fnmatch
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..case.case import Case, CaseError
from ..case.hvdc_schema import Hvdc
from ..case.schema import Bus
from ..grid.bus_devices import DEVICE
from ..grid.coupling import voltage_sources
from ..grid.machine_tables import network_states
from ..grid.series import series_nodes
from .variables import Variable

#: ShowKind of plant/numbers/layout.h
KINDS = (
    *("dw", "delta", "pe", "vt", "tie", "bus_v", "efd", "pm", "line_p", "line_q"),
    *("line_i", "bus_angle", "bus_re", "bus_im", "device_q", "device_p", "device_angle"),
)
MOST_MACHINES = 100  #: of a grid that shows everything unless told otherwise
#: names of states that outputs which see the network may list altogether, since in FMI an output that lists
#: nothing may depend on every input: unasked 14 MB of modelDescription.xml, and what a pattern may ask for
UNASKED_NAMES, MOST_NAMES = 2_000_000, 35_000_000


@dataclass(frozen=True)
class Shown:
    """One variable and what it is: its kind and the position of its machine, bus or branch."""

    variable: Variable
    kind: str
    of: int = 0


def shown_of(case: Case, patterns: Sequence[str] | None = None, more: Sequence[str] = ()) -> list[Shown]:
    """Return outputs, then locals of the plant of `case`.

    patterns : of names such as `G1_*`, `bus7.v`, `branch[7-8].*`, `tie_p`, with `*`, `?` and `[..]` as in
        file names (a `[` of a name may stand for itself): the outputs, and no locals. None: of a grid of up
        to `MOST_MACHINES` the four outputs of each machine, the tie and, as locals, all bus voltages, field
        voltages and mechanical powers; of a larger one speed and power of each machine and the tie; where
        the powers would list more than `UNASKED_NAMES` states, some 600 machines, the speeds and the tie.
        With converters that are voltage sources also all angles, up to some 1400 machines.
    more : patterns of outputs beside those.

    Raises
    ------
    CaseError : a pattern that matches nothing, with the nearest names, or outputs that list more than
        `MOST_NAMES`.
    """
    if patterns is not None:
        return _describable(case, _outputs(case, (*patterns, *more)))
    large = len(case.machines) > MOST_MACHINES
    kinds = _kinds_of_large(case) if large else KINDS
    machines = [s for s in _of_machines(case) if s.kind in kinds]
    outputs, provided = [*machines, *_of_tie(case), *_of_svcs(case)], [] if large else _locals(case)
    if more:
        named = {s.variable.name for s in outputs}
        outputs += [s for s in _outputs(case, more) if s.variable.name not in named]
        named = {s.variable.name for s in outputs}
        provided = [s for s in provided if s.variable.name not in named]
    return [*_describable(case, outputs), *provided]


def _kinds_of_large(case: Case) -> Sequence[str]:
    """Return what a large grid shows of its machines unless told otherwise."""
    kinds = ["dw"]
    if shows_powers(case):
        kinds.append("pe")
    # a source shows no speed that could be integrated in place of its angle
    if len(case.machines) ** 2 <= UNASKED_NAMES and voltage_sources(case):
        kinds.append("delta")
    return kinds


def shows_powers(case: Case) -> bool:
    """Return whether a plant of `case` shows the machines' powers unless told otherwise."""
    return len(case.machines) * len(network_states(case)) <= UNASKED_NAMES


def _describable(case: Case, outputs: list[Shown]) -> list[Shown]:
    names = sum(len(s.variable.depends_on or ()) for s in outputs)
    if not names <= MOST_NAMES:
        raise CaseError(
            f"{case.name}: the {len(outputs)} outputs asked for depend on {names / 1e6:.0f} million states "
            f"altogether, which modelDescription.xml has to list; allowed: {MOST_NAMES / 1e6:.0f} million; "
            "show fewer of them (speeds depend on one state each, powers and voltages on all machines)"
        )
    return outputs


def shown_names(case: Case) -> list[str]:
    """Return the names of all outputs that a plant of `case` can show."""
    return [s.variable.name for s in _every_output(case)]


def _every_output(case: Case) -> list[Shown]:
    return [*_of_machines(case), *_of_tie(case), *_of_svcs(case), *_of_buses(case), *_of_branches(case)]


def _outputs(case: Case, patterns: Sequence[str]) -> list[Shown]:
    every = _every_output(case)
    names = [s.variable.name for s in every]
    expected = {name for pattern in patterns for name in _matching(case, pattern, names)}
    return [s for s in every if s.variable.name in expected]


def _matching(case: Case, pattern: str, names: list[str]) -> set[str]:
    matches = {n for n in names if n == pattern or fnmatch.fnmatchcase(n, pattern.replace("[", "[[]"))}
    matches = matches or set(fnmatch.filter(names, pattern))
    if not matches:
        near = difflib.get_close_matches(pattern, names, 3, 0.4)
        advice = (
            f"nearest: {', '.join(near)}"
            if near
            else "such as G1_dw, bus7.v, bus7.angle, branch[7-8].p, tie_p"
        )
        raise CaseError(f"{case.name}: nothing to show matches {pattern!r}; {advice}")
    return matches


def shown_tables(
    case: Case, shown: Sequence[Shown], ports: npt.NDArray[np.float64]
) -> dict[str, npt.NDArray[np.int32]]:
    """Return the arrays of the record that say what is shown: ties, lines, then each variable.

    ports : table of the ports, where the reactive power of a device at a bus is found.
    """
    number = {b.name: k for k, b in enumerate(case.branches)}
    tie, ends = [], []
    if case.tie is not None:
        tie = [number[name] for name in case.tie.branches]
        ends = [int(case.branches[k].from_bus != case.tie.from_bus) for k in tie]
    lines = sorted({s.of for s in shown if s.kind.startswith("line_")})
    row = {k: place for place, k in enumerate(lines)}
    port = _ports_of_devices(case, ports)
    rows = dict.fromkeys(("device_q", "device_p", "device_angle"), port) | dict.fromkeys(
        (k for k in KINDS if k.startswith("line_")), row
    )
    of = [rows[s.kind][s.of] if s.kind in rows else s.of for s in shown]
    return {
        "tie.branch": np.array([*tie, *lines], dtype=np.int32),
        "tie.end": np.array([*ends, *[0] * len(lines)], dtype=np.int32),
        "show.kind": np.array([KINDS.index(s.kind) for s in shown], dtype=np.int32),
        "show.of": np.array(of, dtype=np.int32),
    }


def _ports_of_devices(case: Case, ports: npt.NDArray[np.float64]) -> dict[int, int]:
    """Return the row of the port of each device at a bus; second ends of links come after all."""
    links = range(len(case.at_buses) - len(case.links), len(case.at_buses))
    port: dict[int, int] = {}
    for place, (kind, device) in enumerate(ports[:, :2].astype(int)):
        if kind == DEVICE and device not in port:
            port[device] = place
        elif kind == DEVICE and device in links:  # of others a second one sees a voltage only
            port[device + len(links)] = place
    return port


def _of_machines(case: Case) -> Iterator[Shown]:
    network = tuple(sorted(network_states(case)))
    angles = tuple(f"{m.name}.delta" for m in case.machines)
    for k, m in enumerate(case.machines):
        slip = (f"{m.name}.slip",)
        yield _output(f"{m.name}_dw", "speed deviation", slip, "dw", k)
        text = "rotor angle to the centre of inertia"
        yield _output(f"{m.name}_delta", text, angles, "delta", k, "rad")
        text = "active power at the terminals, base of the case"
        yield _output(f"{m.name}_pe", text, network, "pe", k)
        yield _output(f"{m.name}_vt", "terminal voltage", network, "vt", k)


def _of_tie(case: Case) -> Iterator[Shown]:
    if case.tie is None:
        return
    text = f"active power from bus {case.tie.from_bus} over {', '.join(case.tie.branches)}, base of the case"
    yield _output("tie_p", text, tuple(sorted(network_states(case))), "tie")


def _of_svcs(case: Case) -> Iterator[Shown]:
    network = tuple(sorted(network_states(case)))
    angles = tuple(f"{m.name}.delta" for m in case.machines)
    nodes, place = series_nodes(case), {bus.number: k for k, bus in enumerate(case.buses)}
    sources = voltage_sources(case)
    for k, row in enumerate(case.at_buses):
        if row.name in nodes:
            text = "size of the current through the series capacitor, base of the case"
            yield _output(f"{row.name}.i", text, network, "bus_v", place[nodes[row.name]])
            continue
        text = "power into the network, base of the case"
        if k >= len(case.at_buses) - len(case.links):
            yield from _of_link(case, k, network)
            continue
        yield _output(f"{row.name}.q", f"reactive {text}", network, "device_q", k)
        if k >= len(case.svcs):
            yield _output(f"{row.name}.p", f"active {text}", network, "device_p", k)
        if row.name in sources:
            angle, on = "angle of its voltage to the centre of inertia", (*angles, f"{row.name}.delta")
            yield _output(f"{row.name}_delta", angle, on, "device_angle", k, "rad")


def _of_link(case: Case, k: int, network: tuple[str, ...]) -> Iterator[Shown]:
    row = case.at_buses[k]
    ends = ("rectifier", "inverter") if isinstance(row, Hvdc) else ("from", "to")
    for end, of in zip(ends, (k, k + len(case.links)), strict=True):
        place = f"the {end}" if isinstance(row, Hvdc) else f"{end}_bus"
        text = f"power into the network at {place}, base of the case"
        yield _output(f"{row.name}.p_{end}", f"active {text}", network, "device_p", of)
        yield _output(f"{row.name}.q_{end}", f"reactive {text}", network, "device_q", of)


def _of_branches(case: Case) -> Iterator[Shown]:
    network = tuple(sorted(network_states(case)))
    for k, b in enumerate(case.branches[: len(case.branches) - len(series_nodes(case))]):
        for letter, what in (("p", "active"), ("q", "reactive")):
            text = f"{what} power from bus {b.from_bus} into {b.name}, base of the case"
            yield _output(f"branch[{b.name}].{letter}", text, network, f"line_{letter}", k)
        text = f"size of the current from bus {b.from_bus} into {b.name}, base of the case"
        yield _output(f"branch[{b.name}].i", text, network, "line_i", k)


#: of a bus voltage -> what it is, unit
_OF_BUS = {
    "v": ("voltage magnitude of bus {}", "pu"),
    "angle": ("voltage angle of bus {} to the centre of inertia", "rad"),
    "re": ("voltage of bus {}, real part, in the frame that turns with rated frequency", "pu"),
    "im": ("voltage of bus {}, imaginary part, in the frame that turns with rated frequency", "pu"),
}


def _of_buses(case: Case) -> Iterator[Shown]:
    network = tuple(sorted(network_states(case)))
    angles = tuple(sorted({*network, *(f"{m.name}.delta" for m in case.machines)}))
    for k, bus in enumerate(_real_buses(case)):
        for key, (text, unit) in _OF_BUS.items():
            on = angles if key == "angle" else network
            yield _output(f"bus{bus.number}.{key}", text.format(bus.number), on, f"bus_{key}", k, unit)


def _real_buses(case: Case) -> Sequence[Bus]:
    """The buses that are no nodes of series capacitors, which come last."""
    return case.buses[: len(case.buses) - len(series_nodes(case))]


def _locals(case: Case) -> list[Shown]:
    text, unit = _OF_BUS["v"]
    provided = [
        Shown(Variable(f"bus{b.number}.v", "local", text.format(b.number), unit=unit), "bus_v", k)
        for k, b in enumerate(_real_buses(case))
    ]
    for k, m in enumerate(case.machines):
        provided.append(Shown(Variable(f"{m.name}.Efd", "local", "field voltage", unit="pu"), "efd", k))
        text = "mechanical power, machine base"
        provided.append(Shown(Variable(f"{m.name}.Pm", "local", text, unit="pu"), "pm", k))
    return provided


def _output(
    name: str, text: str, depends_on: tuple[str, ...], kind: str, of: int = 0, unit: str = "pu"
) -> Shown:
    return Shown(Variable(name, "output", text, unit=unit, depends_on=depends_on), kind, of)
