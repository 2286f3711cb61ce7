"""C of expressions: over the plant's scalar `num`, what holds parameters only prepared once."""

from __future__ import annotations

from .language.device import FBASE, MBASE
from .language.element import On
from .language.expression import ONE, Node
from .language.structure import Model

_FUNCTION = {
    "sqrt": "element_sqrt",
    "exp": "num_exp",
    "log": "num_log",
    "sin": "element_sin",
    "cos": "element_cos",
}
#: Functions that decide by comparing signals, and how often.
_DECIDES = {"min": 1, "max": 1, "clamp": 2, "deadband": 2, "abs": 1, "fex": 4, "vx": 1, "vx_inverse": 1}


WORD, MOST_WORDS = 64, 2  #: decisions in a word; words of a device


def word_name(word: int) -> str:
    """Return the name in C of a device's word of decisions, from 0."""
    return f"l{word + 1}" if word else "l"


def parameter_rows(model: Model) -> tuple[str, ...]:
    """Return the rows of a device's table that the case gives: parameters, bases, references."""
    device = model.device
    hz = (FBASE,) if any(FBASE in line.node.names for line in device.lines) else ()
    return (*(p.name for p in device.parameters), MBASE, *hz, *device.references)


class ExpressionWriter:
    """C of the expressions of one device; `on` says which parts are there."""

    def __init__(self, model: Model) -> None:
        self.model, self.device = model, model.device
        self.prefix = self.device.key
        self.big = self.prefix.upper()
        self.parameter_rows = parameter_rows(model)
        self.prepared: dict[Node, int] = {}
        self.in_prepare = False
        self.decisions = 0  #: bits of the words of decisions that are given away
        self.on: On = lambda condition: condition if isinstance(condition, bool) else None

    def deciding(self, name: str, count: int) -> str:
        """C of the beginning of a call of limiter_`name`, which makes `count` decisions."""
        return f"limiter_{name}({self.bit_of(self.allot(count))}, "

    def allot(self, count: int) -> int:
        """Give away `count` decisions in one word, and return the first."""
        if self.in_prepare:  # of parameters nobody asks
            return self.decisions
        if self.decisions % WORD + count > WORD:
            self.decisions += WORD - self.decisions % WORD
        self.decisions += count
        return self.decisions - count

    def bit_of(self, decision: int) -> str:
        """C of a decision: its word and its bit there."""
        return f"&{word_name(decision // WORD)}, {decision % WORD}u"

    def row(self, name: str) -> str:
        """A row of the table."""
        at = f"{self.big}__{name} * n"
        return f"p[{at}]" if self.in_prepare else f"AT(p, {at})"

    def constant(self, node: Node) -> str:
        """C of a node of parameters and numbers: a literal, a row, or a row prepared once."""
        if node.op == "number":
            return _literal(node.value)
        if node.op == "name":
            return self.row(node.name)
        if node not in self.prepared:
            self.prepared[node] = len(self.prepared)
        return self.row(f"_{self.prepared[node]}")

    def code_of(self, node: Node) -> tuple[str, bool]:
        """C of a node, and whether it is a `num` (else a `real`)."""
        if not self.in_prepare and self.device.constant(node):
            return self.constant(node), False
        if node.op == "number":
            return _literal(node.value), False
        if node.op == "name":
            provided = node.name in self.parameter_rows and node.name != "pref"  # a step is added to pref
            return (self.row(node.name), False) if provided else (f"s_{node.name}", True)
        if node.op == "neg":
            text, is_num = self.code_of(node.args[0])
            return f"(-{text})", is_num
        if node.op in ("+", "-", "*", "/"):
            return self.binary(node)
        if node.op == "per":
            return f"element_per({self.code_of(node.args[0])[0]})", False
        if node.op in ("vx_a", "vx_b"):
            return f"element_{node.op}({', '.join(self.code_of(a)[0] for a in node.args)})", False
        of_signals = {"**": self.power, "pick": self.pick, "table": self.table}
        return of_signals.get(node.op, self.call)(node), True

    def power(self, node: Node) -> str:
        """C of a square, a cube or a fourth power."""
        text = self.num(node.args[0])
        square = f"element_square({text})"
        return {2: square, 3: f"({square} * {text})", 4: f"element_square({square})"}[int(node.args[1].value)]

    def call(self, node: Node) -> str:
        """C of a function of signals; least and largest of several by pairs."""
        *others, text = [self.num(a) for a in node.args]
        if node.op in _FUNCTION:
            return f"{_FUNCTION[node.op]}({', '.join([*others, text])})"
        if node.op not in ("min", "max"):
            return f"{self.deciding(node.op, _DECIDES[node.op])}{', '.join([*others, text])})"
        for other in reversed(others):
            text = f"{self.deciding(node.op, 1)}{other}, {text})"
        return text

    def binary(self, node: Node) -> tuple[str, bool]:
        """C of + - * /."""
        (a, a_num), (b, b_num) = (self.code_of(part) for part in node.args)
        if node.op == "/" and b_num:
            return f"num_ratio({a if a_num else f'NUM({a})'}, {b})", True
        if node.op == "/" and not self.in_prepare:  # by a parameter: its reciprocal is prepared
            return f"({a} * {self.constant(Node('/', (ONE, node.args[1])))})", a_num
        return f"({a} {node.op} {b})", a_num or b_num

    def num(self, node: Node) -> str:
        """C of a node as a `num`."""
        text, is_num = self.code_of(node)
        return text if is_num else f"NUM({text})"

    def pick(self, node: Node) -> str:
        """C of a choice: by a bit of the structure, or by signals."""
        condition, yes, no = node.args
        if not self.in_prepare and self.device.constant(condition):
            decided = self.on(condition)
            if decided is not None:
                return self.num(yes if decided else no)
            return f"({self.bit(condition)} ? {self.num(yes)} : {self.num(no)})"
        return f"num_pick({self.flag(condition)}, {self.num(yes)}, {self.num(no)})"

    def flag(self, node: Node) -> str:
        """C of a comparison of signals."""
        a, b = (self.num(part) for part in node.args)
        if node.op in ("==", "!="):
            same = f"(num_reaches({a}, {b}) & num_reaches({b}, {a}))"
            return same if node.op == "==" else f"flag_not{same}"
        name = "reaches" if "=" in node.op else "above"
        fixed = set(node.names) <= {*self.parameter_rows} - {"pref"}  # at rest, for good: nothing to watch
        call = f"num_{name}(" if fixed else self.deciding(name, 1)
        return f"{call}{a}, {b})" if ">" in node.op else f"{call}{b}, {a})"

    def table(self, node: Node) -> str:
        """C of a table, piece by piece, held beyond the ends."""
        u, points = self.num(node.args[0]), node.args[1:]
        xs, ys = points[0::2], points[1::2]
        text = self.num(ys[0])
        for k in range(len(xs) - 1):
            rise, run = Node("-", (ys[k + 1], ys[k])), Node("-", (xs[k + 1], xs[k]))
            slope = self.num(Node("/", (rise, run)))
            call = self.deciding("piece", 1)
            text = f"{call}{text}, {u}, {self.num(xs[k])}, {self.num(ys[k])}, {slope})"
        call = self.deciding("piece", 1)
        return f"{call}{text}, {u}, {self.num(xs[-1])}, {self.num(ys[-1])}, NUM(0.0))"

    def bit(self, condition: Node) -> str:
        """C of a bit of the structure."""
        return f"(has & {hex(1 << self.model.bits[condition])}u)"

    def times(self, K: Node, u: Node) -> str:
        """C of K u."""
        return self.num(u) if K == ONE else f"{self.constant(K)} * {self.num(u)}"


def _literal(value: float) -> str:
    text = repr(float(value))
    return f"({text})" if value < 0.0 else text
