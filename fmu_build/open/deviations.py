"""What breaks the standard in a modelDescription.xml: harmless and put right, or in a master's way.

Harmless is what leaves inputs, outputs and parameters clear: a unit without definition is a name, an
unknown variability is the default, a dependency on a variable that is not there is one on every input.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from .description import ModelDescription, ScalarVariable, Unknown

CAUSALITY = ("calculatedParameter", "independent", "input", "local", "output", "parameter")
VARIABILITY = ("constant", "continuous", "discrete", "fixed", "tunable")
_SET = {"input", "parameter"}
_USED = {*_SET, "output"}
Tell = Callable[[str], None]


def mended(
    d: ModelDescription, interface: str, number: Callable[[str], float | None]
) -> tuple[ModelDescription, tuple[str, ...], str]:
    """Return a description as it can be used, what was put right in it, and what cannot be ("" if all can).

    number : the value of a start text, None where it is none.
    """
    reported: list[str] = []
    seen: dict[str, ScalarVariable] = {}
    variables = []
    for v in d.variables:
        trouble = _trouble(v, seen, number)
        if trouble:
            return d, tuple(reported), trouble
        seen.setdefault(v.name, v)
        variables.append(_usable(v, d, number, reported.append))
    count = len(variables)
    trouble = _state_trouble(d, variables) if interface == "ModelExchange" else ""
    used = replace(
        d,
        variables=tuple(variables),
        outputs=tuple(_placed(d.outputs, count, reported.append)),
        derivatives=tuple(_placed(d.derivatives, count, reported.append)),
        initial_unknowns=tuple(_placed(d.initial_unknowns, count, reported.append)),
    )
    return used, tuple(reported), trouble


def _where(v: ScalarVariable) -> str:
    return f'variable "{v.name[:80]}" (line {v.line})'


def _trouble(
    v: ScalarVariable, seen: dict[str, ScalarVariable], number: Callable[[str], float | None]
) -> str:
    """Return what leaves ambiguous which variable is meant, what it is for, or what it starts from."""
    if v.causality not in CAUSALITY:
        return f'{_where(v)} has causality "{v.causality[:40]}", allowed: {", ".join(CAUSALITY)}'
    twin = seen.get(v.name)
    used = v.causality in _USED
    if (not v.name and used) or (twin is not None and (used or twin.causality in _USED)):
        return f"{_where(v)} has no name of its own"
    if used and (not v.type or v.reference < 0):
        return f"{_where(v)} has no {'type' if not v.type else 'valueReference'}"
    if v.causality in _SET and v.type != "String" and v.start is not None and number(v.start) is None:
        return f"{_where(v)} has the start value {v.start[:40]!r}, which is no number"
    return ""


def _usable(
    v: ScalarVariable, d: ModelDescription, number: Callable[[str], float | None], tell: Tell
) -> ScalarVariable:
    """Return a variable with what stands against the standard replaced by what it can only mean."""
    if v.variability not in VARIABILITY or (v.variability == "constant" and v.causality in _SET):
        default = _default_variability(v)
        tell(f'{_where(v)} has variability "{v.variability[:40]}", taken as {default}')
        v = replace(v, variability=default)
    if not v.type or v.reference < 0 or not v.name:
        tell(f"{_where(v)} lacks name, type or valueReference, left out")
    if v.unit is not None and v.unit not in d.units:
        tell(f'{_where(v)}: the unit "{v.unit[:40]}" is not defined, taken as a name')
    if v.start is not None and v.type not in ("", "String") and number(v.start) is None:
        tell(f"{_where(v)} has the start value {v.start[:40]!r}, left out")
        v = replace(v, typed={k: text for k, text in v.typed.items() if k != "start"})
    return v


def _default_variability(v: ScalarVariable) -> str:
    if v.causality == "parameter":
        return "fixed"
    return "continuous" if v.type == "Real" else "discrete"


def _placed(unknowns: tuple[Unknown, ...], count: int, tell: Tell) -> Iterator[Unknown]:
    """Entries of ModelStructure that point to variables there are."""
    for u in unknowns:
        if not 1 <= u.index <= count:
            tell(f"ModelStructure names variable {u.index} of {count}, left out")
        elif not all(1 <= k <= count for k in u.dependencies or ()):
            tell(f"ModelStructure: variable {u.index} depends on no variable, taken as on all inputs")
            yield Unknown(u.index, None)
        else:
            yield u


def _state_trouble(d: ModelDescription, variables: list[ScalarVariable]) -> str:
    """Return what leaves ambiguous which variables the continuous states are."""
    count = len(variables)
    for u in d.derivatives:
        if not 1 <= u.index <= count:
            return f"ModelStructure names variable {u.index} as a derivative; there are {count}"
        state = variables[u.index - 1].typed.get("derivative", "")
        if not state.isdecimal() or len(state) > 9 or not 1 <= int(state) <= count:
            return f"{_where(variables[u.index - 1])} is a derivative of variable {state[:20]!r} of {count}"
    return ""
