"""Value of a controller's signals: comparison without them, and with the best own-signal controller.

A controller that uses speeds of other machines is compared with itself with signals masked, and with one of
equal order, effort and conditions that was designed for the machines of its actuators alone. Only the second
is a fair rival: a masked controller was not designed to run masked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import control
import numpy as np

from ..delay.signal_conditions import Condition
from ..reduction.gramians import matrices
from .operating_points import JudgedPlant, judge_family

#: damping ratio that a link must add to the inter-area modes to pay: less is within what one search misses of
#: the best (.008 between two searches for the same own signal, two areas)
PAYS = 0.02
#: cycles that a link must add to the mean clearing time to pay: twice what the searches resolve
PAYS_CYCLES = 0.5


@dataclass(frozen=True)
class WorthRow:
    """Results with some of the signals and nothing lost: the least over points and latencies.

    common_rise : mean response (pu) to the common rise of speed after a fault; None: not computed.
    clearing_cycles : mean change of the clearing times relative to no control; None: not searched.
    """

    name: str
    stable: bool
    inter_area: float
    worst_swing: float
    effort: float  #: pu per rad/s
    common_rise: float | None = None
    clearing_cycles: float | None = None


@dataclass(frozen=True)
class SignalWorth:
    """The controller, the same with each signal masked, and its rival, best first; `sentence` is the
    conclusion."""

    afar: tuple[str, ...]  #: signals of other machines than those of the actuators that see them
    open_loop: WorthRow
    whole: WorthRow
    #: without each signal, and with the own machines' alone
    masked: tuple[WorthRow, ...]
    rival: WorthRow | None = None  #: designed anew for the own machines' signals
    remark: str = ""  #: why there is no rival

    @property
    def best_own(self) -> WorthRow | None:
        """The better of the rival and the controller with the own machines' signals alone."""
        own = [
            row for row in (self.rival, *self.masked) if row is not None and row.name in OWN and row.stable
        ]
        return max(own, key=lambda row: row.inter_area, default=None)

    @property
    def adds(self) -> float | None:
        """Inter-area damping that the remote signals add to `best_own`; None without a rival."""
        own = self.best_own
        return None if self.rival is None or own is None else self.whole.inter_area - own.inter_area

    @property
    def adds_cycles(self) -> float | None:
        """Mean clearing time that they add to the rival's, cycles; None if it was not searched."""
        ours = self.whole.clearing_cycles
        rivals = None if self.rival is None else self.rival.clearing_cycles
        return None if ours is None or rivals is None else ours - rivals

    @property
    def pays(self) -> bool | None:
        """Whether they add `PAYS` of damping or `PAYS_CYCLES` of clearing time; None without a rival."""
        if self.adds is None:
            return None
        return bool(self.adds >= PAYS or (self.adds_cycles or 0.0) >= PAYS_CYCLES)

    @property
    def sentence(self) -> str:
        """Value of the remote signals, as one sentence."""
        whole, alone = self.whole, next((row for row in self.masked if row.name == OWN_MASKED), None)
        if not self.afar:
            gain = whole.inter_area - self.open_loop.inter_area
            return f"no signal of another machine: the controller changes inter-area damping by {gain:+.3f}"
        link = f"the link from {_listed(self.afar)}"
        if self.rival is None:
            masked = "" if alone is None else f", {alone.inter_area:.3f} with its signals masked"
            why = self.remark or "the best own-signal controller is not recorded: --worth designs it"
            return f"{link}: inter-area damping {whole.inter_area:.3f} with it{masked}; {why}"
        own = self.best_own
        if own is None or self.adds is None:
            return (
                f"{link} is necessary: no own-signal controller of this order was stable in every condition"
            )
        against = f"inter-area damping {whole.inter_area:.3f}, without it {own.inter_area:.3f} ({own.name})"
        against += self._clearing_in_words
        if not self.pays:
            return f"a local stabilizer performs as well: do not build {link}; {against}"
        more = f"{link} adds {self._added(self.adds)}: {against}"
        if whole.common_rise is not None and own.common_rise is not None:
            more += (
                f", response to the common speed rise {whole.common_rise:.3f} and {own.common_rise:.3f} pu"
            )
        return more

    @property
    def _clearing_in_words(self) -> str:
        """Mean changes of the clearing times, of the controller and its rival."""
        if self.rival is None or self.adds_cycles is None:
            return "; clearing times not searched"
        ours, rivals = self.whole.clearing_cycles, self.rival.clearing_cycles
        return f", clearing times {ours:+.1f} and {rivals:+.1f} cycles"

    def _added(self, damping: float) -> str:
        """What a link that pays adds."""
        parts = [f"{damping:.3f} of inter-area damping"] if damping >= PAYS else []
        cycles = self.adds_cycles
        if cycles is not None and (cycles >= PAYS_CYCLES or (parts and cycles > 0.0)):
            parts.append(f"{cycles:.1f} cycles of clearing time")
        return " and ".join(parts)

    def with_clearing(self, ours: float | None, rivals: float | None) -> SignalWorth:
        """Return the result with the mean change of its clearing times and of its rival's, cycles."""
        rival = None if self.rival is None else replace(self.rival, clearing_cycles=rivals)
        return replace(self, whole=replace(self.whole, clearing_cycles=ours), rival=rival)

    def as_dict(self) -> dict[str, Any]:
        """Return the record as JSON values."""
        derived = {"adds": self.adds, "adds_cycles": self.adds_cycles, "pays": self.pays}
        return {**asdict(self), **derived, "sentence": self.sentence}


