"""A linear controller with limited outputs, as a block for the FMU builder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .variables import Block, Variable, VariableTable

Data = npt.NDArray[np.float64] | npt.NDArray[np.int32] | bytes
COURSE = "flow_course"  #: state of guards that follow a flow
SOURCE = Path(__file__).resolve().parents[1] / "c" / "controller" / "state_space.c"


@dataclass(frozen=True)
class Guard:
    """Which side of an output's limit falls while a first swing lasts.

    watched : output -> the input, a speed, that tells of the swing, or several, whose mean does: the guard
        goes on watching when one of them is lost.
    sides : output -> share of the limit that falls, above 0 of the upper one, below 0 of the lower one.
    threshold : deviation of the speed from its slow course at which that share has fallen, pu.
    washout_s, lowpass_s : time constants of that slow course and of letting go, s.
    follows : input, a power flow, with whose sign the sides turn: which side adds to a swing depends on which
        end of a tie sends. None: they stand.
    flow_pu : slow course of that flow at which the sides are whole.
    """

    watched: Mapping[str, str | Sequence[str]]
    sides: Mapping[str, float]
    threshold: float
    washout_s: float = 10.0
    lowpass_s: float = 1.0
    follows: str | None = None
    flow_pu: float = 0.1

    def signals(self, output: str) -> tuple[str, ...]:
        """Return the inputs whose mean the guard of an output watches."""
        seen = self.watched[output]
        return (seen,) if isinstance(seen, str) else tuple(seen)

    @property
    def seen(self) -> set[str]:
        """All inputs that are watched."""
        return {signal for output in self.watched for signal in self.signals(output)}

    def weights(self, inputs: Sequence[str], outputs: Sequence[str]) -> npt.NDArray[np.float64]:
        """Return the weight (outputs, inputs) of each input in what is watched; no guard: a row of zeros."""
        table = np.zeros((len(outputs), len(inputs)))
        for row, y in enumerate(outputs):
            for signal in self.signals(y) if y in self.watched else ():
                table[row, inputs.index(signal)] = 1.0 / len(self.signals(y))
        return table

    def in_pu(self, omega_b: float) -> Guard:
        """Return it as an FMU has it, from a threshold in rad/s: in the unit of the speeds that come in."""
        return replace(self, threshold=self.threshold / omega_b)

    def check(self, name: str, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        """Raise ValueError where the guard does not fit a controller with these inputs and outputs."""
        strange = [*(set(self.watched) - set(outputs)), *(self.seen - set(inputs))]
        empty = [y for y in self.watched if not self.signals(y)]
        if strange or empty or not self.watched or set(self.sides) != set(self.watched):
            raise ValueError(
                f"controller {name}: guard watches {dict(self.watched)} with sides {dict(self.sides)}, "
                f"allowed: outputs of {list(outputs)}, inputs of {list(inputs)}, the same outputs in both"
            )
        if self.follows is not None and self.follows not in inputs:
            raise ValueError(
                f"controller {name}: guard follows {self.follows!r}, allowed: inputs of {list(inputs)}"
            )
        for what, value in (
            ("threshold", self.threshold),
            ("washout_s", self.washout_s),
            ("lowpass_s", self.lowpass_s),
            ("flow_pu", self.flow_pu),
        ):
            if not (value > 0.0 and np.isfinite(value)):
                raise ValueError(f"controller {name}: guard {what} is {value}, allowed: above 0")
        if not all(-1.0 <= side <= 1.0 for side in self.sides.values()):
            raise ValueError(f"controller {name}: guard sides are {dict(self.sides)}, allowed: -1 to 1")


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


def guard_record(guard: Guard, inputs: Sequence[str], outputs: Sequence[str]) -> dict[str, Data]:
    """Return what of the inputs the guard of each output watches, and which input is the flow."""
    record: dict[str, Data] = {"guard": guard.weights(inputs, outputs).ravel()}
    if guard.follows is not None:
        record["guard.follows"] = np.array([inputs.index(guard.follows)], dtype=np.int32)
    return record


def guard_states(guard: Guard | None, outputs: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Names of the two filter states of each guarded output, in the order of the outputs."""
    guarded = [] if guard is None else [y for y in outputs if y in guard.watched]
    return {y: (f"{y}_slow_course", f"{y}_swing") for y in guarded}


