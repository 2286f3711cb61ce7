"""A linear system as plain matrices with names: what modes are read from, without python-control."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import control

Matrix = npt.NDArray[np.float64]

#: 1/s: eigenvalues of a smaller modulus stand at 0 (`standing`), and a real part up to it is no growth
ZERO_EIGENVALUE = 1e-6
#: rad/s: a root that is slower may be one at 0, whose computed value has the root of the rounding error
_SLOW = 1e-2


def decays(roots: npt.ArrayLike) -> bool:
    """Return whether a loop with these roots (1/s) is stable: no swing grows or persists, nothing else grows.

    A root at 0, of a common speed or angle that nothing brings back, is allowed.

    >>> decays([-0.1 + 4j, 2e-7]), decays([-0.1, 2e-7 + 4j]), decays([2e-6])
    (True, False, False)
    """
    values = np.atleast_1d(np.asarray(roots, dtype=complex))
    limit = np.where(np.abs(values.imag) > _SLOW, 0.0, ZERO_EIGENVALUE)
    return bool(np.all(values.real < limit))


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

    @classmethod
    def of(cls, system: control.StateSpace) -> LinearMatrices:
        """Return the matrices and names of a system of python-control."""
        A, B, C, D = (np.asarray(M, dtype=float) for M in (system.A, system.B, system.C, system.D))
        return cls(A, B, C, D, system.state_labels, system.input_labels, system.output_labels)

    @classmethod
    def named(
        cls, A: Matrix, B: Matrix, C: Matrix, D: Matrix, inputs: Sequence[str], outputs: Sequence[str]
    ) -> LinearMatrices:
        """Return matrices with the names of states that python-control gives by itself."""
        return cls(A, B, C, D, [f"x[{k}]" for k in range(len(A))], list(inputs), list(outputs))

    def state_space(self, name: str) -> control.StateSpace:
        """Return this as a system of python-control, which takes a second to load."""
        import control

        labels = {"states": self.state_labels, "inputs": self.input_labels, "outputs": self.output_labels}
        return control.ss(self.A, self.B, self.C, self.D, **labels, name=name)
