"""How a master may be told to step: the values of a scenario's [master] table, no more."""

from __future__ import annotations

from typing import Any, Literal, get_args

#: how inputs are handed over: polynomials with slopes, lines, or held
Inputs = Literal["hermite", "linear", "hold-jacobi", "hold-gauss-seidel"]
INPUTS: tuple[Inputs, ...] = get_args(Inputs)

#: what is done with a loop without a channel
Loops = Literal["auto", "iterate", "extrapolate"]
LOOPS: tuple[Loops, ...] = get_args(Loops)

#: what follows when an FMU returns early from a step, see `early_return`
Early = Literal["continue", "roll back"]
EARLY: tuple[Early, ...] = get_args(Early)


def early_word(value: Any) -> Any:
    """Return the value of `early` as it is now called: 0.1 wrote "go on" for "continue"."""
    return "continue" if value == "go on" else value
