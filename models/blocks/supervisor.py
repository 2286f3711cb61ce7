"""A bank of controllers in hot standby behind a supervisor, as a block for the FMU builder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .controller import (
    Data,
    Guard,
    _internal_step_s,
    guard_equations,
    guard_parameters,
    guard_record,
    guard_states,
    guard_variables,
)
from .variables import Block, Variable, VariableTable

SOURCE = Path(__file__).resolve().parents[1] / "c" / "controller" / "supervisor.c"
MAX_SIGNALS = 6  #: as in supervisor.c
MAX_BANK = 16  #: as in supervisor.c

Array = npt.NDArray[np.float64]
Matrices = tuple[Array, Array, Array, Array]


def supervisor_block(
    name: str,
    bank: Mapping[str, Matrices],
    choice: Sequence[str],
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    limit: float = 0.15,
    fade_s: float = 0.05,
    loss_s: float = 0.0,
    return_s: float = 1.0,
    dwell_s: float = 0.0,
    guard: Guard | None = None,
    extra: Mapping[str, Array] | None = None,
    documentation: Mapping[str, str] | None = None,
    provenance: Mapping[str, str] | None = None,
) -> Block:
    """Return the block of `bank`: all controllers run, the validity of the signals says whose output counts.

    Each signal has a Boolean input ``SIGNAL_valid`` (true where nothing is connected). ``active`` (1 = the
    first of the bank) and ``switches`` are outputs; the times and the limit are parameters.

    Parameters
    ----------
    name : model name, a C identifier.
    bank : controller name -> A (n, n), B (n, m), C (p, n), D (p, m) in pu; n may differ and be 0.
    choice : name of the controller for each set of trusted signals; bit j of the position = signal j is
        there.
    inputs, outputs : m signals and p actuators, all of every controller.
    limit : pu. fade_s : time constant of the bumpless transfer, 0 = at once.
    loss_s, return_s : how long a flag must be down, or up again, before it is believed. dwell_s : least time
        between two switches.
    guard : which side of an output's limit falls while a first swing lasts; None: neither.
    extra : arrays that go into the FMU's resource file beside the bank (a Lyapunov matrix).
    documentation, provenance : see `Block`.

    Raises
    ------
    ValueError : sizes that do not fit, names that are not known, times or limits out of range, a guard of
        signals that are not there, or one that follows a flow.
    """
    times = {"fade_time": fade_s, "loss_time": loss_s, "return_time": return_s, "dwell_time": dwell_s}
    _check_sizes(name, bank, choice, len(inputs), len(outputs))
    _check_numbers(name, times, limit)
    if guard is not None:
        guard.check(name, inputs, outputs)
        if guard.follows is not None:
            raise ValueError(f"supervisor {name}: its guard follows {guard.follows!r}, allowed: none")
    names = list(bank)
    data: dict[str, Data] = {
        "orders": np.array([len(K[0]) for K in bank.values()], dtype=np.int32),
        "choice": np.array([names.index(c) for c in choice], dtype=np.int32),
        **{letter: _stacked([K[k] for K in bank.values()]) for k, letter in enumerate("ABCD")},
        **({} if guard is None else guard_record(guard, inputs, outputs)),
        **(extra or {}),
    }
    fastest = [_internal_step_s(K[0]) for K in bank.values()]
    return Block(
        kind="supervisor",
        name=name,
        description=f"Bank of {len(bank)} controllers in hot standby, selected by the valid signals",
        table=VariableTable(
            [
                *_state_variables(bank, choice, inputs, guard, outputs),
                *_port_variables(bank, inputs, outputs, guard),
                *_parameters(times, limit),
                *guard_parameters(guard, outputs),
                *_flags(names, inputs),
            ]
        ),
        data=data,
        sources=(SOURCE,),
        internal_step_s=min([*fastest, 0.1 * fade_s] if fade_s > 0.0 else fastest),
        model_exchange=False,  # flags are looked at where steps begin; model exchange has no steps
        documentation={"Equations": _EQUATIONS + guard_equations(guard), **(documentation or {})},
        provenance=dict(provenance or {}),
    )


_TIMES = {
    "fade_time": "Time constant of the bumpless transfer",
    "loss_time": "Time for which a flag must be false before its signal counts as lost",
    "return_time": "Time for which a flag must be true before its signal is used again",
    "dwell_time": "Least time between two switches",
}

_EQUATIONS = (
    "<p>Every controller runs on the signals v<sub>j</sub> = m<sub>j</sub> u<sub>j</sub>; the output is "
    "&Sigma; w<sub>i</sub> y<sub>i</sub>, limited. Weights w and trust m follow their targets with the time "
    "constant <code>fade_time</code>, so nothing jumps when the active controller changes. A wrong signal "
    "with a valid flag is not detected; it is used unchanged.</p>"
)


def _check_sizes(name: str, bank: Mapping[str, Matrices], choice: Sequence[str], m: int, p: int) -> None:
    if not 1 <= m <= MAX_SIGNALS or not 1 <= len(bank) <= MAX_BANK:
        raise ValueError(
            f"supervisor {name}: {m} signals and {len(bank)} controllers, allowed are 1 to {MAX_SIGNALS} "
            f"and 1 to {MAX_BANK}"
        )
    if len(choice) != 2**m or not set(choice) <= set(bank):
        raise ValueError(
            f"supervisor {name}: choice has {len(choice)} entries {sorted(set(choice))}, wanted {2**m} "
            f"names out of {', '.join(bank)}"
        )
    for who, matrices in bank.items():
        _check(name, who, matrices, m, p)


def _check_numbers(name: str, times: Mapping[str, float], limit: float) -> None:
    for key, value in {**times, "limit": limit}.items():
        if not (value >= 0.0 and np.isfinite(value)) or (key == "limit" and not value > 0.0):
            raise ValueError(f"supervisor {name}: {key} is {value}, allowed are finite, not negative values")


def _states(bank: Mapping[str, Matrices], inputs: Sequence[str]) -> tuple[list[str], list[str], list[str]]:
    """Return the names of the controllers' states, of their weights and of the signals' weights."""
    states = [f"{who}.x[{k + 1}]" for who, K in bank.items() for k in range(len(K[0]))]
    return states, [f"{who}.weight" for who in bank], [f"{signal}_trust" for signal in inputs]


def _state_variables(
    bank: Mapping[str, Matrices],
    choice: Sequence[str],
    inputs: Sequence[str],
    guard: Guard | None,
    outputs: Sequence[str],
) -> Iterator[Variable]:
    states, weights, masks = _states(bank, inputs)
    own = [] if guard is None else guard_variables(guard, guard_states(guard, outputs))
    own = [replace(variable, depends_on=None) for variable in own]  # guards watch what is trusted of a signal
    for s in states:
        yield Variable(s, "state", "State of a controller of the bank", start=0.0)
    for s, who in zip(weights, bank, strict=True):  # the flags start up: the choice for all signals is active
        yield Variable(s, "state", "Weight of a controller in the output", start=float(who == choice[-1]))
    for s in masks:
        yield Variable(s, "state", "Weight of a signal, 0 when not trusted", start=1.0)
    yield from own[: len(own) // 2]
    for s in (*states, *weights, *masks):
        yield Variable(f"der({s})", "derivative", f"Derivative of {s}", unit="1/s", derivative_of=s)
    yield from own[len(own) // 2 :]


def _port_variables(
    bank: Mapping[str, Matrices], inputs: Sequence[str], outputs: Sequence[str], guard: Guard | None
) -> Iterator[Variable]:
    for u in inputs:
        yield Variable(u, "input", f"Measured signal {u}", unit="pu", start=0.0)
    direct = any(np.any(K[3]) for K in bank.values())
    filters = guard_states(guard, outputs)
    for y in outputs:
        watched = () if guard is None or y not in filters else guard.signals(y)
        through = inputs if direct else watched
        own = (s for group in _states(bank, inputs) for s in group)
        depends_on = (*own, *filters.get(y, ()), *through)
        text = f"Control signal {y}, limited to plus or minus `limit`"
        yield Variable(y, "output", text, unit="pu", depends_on=depends_on)


def _parameters(times: Mapping[str, float], limit: float) -> Iterator[Variable]:
    text = "Bound of the magnitude of every output"
    yield Variable("limit", "parameter", text, unit="pu", start=float(limit), min=0.0, tunable=True)
    for key, value in times.items():
        yield Variable(key, "parameter", _TIMES[key], unit="s", start=float(value), min=0.0)


def _flags(names: Sequence[str], inputs: Sequence[str]) -> Iterator[Variable]:
    for u in inputs:
        yield Variable(f"{u}_valid", "input", f"Whether {u} arrives", type="Boolean", start=True)
    yield Variable(
        "active", "output", "Active controller: " + _numbered(names), type="Integer", depends_on=()
    )
    yield Variable("switches", "output", "Switches since the start", type="Integer", depends_on=())


def _numbered(names: Sequence[str]) -> str:
    return ", ".join(f"{k} {name}" for k, name in enumerate(names, start=1))


def _stacked(matrices: Sequence[Array]) -> Array:
    return np.concatenate([np.asarray(M, dtype=np.float64).ravel() for M in matrices])


def _check(name: str, who: str, matrices: Matrices, m: int, p: int) -> None:
    n = len(matrices[0])
    for letter, M, shape in zip("ABCD", matrices, ((n, n), (n, m), (p, n), (p, m)), strict=True):
        if np.shape(M) != shape or not np.all(np.isfinite(M)):
            raise ValueError(
                f"supervisor {name}: {letter} of {who} has shape {np.shape(M)}, wanted finite {shape}"
            )
