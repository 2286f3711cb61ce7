"""Which participant waits for which: connections, the cut at channels, the stepping order.

A connection `a.y -> b.u` makes b wait for a, because b's input over the step
is known only once a has been stepped. A participant that declares a latency
of at least one step knows its outputs over the whole coming step: nothing it
is fed with can reach them in time, so the connections into it are *cut* and
it goes first. What remains is split into strongly connected parts. A part of
one participant is stepped once; a part of several is a loop without a
channel, solved by the master. Neither depends on the order of declaration.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from interarea.fmu_build.open.ports import Description, Port
from interarea.fmu_build.open.units import UnitOf

from ..errors import GraphError, nearest


@dataclass(frozen=True, order=True)
class End:
    """One end of a connection: `instance.variable` (the variable may contain dots)."""

    instance: str
    variable: str

    def __str__(self) -> str:
        return f"{self.instance}.{self.variable}"


@dataclass(frozen=True)
class Connection:
    """A source feeding an input: input = gain * output + offset (unit conversion only)."""

    source: End
    target: End
    gain: float = 1.0
    offset: float = 0.0
    cut: bool = False  #: the target's declared latency covers the step

    def __str__(self) -> str:
        return f"{self.source} -> {self.target}"


@dataclass(frozen=True)
class LoopSet:
    """Participants stepped together, in this order; `tearing` connections run against it."""

    members: tuple[str, ...]
    tearing: tuple[Connection, ...] = ()

    @property
    def is_loop(self) -> bool:
        return bool(self.tearing)


@dataclass(frozen=True)
class Graph:
    """Checked connections of the participants and the order of a step."""

    descriptions: Mapping[str, Description]
    connections: tuple[Connection, ...]
    groups: tuple[LoopSet, ...]
    unconnected: tuple[End, ...]  #: inputs that keep their start value

    def into(self, instance: str) -> tuple[Connection, ...]:
        """Connections into `instance`, by input in the order of its description."""
        place = {p.name: k for k, p in enumerate(self.descriptions[instance].inputs)}
        inputs = [c for c in self.connections if c.target.instance == instance]
        return tuple(sorted(inputs, key=lambda c: place[c.target.variable]))

    @property
    def order(self) -> tuple[str, ...]:
        """All participants in stepping order."""
        return tuple(m for g in self.groups for m in g.members)


def end_of(text: str, instances: Iterable[str]) -> End:
    """Split `instance.variable`.

    Raises
    ------
    GraphError : no dot, or no such instance (nearest names).
    """
    names = list(instances)
    fitting = [n for n in names if text.startswith(n + ".")]
    if not fitting:
        head = text.split(".", 1)[0]
        raise GraphError(
            f"{text!r} is not a connection end 'instance.variable': no instance {head!r}; "
            f"{nearest(head, names)}"
        )
    instance = max(fitting, key=len)
    return End(instance, text[len(instance) + 1 :])


def build_graph(
    descriptions: Mapping[str, Description],
    connections: Iterable[tuple[str, str]],
    *,
    step_ticks: int,
    latency_ticks: Mapping[str, int] | None = None,
) -> Graph:
    """Check the connections and find the order of a step.

    Parameters
    ----------
    descriptions : of each instance.
    connections : pairs (source, target), each 'instance.variable'.
    latency_ticks : instance -> least time its inputs need to reach its outputs.

    Raises
    ------
    GraphError : unknown or mistyped ends (with the nearest names), an output as target or an input as
        source, two sources on one input, types or units that do not fit.
    """
    latency = dict(latency_ticks or {})
    checked: list[Connection] = []
    source_of: dict[End, End] = {}
    for source_text, target_text in connections:
        source, target = end_of(source_text, descriptions), end_of(target_text, descriptions)
        from_port = _port(descriptions, source, "output")
        to_port = _port(descriptions, target, "input")
        if target in source_of:
            raise GraphError(
                f"{target} has two sources, {source_of[target]} and {source}; an input takes one"
            )
        source_of[target] = source
        gain, offset = _conversion(source, from_port, target, to_port)
        cut = latency.get(target.instance, 0) >= step_ticks
        checked.append(Connection(source, target, gain, offset, cut))
    checked.sort(key=lambda c: (c.target, c.source))
    waits: dict[str, set[str]] = {name: set() for name in descriptions}
    for c in checked:
        if not c.cut:
            waits[c.target.instance].add(c.source.instance)
    first = {c.target.instance for c in checked if c.cut}
    parts = strongly_connected(waits, first)
    groups = tuple(_group(part, checked, descriptions) for part in parts)
    free = [End(n, p.name) for n in sorted(descriptions) for p in descriptions[n].inputs]
    return Graph(descriptions, tuple(checked), groups, tuple(e for e in free if e not in source_of))


def strongly_connected(
    waits: Mapping[str, Iterable[str]], first: Collection[str] = ()
) -> list[tuple[str, ...]]:
    """Return the strongly connected parts, each after all it waits for (Tarjan 1972).

    Ties go to parts within `first`, then by name.

    >>> strongly_connected({"b": ["a"], "a": [], "d": ["c", "b"], "c": ["d"]})
    [('a',), ('b',), ('c', 'd')]
    """
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    part_of: dict[str, int] = {}
    parts: list[tuple[str, ...]] = []

    def visit(root: str) -> None:
        todo = [(root, iter(sorted(waits[root])))]
        number[root] = low[root] = len(number)
        stack.append(root)
        while todo:
            name, rest = todo[-1]
            for other in rest:
                if other not in number:
                    number[other] = low[other] = len(number)
                    stack.append(other)
                    todo.append((other, iter(sorted(waits[other]))))
                    break
                if other not in part_of:
                    low[name] = min(low[name], number[other])
            else:
                todo.pop()
                if todo:
                    low[todo[-1][0]] = min(low[todo[-1][0]], low[name])
                if low[name] == number[name]:
                    members = []
                    while True:
                        members.append(stack.pop())
                        part_of[members[-1]] = len(parts)
                        if members[-1] == name:
                            break
                    parts.append(tuple(sorted(members)))

    for name in sorted(waits):
        if name not in number:
            visit(name)
    # always the ready part with the smallest name: one order, whatever was declared first (Kahn)
    needs = [{part_of[o] for m in part for o in waits[m]} - {k} for k, part in enumerate(parts)]
    done: list[int] = []
    while len(done) < len(parts):
        ready = [k for k in range(len(parts)) if k not in done and needs[k] <= set(done)]
        done.append(min(ready, key=lambda k: (not set(parts[k]) <= set(first), parts[k])))
    return [parts[k] for k in done]


def _group(
    part: tuple[str, ...], connections: Sequence[Connection], descriptions: Mapping[str, Description]
) -> LoopSet:
    """Order a loop so that the fewest direct dependencies, then the fewest signals, run against the order."""
    inside = [c for c in connections if not c.cut and c.source.instance in part and c.target.instance in part]
    if not inside:
        return LoopSet(part)

    def tearing(order: tuple[str, ...]) -> list[Connection]:
        place = {name: k for k, name in enumerate(order)}
        return [c for c in inside if place[c.source.instance] >= place[c.target.instance]]

    def cost(order: tuple[str, ...]) -> tuple[int, int, tuple[str, ...]]:
        against = tearing(order)
        direct = sum(
            any(c.target.variable in used for used in descriptions[c.target.instance].feedthrough.values())
            for c in against
        )
        return direct, len({c.source for c in against}), order

    if len(part) <= 6:
        best = min(itertools.permutations(part), key=cost)
    else:
        best = _greedy(part, inside)
    return LoopSet(best, tuple(tearing(best)))


def _greedy(part: tuple[str, ...], inside: Sequence[Connection]) -> tuple[str, ...]:
    """Order a large loop: next the participant with the fewest inputs still open, by name on ties."""
    order: list[str] = []
    while len(order) < len(part):
        rest = [n for n in part if n not in order]
        open_inputs = {
            n: sum(c.target.instance == n and c.source.instance not in order for c in inside) for n in rest
        }
        order.append(min(rest, key=lambda n: (open_inputs[n], n)))
    return tuple(order)


def _port(descriptions: Mapping[str, Description], end: End, causality: str) -> Port:
    description = descriptions[end.instance]
    inputs, outputs = description.input_of, description.output_of
    side, other = (outputs, inputs) if causality == "output" else (inputs, outputs)
    if end.variable in side:
        return side[end.variable]
    if end.variable in other:
        role = "source" if causality == "output" else "target"
        raise GraphError(f"{end} has the wrong causality for a {role}: an {causality} is needed")
    raise GraphError(f"{end.instance} has no {causality} {end.variable!r}; {nearest(end.variable, side)}")


def _conversion(source: End, a: Port, target: End, b: Port) -> tuple[float, float]:
    """Return gain and offset from the source's unit to the target's."""
    if a.type != b.type:
        raise GraphError(
            f"{source} -> {target}: {a.type} does not fit {b.type}; connect variables of one type"
        )
    ua, ub = a.unit, b.unit
    if a.type != "Real" or ua is None or ub is None or ua.name == ub.name:
        return 1.0, 0.0
    if ua.exponents is None or ub.exponents is None:
        undefined = ua if ua.exponents is None else ub
        raise GraphError(
            f"{source} -> {target}: unit {ua.name!r} against {ub.name!r}, and {undefined.name!r} has no "
            "definition in its FMU; define it (UnitDefinitions) or give both ends one unit"
        )
    if ua.exponents != ub.exponents:
        raise GraphError(
            f"{source} -> {target}: unit {ua.name!r} ({_dimension(ua)}) "
            f"does not fit {ub.name!r} ({_dimension(ub)})"
        )
    return ua.factor / ub.factor, (ua.offset - ub.offset) / ub.factor


def _dimension(unit: UnitOf) -> str:
    names = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
    parts = [f"{n}^{e}" for n, e in zip(names, unit.exponents or (), strict=True) if e]
    return " ".join(parts) or "dimensionless"


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
