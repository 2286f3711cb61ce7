"""What is there for given parameters: the bits of a device, its states, the order of its lines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from ...errors import DeviceError
from .device import Device
from .element import Condition, Element, On, State, conditions_in, names_passed
from .elements import element_of
from .expression import Node, evaluate

MOST_BITS, MOST_ORDERS = 52, 64  # bits of a whole number that a double holds


@dataclass(frozen=True)
class Order:
    """Lines in an order in which each is computed before its use; or, with `bit`, one order for each value.

    `loop`: the signals of a loop without a state, in place of an order.
    """

    lines: tuple[str, ...] = ()
    bit: int | None = None
    yes: Order | None = None
    no: Order | None = None
    loop: tuple[str, ...] = ()


class Model:
    """A device with its elements, bits and orders; made once for each device."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.elements: dict[str, Element] = {line.name: element_of(device, line) for line in device.lines}
        numbers: dict[Node, int] = {}
        for element in self.elements.values():
            conditions: list[Condition] = [s.present for s in element.states()]
            for node in (*element.args, *(p for _, p in element.line.node.options)):
                conditions += conditions_in(device, node)
            for condition in conditions:
                if isinstance(condition, Node):
                    numbers.setdefault(condition, len(numbers))
        names = [s.name for e in self.elements.values() for s in e.states()]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise DeviceError(f"{device.file}: two states are called {twice[0]}; rename a line")
        if len(numbers) > MOST_BITS:
            raise DeviceError(f"{device.file}: {len(numbers)} choices by parameters, allowed: {MOST_BITS}")
        self.bits: dict[Node, int] = numbers

    @cached_property
    def states(self) -> tuple[tuple[Element, State], ...]:
        """All states that may be there, in the order of the lines."""
        return tuple((e, s) for e in self.elements.values() for s in e.states())

    @cached_property
    def order(self) -> Order:
        """The order of the lines; DeviceError : it takes too many of them to serve every structure."""
        self._orders = 0
        return self._order({})

    def on(self, decided: Mapping[int, bool]) -> On:
        """Return what the bits in `decided` say about conditions."""

        def on(condition: Condition) -> bool | None:
            return condition if isinstance(condition, bool) else decided.get(self.bits[condition])

        return on

    def has(self, values: Mapping[str, float]) -> int:
        """Return the structure for parameters `values`: one bit for each condition that holds."""
        return sum(1 << k for node, k in self.bits.items() if evaluate(node, values))

    def on_of(self, has: int) -> On:
        """Return what the structure `has` says about conditions."""
        return self.on({k: bool(has >> k & 1) for k in self.bits.values()})

    def states_of(self, has: int) -> tuple[State, ...]:
        """Return the states that structure `has` has, in order."""
        on = self.on_of(has)
        return tuple(s for _, s in self.states if on(s.present))

    def order_of(self, has: int) -> tuple[str, ...]:
        """Return the order of the lines for structure `has`.

        Raises
        ------
        DeviceError : its signals form a loop without a state.
        """
        order = self.order
        while order.bit is not None:
            order = order.yes if has >> order.bit & 1 else order.no  # type: ignore[assignment]
        if order.loop:
            raise DeviceError(
                f"{self.device.name}: the signals {' <- '.join((*order.loop, order.loop[0]))} form a loop "
                "without a state; give a lag in the loop a time above 0"
            )
        return order.lines

    def _order(self, decided: dict[int, bool]) -> Order:
        self._orders += 1
        if self._orders > MOST_ORDERS:  # they double with each loop
            raise DeviceError(
                f"{self.device.file}: more than {MOST_ORDERS} evaluation orders, depending on which "
                "times are 0; allow fewer lags in loops to be 0 (above = 0 in place of min = 0)"
            )
        on = self.on(decided)
        needs = {name: names_passed(e, on) & set(self.elements) for name, e in self.elements.items()}
        done: list[str] = []
        left = dict(needs)
        while left:
            ready = next((name for name, need in left.items() if need <= set(done)), None)
            if ready is None:
                break
            done.append(ready)
            del left[ready]
        if not left:
            return Order(tuple(done))
        loop = _loop_in(left)
        bit = self._opening(loop, decided)
        if bit is None:
            return Order(loop=loop)
        return Order(bit=bit, yes=self._order(decided | {bit: True}), no=self._order(decided | {bit: False}))

    def _opening(self, loop: tuple[str, ...], decided: dict[int, bool]) -> int | None:
        """A bit, not decided yet, that opens the loop for one of its values."""
        pairs = tuple(zip(loop, (*loop[1:], loop[0]), strict=True))
        for bit in self.bits.values():
            if bit in decided:
                continue
            for value in (True, False):
                on = self.on(decided | {bit: value})
                if any(needed not in names_passed(self.elements[name], on) for name, needed in pairs):
                    return bit
        return None


def _loop_in(needs: Mapping[str, set[str]]) -> tuple[str, ...]:
    """A loop among signals each of which needs another one of them."""
    path = [next(iter(needs))]
    while True:
        following = next(name for name in needs if name in needs[path[-1]])
        if following in path:
            return tuple(path[path.index(following) :])
        path.append(following)
