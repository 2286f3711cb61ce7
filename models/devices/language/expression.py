"""Expressions of a device's diagram: read from text, evaluated for numbers.

A file is data. Python's parser gives the tree only; every node of it is taken over by type, so that nothing
but numbers, names, ``+ - * / **``, comparisons and calls of known functions comes through.
"""

from __future__ import annotations

import ast
import cmath
import itertools
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ...documents import parse_python
from ...errors import DeviceError, nearest

LONGEST_LINE = 240  #: characters
DEEPEST = 40
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,23}")
Value = Any  #: float or complex (the complex step)


@dataclass(frozen=True)
class Node:
    """A number, a name or an operation: `op` is "number", "name", an operator or a function's name."""

    op: str
    args: tuple[Node, ...] = ()
    name: str = ""
    value: float = 0.0
    options: tuple[tuple[str, Node], ...] = ()  #: keyword arguments, of elements only

    def __str__(self) -> str:
        return self._text

    def __hash__(self) -> int:
        return self._hash

    # found once: a grid's thousand controls share the nodes of forty devices
    @cached_property
    def names(self) -> tuple[str, ...]:
        """Every name in it, options included, as often as it stands there."""
        own = (self.name,) if self.op == "name" else ()
        inner = (part.names for part in (*self.args, *(p for _, p in self.options)))
        return tuple(itertools.chain(own, *inner))

    @cached_property
    def _text(self) -> str:
        return text_of(self)

    @cached_property
    def _hash(self) -> int:
        return hash((self.op, self.args, self.name, self.value, self.options))


OPERATORS = ("+", "-", "*", "/", "**")
COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")
#: least and most arguments
FUNCTIONS = {
    "min": (2, 4),
    "max": (2, 4),
    "lv": (2, 4),  # low-value gate
    "hv": (2, 4),  # high-value gate
    "clamp": (3, 3),
    "deadband": (2, 2),
    "pick": (3, 3),
    "abs": (1, 1),
    "sqrt": (1, 1),
    "exp": (1, 1),
    "log": (1, 1),
    "vx": (5, 5),  # E SE(E), scaled quadratic of PSS/E: (E, E1, S1, E2, S2)
    "vx_inverse": (6, 6),  # v for which KE v + vx(v) = F: (F, KE, E1, S1, E2, S2)
    "sin": (1, 1),
    "cos": (1, 1),
    "fex": (1, 1),  # regulation of the rectifier
    "table": (5, 25),  # linear between points: (u, x1, y1, x2, y2, ...), held beyond the ends
}
_BINARY = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
_COMPARE = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
ZERO, ONE = Node("number"), Node("number", value=1.0)


def number(value: float) -> Node:
    """Return `value` as a node."""
    return Node("number", value=float(value))


_POWERS = (number(2.0), number(3.0), number(4.0))


