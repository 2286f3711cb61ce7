"""The elements of diagrams: which states they have, what holds at rest, their equations for numbers.

`c/plant/flow/elements.h` holds the same equations over `num`; `emit` writes the calls.
"""

from __future__ import annotations

from typing import Any

from ...errors import DeviceError
from .device import NO_LIMIT, Device, Line
from .element import Element, Equation, On, State, Values, chosen, nonzero, positive, real_part, times
from .expression import ONE, ZERO, Node, evaluate, number


class Lag(Element):
    """T y' = K u - y."""

    @property
    def T(self) -> Node:
        """Time constant."""
        return self.args[1]

    def states(self) -> tuple[State, ...]:
        return (State(self.line.name, positive(self.device, self.T), self.T),)

    def passes_input(self, on: On) -> bool:
        return on(self.states()[0].present) is not True

    def output(self, x: Values, values: Values, on: On) -> Any:
        present = on(self.states()[0].present)
        return self.clamped(x[self.line.name] if present else self.input(values), values)

    def rates(self, x: Values, values: Values, on: On) -> dict[str, Any]:
        if not on(self.states()[0].present):
            return {}
        y, u, T = x[self.line.name], self.input(values), self.time(self.T, values)
        low, high = self.bounds(values)
        if self.line.option("rate_min") is None and self.line.option("rate_max") is None:
            above = real_part(u) > real_part(high) and real_part(y) >= real_part(high)
            below = real_part(u) < real_part(low) and real_part(y) <= real_part(low)
            rate = ((high if above else low if below else u) - y) / T
            return {self.line.name: self.unless_frozen(rate, values)}
        slowest = evaluate(self.option("rate_min", number(-NO_LIMIT)), values)
        fastest = evaluate(self.option("rate_max", number(NO_LIMIT)), values)
        rate = (u - y) / T
        rate = slowest if real_part(rate) < slowest else fastest if real_part(rate) > fastest else rate
        return {self.line.name: _held(self.unless_frozen(rate, values), y, low, high, T)}


def _held(rate: Any, y: Any, low: Any, high: Any, T: float) -> Any:
    """Non-windup: at a limit the state moves only inwards, beyond it back with T."""
    if real_part(y) >= real_part(high) and real_part(rate) > 0.0:
        return (high - y) / T
    if real_part(y) <= real_part(low) and real_part(rate) < 0.0:
        return (low - y) / T
    return rate


class Integrator(Element):
    """T y' = K u; a K that a flag makes 0 leaves the state out, and y is 0."""

    @property
    def T(self) -> Node:
        """Time constant."""
        return self.option("T", ONE)

    def states(self) -> tuple[State, ...]:
        return (State(self.line.name, chosen(self.device, self.K) or True, None),)

    def passes_input(self, on: On) -> bool:
        return False

    def at_rest(self, on: On) -> Equation:
        if on(self.states()[0].present):
            return Equation(ZERO, self.u, self.line.name)
        return Equation(Node("name", name=self.line.name), ZERO, self.line.name)

    def output(self, x: Values, values: Values, on: On) -> Any:
        return self.clamped(x[self.line.name] if on(self.states()[0].present) else 0.0, values)

    def rates(self, x: Values, values: Values, on: On) -> dict[str, Any]:
        if not on(self.states()[0].present):
            return {}
        y, T = x[self.line.name], self.time(self.T, values)
        low, high = self.bounds(values)
        return {self.line.name: _held(self.unless_frozen(self.input(values) / T, values), y, low, high, T)}


class LeadLag(Element):
    """K u (1 + s T1)/(1 + s T2); T2 = 0: K u."""

    def states(self) -> tuple[State, ...]:
        return (State(self.line.name, positive(self.device, self.args[2]), self.args[2], ", slow part"),)

    def output(self, x: Values, values: Values, on: On) -> Any:
        u = self.input(values)
        if on(self.states()[0].present):
            slow = x[self.line.name]
            u = slow + (u - slow) * (self.time(self.args[1], values) / self.time(self.args[2], values))
        return self.clamped(u, values)

    def rates(self, x: Values, values: Values, on: On) -> dict[str, Any]:
        if not on(self.states()[0].present):
            return {}
        name = self.line.name
        return {name: (self.input(values) - x[name]) / self.time(self.args[2], values)}

    def start(self, values: Values, on: On) -> dict[str, float]:
        return {self.line.name: self.input(values)} if on(self.states()[0].present) else {}


