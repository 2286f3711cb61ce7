"""Run-time topics of the check: declared dependencies and directional derivatives against differences."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..open.description import ModelDescription, ScalarVariable, Unknown
from ..open.fmi2 import WARNING, Instance, Library
from .runs import Drive, Tell

_Vector = npt.NDArray[np.float64]
_MOST_KNOWNS = 200  #: larger FMUs are sampled evenly
_EPS = float(np.finfo(float).eps)
_ROUNDING = 1e-10  #: relative; changes below it are no dependency


@dataclass
class _Point:
    """An initialised instance whose knowns can be moved one at a time."""

    instance: Instance
    unknowns: list[ScalarVariable]
    declared: list[Unknown]
    knowns: list[ScalarVariable]
    states: list[ScalarVariable]
    x: _Vector
    u: dict[int, float]

    def at(self, known: ScalarVariable, change: float) -> _Vector | None:
        """Return the unknowns with one known moved from the point; None if the FMU takes no such value."""
        if known in self.states:
            x = self.x.copy()
            x[self.states.index(known)] += change
            self.instance.set_states(x)
            values = self.instance.get(self.unknowns)
            self.instance.set_states(self.x)
            return values
        if self.instance.set(known, self.u[known.index] + change) > WARNING:
            return None
        values = self.instance.get(self.unknowns)
        self.instance.set(known, self.u[known.index])
        return values

    def scale(self, known: ScalarVariable) -> float:
        """Usual size of a known."""
        local = self.x[self.states.index(known)] if known in self.states else self.u[known.index]
        return float(abs(known.number("nominal") or 0.0) or max(abs(local), 1.0))


def _points(library: Library) -> Iterator[_Point]:
    """At the start, and in co-simulation also after some steps."""
    for steps in (0, 3) if library.interface == "CoSimulation" else (0,):
        point = _point(library, steps)
        if point.unknowns:
            yield point
        point.instance.free()


def _point(library: Library, steps: int) -> _Point:
    d = library.d
    instance = library.fresh()
    drive = Drive(d)
    drive.start(instance)
    if steps:
        drive.run(instance, 0, steps)
    exchange = library.interface == "ModelExchange"
    declared = _declared(d, exchange=exchange)
    states = state_variables(d) if exchange else []
    x = instance.states(len(d.derivatives)) if exchange else np.empty(0)
    if len(states) != len(x):
        states, x = [], np.empty(0)
    inputs = _continuous_inputs(d)
    knowns = [*states, *inputs]
    if len(knowns) > _MOST_KNOWNS:
        knowns = [knowns[round(k)] for k in np.linspace(0, len(knowns) - 1, _MOST_KNOWNS)]
    u = dict(zip([v.index for v in inputs], instance.get(inputs), strict=True)) if inputs else {}
    by_index = {v.index: v for v in d.variables}
    return _Point(instance, [by_index[k.index] for k in declared], declared, knowns, states, x, u)


def _declared(d: ModelDescription, *, exchange: bool) -> list[Unknown]:
    """The unknowns that are real variables: derivatives, in model exchange only, and outputs."""
    types = {v.index: v.type for v in d.variables}
    derivatives = [u for u in d.derivatives if exchange and u.index in types]
    return [*derivatives, *(u for u in d.outputs if types.get(u.index) == "Real")]


def _continuous_inputs(d: ModelDescription) -> list[ScalarVariable]:
    kind = ("input", "Real", "continuous")
    return [v for v in d.variables if (v.causality, v.type, v.variability) == kind]


def state_variables(d: ModelDescription) -> list[ScalarVariable]:
    """Return the continuous states in the order of their derivatives."""
    by_index = {v.index: v for v in d.variables}
    variables = []
    for unknown in d.derivatives:
        of = by_index[unknown.index].typed.get("derivative", "") if unknown.index in by_index else ""
        if of.isdigit() and int(of) in by_index:
            variables.append(by_index[int(of)])
    return variables


def dependencies(library: Library, tell: Tell) -> None:
    """No output or derivative moves with a state or input that its dependencies leave out."""
    moved_by: dict[str, list[str]] = {}
    for point in _points(library):
        rest = point.instance.get(point.unknowns)
        for known in point.knowns:
            for sign in (1.0, -1.0):
                values = point.at(known, sign * 1e-3 * point.scale(known))
                if values is None:
                    continue
                for k, unknown in enumerate(point.declared):
                    if unknown.dependencies is None or known.index in unknown.dependencies:
                        continue
                    names = moved_by.setdefault(point.unknowns[k].name, [])
                    usual = max(abs(values[k]), abs(rest[k]), point.unknowns[k].number("nominal") or 0.0)
                    # a network solved by iteration from the last solution moves by rounding errors
                    if abs(values[k] - rest[k]) > _ROUNDING * usual and known.name not in names:
                        names.append(known.name)
    for name, names in moved_by.items():
        if names:
            tell(
                "FMI2 2.2.8 dependencies",
                name,
                f"moves with {', '.join(names[:5])}{' and others' if len(names) > 5 else ''}, "
                "which its dependencies leave out",
                "add them, or leave the attribute dependencies away (= depends on everything)",
            )


def directional(library: Library, tell: Tell) -> None:
    """fmi2GetDirectionalDerivative is the limit of differences."""
    if not library.d.flag(library.interface, "providesDirectionalDerivative"):
        return
    for point in _points(library):
        for known in point.knowns:
            message = point.instance.directional(point.unknowns, known)
            differences = _differences(lambda change: point.at(known, change), point.scale(known))  # noqa: B023
            if differences is None:
                continue
            slope, uncertainty = differences
            apart = np.abs(message - slope)
            wrong = ~(apart <= 1e-4 * np.maximum(np.abs(message), np.abs(slope)) + uncertainty)
            if np.any(wrong):
                k = int(np.argmax(np.where(wrong, np.nan_to_num(apart - uncertainty, nan=np.inf), -1.0)))
                tell(
                    "FMI2 2.1.9 directional derivative",
                    f"d {point.unknowns[k].name} / d {known.name}",
                    f"is {message[k]:.9g}, differences give {slope[k]:.9g}; {wrong.sum()} unknowns differ",
                    "correct the derivative, or do not declare providesDirectionalDerivative",
                )


def _differences(at: Callable[[float], _Vector | None], scale: float) -> tuple[_Vector, _Vector] | None:
    """Central differences with two steps: the finer one, and how far it may be off."""
    slopes, rounding = [], np.empty(0)
    for h in (1e-4 * scale, 5e-5 * scale):
        up, down = at(h), at(-h)
        if up is None or down is None:
            return None
        slopes.append((up - down) / (2.0 * h))
        rounding = 1e3 * _EPS * (np.abs(up) + np.abs(down) + 1e-3) / h
    return slopes[1], 10.0 * np.abs(slopes[0] - slopes[1]) + rounding
