"""Where the lines of a diagram are needed: one that only absent parts use is not computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .element import Condition, On
from .expression import Node

if TYPE_CHECKING:
    from .structure import Model


@dataclass(frozen=True)
class Need:
    """The structures with any bit of `ones` 1 or any bit of `zeros` 0; `always`: all of them."""

    ones: int = 0
    zeros: int = 0
    always: bool = False

    def __or__(self, other: Need) -> Need:
        ones, zeros = self.ones | other.ones, self.zeros | other.zeros
        return ALWAYS if self.always or other.always or ones & zeros else Need(ones, zeros)

    def within(self, other: Need) -> Need:
        """Return one of the two, so that no structure of both is missing: the narrower."""
        return self if self._rank <= other._rank else other

    @property
    def _rank(self) -> tuple[bool, int, int]:
        """How many structures it has, in their order: a flag is 0 where its part is absent, so mostly."""
        return self.always, self.zeros.bit_count(), self.ones.bit_count()

    def holds(self, has: int) -> bool:
        """Return whether the structure `has` is one of them."""
        return self.always or bool(has & self.ones or ~has & self.zeros)


NEVER, ALWAYS = Need(), Need(always=True)


def needs_of(model: Model, lines: Sequence[str], on: On) -> dict[str, Need]:
    """Return where each of `lines`, each after what it uses, is needed; `on`: decided bits."""
    needs = dict.fromkeys(lines, NEVER)
    for name in model.device.outputs:
        needs[name] = ALWAYS

    def use(node: Node, where: Need) -> None:
        for name, need in _uses(model, node, on).items():
            if name in needs:
                needs[name] |= need.within(where)

    for element in model.elements.values():
        for state in element.states():
            where = need_of(model, state.present, on)
            needs[element.line.name] |= where  # the rate takes limits from the line
            for node in (*element.args, *(part for _, part in element.line.node.options)):
                use(node, where)
    for name in reversed(lines):
        for node in model.elements[name].passes(on):
            use(node, needs[name])
    return needs


def need_of(model: Model, condition: Condition, on: On, value: bool = True) -> Need:
    """Return where `condition` is `value`."""
    decided = on(condition)
    if decided is not None or isinstance(condition, bool):
        return ALWAYS if decided is value else NEVER
    bit = 1 << model.bits[condition]
    return Need(ones=bit) if value else Need(zeros=bit)


def _uses(model: Model, node: Node, on: On) -> dict[str, Need]:
    """Return where `node` uses each of the names in it."""
    if node.op == "name":
        return {node.name: ALWAYS}
    parts = [(part, ALWAYS) for part in node.args]
    if node.op == "pick" and node.args[0] in model.bits:
        condition, yes, no = node.args
        parts = [(yes, need_of(model, condition, on)), (no, need_of(model, condition, on, False))]
    uses: dict[str, Need] = {}
    for part, where in parts:
        for name, need in _uses(model, part, on).items():
            uses[name] = uses.get(name, NEVER) | need.within(where)
    return uses
