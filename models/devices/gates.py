"""Gates and clamps of a diagram: what an expression is without one, and which one holds a signal at rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from .language.element import Equation
from .language.elements import Plain
from .language.expression import Node, evaluate
from .language.structure import Model

GATES = ("min", "max", "clamp")
_FITS = 1e-8  #: relative


@dataclass(frozen=True)
class Hold:
    """The argument of a gate that passes instead of the one that the rest needs.

    value : what the one that is needed has at rest. above : whether `limit` is an upper one.
    """

    value: float
    limit: Node
    above: bool


def led_on(node: Node, name: str) -> Node:
    """Return `node` with each gate replaced by its one argument that holds `name`."""
    inside = [part for part in node.args if name in part.names]
    if node.op in GATES and len(inside) == 1:
        return led_on(inside[0], name)
    return replace(node, args=tuple(led_on(part, name) for part in node.args)) if inside else node


def spelled_out(node: Node, model: Model, within: frozenset[str] = frozenset()) -> Node:
    """Return `node` with the signals in it that are plain expressions spelled out; those `within` stand."""
    element = model.elements.get(node.name) if node.op == "name" else None
    if isinstance(element, Plain) and node.name not in within:
        return spelled_out(element.u, model, within | {node.name})
    parts = tuple(spelled_out(part, model, within) for part in node.args)
    return replace(node, args=parts) if parts else node


def holding(e: Equation, known: Mapping[str, float]) -> Hold | None:
    """Return the gate without which `e` holds; None where no single one is to blame."""
    for left, right, gate, k in _without(e):
        one, other = float(evaluate(left, known)), float(evaluate(right, known))
        if abs(one - other) <= _FITS * max(1.0, abs(one)):
            at = [float(evaluate(part, known)) for part in gate.args]
            if gate.op == "clamp":
                above = at[0] > at[2]
                return Hold(at[0], gate.args[2 if above else 1], above)
            above = gate.op == "min"
            passes = at.index(min(at) if above else max(at))
            return Hold(at[k], gate.args[passes], above)
    return None


def _without(e: Equation) -> Iterator[tuple[Node, Node, Node, int]]:
    """Both sides with one gate replaced by one of its arguments, the gate, and which argument."""
    for tree, gate, k in _opened(e.left):
        yield tree, e.right, gate, k
    for tree, gate, k in _opened(e.right):
        yield e.left, tree, gate, k


def _opened(node: Node) -> Iterator[tuple[Node, Node, int]]:
    if node.op in GATES:
        for k, part in enumerate(node.args[:1] if node.op == "clamp" else node.args):
            yield part, node, k
    for i, part in enumerate(node.args):
        for tree, gate, k in _opened(part):
            yield replace(node, args=(*node.args[:i], tree, *node.args[i + 1 :])), gate, k


def crossed(node: Node, model: Model, known: Mapping[str, float]) -> Hold | None:
    """Return the level beyond which a ``pick(a > b, ...)`` in `node`, or one of <, is; None where none is.

    A signal over a parameter, as a field current over the rated one, is compared without the quotient.
    """
    tree = spelled_out(node, model)
    for pick in (part for part in _parts(tree) if part.op == "pick" and part.args[0].op in ("<", ">")):
        signal, limit = pick.args[0].args
        if evaluate(pick.args[0], known):
            if signal.op == "/" and all(name in model.device.by_name for name in signal.args[1].names):
                signal, limit = signal.args[0], Node("*", (limit, signal.args[1]))
            return Hold(float(evaluate(signal, known)), limit, above=pick.args[0].op == ">")
    return None


def _parts(node: Node) -> Iterator[Node]:
    yield node
    for part in node.args:
        yield from _parts(part)