def parse(text: str, where: str, calls: Mapping[str, tuple[int, int]] = FUNCTIONS) -> Node:
    """Return the tree of `text`; `calls`: functions allowed, with least and most arguments.

    Raises
    ------
    DeviceError : anything but numbers, names, operators and those calls.
    """
    if len(text) > LONGEST_LINE:
        raise DeviceError(f"{where}: {len(text)} characters, allowed: {LONGEST_LINE}; split the line")
    if not text.isascii():
        raise DeviceError(f"{where}: {text.strip()[:60]!r} has letters beyond ASCII, allowed: ASCII")
    try:
        tree = parse_python(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise DeviceError(f"{where}: {text.strip()[:60]!r} is no expression") from None
    return _node(tree, where, calls, 0)


def _node(tree: ast.AST, where: str, calls: Mapping[str, tuple[int, int]], depth: int) -> Node:
    if depth > DEEPEST:
        raise DeviceError(f"{where}: nested deeper than {DEEPEST}; split the line")

    def inner(part: ast.AST) -> Node:
        return _node(part, where, calls, depth + 1)

    match tree:
        case ast.Constant() | ast.Name():
            return _leaf(tree, where)
        case ast.UnaryOp(op=ast.USub()):
            part = inner(tree.operand)
            return number(-part.value) if part.op == "number" else Node("neg", (part,))
        case ast.BinOp() if type(tree.op) in _BINARY:
            op, args = _BINARY[type(tree.op)], (inner(tree.left), inner(tree.right))
            if op == "**" and args[1] not in _POWERS:
                raise DeviceError(f"{where}: the power {args[1]}, allowed: 2, 3, 4")
            return Node(op, args)
        case ast.Compare(ops=[operator]) if type(operator) in _COMPARE:
            return Node(_COMPARE[type(operator)], (inner(tree.left), inner(tree.comparators[0])))
        case ast.Call(func=ast.Name(name)):
            return _call(tree, name, where, calls, inner)
    raise _not_allowed(where, f"{type(tree).__name__.lower()} in an expression")


def _leaf(tree: ast.Constant | ast.Name, where: str) -> Node:
    """A number or a name."""
    if isinstance(tree, ast.Name):
        if NAME.fullmatch(tree.id):
            return Node("name", name=tree.id)
        raise _not_allowed(where, "such a name")
    value = tree.value
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= 1e30:
        return number(value)
    raise _not_allowed(where, "such a constant")


def _not_allowed(where: str, what: str) -> DeviceError:
    return DeviceError(f"{where}: {what} is not allowed; allowed: numbers, names, + - * / **, <, calls")


def _call(
    tree: ast.Call,
    name: str,
    where: str,
    calls: Mapping[str, tuple[int, int]],
    inner: Callable[[ast.AST], Node],
) -> Node:
    if name not in calls:
        raise DeviceError(f"{where}: {name[:24]}(): no such function, {nearest(name[:40], calls)}")
    low, high = calls[name]
    if not low <= len(tree.args) <= high:
        expected = f"{low}" if low == high else f"{low} to {high}"
        raise DeviceError(f"{where}: {name}() has {len(tree.args)} arguments, allowed: {expected}")
    args = tuple(inner(part) for part in tree.args)
    options = tuple((str(key.arg), inner(key.value)) for key in tree.keywords)
    if name in ("vx", "vx_inverse"):  # the coefficients of the curve are parameters only: prepared once
        curve = args[-4:]
        return Node(name, (*args[:-4], Node("vx_a", curve), Node("vx_b", curve)))
    if name == "table" and len(args) % 2 == 0:
        raise DeviceError(f"{where}: table() takes u and pairs x, y: an odd number of arguments")
    return Node({"lv": "min", "hv": "max"}.get(name, name), args, options=options)


def replaced(node: Node, by: Mapping[str, Node]) -> Node:
    """Return `node` with names replaced by nodes."""
    if node.op == "name":
        return by.get(node.name, node)
    if not node.args and not node.options:
        return node
    return Node(
        node.op,
        tuple(replaced(part, by) for part in node.args),
        node.name,
        node.value,
        tuple((key, replaced(part, by)) for key, part in node.options),
    )


_STRENGTH = {"+": 1, "-": 1, "*": 2, "/": 2, "neg": 3, "**": 4}


def text_of(node: Node) -> str:
    """Return `node` as it is written in a diagram."""
    if node.op == "number":
        return f"{node.value:g}"
    if node.op == "name":
        return node.name
    if node.op in OPERATORS or node.op in COMPARISONS:
        own = _STRENGTH.get(node.op, 0)
        left, right = (
            f"({part})" if _STRENGTH.get(part.op, 9) < own + side else str(part)
            for side, part in zip((0, int(node.op in ("-", "/"))), node.args, strict=True)
        )
        space = "" if node.op in ("*", "/", "**") else " "
        return f"{left}{space}{node.op}{space}{right}"
    if node.op == "neg":
        return f"-({node.args[0]})" if node.args[0].op in OPERATORS else f"-{node.args[0]}"
    if node.op in ("vx", "vx_inverse"):
        return f"{node.op}({', '.join(map(str, (*node.args[:-2], *node.args[-1].args)))})"
    parts = [*map(str, node.args), *(f"{key}={part}" for key, part in node.options)]
    return f"{node.op}({', '.join(parts)})"


# ---------------------------------------------------------------- numbers


def scaled_quadratic(E1: float, S1: float, E2: float, S2: float) -> tuple[float, float]:
    """Return A, B of E SE(E) = B (E - A)^2 through both points, B = 0 when there is no saturation.

    The two points may come in either order.  [PSS/E model library]
    """
    root1, root2 = math.sqrt(max(S1 * E1, 0.0)), math.sqrt(max(S2 * E2, 0.0))
    if not (abs(root2 - root1) > 0.0 and abs(E2 - E1) > 0.0):
        return 0.0, 0.0
    slope = (root2 - root1) / (E2 - E1)
    return (0.0, 0.0) if not slope > 0.0 else (E1 - root1 / slope, slope * slope)


def _part(a: Value) -> float:
    return a.real if isinstance(a, complex) else a


def _clamp(a: Value, low: Value, high: Value) -> Value:
    return low if _part(low) > _part(a) else high if _part(a) > _part(high) else a


def _sqrt(a: Value) -> Value:
    if isinstance(a, complex):
        return cmath.sqrt(a) if a.real > 0.0 else 0.0
    return math.sqrt(a) if a > 0.0 else 0.0


def _fex(n: Value) -> Value:
    """Rectifier regulation with the exact constants: 1/sqrt 3, sqrt 3/4, sqrt 3 make it continuous."""
    v = _part(n)
    if v <= 0.0:
        return 1.0
    if v <= 0.75 / math.sqrt(3.0):
        return 1.0 - n / math.sqrt(3.0)
    if v < 0.75:
        return _sqrt(0.75 - n * n)
    return math.sqrt(3.0) * (1.0 - n) if v < 1.0 else 0.0


def _vx(e: Value, a: float, b: float) -> Value:
    return b * (e - a) * (e - a) if _part(e) > a else 0.0


def _vx_inverse(f: Value, KE: float, a: float, b: float) -> Value:
    v = f / KE if KE else math.inf
    if not (b > 0.0 and _part(v) > a):
        return v
    return a + (_sqrt(KE * KE + 4.0 * b * (f - KE * a)) - KE) / (2.0 * b)


def _table(u: Value, *points: float) -> Value:
    xs, ys = points[0::2], points[1::2]
    if _part(u) <= xs[0]:
        return ys[0]
    for k in range(1, len(xs)):
        if _part(u) < xs[k]:
            return ys[k - 1] + (u - xs[k - 1]) * ((ys[k] - ys[k - 1]) / (xs[k] - xs[k - 1]))
    return ys[-1]


def _divide(a: Value, b: Value) -> Value:
    return a / b if b != 0.0 else math.nan


_VALUE: dict[str, Callable[..., Value]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": _divide,
    "**": lambda a, b: a ** int(b),
    "neg": lambda a: -a,
    "<": lambda a, b: _part(a) < _part(b),
    "<=": lambda a, b: _part(a) <= _part(b),
    ">": lambda a, b: _part(a) > _part(b),
    ">=": lambda a, b: _part(a) >= _part(b),
    "==": lambda a, b: _part(a) == _part(b),
    "!=": lambda a, b: _part(a) != _part(b),
    "min": lambda *a: min(a, key=_part),
    "max": lambda *a: max(a, key=_part),
    "clamp": _clamp,
    "deadband": lambda a, d: a - _clamp(a, -d, d),
    "abs": lambda a: -a if _part(a) < 0.0 else a,
    "sqrt": _sqrt,
    "exp": lambda a: cmath.exp(a) if isinstance(a, complex) else math.exp(min(a, 700.0)),
    "log": lambda a: cmath.log(a) if isinstance(a, complex) else math.log(a) if a > 0.0 else math.nan,
    "vx": _vx,
    "vx_a": lambda *p: scaled_quadratic(*p)[0],
    "vx_b": lambda *p: scaled_quadratic(*p)[1],
    "vx_inverse": _vx_inverse,
    "sin": lambda a: cmath.sin(a) if isinstance(a, complex) else math.sin(a),
    "cos": lambda a: cmath.cos(a) if isinstance(a, complex) else math.cos(a),
    "fex": _fex,
    "table": _table,
}


def evaluate(node: Node, values: Mapping[str, Value]) -> Value:
    """Return the value of `node` where names have `values`; KeyError names one that has none."""
    if node.op == "number":
        return node.value
    if node.op == "name":
        return values[node.name]
    if node.op == "pick":
        chosen = node.args[1] if evaluate(node.args[0], values) else node.args[2]
        return evaluate(chosen, values)
    try:
        return _VALUE[node.op](*(evaluate(part, values) for part in node.args))
    except OverflowError:
        return math.inf


def folded(node: Node, values: Mapping[str, float]) -> Node:
    """Return `node` with a number for each part of it that holds names of `values` alone.

    The rest has the same value to the bit for whatever the other names are.
    """
    if node.op == "number" or (node.op == "name" and node.name not in values):
        return node
    if node.op == "name":
        return Node("number", value=values[node.name])
    args = [folded(part, values) for part in node.args[: 1 if node.op == "pick" else None]]
    if node.op == "pick":
        if args[0].op == "number":  # the other branch may have no value
            return folded(node.args[1 if args[0].value else 2], values)
        return Node("pick", (args[0], *(_folded_branch(part, values) for part in node.args[1:])))
    if all(part.op == "number" for part in args):
        return Node("number", value=evaluate(Node(node.op, tuple(args)), {}))  # type: ignore[arg-type]
    return Node(node.op, tuple(args))


def _folded_branch(node: Node, values: Mapping[str, float]) -> Node:
    """Fold a branch that may not be taken: as it is where a part of it has no value."""
    try:
        return folded(node, values)
    except (ArithmeticError, ValueError):
        return node


def is_constant(node: Node, constants: frozenset[str]) -> bool:
    """Return whether `node` holds numbers and names of `constants` only."""
    return all(name in constants for name in node.names)
