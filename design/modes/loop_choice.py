r"""Selection of actuators and signals, for several modes at once and on a grid of any size.

With :math:`A v = \lambda v,\ w^T A = \lambda w^T,\ w^T v = 1` a loop from actuator b to signal c that is late
by tau has the residue :math:`R = (c v)(w^T b)\, e^{-\lambda\tau}`: a small gain K moves the mode by K R.
Signals of one kind (speeds, bus frequencies, angles, powers, currents) have one unit, so the index of a loop
is |R| over the largest of its kind for that mode, independent of state coordinates and units. The score of a
set is the least over modes of its largest index.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, islice
from typing import Any

import numpy as np
import numpy.typing as npt

from interarea.models.case.tables import swing_name

from ..linear.sparse_plant import SparsePlant
from .loop_points import LoopPoint, LoopSet, gone, held
from .loop_selection import require_actuator
from .modes import Mode, ModeError

ComplexArray = npt.NDArray[np.complex128]

KINDS = ("speed", "frequency", "angle", "power", "current")
_ENDS = 6  #: machines or buses of an area whose differences are candidates, those that show a mode most
_UNSEEN = 1e-9  # of the largest residue of any mode: less reaches or shows nothing
_MOST_ACTUATORS = 24  # of which sets are formed
_MOST_SETS = 200_000
_LISTED = 12  # names in a message


@dataclass(frozen=True)
class Signal:
    """A candidate signal, with its observability of each mode in the unit of its kind.

    kind : of `KINDS`; speeds and frequencies in pu, angles in rad, powers and currents in pu.
    """

    name: str
    kind: str
    shows: ComplexArray  #: (modes,)


@dataclass(frozen=True)
class RankedLoop:
    """One signal fed back to one actuator, for one mode.

    index : 0..1, share of the largest residue of any signal of its kind and any actuator.
    residue : with the delay, unit of the signal per unit of the actuator and second.
    lead_deg : phase that the controller must compensate, including the delay, -180..180.
    beside : the other mode that the loop moves most, and its shift relative to the target's.
    """

    mode: str
    actuator: str
    signal: str
    kind: str
    index: float
    residue: complex
    lead_deg: float
    beside: tuple[str, float]


@dataclass(frozen=True)
class LoopChoice:
    """Ranked loops of each target mode, best first, and ranked sets.

    least_damped : of the targets. remarks : targets that do not exist at another operating point.
    """

    targets: tuple[str, ...]
    least_damped: str
    latency_s: float
    loops: Mapping[str, tuple[RankedLoop, ...]]
    sets: tuple[LoopSet, ...]
    remarks: tuple[str, ...] = ()


def choose_loops(
    plant: SparsePlant,
    modes: Sequence[Mode],
    areas: Mapping[str, int],
    *,
    targets: Sequence[str] = (),
    latency_s: float = 0.0,
    actuators: Sequence[str] = (),
    kinds: Sequence[str] = KINDS,
    together: int | None = None,
    most: int = 10,
    points: Sequence[LoopPoint] = (),
) -> LoopChoice:
    """Rank every signal at every actuator for every target mode, and sets of `together` actuators.

    Parameters
    ----------
    modes : of the plant (`all_modes`); targets : names among them, default the inter-area ones.
    areas : machine name -> area number.
    latency_s : of every signal. actuators : inputs of the plant, default all. most : rows that are kept.
    together : default 2, or 1 where there is one actuator.
    points : other operating points of the sets; these are ranked by the least score of all.

    Raises
    ------
    ModeError : no inter-area mode, unknown names, no actuator, a target that no loop controls and observes.
    """
    aimed = _targets(modes, targets)
    names = _actuators(plant, actuators)
    together = min(len(names), 2) if together is None else together
    _require(kinds, latency_s, together, names)
    V = np.array([mode.right for mode in modes]).T
    value = np.array([mode.eigenvalue for mode in modes])
    B = plant.Bu[:, [plant.inputs.index(n) for n in names]].toarray()
    reach = (np.array([mode.left for mode in modes]) @ B) * np.exp(-value * latency_s)[:, None]
    signals = [s for s in signals_of(plant, V, value, areas, aimed) if s.kind in kinds]
    if not signals:
        raise ModeError(
            f"no signal of kind {' or '.join(kinds)}: angles and frequencies are differences between areas, "
            "and all machines are in one; allow other kinds, or assign machines to areas"
        )
    table = _Residues([m.name for m in modes], names, signals, reach)
    table.require(aimed, modes)
    loops = {modes[m].name: tuple(table.ranked(m, most)) for m in aimed}
    worst = min((modes[m] for m in aimed), key=lambda mode: mode.damping_ratio)
    sets, requested = table.sets(aimed, together), [modes[m] for m in aimed]
    if points:
        sets = held(sets, requested, names, points)
    return LoopChoice(tuple(loops), worst.name, latency_s, loops, sets[:most], gone(requested, points))


def _require(kinds: Sequence[str], latency_s: float, together: int, actuators: Sequence[str]) -> None:
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown or not kinds:
        raise ModeError(f"signals {unknown[0] if unknown else '(none)'!r}, allowed: {', '.join(KINDS)}")
    if not (np.isfinite(latency_s) and latency_s >= 0.0):
        raise ModeError(f"latency = {latency_s:g} s, wanted: 0 or more")
    if not 0 < together <= len(actuators):
        raise ModeError(
            f"sets of {together} actuators, wanted: 1 to {len(actuators)}, the number of actuators"
        )


def _targets(modes: Sequence[Mode], chosen: Sequence[str]) -> list[int]:
    labels = [mode.name for mode in modes]
    more = f" and {len(labels) - _LISTED} more" if len(labels) > _LISTED else ""
    listed = (", ".join(labels[:_LISTED]) or "none") + more
    for name in chosen:
        if name not in labels:
            raise ModeError(
                f"no mode {name!r} in this band and below this damping ratio; there are: {listed}"
            )
    targets = [k for k, n in enumerate(labels) if (n in chosen if chosen else n.startswith("inter-area"))]
    if not targets:
        raise ModeError(
            f"no inter-area mode in this band and below this damping ratio; there are: {listed}; widen "
            "--band, raise --below, name targets with --mode, or assign machines to areas"
        )
    return targets


def _actuators(plant: SparsePlant, chosen: Sequence[str]) -> list[str]:
    for name in chosen:
        if name not in plant.inputs:
            raise ModeError(f"no actuator {name!r}; the plant has {', '.join(plant.inputs[:12])}")
    names = list(chosen or plant.inputs)
    require_actuator(names)
    return names


def signals_of(
    plant: SparsePlant,
    right: ComplexArray,
    value: ComplexArray,
    areas: Mapping[str, int],
    aimed: Sequence[int],
) -> list[Signal]:
    """Return every candidate signal with its observability of each mode: speeds, differences, branches.

    right : (n, modes); value : (modes,) eigenvalues; aimed : modes whose extreme machines form differences.
    """
    omega = _base(plant)
    speeds = right[plant.speed]
    signals = [Signal(f"{m}_dw", "speed", speeds[k]) for k, m in enumerate(plant.machines)]
    machine_area = np.array([areas[m] for m in plant.machines])
    for a, b in _pairs(speeds, machine_area, aimed):
        name = swing_name(plant.machines[a], plant.machines[b])
        signals.append(Signal(name, "speed", speeds[a] - speeds[b]))
    dV = plant.voltages(right)
    _, theta = plant.size_and_angle(dV)
    bus_area = _bus_areas(plant, machine_area)
    for a, b in _pairs(theta, bus_area, aimed):
        name = f"{plant.bus_names[a]}_{plant.bus_names[b]}"
        signals.append(Signal(f"angle_{name}", "angle", theta[a] - theta[b]))
        signals.append(Signal(f"frequency_{name}", "frequency", value * (theta[a] - theta[b]) / omega))
    return signals + _branches(plant, dV)


def _branches(plant: SparsePlant, dV: ComplexArray) -> list[Signal]:
    """Active power into each branch at its `from` end, and the size of the current there."""
    power, _, flow = plant.branch_flows(dV)
    branches = [Signal(f"power_{name}", "power", power[k]) for k, name in enumerate(plant.branches)]
    return branches + [Signal(f"current_{name}", "current", flow[k]) for k, name in enumerate(plant.branches)]


def _base(plant: SparsePlant) -> float:
    """Rated speed, rad/s: d angle / dt over the speed."""
    place = plant.place[: len(plant.machines)]
    at, speed = (np.argwhere(place == states[:, None]) for states in (plant.angle, plant.speed))
    return float(plant.A[at[0, 0], at[0, 1], speed[0, 1]])


def _bus_areas(plant: SparsePlant, machine_area: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Area of each bus: of its nearest machine by branches, 0 where none is connected."""
    b = len(plant.bus_names)
    area = np.zeros(b, dtype=int)
    area[plant.bus[: len(plant.machines), 0]] = machine_area
    one, other = plant.ends.T
    for _ in range(b):
        take = (area[one] == 0) & (area[other] != 0)
        give = (area[other] == 0) & (area[one] != 0)
        if not (take.any() or give.any()):
            break
        area[one[take]] = area[other[take]]
        area[other[give]] = area[one[give]]
    return area