OWN_MASKED, OWN_RIVAL = "own machines' signals, masked", "own machines' signals, designed anew"
OWN = (OWN_MASKED, OWN_RIVAL)


def own_signals(actuators: Sequence[str], signals: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return actuator -> the signals that are measured at its own machine.

    >>> own_signals(["G2_vs", "G20_vs"], ["G2_dw", "G20_dw", "G4_dw", "tie_p"])
    {'G2_vs': ('G2_dw',), 'G20_vs': ('G20_dw',)}
    """

    def machine(name: str) -> str:
        return name.rpartition("_")[0]

    return {a: tuple(s for s in signals if machine(s) == machine(a)) for a in actuators}


def seen_by(K: control.StateSpace) -> dict[str, tuple[str, ...]]:
    """Return output -> the inputs that affect it, by the structure of A, B, C, D."""
    _, B, _, D = matrices(K)
    inputs = np.array(K.input_labels)
    seen = {}
    for row, output in enumerate(K.output_labels):
        reached = np.any(B[states_of(K, row)] != 0.0, axis=0) | (D[row] != 0.0)
        seen[output] = tuple(str(name) for name in inputs[reached])
    return seen


def masked(K: control.StateSpace, sees: Mapping[str, Sequence[str]]) -> control.StateSpace:
    """Return `K` with each output using only the named signals; the others of its part are zero.

    Outputs that share states get a copy each, because their signals may differ.
    """
    A, B, C, D = matrices(K)
    inputs = list(K.input_labels)
    blocks: list[tuple[Any, Any, Any, int]] = []
    direct = np.zeros_like(D)
    for row, output in enumerate(K.output_labels):
        retained = np.array([name in sees.get(output, ()) for name in inputs], dtype=float)
        direct[row] = D[row] * retained
        states = states_of(K, row)
        if len(states) and np.any(B[states] * retained):
            blocks.append((A[np.ix_(states, states)], B[states] * retained, C[row, states], row))
    size = sum(len(a) for a, _, _, _ in blocks)
    A_all, B_all, C_all = np.zeros((size, size)), np.zeros((size, len(inputs))), np.zeros((len(D), size))
    first = 0
    for a, b, c, row in blocks:
        part = slice(first, first + len(a))
        A_all[part, part], B_all[part], C_all[row, part] = a, b, c
        first += len(a)
    return control.ss(A_all, B_all, C_all, direct, inputs=inputs, outputs=list(K.output_labels), name=K.name)


def states_of(K: control.StateSpace, row: int) -> list[int]:
    """States that affect output `row`, also through A."""
    A, _, C, _ = matrices(K)
    reached = {int(k) for k in np.flatnonzero(C[row])}
    while True:
        more = {int(j) for k in reached for j in np.flatnonzero(A[k])} - reached
        if not more:
            return sorted(reached)
        reached |= more


def signal_worth(
    plants: Mapping[str, JudgedPlant],
    K: control.StateSpace,
    conditions: Sequence[Condition],
    rival: control.StateSpace | None = None,
    *,
    bands_hz: Mapping[str, tuple[float, float]] | None = None,
    remark: str = "",
) -> SignalWorth:
    """Evaluate `K` with all signals, without each, with the own machines' alone, and its rival.

    All operating points are used, under the conditions without loss or scaling; single signals are masked
    only at the first point with nothing late, to save time.

    Parameters
    ----------
    plants, conditions, bands_hz : as in `judge_family`.
    rival : the best known controller that uses only the own machines' signals.
    remark : why there is none.
    """
    there = [c for c in conditions if c.kind in ("all", "late")] or list(NOW)
    sees = seen_by(K)
    afar = signals_from_afar(K)

    def row(
        name: str, system: control.StateSpace, among: Sequence[Condition], selected: Sequence[str]
    ) -> WorthRow:
        late = [_only(c, system.input_labels) for c in among]
        judged = judge_family({p: plants[p] for p in selected}, system, late, bands_hz=bands_hz)
        steady = all(each.stable for each in judged.rows)
        return WorthRow(name, steady, judged.inter_area, judged.worst_swing, judged.effort)

    points = list(plants)
    outputs, inputs = list(K.output_labels), list(K.input_labels)
    nothing = control.ss([], [], [], np.zeros((len(outputs), len(inputs))), inputs=inputs, outputs=outputs)
    rows = []
    for signal in inputs if afar else ():
        rest = {a: [other for other in selected if other != signal] for a, selected in sees.items()}
        rows.append(row(f"without {signal}", masked(K, rest), NOW, points[:1]))
    if afar:
        rows.append(row(OWN_MASKED, own_alone(K), there, points))
    return SignalWorth(
        afar,
        row("no control", nothing, NOW, points),
        row("all signals", K, there, points),
        tuple(rows),
        None if rival is None else row(OWN_RIVAL, rival, there, points),
        remark,
    )


def signals_from_afar(K: control.StateSpace) -> tuple[str, ...]:
    """Return the inputs that affect an output of another machine."""
    own = own_signals(list(K.output_labels), list(K.input_labels))
    sees = seen_by(K)
    return tuple(
        s for s in K.input_labels if any(s in selected and s not in own[a] for a, selected in sees.items())
    )


def own_alone(K: control.StateSpace) -> control.StateSpace:
    """Return `K` with each output using only the signals of its own machine."""
    return masked(K, own_signals(list(K.output_labels), list(K.input_labels)))


NOW = (Condition("N"),)


def _only(condition: Condition, signals: Sequence[str]) -> Condition:
    """Return the latencies of these signals alone, nothing being lost."""
    late = {s: value for s, value in condition.latency_s_of.items() if s in signals}
    return replace(condition, latency_s_of=late)


def _listed(names: Sequence[str]) -> str:
    """Return machines of signals in words: the first ones of many.

    >>> _listed(["G2_dw"]), _listed(["G1_dw", "G2_dw", "G3_dw", "G4_dw", "G5_dw"])
    ('G2', 'G1, G2, G3 and 2 more')
    """
    machines = [name.rpartition("_")[0] or name for name in names]
    return (
        ", ".join(machines)
        if len(machines) <= 4
        else f"{', '.join(machines[:3])} and {len(machines) - 3} more"
    )