class Washout(Element):
    """K u s T/(1 + s T); T = 0: K u, as stabilizers have it."""

    def states(self) -> tuple[State, ...]:
        return (State(self.line.name, positive(self.device, self.args[1]), self.args[1], ", slow part"),)

    def at_rest(self, on: On) -> Equation:
        flat = on(self.states()[0].present)
        value = ZERO if flat else times(self.K, self.u)
        return Equation(Node("name", name=self.line.name), value, self.line.name)

    def output(self, x: Values, values: Values, on: On) -> Any:
        if not on(self.states()[0].present):
            return self.input(values)
        return evaluate(self.K, values) * (evaluate(self.u, values) - x[self.line.name])

    def rates(self, x: Values, values: Values, on: On) -> dict[str, Any]:
        if not on(self.states()[0].present):
            return {}
        name = self.line.name
        return {name: (evaluate(self.u, values) - x[name]) / self.time(self.args[1], values)}

    def start(self, values: Values, on: On) -> dict[str, float]:
        return {self.line.name: evaluate(self.u, values)} if on(self.states()[0].present) else {}


class Rate(Element):
    """u s K/(1 + s T); K = 0: nothing, and no state."""

    def states(self) -> tuple[State, ...]:
        return (State(self.line.name, nonzero(self.device, self.args[1]), self.args[2], ", slow part"),)

    def passes_input(self, on: On) -> bool:
        return on(self.states()[0].present) is not False

    def check(self, values: Values, on: On, who: str) -> None:
        if on(self.states()[0].present) and not evaluate(self.args[2], values) > 0.0:
            gain, lag = (str(node) for node in self.args[1:])
            raise DeviceError(
                f"{who}: {lag} = 0 with {gain} = {evaluate(self.args[1], values):g}; give {lag} > 0"
            )

    def acting(self, on: On) -> tuple[Node, ...]:
        return self.args if on(self.states()[0].present) else ()

    def at_rest(self, on: On) -> Equation:
        return Equation(Node("name", name=self.line.name), ZERO, self.line.name)

    def output(self, x: Values, values: Values, on: On) -> Any:
        if not on(self.states()[0].present):
            return 0.0
        gain = evaluate(self.args[1], values) / evaluate(self.args[2], values)
        return (evaluate(self.u, values) - x[self.line.name]) * gain

    def rates(self, x: Values, values: Values, on: On) -> dict[str, Any]:
        if not on(self.states()[0].present):
            return {}
        name = self.line.name
        return {name: (evaluate(self.u, values) - x[name]) / evaluate(self.args[2], values)}

    def start(self, values: Values, on: On) -> dict[str, float]:
        return {self.line.name: evaluate(self.u, values)} if on(self.states()[0].present) else {}


