"""C code of devices: one straight line for each line of a diagram, over the plant's scalar `num`."""

from __future__ import annotations

import functools
import itertools
import operator
import re
import zlib
from collections.abc import Iterable, Iterator

from ..errors import DeviceError
from .c_expression import MOST_WORDS, WORD, ExpressionWriter, word_name
from .language.device import KINDS
from .language.element import Condition, Element, resolved
from .language.elements import Integrator, Lag, Pi, Plain
from .language.expression import ONE, ZERO, Node
from .language.need import Need, needs_of
from .language.structure import Model, Order

_FEW = ("hvdc", "vsc")  #: kinds of which a grid rarely has two of one structure
_TEXT = re.compile(r"[^A-Za-z0-9 ,.:;()=+-]")


def devices_header(models: Iterable[Model]) -> str:
    """Return `devices.h` for `models`: tables, equations and the choice by number, in their order."""
    written = [Writer(model) for model in models]
    out = [
        "/* Written by models/devices/emit.py from the device files; not to be edited. */",
        "#ifndef INTERAREA_DEVICES_H",
        "#define INTERAREA_DEVICES_H",
        '#include "elements.h"',
        "",
    ]
    for writer in written:
        out += [*writer.code(), ""]
    names = [w.prefix for w in written]
    digest = zlib.crc32("\n".join(out).encode())  # a record made for other devices is refused
    out += [f"#define DEVICE_SIGNATURE {digest}u"]
    out += [f"enum {{ {', '.join([*(f'DEVICE_NUMBER_{n.upper()}' for n in names), 'DEVICE_COUNT'])} }};"]
    numbers = {
        "rows": [f"{n.upper()}___ROWS" for n in names],
        "parameters": [f"{n.upper()}___PARAMETERS" for n in names],
        "kind": [str(list(KINDS).index(w.device.kind)) for w in written],
        "reference": [w.reference for w in written],
        "decisions": [str(w.most) for w in written],
    }
    for what, values in numbers.items():
        out += _choice(what, "size_t device", names, values)
    out += _choice("states", "size_t device, uint64_t has", names, [w.states() for w in written])
    out += [
        "static inline void device_run(size_t device, const DeviceGroup *g, const DeviceSignals *in,",
        "                              const cell *x, cell *dx)",
        "{",
        "    switch (device) {",
        *(f"    case DEVICE_NUMBER_{n.upper()}: equations_of_{n}(g, in, x, dx); break;" for n in names),
        "    default: (void)g; (void)in; (void)x; (void)dx;",
        "    }",
        "}",
        "#if !defined PLANT_TANGENT && !defined PLANT_LANES && !defined PLANT_HELD",
        "static inline void device_prepare(size_t device, double *table, size_t n)",
        "{",
        "    switch (device) {",
        *(f"    case DEVICE_NUMBER_{n.upper()}: numbers_of_{n}(table, n); break;" for n in names),
        "    default: (void)table; (void)n;",
        "    }",
        "}",
        "#endif",
        "#endif",
    ]
    return "\n".join(out) + "\n"


@functools.lru_cache(maxsize=256)
def decisions(model: Model) -> int:
    """Return how many decisions a device makes: of limits, gates, choices and pieces of tables."""
    writer = Writer(model)
    writer.code()
    return writer.most


def _choice(what: str, arguments: str, names: list[str], values: list[str]) -> list[str]:
    return [
        f"static inline size_t device_{what}({arguments})",
        "{",
        *(["    (void)has;"] if "has" in arguments else []),
        "    switch (device) {",
        *(f"    case DEVICE_NUMBER_{n.upper()}: return {v};" for n, v in zip(names, values, strict=True)),
        "    default: return 0;",
        "    }",
        "}",
    ]


