"""Playback into a single machine with its controls: recorded terminal voltage and angle in, P and Q out.

The machine is at a bus between two ideal sources. Their angles, theta plus and minus acos(V/E), produce the
recorded phasor V exp(j theta) of the terminal from two constant EMFs E. The plant is that of every run, in
model exchange: its states are integrated by the W-method ROS2 (Verwer et al. 1999: second order with any
matrix, here that at the equilibrium, and L-stable, so a time constant of a millisecond needs no short steps).
The source angles follow the record by cubic splines, one for each interval between two jumps. A step with a
jump uses the spline before it up to the jump, and the one after it from there on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from interarea.fmu_build.open.plant import PlantFmu, open_plant
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import Case, case_of
from interarea.models.case.schema import Branch, Machine
from interarea.models.errors import nearest
from interarea.models.files import temporary_folder
from interarea.models.grid.equilibrium import operating_point

from .record import Array, Record, RecordError, deviation_hz

_SOURCES = ("PlayA", "PlayB")
_BUS, _FAR = 1, 2
#: pu, of the line to the sources and of each of them: the terminal has the recorded voltage. With 1e-6 the
#: reactive power of a machine with a gain of 200 drifts by a thousandth
_X = 1e-8
_SPREAD = math.pi / 3.0  #: angle of each source from the terminal at rest: E is twice the voltage
_STEP_S = 1e-3  #: longest
_GAMMA = 1.0 - math.sqrt(0.5)  #: makes the method L-stable
_LEAST_S = 2.0
_MOST_V = 1.9  #: over the voltage at rest


@dataclass(frozen=True, eq=False)
class Terminal:
    """What was measured at a machine. V : pu of its bus. angle : rad, to a frame of rated frequency. P, Q :
    pu of the case's base, out of the machine. before : points of the steady state at the start."""

    step_s: float
    V: Array
    angle: Array
    P: Array
    Q: Array
    before: int


def terminal_of(record: Record, case: Case, machine: str, rest_s: float) -> Terminal:
    """Return voltage, angle, P and Q at a machine of a record: of the channels at `machine`, at its bus, and
    at the branch that alone leads away from it.

    rest_s : duration of the steady state at the start, s: its means are the operating point.

    Raises
    ------
    RecordError : no such machine, a missing measurement, a record too short.
    """
    names = [m.name for m in case.machines]
    if machine not in names:
        raise RecordError(f"{case.name}: no machine {machine!r}; {nearest(machine, names)}")
    m = case.machines[names.index(machine)]
    if not rest_s > 0.0:
        raise RecordError(f"rest_s = {rest_s:g} s of steady state, allowed: above 0")
    if not record.length_s >= _LEAST_S + rest_s:
        raise RecordError(
            f"{record.source}: {record.length_s:.3g} s with {rest_s:g} s of steady state, wanted: "
            f"{_LEAST_S + rest_s:g} s at least, with a disturbance in it"
        )
    bus = f"bus{m.bus}"
    places = [machine, bus]
    out = _only_branch(case, m)
    if out is not None and out.from_bus == m.bus:
        places.append(f"branch[{out.name}]")
    kv = next(b.kv for b in case.buses if b.number == m.bus)
    V = _voltage(record, places, kv)
    turned = _turned(record, bus)
    if turned is not None:
        V, angle = np.abs(turned), np.unwrap(np.angle(turned))
    else:
        angle = _angle(record, places, case.frequency_hz)
    P, Q = (_power(record, places, q, case.base_mva) for q in ("active power", "reactive power"))
    return Terminal(record.step_s, V, angle, P, Q, max(2, round(rest_s / record.step_s)))


def _only_branch(case: Case, m: Machine) -> Branch | None:
    """Return the branch that carries what one machine gives, and nothing else; None where there is none."""
    there = [b for b in case.branches if m.bus in (b.from_bus, b.to_bus) and b.in_service]
    buses = [row.bus for row in case.machines] + [row.bus for row in case.loads]
    buses += [row.bus for row in case.shunts] + [row.bus for row in case.svcs]
    buses += [row.bus for row in case.converters]
    alone = buses.count(m.bus) == 1 and not case.links
    return there[0] if len(there) == 1 and alone and not there[0].b else None


def _place(record: Record, places: Sequence[str], quantity: str) -> str:
    """Return the first place at which a quantity was measured."""
    for place in places:
        if quantity in record.terminals.get(place, {}):
            return place
    raise RecordError(
        f"{record.source}: no {quantity} at {', '.join(places)}, wanted: V, angle or frequency, P and Q there"
    )


