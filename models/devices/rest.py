"""Start values: each line gives one equation; those with one unknown are turned round until none is left.

Limits are left out on the way (a clamp or gate passes the argument that leads on) and checked at the end.
What stays coupled is torn: one unknown is bracketed, and found by Brent's method.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from ..errors import BeyondLimit, DeviceError
from .gates import crossed, holding, led_on, spelled_out
from .instance import Instance, Margin
from .language.device import BASES
from .language.element import Equation, resolved
from .language.elements import Plain
from .language.expression import Node, evaluate, folded
from .language.structure import Model

STILL = 1e-8  #: largest rate at rest, pu/s, relative to the size of the state
_CURE = "change the parameters in it or the dispatch"
_GRID = [10.0 ** (k / 8) for k in range(-32, 33)]


class _Stuck(Exception):
    """An expression that cannot be turned round."""


BEYOND = -1e-9  #: by rounding a signal may lie that far beyond a limit, relative to it


@dataclass(frozen=True)
class RestPoint:
    """A device at rest."""

    instance: Instance  #: its values hold the references and what was computed
    states: tuple[float, ...]
    signals: Mapping[str, float]
    margins: tuple[Margin, ...]
    steps: tuple[str, ...]  #: how the unknowns were found, in order

    @property
    def output(self) -> float:
        """Output at rest."""
        return float(self.signals[self.instance.model.device.output])


def rest_of(
    model: Model, values: Mapping[str, float | str], inputs: Mapping[str, float], output: float | None,
    who: str, *, check: bool = True, room: float = BEYOND,
) -> RestPoint:  # fmt: skip
    """Return the device at rest with `inputs` and, when it has references, with `output`.

    values : parameters, MBASE and FBASE among them; one that equals its `computed.when` is computed. `who`
    names the device in errors.  check : refuse a rest beyond a limit; room : nearer
    to one than this, relative to the signal, is beyond it.

    Raises
    ------
    DeviceError : a check between parameters fails, no rest is found, or it lies beyond a limit (`BeyondLimit`
        where one limit is to blame).
    """
    device = model.device
    known = {name: value for name, value in values.items() if not isinstance(value, str)} | dict(inputs)
    at_rest = dict(known) | ({} if output is None else {device.output: output})
    steps: list[str] = []
    for name, rule in device.computed.items():
        if values[name] == rule.when:
            known[name] = at_rest[name] = float(evaluate(rule.value, at_rest))
            steps.append(f"{name} = {rule.value}")
    parameters = {name: float(known[name]) for name in (*device.by_name, *BASES)}
    for check_ in device.checks:
        if not evaluate(check_.node, parameters):
            parts = ", ".join(f"{n} = {parameters[n]:g}" for n in dict.fromkeys(check_.node.names))
            raise DeviceError(f"{who}: {parts}{check_.says}")
    for name, node in device.fixed:
        parameters[name] = known[name] = float(evaluate(node, at_rest))
    walk = _Walk(model, Instance(model, parameters), known, output, who, steps)
    walk.solve()
    return _checked(walk, parameters, inputs, who, check=check, room=room)


class _Walk:
    """The equations at rest while they are solved."""

    def __init__(
        self, model: Model, instance: Instance, known: dict[str, float], output: float | None, who: str,
        steps: list[str],
    ) -> None:  # fmt: skip
        self.model, self.instance, self.who = model, instance, who
        self.known: dict[str, float] = dict(known)
        self.steps = steps
        self.equations: list[Equation] = []
        for name, element in model.elements.items():
            start = element.line.option("rest")
            if start is not None and any(instance.on(s.present) for s in element.states()):
                self.equations.append(Equation(Node("name", name=name), start, name))
            elif isinstance(element, Plain):
                self.equations.append(Equation(Node("name", name=name), element.u, name))
            else:
                self.equations.append(element.at_rest(instance.on))
        # with choices by parameters taken an equation can be turned, where else a root is looked for
        taken = [resolved(model.device, e.right, instance.on) for e in self.equations]
        self.equations = [replace(e, right=right) for e, right in zip(self.equations, taken, strict=True)]
        if output is not None and model.device.references:
            self.known[model.device.output] = output
        self.unknown = set(model.elements) | set(model.device.references)
        self.unknown -= set(self.known)

    def solve(self) -> None:
        """Find every unknown."""
        while True:
            plan = self.plan(set(self.known), set(range(len(self.equations))))
            for k, name in plan:
                self.take(k, name, self.known)
                self.steps.append(self.story(k, name))
            used = {k for k, _ in plan}
            self.unknown -= {name for _, name in plan}
            left = [k for k in range(len(self.equations)) if k not in used]
            # one without an unknown, as theta of a source is given, is checked at the end
            self.equations = [self.equations[k] for k in left if not self.names(k) <= set(self.known)]
            if not self.unknown:
                return
            self.tear()

    def plan(self, known: set[str], left: set[int]) -> list[tuple[int, str]]:
        """Equations in an order in which each has one unknown; forward ones first."""
        result: list[tuple[int, str]] = []
        free = {k: self.names(k) - known for k in sorted(left)}
        while True:
            choice: tuple[int, str] | None = None
            for k, unknown in free.items():
                if len(unknown) == 1:
                    name = next(iter(unknown))
                    if name == self.equations[k].left.name and name not in self.equations[k].right.names:
                        choice = (k, name)
                        break
                    choice = choice or (k, name)
            if choice is None:
                return result
            result.append(choice)
            del free[choice[0]]
            for unknown in free.values():
                unknown.discard(choice[1])

    def names(self, k: int) -> set[str]:
        """Names in equation `k`."""
        return {*self.equations[k].left.names, *self.equations[k].right.names}

    def story(self, k: int, name: str) -> str:
        """How equation `k` gave `name`."""
        e = self.equations[k]
        return f"{name} from {e.left} = {e.right}" if str(e.left) != name else f"{name} = {e.right}"

    def take(self, k: int, name: str, known: dict[str, float]) -> None:
        """Put the value of `name` from equation `k` into `known`."""
        e = self.equations[k]
        known[name] = self.value_of(e, name, known)

    def value_of(self, e: Equation, name: str, known: dict[str, float]) -> float:
        """Value of `name` from equation `e`."""
        sides = [side.names.count(name) for side in (e.left, e.right)]
        if sum(sides) == 1:
            inner, outer = (e.left, e.right) if sides[0] else (e.right, e.left)
            try:
                return _turned(inner, name, float(evaluate(outer, known)), known)
            except _Stuck:
                pass
        root = _root_of(e, name, known)
        if root is None:  # a gate may hold it: the rest without gates lets `_check_gates` name which
            free = replace(e, left=led_on(e.left, name), right=led_on(e.right, name))
            root = None if free == e else _root_of(free, name, known)
        if root is None:
            raise DeviceError(
                f"{self.who}: no equilibrium value of {name} satisfies {e.left} = {e.right}; {_CURE}"
            )
        return root

    def tear(self) -> None:
        """Find one unknown so that what it leads to fits, by bracketing."""
        left = set(range(len(self.equations)))
        for name in [n for n in self.model.elements if n in self.unknown] + sorted(self.unknown):
            plan = self.plan(set(self.known) | {name}, left)
            reached = set(self.known) | {name} | {result for _, result in plan}
            closing = [k for k in sorted(left - {k for k, _ in plan}) if self.names(k) <= reached]
            if not closing:
                continue

            def residual(
                z: float, name: str = name, plan: list[tuple[int, str]] = plan, k: int = closing[0]
            ) -> float:
                trial = self.known | {name: z}
                try:
                    for at, target in plan:
                        self.take(at, target, trial)
                except DeviceError:
                    return math.nan
                return _residual(self.equations[k], trial)

            value = _root(residual)
            if value is not None:
                self.known[name] = value
                self.unknown.discard(name)
                self.steps.append(f"{name} so that {self.story(closing[0], '')[6:]}")
                del self.equations[closing[0]]
                return
        raise DeviceError(f"{self.who}: no equilibrium value for {', '.join(sorted(self.unknown))}; {_CURE}")


def _root_of(e: Equation, name: str, known: Mapping[str, float]) -> float | None:
    values = {other: value for other, value in known.items() if other != name}
    short = replace(e, left=folded(e.left, values), right=folded(e.right, values))

    def residual(z: float) -> float:
        values[name] = z
        return _residual(short, values)

    return _root(residual)


def _residual(e: Equation, known: Mapping[str, float]) -> float:
    return float(evaluate(e.left, known)) - float(evaluate(e.right, known))


def _root(f: Callable[[float], float]) -> float | None:
    """A zero of `f`: the first change of sign on a grid, positive numbers before negative ones."""
    for grid in ([0.0, *_GRID], [0.0, *(-g for g in _GRID)]):
        before: tuple[float, float] | None = None
        for z in grid:
            try:
                value = f(z)
            except (ZeroDivisionError, ValueError, OverflowError):
                value = math.nan
            if value == 0.0:
                return float(z)
            if math.isfinite(value):
                if before is not None and (value > 0.0) != (before[1] > 0.0):
                    from scipy.optimize import brentq  # takes 0.2 s; few devices have a loop at rest

                    return float(brentq(f, before[0], z, xtol=1e-300, rtol=8.9e-16))
                before = (z, value)
    return None


def _turned(node: Node, name: str, value: float, known: Mapping[str, float]) -> float:
    """Value of `name` for which `node` has `value`; _Stuck where that is not to be told."""
    if node.op == "name":
        return value
    k = next(k for k, part in enumerate(node.args) if name in part.names)
    turn = _TURNED.get(node.op)
    if turn is None:
        raise _Stuck
    inner = turn(value, k, lambda j: float(evaluate(node.args[j], known)))
    return _turned(node.args[k], name, inner, known)


Other = Callable[[int], float]  #: values of the other arguments


def _turned_deadband(value: float, k: int, other: Other) -> float:
    if k != 0:
        raise _Stuck
    return value + math.copysign(other(1), value) if value else 0.0


def _turned_clamp(value: float, k: int, _: Other) -> float:
    if k != 0:
        raise _Stuck
    return value


def _turned_pick(value: float, k: int, other: Other) -> float:
    if k == 0 or bool(other(0)) != (k == 1):
        raise _Stuck
    return value


def _turned_power(value: float, _: int, other: Other) -> float:
    if value < 0.0:
        raise _Stuck
    return float(value ** (1.0 / other(1)))


def _turned_exp(value: float, _: int, __: Other) -> float:
    if not value > 0.0:
        raise _Stuck
    return math.log(value)


#: operation -> its argument k from its value and the other arguments
_TURNED: dict[str, Callable[[float, int, Other], float]] = {
    "+": lambda value, k, other: value - other(1 - k),
    "-": lambda value, k, other: value + other(1) if k == 0 else other(0) - value,
    "*": lambda value, k, other: _over(value, other(1 - k)),
    "/": lambda value, k, other: value * other(1) if k == 0 else _over(other(0), value),
    "neg": lambda value, k, other: -value,
    "min": lambda value, k, other: value,
    "max": lambda value, k, other: value,
    "clamp": _turned_clamp,
    "deadband": _turned_deadband,
    "pick": _turned_pick,
    "**": _turned_power,
    "exp": _turned_exp,
    "sqrt": lambda value, k, other: value * value,
}


def _over(a: float, b: float) -> float:
    if b == 0.0:
        raise _Stuck
    return a / b


def _checked(
    walk: _Walk,
    parameters: dict[str, float],
    inputs: Mapping[str, float],
    who: str,
    *,
    check: bool,
    room: float,
) -> RestPoint:
    model, known = walk.model, walk.known
    values = parameters | {name: float(known[name]) for name in model.device.references}
    instance = Instance(model, values)
    starts: dict[str, float] = {}
    for element in model.elements.values():
        starts |= element.start(dict(known), instance.on)
    states = tuple(float(starts[name]) for name in instance.state_names)
    bad = [name for name, value in (starts | known).items() if not math.isfinite(value)]
    if bad:
        raise DeviceError(
            f"{who}: {bad[0]} is {(starts | known)[bad[0]]} at the equilibrium; set gains and limits in "
            "it to other "
            "than 0, or change the dispatch"
        )
    margins = tuple(instance.margins(known))
    if check:
        for margin in margins:
            if isinstance(model.elements[margin.signal], Plain):  # a clamp may rest at its limit
                if margin.low <= known[margin.signal] <= margin.high:
                    continue
                margin = replace(margin, value=known[margin.signal])
            _check_margin(margin, model, who, room)
        _check_still(walk, instance, states, inputs, who)
    signals = {name: float(known[name]) for name in model.elements}
    return RestPoint(instance, states, signals, margins, tuple(walk.steps))


def _check_margin(margin: Margin, model: Model, who: str, room: float) -> None:
    if margin.low == margin.value == margin.high:  # on purpose: a control that is switched off
        return
    room *= max(1.0, abs(margin.value))
    for sign, limit, text, word in (
        (1.0, margin.high, margin.high_text, "above"),
        (-1.0, margin.low, margin.low_text, "below"),
    ):
        if text and not sign * (limit - margin.value) >= room:
            name = f"{margin.signal} ({margin.text})" if margin.text else margin.signal
            to = "at least" if sign > 0.0 else "at most"
            known = {p.name for p in model.device.parameters}
            what = f"{text} = {limit:.6g}" if not _is_number(text) else f"{limit:.6g}"
            if text in known:
                cure = f"set {text} to {to} {margin.value:.6g} or change the dispatch"
            else:
                cure = _CURE if not _is_number(text) else "change the dispatch"
            raise BeyondLimit(
                f"{who}: {name} is {margin.value:.6g} at the equilibrium, {word} {what}; {cure}",
                signal=margin.signal, value=margin.value, limit=text, above=sign > 0.0,
            )  # fmt: skip


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _check_still(
    walk: _Walk, instance: Instance, states: tuple[float, ...], inputs: Mapping[str, float], who: str
) -> None:
    signals, rates = instance.run(states, inputs)
    for name, element in walk.model.elements.items():
        expected, got = walk.known[name], float(signals[name])
        if not abs(expected - got) <= 1e-8 * max(1.0, abs(expected)):
            limits = str(element.u) if isinstance(element, Plain) else str(element.line.node)
            word = "above" if expected > got else "below"
            _check_gates(walk, name, who)
            raise DeviceError(
                f"{who}: {name} is {expected:.6g} at the equilibrium, {word} {limits} = {got:.6g}; change "
                "the parameters in it or the dispatch"
            )
    for name, value, rate in zip(instance.state_names, states, rates, strict=True):
        if not abs(rate) <= STILL * max(1.0, abs(value)) * _stiffness(instance, name):
            moves = f"its value is {value:.6g}, its rate {float(rate):.3g} 1/s"
            what = f"{who}: {name} is not constant at the equilibrium: {moves}"
            if name not in walk.model.elements:
                raise DeviceError(what)
            _check_gates(walk, name, who)
            _check_crossed(walk, name, what)
            raise DeviceError(
                f"{what}; change the parameters in {walk.model.elements[name].u} or the dispatch"
            )


def _check_crossed(walk: _Walk, name: str, what: str) -> None:
    """Refuse what sets a signal going that waits at rest: another one beyond the level where it does."""
    u = walk.model.elements[name].u
    beyond = crossed(u, walk.model, {**walk.instance.values, **walk.known})
    if beyond is not None:
        level = f"{beyond.limit} = {float(evaluate(beyond.limit, walk.instance.values)):.6g}"
        raise BeyondLimit(
            f"{what}, as {beyond.value:.6g} is {'above' if beyond.above else 'below'} {level}; {_CURE}",
            signal=name, value=beyond.value, limit=str(beyond.limit), above=beyond.above,
        )  # fmt: skip


def _check_gates(walk: _Walk, name: str, who: str) -> None:
    """Refuse a gate or clamp before `name` that passes something else than the rest needs."""
    element = walk.model.elements[name]
    if element.line.option("rest") is not None:
        return
    if isinstance(element, Plain):
        e = Equation(Node("name", name=name), element.u, name)
    else:
        e = element.at_rest(walk.instance.on)
    hold = holding(e, walk.known)
    if hold is not None:
        passed = float(evaluate(hold.limit, walk.known))
        spelled = spelled_out(hold.limit, walk.model)
        what = f"{hold.limit} = {spelled}" if spelled != hold.limit else str(spelled)
        raise BeyondLimit(
            f"{who}: {name} is {walk.known[name]:.6g} at the equilibrium, but {what} = {passed:.6g} keeps it "
            f"{'below' if hold.above else 'above'}; change the parameters in it or the dispatch",
            signal=name, value=hold.value, limit=str(hold.limit), above=hold.above,
        )  # fmt: skip


def _stiffness(instance: Instance, name: str) -> float:
    """1/T of a state: its rate is the difference of two numbers over T."""
    state = next(s for s in instance.states if s.name == name)
    if state.time is None:
        return 1.0
    time = float(evaluate(state.time, instance.values))
    return max(1.0, 1.0 / time) if time > 0.0 else 1.0
