"""The one list of FMI variables of a block, and the block itself as the FMU builder receives it.

Value references are positions in this list, separately for Reals and for
everything stored as an integer (Integer, Enumeration, Boolean):

* Reals: states, derivatives, inputs, outputs, locals, parameters;
* integers: inputs, outputs, locals, parameters.

The C side (`block/block.h`, `BlockLayout`) counts in the same order.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

Role = Literal["state", "derivative", "input", "output", "local", "parameter"]
Type = Literal["Real", "Integer", "Boolean", "Enumeration"]

REAL_ROLES: tuple[Role, ...] = ("state", "derivative", "input", "output", "local", "parameter")
INTEGER_ROLES: tuple[Role, ...] = ("input", "output", "local", "parameter")

#: Units a variable may carry; `pu` and `1` are dimensionless. The FMU builder knows their SI base.
UNITS = ("1", "pu", "pu/s", "s", "1/s", "rad", "rad/s", "rad/s2", "Hz", "Hz/s", "deg")


#: Name of the parameter by which a block lets its user choose the longest step of its integration.
STEP_PARAMETER = "solver.step"


@dataclass(frozen=True)
class Enumeration:
    """A named set of integer values, e.g. what a channel does on loss."""

    name: str
    items: tuple[tuple[str, int, str], ...]  #: (item, value, description)


@dataclass(frozen=True)
class Variable:
    """One FMI variable. `depends_on` (outputs and derivatives): names of states and inputs; None = all."""

    name: str
    role: Role
    description: str
    type: Type = "Real"
    unit: str = "1"
    display_unit: str | None = None
    start: float | int | bool | None = None
    nominal: float | None = None
    min: float | None = None
    max: float | None = None
    tunable: bool = False
    derivative_of: str | None = None
    enumeration: Enumeration | None = None
    depends_on: tuple[str, ...] | None = None


class VariableTable:
    """Variables in the order of their value references; names are unique."""

    def __init__(self, variables: list[Variable]) -> None:
        reals = [v for role in REAL_ROLES for v in variables if v.role == role and v.type == "Real"]
        integers = [v for role in INTEGER_ROLES for v in variables if v.role == role and v.type != "Real"]
        self.reals: tuple[Variable, ...] = tuple(reals)
        self.integers: tuple[Variable, ...] = tuple(integers)
        if len(reals) + len(integers) != len(variables):
            bad = [v.name for v in variables if v not in reals and v not in integers]
            raise ValueError(f"variables: {bad} have a role their type does not allow")
        self._check()

    def _check(self) -> None:
        """Raise ValueError for names, units, start values or derivatives that no FMU could have."""
        names = [v.name for v in self]
        twice = sorted({n for n in names if names.count(n) > 1}) if len(set(names)) != len(names) else []
        if twice:
            raise ValueError(f"variables: names used twice: {twice}")
        for v in self:
            if v.unit not in UNITS:
                raise ValueError(f"variables: {v.name} has unit {v.unit!r}, allowed: {', '.join(UNITS)}")
            if v.role in ("state", "input", "parameter") and v.start is None:
                raise ValueError(f"variables: {v.name} is a {v.role} and needs a start value")
        states = [v.name for v in self.of_role("state")]
        derivatives = [v.derivative_of for v in self.of_role("derivative")]
        if states != derivatives:
            raise ValueError("variables: derivatives must follow the states one by one, in their order")

    def __iter__(self) -> Iterator[Variable]:
        yield from self.reals
        yield from self.integers

    def __getitem__(self, name: str) -> Variable:
        return self._by_name[name]

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    @cached_property
    def _by_name(self) -> dict[str, Variable]:
        return {v.name: v for v in self}

    @cached_property
    def _reference(self) -> dict[str, int]:
        pairs = [(v.name, k) for group in (self.reals, self.integers) for k, v in enumerate(group)]
        return dict(pairs)

    def value_reference(self, name: str) -> int:
        """Return the FMI value reference of variable `name`."""
        return self._reference[name]

    def of_role(self, role: Role, *, integers: bool = False) -> tuple[Variable, ...]:
        """Return the Real (or, with `integers`, the integer-like) variables of one role, in order."""
        return tuple(v for v in (self.integers if integers else self.reals) if v.role == role)

    def layout(self) -> npt.NDArray[np.int32]:
        """Return the nine counts of `BlockLayout` in its order."""
        counts = [len(self.of_role(role)) for role in REAL_ROLES if role != "derivative"]
        counts += [len(self.of_role(role, integers=True)) for role in INTEGER_ROLES]
        return np.array(counts, dtype=np.int32)

    def start_reals(self) -> npt.NDArray[np.float64]:
        """Return the start value of every Real by value reference (0 where none is declared)."""
        return np.array([0.0 if v.start is None else float(v.start) for v in self.reals])

    def start_integers(self) -> npt.NDArray[np.int32]:
        """Return the start value of every integer-like variable by value reference."""
        return np.array([0 if v.start is None else int(v.start) for v in self.integers], dtype=np.int32)


@dataclass(frozen=True)
class Block:
    """Everything the FMU builder needs: which C, which variables, which numbers.

    `data` goes into `resources/model.bin` beside what the builder adds itself
    (``layout``, ``start.real``, ``start.integer``, ``guid``).
    """

    kind: str  #: "plant", "controller", "channel", ...: one generic binary per kind
    name: str  #: model name, a C identifier; also the file name
    description: str
    table: VariableTable
    data: Mapping[str, npt.NDArray[np.float64] | npt.NDArray[np.int32] | bytes]
    sources: tuple[Path, ...]  #: C files; headers are found beside them
    step_s: float = 0.01  #: communication step of the DefaultExperiment
    stop_s: float = 20.0
    #: longest Runge-Kutta step inside a communication step of a block without `solver.step`; None: 1 ms
    internal_step_s: float | None = None
    model_exchange: bool = True
    event_indicators: int = 0  #: of model exchange: decisions that the block's C counts (`n_decisions`)
    documentation: Mapping[str, str] = field(default_factory=dict)  #: heading -> HTML fragment
    provenance: Mapping[str, str] = field(default_factory=dict)  #: source, case hash, method

    def __post_init__(self) -> None:
        if self.internal_step_s is not None and STEP_PARAMETER in self.table:
            raise ValueError(
                f"block {self.name}: internal_step_s = {self.internal_step_s:g}, allowed: None, because its "
                f"parameter {STEP_PARAMETER} says how long its steps are; give that another start value"
            )

    @property
    def longest_step_s(self) -> float:
        """Longest Runge-Kutta step inside a communication step, s: the start of `solver.step` if any."""
        if STEP_PARAMETER in self.table:
            return float(self.table[STEP_PARAMETER].start or 0.0)
        return 0.001 if self.internal_step_s is None else self.internal_step_s
