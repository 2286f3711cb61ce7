"""The linear loop in the few numbers from which a page finds every eigenvalue with exact delay.

The transfer function from actuator a to output i is d_ia + sum_j c_ij b_ja / (s - l_j): one eigenproblem
per operating point and per controller, and none while a slider moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from interarea.design.linear.linearise import LinearisationError

if TYPE_CHECKING:
    import control

ComplexMatrix = npt.NDArray[np.complex128]
_AT = 3j  #: 1/s, amid the swing modes: here both forms of the transfer function must agree
_AGREES = 1e-9


def modal(system: control.StateSpace, inputs: Sequence[str], outputs: Sequence[str]) -> dict[str, Any]:
    """Return `system` between `inputs` and `outputs` in modal form, as JSON values.

    Returns
    -------
    dict with ``poles`` (1/s, [re, im], only those with im >= 0), ``c`` ([output][pole]), ``b``
    ([input][pole]) and ``d`` ([output][input]); the conjugate of a complex pole has conjugate c and b.

    Raises
    ------
    LinearisationError : eigenvectors so nearly parallel that this form would be wrong.
    """
    rows = [list(system.output_labels).index(name) for name in outputs]
    columns = [list(system.input_labels).index(name) for name in inputs]
    A, B, C = (np.asarray(M, dtype=float) for M in (system.A, system.B[:, columns], system.C[rows]))
    D = np.asarray(system.D, dtype=float)[np.ix_(rows, columns)]
    poles, right = np.linalg.eig(A)
    try:
        left = np.linalg.inv(right)
    except np.linalg.LinAlgError:
        left = np.full_like(right, np.nan)
    c, b = C @ right, left @ B
    _check(A, B, C, poles, c, b)
    upper = np.flatnonzero(poles.imag >= 0.0)
    return {
        "poles": [_pair(z, 15) for z in poles[upper]],
        "c": [[_pair(z, 10) for z in row] for row in c[:, upper]],
        "b": [[_pair(z, 10) for z in row] for row in b[upper].T],
        "d": D.tolist(),
    }


def _check(A: Any, B: Any, C: Any, poles: ComplexMatrix, c: ComplexMatrix, b: ComplexMatrix) -> None:
    if not (len(A) and B.shape[1] and C.shape[0]):
        return
    direct = C @ np.linalg.solve(_AT * np.eye(len(A)) - A, B)
    modal_form = (c / (_AT - poles)) @ b
    error = float(np.max(np.abs(direct - modal_form)) / max(float(np.max(np.abs(direct))), 1e-300))
    if not error <= _AGREES:
        raise LinearisationError(
            f"eigenvectors of the linear model are nearly parallel: its transfer function at {_AT} 1/s "
            f"differs by {error:.1e} in modal form, allowed {_AGREES:g}; the page cannot show eigenvalues"
        )


def _pair(z: complex, digits: int) -> list[float]:
    return [float(f"{z.real:.{digits}g}"), float(f"{z.imag:.{digits}g}")]
