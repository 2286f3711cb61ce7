"""A linear system as plain matrices with names: what modes are read from, without python-control."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Matrix = npt.NDArray[np.float64]

#: 1/s: eigenvalues of a smaller modulus stand at 0 (`standing`), and a real part up to it is no growth
ZERO_EIGENVALUE = 1e-6


@dataclass(frozen=True)
class LinearMatrices:
    """dx/dt = A x + B u, y = C x + D u with the names that a `control.StateSpace` would have.

    A (n, n), B (n, m), C (p, n), D (p, m). output_start (p,) : the outputs at the operating point, in their
    own units; None where they are not known.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    state_labels: Sequence[str]
    input_labels: Sequence[str]
    output_labels: Sequence[str]
    output_start: Matrix | None = None

    @property
    def nstates(self) -> int:
        """The number n of states."""
        return len(self.state_labels)