def _measured(record: Record, places: Sequence[str], quantity: str) -> tuple[Array, str]:
    """Return a quantity at the first place that has it, and its unit."""
    name = record.terminals[_place(record, places, quantity)][quantity]
    return record[name], next(c.unit for c in record.channels if c.name == name)


def _power(record: Record, places: Sequence[str], quantity: str, base_mva: float) -> Array:
    """Return P or Q, pu of the case's base."""
    values, unit = _measured(record, places, quantity)
    return values / (base_mva if unit in ("MW", "Mvar") else 1.0)


def _voltage(record: Record, places: Sequence[str], kv: float | None) -> Array:
    """Return the voltage, pu; kV are from phase to ground."""
    V, unit = _measured(record, places, "voltage")
    if unit == "kV":
        if kv is None:
            raise RecordError(
                f"{record.source}: {places[1]} in kV, wanted: kv of that bus in the case, or pu"
            )
        V = V * math.sqrt(3.0) / kv
    return V


def _turned(record: Record, bus: str) -> npt.NDArray[np.complex128] | None:
    """Return the phasor of a bus of a run, in the frame that turns with rated frequency; None without it."""
    parts = {c.name.rpartition(".")[2]: c.name for c in record.channels if f".{bus}." in f".{c.name}"}
    return record[parts["re"]] + 1j * record[parts["im"]] if {"re", "im"} <= parts.keys() else None


def _angle(record: Record, places: Sequence[str], frequency_hz: float) -> Array:
    """Return the angle of the voltage (rad), or what its frequency adds up to."""
    seen = [record.terminals.get(place, {}) for place in places]
    angles = [there["voltage angle"] for there in seen if "voltage angle" in there]
    own = [name for name in angles if not name.endswith(f"{places[1]}.angle")]
    if own:
        return record[own[0]]
    frequencies = [there["frequency"] for there in seen if "frequency" in there]
    if frequencies:
        what = f"{record.source}: {frequencies[0]}"
        slip = 2.0 * np.pi * deviation_hz(record[frequencies[0]], frequency_hz, what) * record.step_s
        return np.concatenate([[0.0], np.cumsum(0.5 * (slip[1:] + slip[:-1]))])
    if angles:
        raise RecordError(
            f"{record.source}: {angles[0]} is to the centre of inertia, wanted: a run with show = "
            f'["{places[1]}.re", "{places[1]}.im", ...], or a frequency'
        )
    raise RecordError(
        f"{record.source}: no voltage angle or frequency at {', '.join(places)}, wanted: one of them"
    )