class Pi(Element):
    """KP e + integral + add within limits, e = u - feedback y; the integral stands while it pushes outwards.

    With `feedback` the loop through the proportional part is solved: y = (KP u + integral + add)/(1 + KP F).
    """

    def states(self) -> tuple[State, ...]:
        return (State(self.line.name, nonzero(self.device, self.args[2]), None, ", integral"),)

    def acting(self, on: On) -> tuple[Node, ...]:
        integral = self.args[2:] if on(self.states()[0].present) else ()
        return (*self.args[:2], *integral, *(part for _, part in self.line.node.options))

    @property
    def parts(self) -> tuple[Node, Node]:
        """Signal added before the limits; factor of the feedback of the output."""
        return self.option("add", ZERO), self.option("feedback", ZERO)

    def passes(self, on: On) -> tuple[Node, ...]:
        return (*super().passes(on), *self.parts)

    def at_rest(self, on: On) -> Equation:
        (add, feedback), own = self.parts, Node("name", name=self.line.name)
        KP = self.args[1]
        if on(self.states()[0].present):
            back = Node("*", (feedback, own))
            return Equation(self.u, ZERO if feedback == ZERO else back, self.line.name)
        value = Node("*", (KP, self.u))
        if add != ZERO:
            value = Node("+", (value, add))
        if feedback != ZERO:
            value = Node("/", (value, Node("+", (ONE, Node("*", (KP, feedback))))))
        return Equation(own, value, self.line.name)

    def _whole(self, x: Values, values: Values, on: On) -> Any:
        add, feedback = (evaluate(part, values) for part in self.parts)
        KP = evaluate(self.args[1], values)
        y = KP * evaluate(self.u, values) + add
        if on(self.states()[0].present):
            y = y + x[self.line.name]
        return y / (1.0 + KP * feedback)

    def output(self, x: Values, values: Values, on: On) -> Any:
        return self.clamped(self._whole(x, values, on), values)

    def rates(self, x: Values, values: Values, on: On) -> dict[str, Any]:
        if not on(self.states()[0].present):
            return {}
        whole, (low, high) = self._whole(x, values, on), self.bounds(values)
        feedback = evaluate(self.parts[1], values)
        error = evaluate(self.u, values) - feedback * values[self.line.name]
        rate = self.unless_frozen(evaluate(self.args[2], values) * error, values)
        outwards = (real_part(whole) > real_part(high) and real_part(rate) > 0.0) or (
            real_part(whole) < real_part(low) and real_part(rate) < 0.0
        )
        return {self.line.name: 0.0 if outwards else rate}

    def start(self, values: Values, on: On) -> dict[str, float]:
        if not on(self.states()[0].present):
            return {}
        add, feedback = (evaluate(part, values) for part in self.parts)
        y = values[self.line.name]
        error = evaluate(self.u, values) - feedback * y
        return {self.line.name: y - evaluate(self.args[1], values) * error - add}


class Filter2(Element):
    """u (1 + B1 s + B2 s^2)/(1 + A1 s + A2 s^2); states u/(...) and, with A2, its rate."""

    def states(self) -> tuple[State, ...]:
        A1, A2 = self.args[1:3]
        larger = Node("max", (A1, A2))
        either = self.device.always_positive(A1) or self.device.always_positive(A2)
        name = self.line.name
        return (
            State(name, True if either else positive(self.device, larger), A1, ", filtered"),
            State(f"{name}_rate", positive(self.device, A2), None, ", rate of the filtered"),
        )

    def _acceleration(self, x: Values, values: Values) -> Any:
        A1, A2 = (evaluate(a, values) for a in self.args[1:3])
        name = self.line.name
        return (evaluate(self.u, values) - x[name] - A1 * x[f"{name}_rate"]) / A2

    def output(self, x: Values, values: Values, on: On) -> Any:
        first, second = self.states()
        B1, B2 = (evaluate(b, values) for b in self.args[3:5])
        if on(second.present):
            return x[first.name] + B1 * x[second.name] + B2 * self._acceleration(x, values)
        if on(first.present):
            slow = x[first.name]
            return slow + (evaluate(self.u, values) - slow) * (B1 / evaluate(self.args[1], values))
        return evaluate(self.u, values)

    def rates(self, x: Values, values: Values, on: On) -> dict[str, Any]:
        first, second = self.states()
        if on(second.present):
            return {first.name: x[second.name], second.name: self._acceleration(x, values)}
        if on(first.present):
            return {first.name: (evaluate(self.u, values) - x[first.name]) / evaluate(self.args[1], values)}
        return {}

    def start(self, values: Values, on: On) -> dict[str, float]:
        first, second = self.states()
        outputs = {first.name: evaluate(self.u, values)} if on(first.present) else {}
        return outputs | ({second.name: 0.0} if on(second.present) else {})


class Plain(Element):
    """A line without states."""

    def __init__(self, device: Device, line: Line) -> None:
        super().__init__(device, Line(line.name, Node("plain", (line.node,)), line.comment, line.number))

    def states(self) -> tuple[State, ...]:
        return ()

    def output(self, x: Values, values: Values, on: On) -> Any:
        return evaluate(self.u, values)

    def rates(self, x: Values, values: Values, on: On) -> dict[str, Any]:
        return {}


_CLASSES: dict[str, type[Element]] = {
    "lag": Lag,
    "leadlag": LeadLag,
    "washout": Washout,
    "rate": Rate,
    "integrator": Integrator,
    "pi": Pi,
    "filter2": Filter2,
    "": Plain,
}


def element_of(device: Device, line: Line) -> Element:
    """Return the element of `line`."""
    return _CLASSES[line.element](device, line)
