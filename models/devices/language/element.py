"""What every element of a diagram has: states, what its output depends on, an equation at rest, numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, MutableMapping
from dataclasses import dataclass
from typing import Any

from .device import NO_LIMIT, Device, Line
from .expression import ONE, ZERO, Node, evaluate

Condition = bool | Node  #: a Node holds parameters only: a bit of the structure
On = Callable[[Condition], bool | None]  #: None: not decided yet
Values = MutableMapping[str, Any]


@dataclass(frozen=True)
class State:
    """One state of an element: there when `present` holds, with time constant `time` (None: none)."""

    name: str
    present: Condition
    time: Node | None
    what: str = ""  #: added to the comment of the line


@dataclass(frozen=True)
class Equation:
    """What holds at rest: left = right; `signal` is the line whose element it comes from."""

    left: Node
    right: Node
    signal: str


def positive(device: Device, node: Node) -> Condition:
    """Return the condition `node` > 0, decided where the ranges decide it."""
    if device.always_positive(node):
        return True
    return False if node.op == "number" else chosen(device, node) or Node(">", (node, ZERO))


def nonzero(device: Device, node: Node) -> Condition:
    """Return the condition `node` != 0, decided where the ranges decide it."""
    if node.op == "number":
        return node.value != 0.0
    return True if device.always_positive(node) else chosen(device, node) or Node("!=", (node, ZERO))


def chosen(device: Device, node: Node) -> Node | None:
    """Return the condition of a choice of something above 0 or 0: one bit in place of two."""
    positive_or_0 = node.op == "pick" and device.always_positive(node.args[1]) and node.args[2] == ZERO
    return node.args[0] if positive_or_0 else None


def conditions_in(device: Device, node: Node) -> Iterator[Node]:
    """Yield the conditions on parameters alone that choose in `node`."""
    if node.op == "pick" and device.constant(node.args[0]) and not device.constant(node):
        yield node.args[0]
    for part in node.args:
        yield from conditions_in(device, part)


def resolved(device: Device, node: Node, on: On) -> Node:
    """Return `node` with every choice taken that `on` decides."""
    if not node.args or device.constant(node):  # what is computed once needs no choice here
        return node
    if node.op == "pick" and device.constant(node.args[0]):
        chosen = on(node.args[0])
        if chosen is not None:
            return resolved(device, node.args[1 if chosen else 2], on)
    return Node(
        node.op, tuple(resolved(device, p, on) for p in node.args), node.name, node.value, node.options
    )


def times(K: Node, u: Node) -> Node:
    """Return K u, `u` itself where K is 1."""
    return u if K == ONE else Node("*", (K, u))


class Element:
    """One line that is no plain expression. `u` is its input, `K` its gain."""

    def __init__(self, device: Device, line: Line) -> None:
        self.device, self.line = device, line
        self.args = line.node.args
        self.u = self.args[0]
        self.K = self.option("K", ONE)

    def option(self, name: str, default: Node) -> Node:
        """Return option `name` or `default`."""
        provided = self.line.option(name)
        return default if provided is None else provided

    @property
    def limits(self) -> tuple[Node | None, Node | None]:
        """Lower and upper limit of the output."""
        return self.line.option("min"), self.line.option("max")

    @property
    def is_limited(self) -> bool:
        """True when the output has a limit."""
        return self.limits != (None, None)

    def states(self) -> tuple[State, ...]:
        """States, in their order."""
        return ()

    def passes(self, on: On) -> tuple[Node, ...]:
        """What the output depends on at once; undecided conditions count as the worse."""
        limits = tuple(limit for limit in self.limits if limit is not None)
        return (*((self.u,) if self.passes_input(on) else ()), *limits)

    def passes_input(self, on: On) -> bool:
        """Whether the output depends on the input at once."""
        return True

    def check(self, values: Values, on: On, who: str) -> None:
        """Refuse what has no meaning."""

    def acting(self, on: On) -> tuple[Node, ...]:
        """The expressions in use: without times of what is absent."""
        states = self.states()
        if states and not any(on(s.present) for s in states):
            return (self.u, *(part for key, part in self.line.node.options if key != "T"))
        return (*self.args, *(part for _, part in self.line.node.options))

    def at_rest(self, on: On) -> Equation:
        """The equation at rest without limits."""
        return Equation(Node("name", name=self.line.name), times(self.K, self.u), self.line.name)

    def output(self, x: Values, values: Values, on: On) -> Any:
        """Value of the line; `x`: states by name, `values`: everything known so far."""
        return self.clamped(self.input(values), values)

    def rates(self, x: Values, values: Values, on: On) -> dict[str, Any]:
        """Rates of the states that are there."""
        return {}

    def start(self, values: Values, on: On) -> dict[str, float]:
        """States at rest from the signals at rest."""
        return {s.name: values[self.line.name] for s in self.states() if on(s.present)}

    def time(self, node: Node, values: Values) -> Any:
        """A time constant's value."""
        return evaluate(node, values)

    def input(self, values: Values) -> Any:
        """Value of K u."""
        return evaluate(self.K, values) * evaluate(self.u, values)

    def unless_frozen(self, rate: Any, values: Values) -> Any:
        """`rate`, or less of it where the option freeze says so: 0 where that is 1."""
        freeze = self.line.option("freeze")
        return rate if freeze is None else rate * (1.0 - evaluate(freeze, values))

    def bounds(self, values: Values) -> tuple[Any, Any]:
        """Values of the limits; a lower one above the upper takes its place."""
        low, high = self.limits
        least = -NO_LIMIT if low is None else evaluate(low, values)
        most = NO_LIMIT if high is None else evaluate(high, values)
        return least, most if real_part(most) >= real_part(least) else least

    def clamped(self, y: Any, values: Values) -> Any:
        """`y` within the limits."""
        if not self.is_limited:
            return y
        least, most = self.bounds(values)
        return least if real_part(y) < real_part(least) else most if real_part(y) > real_part(most) else y


def real_part(a: Any) -> float:
    """Return what comparisons look at."""
    return float(a.real)


def names_passed(element: Element, on: On) -> set[str]:
    """Return the names that the output of `element` depends on at once."""
    return {name for node in element.passes(on) for name in resolved(element.device, node, on).names}
