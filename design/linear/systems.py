"""What is taken where a linear system is wanted: one check for every entrance.

Everything here works with dx/dt = A x + B u, y = C x + D u. A system in discrete time has the same four
matrices with another meaning, and nothing in them tells.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from interarea.models.arguments import kind_of
from interarea.models.errors import UserError

from .matrices import LinearMatrices

if TYPE_CHECKING:
    import control

#: A `control.StateSpace` in continuous time, or its matrices (A, B, C, D)
SystemLike: TypeAlias = "control.StateSpace | tuple[Any, Any, Any, Any]"

_EXPECTED = "wanted a control.StateSpace or its matrices (A, B, C, D)"
_ADVICE = {
    "TransferFunction": "control.ss(system) makes one",
    "dict": "control.ss(d['A'], d['B'], d['C'], d['D'])",
    "ndarray": "control.ss(A, B, C, D) with all four",
    "matrix": "control.ss(A, B, C, D) with all four",
}


class LinearSystemError(UserError):
    """What was given is no linear system in continuous time, or its matrices do not fit."""


def is_system(provided: object) -> bool:
    """Return whether a thing is meant as a linear system: a `StateSpace` or four matrices."""
    loaded = sys.modules.get("control")  # without it nothing is one, and loading it takes a second
    return _is_matrices(provided) or (loaded is not None and isinstance(provided, loaded.StateSpace))


def state_space(provided: object, what: str = "system") -> control.StateSpace:
    """Return a linear system in continuous time as a `StateSpace`; one that is given is returned itself.

    Parameters
    ----------
    provided : a `StateSpace`, or (A, B, C, D): arrays, numpy matrices or lists; the number 0 is D = 0.
    what : its name in messages.

    Raises
    ------
    LinearSystemError : another kind of thing, in discrete time, or with numbers that are not finite.
    """
    import control

    system = _of_matrices(provided, what) if _is_matrices(provided) else provided
    if not isinstance(system, control.StateSpace):
        raise LinearSystemError(f"{what}: is {kind_of(system)}, {_EXPECTED}{_advice(system)}")
    if system.isdtime(strict=True):
        step = "of no given length" if system.dt is True else f"= {system.dt:g} s"
        raise LinearSystemError(
            f"{what}: is in discrete time (dt {step}), wanted continuous: the model it was sampled from"
        )
    require_finite(system, what)
    return system


def require_finite(system: control.StateSpace | LinearMatrices, what: str) -> None:
    """Raise LinearSystemError where a matrix of a system holds a number that is not finite."""
    for name in ("A", "B", "C", "D"):
        if not np.all(np.isfinite(getattr(system, name))):
            raise LinearSystemError(f"{what}: {name} has numbers that are not finite")


def _advice(thing: object) -> str:
    known = type(thing).__module__.split(".")[0]
    if known == "scipy":
        return "; s = system.to_ss(); control.ss(s.A, s.B, s.C, s.D) makes one"
    message = _ADVICE.get(type(thing).__name__, "")
    return f"; {message}" if message else ""


def _is_matrices(provided: object) -> bool:
    """Whether it is four matrices: a list or tuple of arrays, lists or numbers, no names."""
    return (
        isinstance(provided, tuple | list)
        and len(provided) == 4
        and not any(isinstance(part, str) or callable(part) for part in provided)
    )


def _of_matrices(provided: Any, what: str) -> control.StateSpace:
    import control

    matrices = []
    for name, part in zip("ABCD", provided, strict=True):
        try:
            M = np.asarray(part)
            if np.iscomplexobj(M):
                raise LinearSystemError(f"{what}: {name} has complex numbers, wanted real ones")
            M = M.astype(float)
        except (TypeError, ValueError) as error:
            raise LinearSystemError(f"{what}: {name} is no matrix of numbers ({error})") from None
        matrices.append(M)
    B, C, D = matrices[1:]
    if D.ndim == 0 and D == 0.0 and B.ndim == C.ndim == 2:
        matrices[3] = np.zeros((C.shape[0], B.shape[1]))
    try:
        return control.ss(*matrices)
    except (TypeError, ValueError, control.ControlDimension) as error:
        shapes = ", ".join(f"{n} {M.shape}" for n, M in zip("ABCD", matrices, strict=True))
        raise LinearSystemError(
            f"{what}: the matrices do not fit ({shapes}): {error}; wanted A (n, n), B (n, m), C (p, n), "
            "D (p, m) or the number 0"
        ) from None