class Bench:
    """A machine of a case between ideal sources; `run` gives P and Q with other parameters."""

    def __init__(self, case: Case, machine: str, terminal: Terminal, cache: Path) -> None:
        self._case, self.machine, self.terminal, self._cache = case, machine, terminal, cache
        first = slice(0, terminal.before)
        self.V0 = float(np.mean(terminal.V[first]))
        self.angle0 = float(np.mean(terminal.angle[first]))
        if not float(np.max(terminal.V)) < _MOST_V * self.V0 or not float(np.min(terminal.V)) >= 0.0:
            raise RecordError(
                f"voltage of {machine} from {np.min(terminal.V):.3g} to {np.max(terminal.V):.3g} pu, "
                f"initially {self.V0:.3g}, allowed: from 0 to {_MOST_V:g} times the initial value"
            )
        self.power0 = complex(np.mean(terminal.P[first]), np.mean(terminal.Q[first]))

    def alone(self, values: Mapping[str, float], power: complex) -> Case:
        """Return the case of the single machine, with `values` by path, at P + jQ."""
        document = self._case.document()
        row = dict(document["machines"][self.machine])
        row |= {"bus": _BUS, "V_pu": self.V0, "slack": False, "area": 1}
        row |= {"P_mw": power.real * self._case.base_mva, "Q_mvar": power.imag * self._case.base_mva}
        row.pop("angle_deg", None)
        base = 1e5 * self._case.base_mva
        far = abs(self.V0 - 1j * _X * (power / self.V0).conjugate())
        through = far**2 * math.tan(_SPREAD) / _X * self._case.base_mva
        ideal = {
            "bus": _FAR, "base_mva": base, "model": "infinite_bus", "Xd1": _X * 1e5, "V_pu": far,
        }  # fmt: skip
        alone = {
            "name": f"{self._case.name}-{self.machine}-alone", "title": "play-in",
            "source": "made for a record", "frequency_hz": self._case.frequency_hz,
            "base_mva": self._case.base_mva, "sources": {},
            "devices": document.get("devices", {}),
            "buses": {str(_BUS): {}, str(_FAR): {}},
            "branches": {"out": {"from": _BUS, "to": _FAR, "r": 0.0, "x": _X, "b": 0.0}},
            "machines": {
                self.machine: row,
                _SOURCES[0]: {**ideal, "P_mw": 0.0, "slack": True},
                _SOURCES[1]: {**ideal, "P_mw": -through},
            },
        }  # fmt: skip
        case = case_of(alone, where=self._case.name)
        for path, value in values.items():
            case = with_value(case, self.machine, path, value)
        return case

    def run(
        self,
        values: Mapping[str, float],
        power: complex | None = None,
        jumps: Mapping[int, float] | None = None,
    ) -> Array:
        """Return P and Q (points, 2), pu of the case's base, with `values` by path, from the equilibrium at
        `power`.

        jumps : point -> share of the step after it at which the voltage jumps from there to the next.

        Raises
        ------
        CaseError : values that the case rejects, or with which a control has no equilibrium there.
        """
        case = self.alone(values, self.power0 if power is None else power)
        point = operating_point(case)
        block = plant_block(case, event_slots=1, show=("branch[out].p", "branch[out].q"), point=point)
        with temporary_folder() as folder:
            fmu = build_fmu(block, folder / "plant.fmu", cache=self._cache)
            with open_plant(fmu) as plant:
                return self._played(plant, jumps or {})

    def _driven(self, many: int, jumps: Mapping[int, float]) -> tuple[Array, Array]:
        """Return the angles of the sources (steps, 2) as each of `many` steps a point begins and ends."""
        seen = np.column_stack([self.terminal.V, self.terminal.angle])
        ends = [*sorted(jumps), len(seen) - 1]
        firsts = [0, *(k + 1 for k in ends[:-1])]
        curves = [
            CubicSpline(np.arange(i, k + 1), seen[i : k + 1]) for i, k in zip(firsts, ends, strict=True)
        ]
        sides = []
        for side in (0, 1):
            share = (np.arange(many) + side) / many
            values = np.empty((len(seen) - 1, many, 2))
            for curve, i, k in zip(curves, firsts, ends, strict=True):
                values[i:k] = curve(np.arange(i, k)[:, None] + share)
            for old, new, k in zip(curves, curves[1:], ends, strict=False):
                # the mean over a step is that of the jump within it
                before = np.clip(jumps[k] * many - np.arange(many), 0.0, 1.0)[:, None]
                after = np.clip(2.0 * (1.0 - before) - (1 - side), 0.0, 1.0)
                values[k] = old(k + share) * (1.0 - after) + new(k + share) * after
            V, angle = values.reshape(-1, 2).T
            apart = np.arccos(np.clip(V / (2.0 * self.V0), 0.0, 1.0))
            turn = angle - self.angle0
            sides.append(np.column_stack([turn + apart, turn - apart]))
        return sides[0], sides[1]

    def _played(self, plant: PlantFmu, jumps: Mapping[int, float]) -> Array:
        t = self.terminal
        many = max(1, math.ceil(t.step_s / _STEP_S - 1e-9))
        h = t.step_s / many
        begins, ends = self._driven(many, jumps)
        first, last = self._driven(1, {})
        points = np.concatenate([first, last[-1:]])
        places = [plant.state_names.index(f"{name}.delta") for name in _SOURCES]
        p, q = (plant.output_names.index(f"branch[out].{letter}") for letter in "pq")
        x, _ = plant.operating_point()
        A = plant.jacobians()[0]
        A[places] = 0.0
        solved = np.linalg.inv(np.eye(len(x)) - _GAMMA * h * A)
        z, dx, y = np.empty_like(x), np.empty_like(x), np.empty((len(t.V), 2))
        rates = plant.rates_between(z, dx)
        for k in range(len(t.V)):
            x[places] = points[k]
            z[:] = x
            rates()
            seen = plant.outputs()
            y[k] = seen[p], seen[q]
            if not math.isfinite(y[k, 0]) or k == len(t.V) - 1:
                break
            for j in range(many * k, many * (k + 1)):
                x[places] = begins[j]
                z[:] = x
                rates()
                k1 = solved @ dx
                z[:] = x + h * k1
                z[places] = ends[j]
                rates()
                x += h * (1.5 * k1 + 0.5 * (solved @ (dx - 2.0 * k1)))
        return y


def with_value(case: Case, machine: str, path: str, value: float) -> Case:
    """Return the case with one number of a machine replaced."""
    change: object = value
    for field in reversed(path.split(".")):
        change = {field: change}
    return case.with_changes({"machines": {machine: change}})