def guard_variables(guard: Guard, filters: Mapping[str, tuple[str, str]]) -> list[Variable]:
    """Return the states of guards, then as many derivatives. filters : as `guard_states` gives them."""
    states, derivatives = [], []
    for y, (slow, swing) in filters.items():
        signals = guard.signals(y)
        watched = signals[0] if len(signals) == 1 else f"the mean of {', '.join(signals)}"
        for state, what, seen in (
            (slow, f"Low pass of {watched}, subtracted by the guard of {y}", (slow, *signals)),
            (swing, f"Low pass of {watched} after that subtraction", (slow, swing, *signals)),
        ):
            states.append(Variable(state, "state", what, unit="pu", start=0.0))
            derivatives.append(
                Variable(
                    f"der({state})",
                    "derivative",
                    f"Derivative of {state}",
                    unit="1/s",
                    derivative_of=state,
                    depends_on=seen,
                )
            )
    if guard.follows is not None:
        what = f"Low pass of {guard.follows}, whose sign selects the sides of the guards"
        # a start value would be overwritten with the flow at rest
        states.append(Variable(COURSE, "state", what, unit="pu", start=0.0))
        derivatives.append(
            Variable(
                f"der({COURSE})",
                "derivative",
                f"Derivative of {COURSE}",
                unit="1/s",
                derivative_of=COURSE,
                depends_on=(COURSE, guard.follows),
            )
        )
    return [*states, *derivatives]


def guard_parameters(guard: Guard | None, outputs: Sequence[str]) -> list[Variable]:
    """Return the parameters of a guard, in the order in which the block reads them."""
    if guard is None:
        return []
    rows = [
        (
            f"guard_side[{k + 1}]",
            guard.sides[y],
            f"{y}: share by which the upper (+) or lower (-) limit is reduced",
            "1",
        )
        for k, y in enumerate(y for y in outputs if y in guard.watched)
    ]
    rows += [
        ("guard_threshold", guard.threshold, "Speed deviation of the full reduction", "pu"),
        ("guard_washout", guard.washout_s, "Time constant of the low pass that is subtracted", "s"),
        ("guard_lowpass", guard.lowpass_s, "Time constant with which the limit is restored", "s"),
    ]
    if guard.follows is not None:
        text = f"Low-passed {guard.follows} at which the sides apply fully; below 0 they are reversed"
        rows.append(("guard_flow", guard.flow_pu, text, "pu"))
    return [
        Variable(
            name,
            "parameter",
            text,
            unit=unit,
            start=float(value),
            min=-1.0 if name.startswith("guard_side") else 0.0,
            max=1.0 if name.startswith("guard_side") else None,
            tunable=True,
        )
        for name, value, text, unit in rows
    ]


_GUARD_EQUATIONS = (
    "<p>The guard of an output uses a speed s, or the mean of several: "
    "dw/dt = (s &minus; w) / guard_washout, "
    "dl/dt = (s &minus; w &minus; l) / guard_lowpass, q = min(1, max(|s &minus; w|, |l|) / guard_threshold). "
    "With guard_side above 0 the upper limit is limit (1 &minus; q guard_side), with it below 0 the "
    "lower one is &minus;limit (1 + q guard_side): no control in the direction of a first swing.</p>"
)
_TURNING = (
    "<p>The sides follow the low-passed flow c of a flow f, which starts at the flow in equilibrium: "
    "dc/dt = (f &minus; c) / guard_washout, each guard_side times max(&minus;1, min(1, c / guard_flow)).</p>"
)


def guard_equations(guard: Guard | None) -> str:
    """Return the paragraphs of an FMU's documentation on its guard; nothing without one."""
    if guard is None:
        return ""
    return _GUARD_EQUATIONS + ("" if guard.follows is None else _TURNING)


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