def _pairs(shows: ComplexArray, area: npt.NDArray[Any], aimed: Sequence[int]) -> list[tuple[int, int]]:
    """Places in different areas, of each the `_ENDS` that show one of the aimed modes most."""
    most: dict[int, set[int]] = {}
    for k in sorted(set(area.tolist()) - {0}):
        own = np.flatnonzero(area == k)
        for m in aimed:
            best = own[np.argsort(-np.abs(shows[own, m]), kind="stable")[:_ENDS]]
            most.setdefault(k, set()).update(int(i) for i in best)
    return [
        (a, b) for one, two in combinations(most, 2) for a in sorted(most[one]) for b in sorted(most[two])
    ]


class _Residues:
    """R[signal, mode, actuator] = shows[signal, mode] reach[mode, actuator], never formed as a whole."""

    def __init__(
        self,
        labels: Sequence[str],
        actuators: Sequence[str],
        signals: Sequence[Signal],
        reach: ComplexArray,
    ) -> None:
        self._labels, self._actuators, self._signals, self._reach = labels, actuators, signals, reach
        self._shows = np.array([s.shows for s in signals])
        self._seen = np.abs(self._shows)  # over the largest of the kind, for each mode
        of = np.array([s.kind for s in signals])
        for kind in set(of.tolist()):
            rows = of == kind
            self._seen[rows] /= np.maximum(self._seen[rows].max(axis=0), 1e-300)
        self._moved = np.abs(reach) / np.maximum(np.abs(reach).max(axis=1, keepdims=True), 1e-300)

    def require(self, aimed: Sequence[int], modes: Sequence[Mode]) -> None:
        """Reject targets that no loop controls and observes."""
        size = np.abs(self._shows).max(axis=0) * np.abs(self._reach).max(axis=1)
        for m in aimed:
            if not size[m] > _UNSEEN * size.max():
                raise ModeError(
                    f"{modes[m].name} ({modes[m].frequency_hz:.3f} Hz): no allowed actuator and signal "
                    "control and observe it; allow more actuators or more kinds of signals"
                )

    def ranked(self, m: int, most: int) -> list[RankedLoop]:
        """The best loops for mode m; among equal ones those that move other modes less."""
        index = np.outer(self._seen[:, m], self._moved[m])
        k = min(4 * most, index.size)
        few = np.flatnonzero(index >= np.partition(index, index.size - k, axis=None)[index.size - k])
        first = few[np.argsort(-index.ravel()[few], kind="stable")[:k]]
        places = [divmod(int(k), index.shape[1]) for k in first]
        result = [self._loop(m, i, j, float(index[i, j])) for i, j in places]
        return sorted(result, key=lambda loop: (-round(loop.index, 6), loop.beside[1]))[:most]

    def _loop(self, m: int, i: int, j: int, index: float) -> RankedLoop:
        R = self._shows[i] * self._reach[:, j]  # of each mode
        others = np.abs(R) / max(abs(R[m]), 1e-300)
        others[m] = 0.0
        worst = int(others.argmax())
        return RankedLoop(
            mode=self._labels[m],
            actuator=self._actuators[j],
            signal=self._signals[i].name,
            kind=self._signals[i].kind,
            index=index,
            residue=complex(R[m]),
            lead_deg=float(np.degrees(np.angle(-1.0 / R[m]))) if R[m] else 0.0,
            beside=(self._labels[worst], float(others[worst])) if len(others) > 1 else ("", 0.0),
        )

    def sets(self, aimed: Sequence[int], together: int) -> tuple[LoopSet, ...]:
        """Sets of the actuators with the largest indices for some target, the best first."""
        best = self._moved[list(aimed)]  # the index with the best signal of any kind
        strong = np.argsort(-best.max(axis=0), kind="stable")[: max(_MOST_ACTUATORS, together)]
        rows = []
        for picked in islice(combinations(sorted(int(k) for k in strong), together), _MOST_SETS):
            each = best[:, list(picked)]
            rest = [np.delete(each, k, axis=1) for k in range(together)]
            left = min(float(np.min(np.max(one, axis=1, initial=0.0))) for one in rest)
            rows.append((float(each.max(axis=1).min()), left, float(each.sum()), picked))
        rows.sort(key=lambda row: row[:3], reverse=True)
        serves = {int(k): aimed[int(np.argmax(best[:, k]))] for k in strong}
        shown = {k: self._signals[int(np.argmax(self._seen[:, m]))] for k, m in serves.items()}
        return tuple(
            LoopSet(
                actuators=tuple(self._actuators[k] for k in picked),
                score=score,
                left=left,
                decides=self._labels[aimed[int(np.argmin(best[:, list(picked)].max(axis=1)))]],
                loops={self._actuators[k]: shown[k].name for k in picked},
            )
            for score, left, _, picked in rows
        )
