"""A linear controller with limited outputs, as a block for the FMU builder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .guard import (
    COURSE,
    Guard,
    guard_equations,
    guard_parameters,
    guard_record,
    guard_states,
    guard_variables,
)
from .variables import Block, Variable, VariableTable

SOURCE = Path(__file__).resolve().parents[1] / "c" / "controller" / "state_space.c"


def _state_variables(states: Sequence[str], inputs: Sequence[str]) -> list[Variable]:
    """Return the states and their derivatives."""
    numbered = list(enumerate(states, start=1))
    variables = [Variable(s, "state", f"State {i} of the controller", start=0.0) for i, s in numbered]
    return variables + [
        Variable(
            f"der({s})",
            "derivative",
            f"Derivative of state {i}",
            unit="1/s",
            derivative_of=s,
            depends_on=(*states, *inputs),
        )
        for i, s in numbered
    ]


def controller_block(
    name: str,
    A: npt.ArrayLike,
    B: npt.ArrayLike,
    C: npt.ArrayLike,
    D: npt.ArrayLike,
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    limit: float = 0.15,
    guard: Guard | None = None,
    documentation: Mapping[str, str] | None = None,
    provenance: Mapping[str, str] | None = None,
) -> Block:
    r"""Return the block :math:`\dot x = A x + B u,\ y = \mathrm{clip}(C x + D u, \pm limit)`.

    The entries of the matrices become fixed FMI parameters ``A[1,1]``..``D[p,m]``.
    Outputs depend on the inputs only where an entry of D is not zero, so with
    D = 0 no master sees an algebraic loop; such an entry cannot be set to
    anything else afterwards.

    Parameters
    ----------
    name : model name, a C identifier.
    A, B, C, D : (n, n), (n, m), (p, n), (p, m), 1/s and pu per pu.
    inputs, outputs : m and p names; signals in pu, actuators in pu.
    limit : pu, bound of the magnitude of every output.
    guard : which side of an output's limit falls while a first swing lasts; None: neither.
    documentation, provenance : see `Block`.

    Raises
    ------
    ValueError : shapes that do not fit, entries that are not finite, a limit that is not positive, or a
        guard of outputs and inputs that are not there.
    """
    n, m, p = _square(name, A), len(inputs), len(outputs)
    matrices = {
        "A": _matrix(name, "A", A, n, n),
        "B": _matrix(name, "B", B, n, m),
        "C": _matrix(name, "C", C, p, n),
        "D": _matrix(name, "D", D, p, m),
    }
    if not (limit > 0 and np.isfinite(limit)):
        raise ValueError(f"controller {name}: limit is {limit}, allowed are positive finite values in pu")
    if guard is not None:
        guard.check(name, inputs, outputs)
    states = [f"x[{i + 1}]" for i in range(n)]
    variables = _state_variables(states, inputs)
    filters = guard_states(guard, outputs)
    own = [] if guard is None else guard_variables(guard, filters)
    half, extra = len(variables) // 2, len(own) // 2
    variables = [*variables[:half], *own[:extra], *variables[half:], *own[extra:]]
    variables += [Variable(u, "input", f"Measured signal {u}", unit="pu", start=0.0) for u in inputs]
    variables += [
        Variable(
            y,
            "output",
            f"Control signal {y}, limited to plus or minus `limit`",
            unit="pu",
            depends_on=_seen_by(y, (*states, *_nonzero(matrices["D"][i], inputs)), guard, filters),
        )
        for i, y in enumerate(outputs)
    ]
    for letter, matrix in matrices.items():
        variables += [_entry(letter, i, j, float(value)) for (i, j), value in np.ndenumerate(matrix)]
    variables.append(
        Variable(
            "limit",
            "parameter",
            "Bound of the magnitude of every output",
            unit="pu",
            start=float(limit),
            min=0.0,
            tunable=True,
        )
    )
    variables += guard_parameters(guard, outputs)
    return Block(
        kind="controller",
        name=name,
        description=f"Linear controller of order {n} with outputs limited to +-{limit:g} pu",
        table=VariableTable(variables),
        data={} if guard is None else guard_record(guard, inputs, outputs),
        sources=(SOURCE,),
        internal_step_s=_internal_step_s(matrices["A"]),
        documentation={
            "Equations": _EQUATIONS + guard_equations(guard),
            **(documentation or {}),
        },
        provenance=dict(provenance or {}),
    )


def with_trust(block: Block) -> Block:
    """Return the block of a controller with an input ``SIGNAL_trusted`` for each: where false it takes 0."""
    signals = [v.name for v in block.table.of_role("input")]
    flags = {s: f"{s}_trusted" for s in signals}
    table = [_dependent(v, flags) for v in block.table]
    table += [
        Variable(flag, "input", f"Whether {s} is trusted", type="Boolean", start=True)
        for s, flag in flags.items()
    ]
    return replace(block, table=VariableTable(table))


def _dependent(v: Variable, flags: Mapping[str, str]) -> Variable:
    """Return a variable that depends on the flags of the signals that it depends on."""
    seen = v.depends_on or ()
    return replace(v, depends_on=(*seen, *(flags[s] for s in seen if s in flags))) if seen else v


def _seen_by(
    y: str, linear: tuple[str, ...], guard: Guard | None, filters: Mapping[str, tuple[str, str]]
) -> tuple[str, ...]:
    """What an output depends on: the filters and the watched signal of its guard too."""
    if guard is None or y not in filters:
        return linear
    turning = () if guard.follows is None else (COURSE,)
    return tuple(dict.fromkeys((*linear, *filters[y], *turning, *guard.signals(y))))


_EQUATIONS = (
    "<p>dx/dt = A x + B u, y = min(max(C x + D u, &minus;limit), limit). "
    "The matrices are the parameters <code>A[i,j]</code> .. <code>D[i,j]</code>.</p>"
)


def _internal_step_s(A: npt.NDArray[np.float64]) -> float:
    """Longest Runge-Kutta step, s: a tenth of the fastest time constant, at most 2 ms."""
    fastest = float(np.max(np.abs(np.linalg.eigvals(A)))) if A.size else 0.0
    return min(2e-3, 0.1 / fastest) if fastest > 0 else 2e-3


def _entry(letter: str, i: int, j: int, value: float) -> Variable:
    """Parameter of one matrix entry; a zero of D is a promise to masters and stays zero."""
    bound = 0.0 if letter == "D" and value == 0.0 else None
    return Variable(
        f"{letter}[{i + 1},{j + 1}]",
        "parameter",
        f"Entry of the matrix {letter}",
        start=value,
        min=bound,
        max=bound,
    )


def _square(name: str, A: npt.ArrayLike) -> int:
    shape = np.shape(A)
    if len(shape) != 2 or shape[0] != shape[1]:
        raise ValueError(
            f"controller {name}: A has shape {shape}, it must be square (0 by 0 for a static gain)"
        )
    return int(shape[0])


def _matrix(name: str, letter: str, value: npt.ArrayLike, rows: int, columns: int) -> npt.NDArray[np.float64]:
    matrix = np.asarray(value, dtype=np.float64)
    if matrix.shape != (rows, columns):
        raise ValueError(f"controller {name}: {letter} has shape {matrix.shape}, wanted ({rows}, {columns})")
    if not np.all(np.isfinite(matrix)):
        raise ValueError(f"controller {name}: {letter} has entries that are not finite")
    return matrix


def _nonzero(row: npt.NDArray[np.float64], names: Sequence[str]) -> tuple[str, ...]:
    return tuple(name for value, name in zip(row, names, strict=True) if value != 0.0)
