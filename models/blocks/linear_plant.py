"""What a design needs of a plant: names, an operating point, derivatives, exact Jacobians."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@runtime_checkable
class Plant(Protocol):
    """A continuous-time plant dx/dt = f(x, u), y = g(x, u) with named states, inputs and outputs.

    An open FMU is one; so is any object a test writes down by hand.
    """

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the n states."""

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the m inputs."""

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the p outputs."""

    def operating_point(self) -> tuple[Array, Array]:
        """Return the equilibrium (x0, u0), shapes (n,) and (m,)."""

    def derivatives(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return (dx, y) at (x, u), shapes (n,) and (p,)."""

    def jacobians(self, x: Array | None = None, u: Array | None = None) -> tuple[Array, Array, Array, Array]:
        """Return exact (A, B, C, D) at (x, u), by default at the operating point."""
