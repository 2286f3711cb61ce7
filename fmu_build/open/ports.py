"""What a master needs to know of a model: its inputs and outputs with their units, and what it can do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from .units import UnitOf

Type = Literal["Real", "Integer", "Boolean"]
DLL_SUFFIXES = (".dll", ".so", ".dylib")  #: of IEEE/CIGRE DLLs, which take part beside FMUs


@dataclass(frozen=True)
class Port:
    """An input or output of a participant."""

    name: str
    type: Type = "Real"
    unit: UnitOf | None = None
    start: float = 0.0
    nominal: float = 1.0
    discrete: bool = False  #: changes at communication points only: held, never interpolated
    description: str = ""


@dataclass(frozen=True)
class Description:
    """Ports and abilities of a participant.

    feedthrough : output -> inputs whose present value it needs (direct dependence).
    initial_feedthrough : the same while initialising.
    input_order : highest derivative of an input it takes over a step; 0 = held inputs only.
    output_order : highest derivative of an output it offers.
    """

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    feedthrough: Mapping[str, frozenset[str]]
    initial_feedthrough: Mapping[str, frozenset[str]] = field(default_factory=dict)
    input_order: int = 0
    output_order: int = 0
    saves_state: bool = False
    variable_step: bool = True
    title: str = ""

    @property
    def input_of(self) -> dict[str, Port]:
        """Inputs by name."""
        return {p.name: p for p in self.inputs}

    @property
    def output_of(self) -> dict[str, Port]:
        """Outputs by name."""
        return {p.name: p for p in self.outputs}
