"""The diagram of a device file: each line read by itself, then checked against the others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

from ...errors import nearest
from .device import ELEMENTS, KINDS, Line
from .expression import (
    COMPARISONS,
    FUNCTIONS,
    ZERO,
    Node,
    is_constant,
    number,
    parse,
    replaced,
)
from .source import Source

MOST_LINES, LARGEST_EXPRESSION = 200, 2000
_CALLS = FUNCTIONS | {name: (count, count) for name, (count, _) in ELEMENTS.items()} | {"ramp": (5, 5)}


class Diagram:
    """The diagram of `source`; `constants`: names of parameters, `references`: of its set-points."""

    def __init__(
        self, source: Source, kind: str, constants: frozenset[str], references: tuple[str, ...]
    ) -> None:
        self.source, self.kind_name, self.kind = source, kind, KINDS[kind]
        self.constants, self.references = constants, references
        self.outputs = (self.kind.output, *self.kind.also)

    def lines(self) -> tuple[Line, ...]:
        """Return the lines in their order; those of parameters only are put in where they are used.

        Raises
        ------
        DeviceError : a line that is none, a name that is not known or defined twice, no output.
        """
        written = [
            line for code, comment, k in self.rows_of_text() for line in self.read_line(code, comment, k)
        ]
        provided = self.constants | set(self.kind.inputs) | set(self.references)
        self.check_once(written, provided)
        lines = self.fold(written)
        self.check_known(lines, provided | {line.name for line in lines})
        return tuple(lines)

    def rows_of_text(self) -> Iterator[tuple[str, str, int]]:
        """Yield code, comment and number in the file of each row that has code."""
        rows = self.source.word("diagram").splitlines()
        if len(rows) > MOST_LINES:
            raise self.source.fail(f"diagram: {len(rows)} lines, allowed: {MOST_LINES}")
        file = self.source.rows
        start = next((k for k, row in enumerate(file, start=1) if row.startswith("diagram")), 0)
        if start and file[start - 1].rstrip().endswith(("'''", '"""')):
            start += 1  # TOML drops the end of the line that opens a text
        for k, row in enumerate(rows, start=start):
            code, _, comment = row.partition("#")
            if code.strip():
                yield code, comment.strip(), k

    def check_once(self, lines: list[Line], provided: frozenset[str]) -> None:
        """Check that each name is defined once."""
        count = Counter(line.name for line in lines)
        for line in lines:
            if count[line.name] > 1 or line.name in provided:
                raise self.source.fail(f"{line.name} is defined twice, allowed: once", line.number)

    def check_known(self, lines: list[Line], known: frozenset[str]) -> None:
        """Check that what a line uses is there, and that one gives the output."""
        for line in lines:
            for name in line.node.names:
                if name not in known:
                    raise self.source.fail(f"{name} is not known, {nearest(name, known)}", line.number)
        for output in self.outputs:
            if output not in known:
                raise self.source.fail(f"no line gives {output}, the output of a {self.kind_name}")

    def fold(self, lines: list[Line]) -> list[Line]:
        """Put lines of parameters only into the lines that use them."""
        fixed = self.constants | {line.name for line in lines}
        constant = {p.name: p.node for p in lines if not p.element and is_constant(p.node, fixed)}
        solved: dict[str, Node] = {}
        sizes: dict[str, int] = {}
        for _ in range(len(constant)):
            for name, node in constant.items():
                if name in solved:
                    continue
                size = self.bounded(name, node, sizes)
                if is_constant(put := replaced(node, solved), self.constants):
                    solved[name], sizes[name] = put, size
        for line in lines:
            self.bounded(line.name, line.node, sizes, line.number)
        return [
            Line(line.name, replaced(line.node, solved), line.comment, line.number)
            for line in lines
            if line.name not in solved or line.name in self.outputs
        ]

    def bounded(self, name: str, node: Node, sizes: Mapping[str, int], line: int = 0) -> int:
        """Return the size of an expression with lines of parameters put in, before they are."""
        size = _size(node, sizes)
        if size > LARGEST_EXPRESSION:
            raise self.source.fail(
                f"{name} has {size} parts with parameter lines substituted, allowed: {LARGEST_EXPRESSION}",
                line,
            )
        return size

    def read_line(self, code: str, comment: str, k: int) -> list[Line]:
        name, sign, text = code.partition("=")
        if not sign:
            raise self.source.fail(f"{code.strip()[:40]!r}: allowed: name = expression", k)
        name = name.strip() if name.strip() in self.outputs else self.source.name_of(name.strip(), k)
        node = parse(text, f"{self.source.file}:{k}", _CALLS)
        if node.op == "ramp":
            return self.ramp(name, node, comment, k)
        self.check_element(node, k, top=True)
        return [Line(name, node, comment, k)]

    def check_element(self, node: Node, k: int, *, top: bool, chooses: bool = False) -> None:
        """Check where elements and comparisons stand; `top`: the node is a whole line."""
        if node.op in ELEMENTS or node.op == "ramp":
            if not top:
                raise self.source.fail(
                    f"{node.op} has a state and needs a line of its own: name = {node.op}(...)", k
                )
            self.check_options(node, k)
            self.check_constants(node, k)
        elif node.options:
            raise self.source.fail(f"{node.op}() takes no options", k)
        elif node.op in COMPARISONS and not chooses:
            raise self.source.fail(f"{node}: a comparison, allowed: as the condition of pick()", k)
        for j, part in enumerate((*node.args, *(part for _, part in node.options))):
            choice = node.op == "pick" and j == 0
            if choice and part.op not in COMPARISONS:
                raise self.source.fail(
                    f"the condition of pick() is a comparison such as A > 0, not {part}", k
                )
            self.check_element(part, k, top=False, chooses=choice)

    def check_options(self, node: Node, k: int) -> None:
        """Check that an element has the options of its calls, each once."""
        options = ELEMENTS[node.op][1]
        keys = [key for key, _ in node.options]
        for key in keys:
            if key not in options:
                what = f"{node.op}() has no option {key[:40]}, {nearest(key[:40], options)}"
                raise self.source.fail(what, k)
        if len(set(keys)) != len(keys):
            raise self.source.fail(f"{node.op}() has an option twice", k)

    def check_constants(self, node: Node, k: int) -> None:
        """Times and gains of an element hold parameters only; lines of parameters are put in later."""
        fixed = [*node.args[1:], *(p for key, p in node.options if key in ("K", "T"))]
        signals = set(self.kind.inputs) | set(self.references)
        for part in fixed:
            for name in part.names:
                if name in signals:
                    raise self.source.fail(
                        f"{node.op}(): {part} holds the signal {name}, allowed: parameters", k
                    )

    def ramp(self, name: str, node: Node, comment: str, k: int) -> list[Line]:
        """[(1 + s T1)/(1 + s T2)^M]^N as eight places for a lead-lag, the leads in the first ones."""
        u, T1, T2, M, N = node.args
        lines = []
        for j in range(8):
            lead = Node("pick", (Node(">", (N, number(j))), T1, ZERO))
            lag = Node("pick", (Node(">", (Node("*", (M, N)), number(j))), T2, ZERO))
            own = name if j == 7 else f"{name}_{j + 1}"
            lines.append(Line(own, Node("leadlag", (u, lead, lag)), comment, k))
            u = Node("name", name=own)
        return lines


def _size(node: Node, sizes: Mapping[str, int]) -> int:
    """Number of parts of an expression; `sizes`: of names that stand for more than one."""
    parts = (*node.args, *(part for _, part in node.options))
    return sizes.get(node.name, 1) if node.op == "name" else 1 + sum(_size(part, sizes) for part in parts)
