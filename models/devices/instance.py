"""A device with its numbers: rates and signals at a state, and the check of what was found at rest."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .language.element import State, names_passed, resolved
from .language.expression import Node, evaluate
from .language.structure import Model


@dataclass(frozen=True)
class Margin:
    """A limited signal at rest; `low`, `high` are its limits there."""

    signal: str
    text: str
    value: float
    low: float
    high: float
    low_text: str
    high_text: str

    @property
    def least(self) -> float:
        """Distance to the nearer limit; negative: beyond it."""
        return min(self.value - self.low, self.high - self.value)


class Instance:
    """A device for the parameters `values` (references, MBASE and FBASE among them).

    Raises
    ------
    DeviceError : these parameters close a loop without a state.
    """

    def __init__(self, model: Model, values: Mapping[str, float]) -> None:
        self.model, self.values = model, dict(values)
        self.has = model.has(values)
        self.on = model.on_of(self.has)
        self.order = model.order_of(self.has)
        self.states: tuple[State, ...] = model.states_of(self.has)
        for element in model.elements.values():
            element.check(self.values, self.on, model.device.name)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states that are there."""
        return tuple(s.name for s in self.states)

    def run(self, x: Sequence[Any], inputs: Mapping[str, Any]) -> tuple[dict[str, Any], list[Any]]:
        """Return every signal and the rates of the states, at states `x` with `inputs`."""
        states = dict(zip(self.state_names, x, strict=True))
        values: dict[str, Any] = self.values | dict(inputs)
        for name in self.order:
            values[name] = self.model.elements[name].output(states, values, self.on)
        rates: dict[str, Any] = {}
        for element in self.model.elements.values():
            rates |= element.rates(states, values, self.on)
        return values, [rates[name] for name in self.state_names]

    def depends_on(self) -> tuple[dict[str, frozenset[str]], frozenset[str]]:
        """Return what each state's rate and the output depend on: states ("x.NAME") and inputs."""
        reach: dict[str, frozenset[str]] = {}
        inputs = set(self.model.device.inputs)

        def of(names: set[str]) -> frozenset[str]:
            result: frozenset[str] = frozenset()
            for name in names:
                result |= reach.get(name, frozenset({name} if name in inputs else ()))
            return result

        for name in self.order:
            element = self.model.elements[name]
            own = frozenset(f"x.{s.name}" for s in element.states() if self.on(s.present))
            reach[name] = own | of(names_passed(element, self.on))
        rates = {}
        for element in self.model.elements.values():
            node = element.line.node
            parts = [*element.args, *(p for _, p in node.options)]
            seen = {n for part in parts for n in resolved(self.model.device, part, self.on).names}
            states = [s for s in element.states() if self.on(s.present)]
            for s in states:
                rates[s.name] = of(seen) | frozenset(f"x.{t.name}" for t in states)
        return rates, reach[self.model.device.output]

    def used(self) -> set[str]:
        """Return the parameters that act: those of the parts that are there."""
        device = self.model.device
        parts = [part for e in self.model.elements.values() for part in e.acting(self.on)]
        return {name for part in parts for name in resolved(device, part, self.on).names} & device.constants

    def state_texts(self) -> dict[str, str]:
        """Return what each state is."""
        return {
            s.name: f"{e.line.comment or e.line.name}{s.what}"
            for e in self.model.elements.values()
            for s in e.states()
        }

    def time_of(self, state: State) -> float:
        """Return the time constant of a state, s; infinite where it has none."""
        time = math.inf if state.time is None else float(evaluate(state.time, self.values))
        return time if time > 0.0 else math.inf

    def margins(self, values: Mapping[str, float]) -> list[Margin]:
        """Return the limited signals with their limits where the signals have `values`."""
        result = []
        for name, element in self.model.elements.items():
            if element.is_limited:
                low, high = element.bounds(dict(values))
                texts = tuple("" if node is None else str(node) for node in element.limits)
                result.append(
                    Margin(name, element.line.comment, float(values[name]), float(low), float(high), *texts)
                )
            elif element.u.op == "clamp":
                result += self._clamped(name, element.u, values)
        return result

    def _clamped(self, name: str, node: Node, values: Mapping[str, float]) -> list[Margin]:
        value, low, high = (float(evaluate(part, values)) for part in node.args)
        comment = self.model.elements[name].line.comment
        return [Margin(name, comment, value, low, high, str(node.args[1]), str(node.args[2]))]
