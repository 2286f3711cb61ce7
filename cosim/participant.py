"""What the master needs of anything it steps: an FMU, or a model written in Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

Type = Literal["Real", "Integer", "Boolean"]


@dataclass(frozen=True)
class UnitOf:
    """A unit by FMI 2.0: exponents of kg, m, s, A, K, mol, cd, rad, and base = factor value + offset."""

    name: str
    exponents: tuple[int, ...] | None = None  #: None: the FMU names the unit without defining it
    factor: float = 1.0
    offset: float = 0.0


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
        return {p.name: p for p in self.inputs}

    @property
    def output_of(self) -> dict[str, Port]:
        return {p.name: p for p in self.outputs}


class Participant(Protocol):
    """One instance in a run. Numbers pass through the buffers `u`, `du`, `y`, `dy`.

    u[i] : value of bound input i; du[3 i + k - 1] : its k-th derivative (k = 1..3).
    y[j] : value of output j in the order of the description; dy[m] : slope of the m-th bound slope.
    Integers and Booleans travel as floats.
    """

    name: str
    description: Description
    u: Any
    du: Any
    y: Any
    dy: Any

    def bind(self, inputs: Sequence[str], slopes: Sequence[str]) -> None:
        """Fix which inputs will be sent and of which outputs slopes will be asked; makes the buffers."""

    def begin(self, start_s: float, stop_s: float) -> None:
        """Instantiate or reset, set start values, enter initialisation."""

    def ready(self) -> None:
        """Leave initialisation."""

    def send(self, order: int) -> None:
        """Set the bound inputs from `u`, and their derivatives up to `order` from `du`."""

    def advance(self, time_s: float, length_s: float) -> None:
        """Do one step; raises StepError."""

    def receive(self, slopes: bool) -> None:
        """Fill `y`, and `dy` if `slopes`."""

    def save(self) -> Any:
        """Return a copy of the state."""

    def restore(self, state: Any) -> None:
        """Go back to a saved state."""

    def release(self, state: Any) -> None:
        """Free a saved state."""

    def last_log(self) -> str:
        """Return the last line the instance logged, or an empty string."""

    def close(self) -> None:
        """End the instance and free what it holds."""