class Writer(ExpressionWriter):
    """The C code of one device."""

    def __init__(self, model: Model) -> None:
        super().__init__(model)
        self.most = 0  #: decisions of the order that has most
        self.first: dict[str, int] = {}  #: of a line with limits: its first decision

    @property
    def reference(self) -> str:
        """C of the row of the set-point that is solved for, 0 where there is none."""
        fixed = {name for name, _ in self.device.fixed}
        solved = [name for name in self.device.references if name not in fixed]
        return f"{self.big}__{solved[0]}" if solved else "0"

    def states(self) -> str:
        """C of the number of states."""
        present = [state.present for _, state in self.model.states]
        optional = [f"({self.bit(p)} ? 1u : 0u)" for p in present if isinstance(p, Node)]
        return " + ".join([f"{sum(p is True for p in present)}u", *optional])

    # ------------------------------------------------------------ the device

    def code(self) -> list[str]:
        """Enumeration, what is prepared, the equations."""
        body = self.branch(self.model.order, {}, 2)
        if self.most > WORD * MOST_WORDS:
            raise DeviceError(
                f"{self.device.name}: its limits, gates, choices and points of tables make {self.most} "
                f"decisions, allowed: {WORD * MOST_WORDS} in one device; give tables fewer points"
            )
        words = [(k, word_name(k)) for k in range(MOST_WORDS) if self.most > k * WORD]
        begin = [f"        Limiters {name} = limiters_begin(g, k, {k});" for k, name in words]
        end = [f"        limiters_end(g, k, {k}, &{name});" for k, name in words]
        few = self.device.kind in _FEW
        signature = f"static inline void equations_of_{self.prefix}("
        first, last = (
            "const DeviceGroup *g, const DeviceSignals *in,",
            f"{' ' * len(signature)}const cell *x, cell *dx)",
        )
        every = f"static DEVICE_COPIED void every_{self.prefix}(size_t n, "
        head = [
            (every if few else signature) + first,
            last,
            "{",
            *([] if few else ["    const size_t n = g->n;"]),
            *(["    const uint64_t has = g->has;"] if self.model.bits else []),
            *self.places(),
        ]
        signals = self.signals()
        uses_table = any("AT(p, " in row for row in body + signals)
        loop = [
            "    EACH(k, 0, n) {",
            *(["        const stored *p = g->table + k;"] if uses_table else []),
            "        const where m = where_at(g->machine, k);",
            *begin,
            *signals,
        ]
        prepare = self.prepare()
        title = f"/* {self.device.name}: {_TEXT.sub(' ', self.device.title)} */"
        call = [signature + first, last, "{", f"    DEVICE_FEW(every_{self.prefix}, g, in, x, dx);", "}"]
        rows = [title, *self.enumeration(), *prepare, *head, *loop, *body, *end, "    }", "}"]
        return rows + (call if few else [])

    def enumeration(self) -> list[str]:
        """The rows of the device's table by name."""
        prepared = (f"_{k}" for k in range(len(self.prepared)))
        rows = ", ".join(f"{self.big}__{name}" for name in (*self.parameter_rows, *prepared))
        last = f"       {self.big}___PARAMETERS = {len(self.parameter_rows)} }};"
        return _wrapped(f"enum {{ {rows}, {self.big}___ROWS,", last)

    def places(self) -> list[str]:
        """Where each state begins, one after the other as far as they are there."""
        rows, at = [], "0"
        for _, state in self.model.states:
            rows.append(f"    const size_t at_{state.name} = {at};")
            there = "n" if state.present is True else f"({self.condition(state.present)} ? n : 0)"
            at = f"at_{state.name} + {there}"
        return rows or ["    (void)x;", "    (void)dx;"]

    def signals(self) -> list[str]:
        """What the lines use: inputs, the set-point with its step, states."""
        device = self.device
        inputs = sorted({n for line in device.lines for n in line.node.names} & set(device.inputs))
        rows = [f"        const num s_{name} = OF(in->{name}, m);" for name in inputs]
        if "pref" in device.references:
            rows.append(f"        const num s_pref = NUM({self.row('pref')} + OF(in->pref_step, m));")
        states = (
            (self.condition(state.present), (f"x_{state.name}", f"AT(x, at_{state.name} + k)", ""))
            for _, state in self.model.states
        )
        return rows + ["        " + row for row in self.where_needed(states)]

    def where_needed(self, named: Iterable[tuple[str, tuple[str, str, str]]]) -> Iterator[str]:
        """Variables with their values, those next to each other under one condition together; 0 elsewhere."""
        for condition, group in itertools.groupby(named, key=operator.itemgetter(0)):
            variables = [variable for _, variable in group]
            if condition == "1":
                yield from (f"const num {name} = {value};{comment}" for name, value, comment in variables)
            elif condition != "0":
                yield from (f"num {name} = NUM(0.0);" for name, _, _ in variables)
                yield f"if ({condition}) {{"
                yield from (f"    {name} = {value};{comment}" for name, value, comment in variables)
                yield "}"

    def prepare(self) -> list[str]:
        """The rows computed once."""
        self.in_prepare, self.decisions = True, 0
        rows = [
            f"        p[{self.big}___{k} * n] = {self.code_of(node)[0]};" for node, k in self.prepared.items()
        ]
        self.in_prepare = False
        head = ["#if !defined PLANT_TANGENT && !defined PLANT_LANES && !defined PLANT_HELD"]
        head += [f"static inline void numbers_of_{self.prefix}(double *table, size_t n)", "{"]
        if not rows:
            return [*head, "    (void)table;", "    (void)n;", "}", "#endif"]
        return [
            *head,
            "    for (size_t k = 0; k < n; ++k) {",
            "        double *p = table + k;",
            *(["        Limiters l = { 0 };"] if any("&l," in row for row in rows) else []),
            *rows,
            "    }",
            "}",
            "#endif",
        ]

    def branch(self, order: Order, decided: dict[int, bool], depth: int) -> list[str]:
        """The lines in an order, or a choice between two."""
        pad = "    " * depth
        if order.bit is not None and order.yes is not None and order.no is not None:
            return [
                f"{pad}if (has & {hex(1 << order.bit)}u) {{",
                *self.branch(order.yes, decided | {order.bit: True}, depth + 1),
                f"{pad}}} else {{",
                *self.branch(order.no, decided | {order.bit: False}, depth + 1),
                f"{pad}}}",
            ]
        output, *also = self.device.outputs  # the network takes the latter from their states
        if order.loop:  # refused when the case is read
            return [f"{pad}TO(in->{output}, m, NUM(NAN));"]
        self.on = self.model.on(decided)
        self.decisions = 0  # of two orders only one is gone through
        needs = needs_of(self.model, order.lines, self.on)
        rows = list(
            self.where_needed(
                (self.needed(needs[name]), variable)
                for name in order.lines
                for variable in self.output_of(self.model.elements[name])
            )
        )
        rows += [f"TO(in->{output}, m, s_{output});", *(f"(void)s_{name};" for name in also)]
        rates = (rate for element in self.model.elements.values() for rate in self.rates_of(element))
        for condition, group in itertools.groupby(rates, key=operator.itemgetter(0)):
            inner = [row for _, row in group]
            rows += inner if condition == "1" else [f"if ({condition}) {{", *("    " + r for r in inner), "}"]
        self.most = max(self.most, self.decisions)
        return [pad + row for row in rows]

    def needed(self, need: Need) -> str:
        """C of where a line is needed."""
        if need.always:
            return "1"
        ones, zeros = (f"{hex(bits)}u" for bits in (need.ones, need.zeros))
        tests = [f"(has & {ones})"] if need.ones else []
        tests += [f"(has & {zeros}) != {zeros}"] if need.zeros else []
        return " || ".join(tests) or "0"

    def condition(self, condition: Condition) -> str:
        """C of a condition."""
        return "1" if condition is True else "0" if condition is False else self.bit(condition)

    def chosen(self, present: Condition, yes: str, no: str) -> str:
        """`yes` where a state is there, else `no`."""
        decided = self.on(present)
        if decided is not None or isinstance(present, bool):
            return yes if decided else no
        return f"{self.bit(present)} ? {yes} : {no}"

    def output_of(self, e: Element) -> Iterator[tuple[str, str, str]]:
        """The variables of a signal, their values and a comment."""
        name = e.line.name
        comment = _TEXT.sub(" ", e.line.comment).strip()
        comment = f"  /* {comment} */" if comment else ""
        if isinstance(e, Plain):
            yield f"s_{name}", self.num(resolved(self.device, e.u, self.on)), comment
            return
        value = getattr(self, f"{e.line.element}_output")(e)
        if e.is_limited:
            low, high = (
                self.num(Node("number", value=bare) if limit is None else limit)
                for limit, bare in zip(e.limits, (-1e30, 1e30), strict=True)
            )
            yield f"low_{name}", low, ""
            fixed = all(limit is None or self.device.constant(limit) for limit in e.limits)
            yield f"high_{name}", high if fixed else f"element_max({high}, low_{name})", ""
        if isinstance(e, Pi):
            yield f"whole_{name}", value, ""
            value = f"whole_{name}"
        if e.is_limited:
            dynamic = isinstance(e, Lag | Integrator)
            self.first[name] = self.allot(4 if dynamic or isinstance(e, Pi) else 2)
            call = f"limiter_{'state' if dynamic else 'clamp'}({self.bit_of(self.first[name])}, "
            value = f"{call}{value}, low_{name}, high_{name})"
        yield f"s_{name}", value, comment

    def rates_of(self, e: Element) -> Iterator[tuple[str, str]]:
        """The rates of a line's states, and the conditions under which these are there."""
        for state in e.states():
            if self.on(state.present) is False:
                continue
            guard = "1" if self.on(state.present) else self.condition(state.present)
            value = getattr(self, f"{e.line.element}_rate")(e, state.name)
            yield guard, f"PUT(dx, at_{state.name} + k, {value});"
            if e.is_limited and isinstance(e, Lag | Integrator):
                arguments = f"{self.bit_of(self.first[e.line.name])}, g, at_{state.name} + k"
                yield guard, f"LIMITER_ONTO({arguments}, low_{e.line.name}, high_{e.line.name});"

    # ------------------------------------------------------------ elements

    def lag_output(self, e: Element) -> str:
        return self.chosen(e.states()[0].present, f"x_{e.line.name}", self.times(e.K, e.u))

    def lag_rate(self, e: Element, x: str) -> str:
        name, per = e.line.name, self.constant(Node("per", (e.args[1],)))
        low, high = e.line.option("rate_min"), e.line.option("rate_max")
        u = self.times(e.K, e.u)
        if low is None and high is None:
            if not e.is_limited:
                return self.unless_frozen(e, f"({u} - x_{x}) * {per}")
            call = f"limiter_lag_rate({self.bit_of(self.first[name])}, {u}, x_{x}, low_{name}, high_{name})"
            return self.unless_frozen(e, f"{call} * {per}")
        bounds = ", ".join(self.num(bound) for bound in (low, high) if bound is not None)
        which = "min" if low is None else "max" if high is None else "clamp"
        call = self.deciding(which, 2 if which == "clamp" else 1)
        rate = f"{call}({u} - x_{x}) * {per}, {bounds})"
        return self.held(e, self.unless_frozen(e, rate), x, per)

    def unless_frozen(self, e: Element, rate: str) -> str:
        """C of a rate with the option freeze."""
        freeze = e.line.option("freeze")
        return rate if freeze is None else f"{rate} * (1.0 - {self.num(freeze)})"

    def held(self, e: Element, rate: str, x: str, per: str) -> str:
        name = e.line.name
        if not e.is_limited:
            return rate
        call = f"limiter_held_rate({self.bit_of(self.first[name])}, "
        return f"{call}{rate}, x_{x}, low_{name}, high_{name}, {per})"

    def integrator_output(self, e: Element) -> str:
        return f"x_{e.line.name}"

    def integrator_rate(self, e: Element, x: str) -> str:
        T = e.option("T", ONE)
        per: Node = ONE if T == ONE else Node("/", (ONE, T))
        gain = per if e.K == ONE else Node("*", (e.K, per))
        rate = self.num(e.u) if gain == ONE else f"{self.constant(gain)} * {self.num(e.u)}"
        return self.held(e, self.unless_frozen(e, rate), x, self.real(per))

    def real(self, node: Node) -> str:
        """C of a constant as a `real`, which a literal is not in lanes."""
        return f"REAL({self.constant(node)})" if node.op == "number" else self.constant(node)

    def leadlag_output(self, e: Element) -> str:
        name, ratio = e.line.name, self.constant(Node("*", (e.args[1], Node("per", (e.args[2],)))))
        u = self.times(e.K, e.u)
        return self.chosen(e.states()[0].present, f"x_{name} + ({u} - x_{name}) * {ratio}", u)

    def leadlag_rate(self, e: Element, x: str) -> str:
        return f"({self.times(e.K, e.u)} - x_{x}) * {self.constant(Node('per', (e.args[2],)))}"

    def washout_output(self, e: Element) -> str:
        u = self.num(e.u)
        high = f"({u} - x_{e.line.name})"
        if e.K != ONE:
            high = f"{self.constant(e.K)} * {high}"
        return self.chosen(e.states()[0].present, high, self.times(e.K, e.u))

    def washout_rate(self, e: Element, x: str) -> str:
        return f"({self.num(e.u)} - x_{x}) * {self.constant(Node('per', (e.args[1],)))}"

    def rate_output(self, e: Element) -> str:
        gain = self.constant(Node("*", (e.args[1], Node("per", (e.args[2],)))))
        return self.chosen(e.states()[0].present, f"({self.num(e.u)} - x_{e.line.name}) * {gain}", "NUM(0.0)")

    def rate_rate(self, e: Element, x: str) -> str:
        return f"({self.num(e.u)} - x_{x}) * {self.constant(Node('per', (e.args[2],)))}"

    def pi_output(self, e: Element) -> str:
        add, feedback = e.option("add", ZERO), e.option("feedback", ZERO)
        KP = self.constant(e.args[1])
        whole = f"{KP} * {self.num(e.u)}"
        if add != ZERO:
            whole += f" + {self.num(add)}"
        whole += f" + x_{e.line.name}"  # 0 where the state is not there
        if feedback == ZERO:
            return whole
        return f"num_ratio({whole}, 1.0 + {KP} * {self.num(feedback)})"

    def pi_rate(self, e: Element, x: str) -> str:
        name, feedback = e.line.name, e.option("feedback", ZERO)
        error = self.num(e.u)
        if feedback != ZERO:
            error = f"({error} - {self.num(feedback)} * s_{name})"
        rate = self.unless_frozen(e, f"{self.constant(e.args[2])} * {error}")
        if not e.is_limited:
            return rate
        call = f"limiter_pi_rate({self.bit_of(self.first[name] + 2)}, "
        return f"{call}{rate}, whole_{name}, low_{name}, high_{name})"

    def _filter(self, e: Element) -> tuple[str, str]:
        name, per = e.line.name, self.constant(Node("per", (e.args[2],)))
        slow = f"({self.num(e.u)} - x_{name})"
        return f"({slow} - {self.constant(e.args[1])} * x_{name}_rate) * {per}", slow

    def filter2_output(self, e: Element) -> str:
        name, (fast, slow) = e.line.name, self._filter(e)
        B1, B2 = (self.constant(b) for b in e.args[3:5])
        first, second = e.states()
        ratio = self.constant(Node("*", (e.args[3], Node("per", (e.args[1],)))))
        inner = self.chosen(first.present, f"x_{name} + {slow} * {ratio}", self.num(e.u))
        return self.chosen(second.present, f"x_{name} + {B1} * x_{name}_rate + {B2} * ({fast})", inner)

    def filter2_rate(self, e: Element, x: str) -> str:
        fast, slow = self._filter(e)
        if x.endswith("_rate"):
            return fast
        flat = f"{slow} * {self.constant(Node('per', (e.args[1],)))}"
        return self.chosen(e.states()[1].present, f"x_{x}_rate", flat)


def _wrapped(text: str, last: str) -> list[str]:
    rows, row = [], ""
    for word in text.split(" "):
        if len(row) + len(word) > 100:
            rows.append(row.rstrip())
            row = "       "
        row += word + " "
    return [*rows, row.rstrip(), last]
