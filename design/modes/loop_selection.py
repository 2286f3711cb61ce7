"""Selection of actuator and signal: controllability and observability of a mode in each loop.

The geometric index of the literature,
|b^T w| |c v| / (|b| |w| |c| |v|), changes with the scaling of the states: in mixed units it is
meaningless. Loops are therefore ranked by the product of the mode's normalised pole vectors, which is
invariant to state coordinates; the geometric index is given too, in stated coordinates.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray

from interarea.models.case.tables import swing_name

from ..linear.linearise import select
from ..linear.norms import frequency_response
from ..reduction.balanced import balanced_truncation
from .modes import Mode, ModeError

Matrix = NDArray[np.float64]
_DRIVEN = re.compile(r"_vs$|_[vxpq]_mod(_from|_to)?$")


@dataclass(frozen=True)
class Loop:
    r"""One candidate: a signal fed back to an actuator.

    Attributes
    ----------
    actuator, signal : such as ``G4_vs`` and ``dw24``.
    index : controllability * observability, 0..1; the ranking criterion.
    controllability : \|w b_j\| / \|w B\|, the actuator's part in the mode's input pole vector.
    observability : \|c_i v\| / \|C v\|, the signal's part in the mode's output pole vector.
    residue : (c v)(w b), unit of the signal per unit of the actuator and second; its angle is the
        phase that a controller must compensate.
    geometric : the geometric index in the coordinates stated by `Loops.coordinates`.
    outputs : the signal as weights of plant outputs.
    """

    actuator: str
    signal: str
    index: float
    controllability: float
    observability: float
    residue: complex
    geometric: float
    outputs: Mapping[str, float]


@dataclass(frozen=True)
class Loops:
    """Ranked candidates for one mode, best first."""

    mode: str
    ranking: tuple[Loop, ...]
    coordinates: str

    @property
    def selected(self) -> Loop:
        """The best loop."""
        return self.ranking[0]


def difference_signals(areas: Mapping[str, int]) -> dict[str, dict[str, float]]:
    """Speed differences of all machine pairs in different areas, with names such as ``dw24`` (G2 minus G4).

    areas : machine name -> area. Machines called G1..G9 give ``dw24``, others ``dw_NAME_NAME``.
    """
    signals: dict[str, dict[str, float]] = {}
    for a, b in combinations(areas, 2):
        if areas[a] == areas[b]:
            continue
        signals[swing_name(a, b)] = {f"{a}_dw": 1.0, f"{b}_dw": -1.0}
    return signals


def actuators_of(inputs: Sequence[str]) -> list[str]:
    """Return the inputs of a plant for a controller: those of exciters and of devices at buses.

    >>> actuators_of(["G1_vs", "svc1_v_mod", "vsc1_q_mod_from", "torque"])
    ['G1_vs', 'svc1_v_mod', 'vsc1_q_mod_from']
    """
    return [name for name in inputs if _DRIVEN.search(name)]


def require_actuator(names: Sequence[str]) -> None:
    """Reject a plant without an input for a controller."""
    if not names:
        raise ModeError(
            "no machine has an exciter that takes a signal (an input *_vs) and no bus an SVC or STATCOM "
            "(*_v_mod), no line a series capacitor (*_x_mod), and there is no dc link or converter "
            "(*_p_mod, *_q_mod), so no loop can be closed; add an exciter that regulates to a machine"
        )


def rank_loops(
    system: control.StateSpace,
    mode: Mode,
    *,
    signals: Mapping[str, Mapping[str, float]] | None = None,
    areas: Mapping[str, int] | None = None,
    actuators: list[str] | None = None,
    own_machine: bool = True,
    order: int = 6,
    least: float = 1e-9,
) -> Loops:
    r"""Rank actuators and signals by controllability and observability of a mode.

    With :math:`A v = \lambda v,\ w^T A = \lambda w^T,\ w^T v = 1` the loop from actuator j to signal i
    has the residue :math:`R_{ij} = (c_i v)(w^T b_j)`, and the index is

    .. math:: \frac{|w^T b_j|}{\|w^T B\|} \cdot \frac{|c_i v|}{\|C v\|} = \frac{|R_{ij}|}{\|R\|_F},

    taken over all actuators and signals of the call: invariant to the scaling of states and eigenvectors.

    Parameters
    ----------
    system : the full plant without reference angle, speeds in one unit.
    mode : the mode to damp, of this very system.
    signals : signal name -> {plant output: weight}; default the speed differences between `areas`.
    areas : machine name -> area, needed when `signals` is not given.
    actuators : plant inputs; default `actuators_of`.
    own_machine : rank a difference only with actuators of its own machines, so that one of its two parts is
        local.
    order : order of the balanced reduction whose coordinates define the geometric index.
    least : share of the plant's largest gain at the mode's frequency; a mode with smaller residues is not
        controllable or observable.

    Raises
    ------
    ModeError : the mode is not of this system, or no candidate controls and observes it.
    ValueError : unknown signals or actuators.
    """
    signals = _candidate_signals(signals, areas)
    requested = actuators_of(system.input_labels) if actuators is None else actuators
    require_actuator(requested)
    picked = select(system, requested, {name: dict(weights) for name, weights in signals.items()})
    A, B, C = (np.asarray(M, dtype=float) for M in (picked.A, picked.B, picked.C))
    _require_mode_of(A, mode)
    reach, see = mode.left @ B, C @ mode.right
    gain = np.max(np.abs(frequency_response(A, B, C, picked.D, [abs(mode.eigenvalue) + 1e-9])))
    if not np.max(np.abs(reach)) * np.max(np.abs(see)) > least * gain * abs(mode.eigenvalue):
        raise ModeError(
            f"mode {mode.name!r} ({mode.frequency_hz:.3f} Hz) is not both controllable from "
            f"{', '.join(requested)} "
            f"(at most {np.max(np.abs(reach)):.2g}) and observable in {', '.join(signals)} "
            f"(at most {np.max(np.abs(see)):.2g})"
        )
    controllability = np.abs(reach) / np.linalg.norm(reach)
    observability = np.abs(see) / np.linalg.norm(see)
    geometric, used = _geometric_indices(picked, mode.eigenvalue, order)
    own = {name: {output.removesuffix("_dw") for output in signals[name]} for name in signals}
    loops = [
        Loop(
            actuator=actuator,
            signal=signal,
            index=float(controllability[j] * observability[i]),
            controllability=float(controllability[j]),
            observability=float(observability[i]),
            residue=complex(see[i] * reach[j]),
            geometric=float(geometric[i, j]),
            outputs=dict(weights),
        )
        for i, (signal, weights) in enumerate(signals.items())
        for j, actuator in enumerate(requested)
        if not own_machine or actuator.removesuffix("_vs") in own[signal]
    ]
    if not loops:
        raise ValueError(
            f"none of the signals {', '.join(signals)} belongs to a machine of {', '.join(requested)}; "
            "pass own_machine=False to rank them all the same"
        )
    loops.sort(key=lambda loop: -loop.index)
    return Loops(
        mode=mode.name,
        ranking=tuple(loops),
        coordinates=(
            "index: normalised pole vectors of the full plant, free of state coordinates; "
            f"geometric: balanced coordinates of its reduction to {used} states, "
            f"inputs {', '.join(requested)}, outputs {', '.join(signals)}"
        ),
    )


def _candidate_signals(
    signals: Mapping[str, Mapping[str, float]] | None, areas: Mapping[str, int] | None
) -> Mapping[str, Mapping[str, float]]:
    """The signals given, or else the speed differences between the areas."""
    if signals is None:
        if areas is None:
            raise ValueError("give `signals`, or `areas` to form the speed differences between them")
        signals = difference_signals(areas)
    if not signals:
        raise ValueError("no candidate signals: all machines lie in one area")
    return signals


def _require_mode_of(A: Matrix, mode: Mode) -> None:
    v = mode.right
    if v.size == A.shape[0]:
        near = 1e-6 * np.linalg.norm(A) * np.linalg.norm(v)
        if np.allclose(A @ v, mode.eigenvalue * v, atol=near):
            return
    raise ModeError(f"mode {mode.name!r} is not a mode of this system; take it from modes_of(system, ...)")


def lead_by_coordinates(
    system: control.StateSpace, loops: Loops, eigenvalue: complex, orders: Sequence[int] = (6, 8, 16)
) -> list[dict[str, Any]]:
    """Return the first candidate by the geometric index, for several state coordinates.

    system : as in `rank_loops`. orders : balanced reductions whose coordinates are tried, besides those of
    the whole system, as modelled and balanced.

    Returns
    -------
    rows: `coordinates`, `best` [actuator, signal], `indices` of the candidates in the order of
    `loops.ranking`, and `lead`, the index of `loops.selected` over the best of the others, minus 1; negative:
    another is first.
    """
    signals = {loop.signal: dict(loop.outputs) for loop in loops.ranking}
    actuators = [n for n in system.input_labels if any(loop.actuator == n for loop in loops.ranking)]
    picked = select(system, actuators, signals)
    forms = {"states as modelled (rad, pu)": picked}
    forms |= {f"balanced reduction to {k} states": balanced_truncation(picked, k).system for k in orders}
    forms["balanced, every state"] = balanced_truncation(picked, picked.nstates).system
    at = [(list(signals).index(loop.signal), actuators.index(loop.actuator)) for loop in loops.ranking]
    rows = [("pole vectors (free of coordinates)", [loop.index for loop in loops.ranking])]
    for name, coordinates in forms.items():
        table, _ = _geometric_index(coordinates, eigenvalue)
        rows.append((name, [float(table[place]) for place in at]))
    out = []
    for name, indices in rows:
        best = loops.ranking[int(np.argmax(indices))]
        out.append(
            {
                "coordinates": name,
                "best": [best.actuator.removesuffix("_vs"), best.signal],
                "indices": indices,
                "lead": indices[0] / max(indices[1:]) - 1.0 if len(indices) > 1 else float("inf"),
            }
        )
    return out


def _geometric_indices(system: control.StateSpace, eigenvalue: complex, order: int) -> tuple[Matrix, int]:
    """Geometric index of every (signal, actuator) in balanced coordinates, and the order used."""
    n = system.nstates
    for k in range(min(max(order, 1), n), n + 1):
        reduced = balanced_truncation(system, k).system
        indices, moved = _geometric_index(reduced, eigenvalue)
        # a reduction that lost the mode measures another one
        if moved < 0.1 * abs(eigenvalue) or k == n:
            break
    return indices, int(reduced.nstates)


def _geometric_index(system: control.StateSpace, eigenvalue: complex) -> tuple[Matrix, float]:
    """Geometric index (signals, actuators) in a system's own coordinates; distance of its mode to the one."""
    A, B, C = (np.asarray(M, dtype=float) for M in (system.A, system.B, system.C))
    values, right = np.linalg.eig(A)
    i = int(np.argmin(np.abs(values - eigenvalue)))
    w, v = np.linalg.inv(right)[i], right[:, i]
    reach = np.abs(w @ B) / (np.linalg.norm(w) * np.maximum(np.linalg.norm(B, axis=0), 1e-300))
    see = np.abs(C @ v) / (np.linalg.norm(v) * np.maximum(np.linalg.norm(C, axis=1), 1e-300))
    return np.outer(see, reach), float(abs(values[i] - eigenvalue))
