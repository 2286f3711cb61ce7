"""Guards: which side of an output's limit falls while a first swing lasts (models/c/controller/guard.h)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from .variables import Variable

Data = npt.NDArray[np.float64] | npt.NDArray[np.int32] | bytes
COURSE = "flow_course"  #: state of guards that follow a flow


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
            (slow, f"Slow course of {watched}, which the guard of {y} takes off", (slow, *signals)),
            (swing, f"Low pass of what is left of {watched}", (slow, swing, *signals)),
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
        what = f"Slow course of {guard.follows}, with whose sign the sides of the guards turn"
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
            f"{y}: share of the upper (+) or lower (-) limit that falls",
            "1",
        )
        for k, y in enumerate(y for y in outputs if y in guard.watched)
    ]
    rows += [
        ("guard_threshold", guard.threshold, "Speed deviation at which that share has fallen whole", "pu"),
        ("guard_washout", guard.washout_s, "Time constant of the slow course that is taken off", "s"),
        ("guard_lowpass", guard.lowpass_s, "Time constant with which the guard lets go", "s"),
    ]
    if guard.follows is not None:
        text = f"Slow course of {guard.follows} at which the sides are whole; below 0 they are turned"
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
    "<p>An output with a guard watches a speed s, or the mean of several: "
    "dw/dt = (s &minus; w) / guard_washout, "
    "dl/dt = (s &minus; w &minus; l) / guard_lowpass, q = min(1, max(|s &minus; w|, |l|) / guard_threshold). "
    "Where its guard_side is above 0 the upper limit is limit (1 &minus; q guard_side), where it is below 0 "
    "the lower one &minus;limit (1 + q guard_side): no control on the side that adds to a first swing.</p>"
)
_TURNING = (
    "<p>The sides turn with the slow course c of a flow f, which starts at the flow at rest: "
    "dc/dt = (f &minus; c) / guard_washout, each guard_side times max(&minus;1, min(1, c / guard_flow)).</p>"
)


def guard_equations(guard: Guard | None) -> str:
    """Return the paragraphs of an FMU's documentation on its guard; nothing without one."""
    if guard is None:
        return ""
    return _GUARD_EQUATIONS + ("" if guard.follows is None else _TURNING)
