"""The solution that a file stores: how far it is from one, and the one beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..grid.network import assembled, series_stamps
from ..grid.newton import Iterate, newton
from ..grid.powerflow import PowerFlowError
from .report import Report
from .static import LOAD, SLACK, UNIT, StaticBus, StaticGrid, StaticLoad, StaticUnit
from .topology import live_islands

GOOD_MVA, FAIR_MVA = 0.1, 5.0  #: largest mismatch of a solved file, and of one written with few digits
_GOOD, _FAIR = 1e-3, 0.05  # of the power of a grid: that of a feeder of 1 MW is not 5 MVA
_TOLERANCE_PU = 1e-11


@dataclass(frozen=True)
class Solution:
    """Voltages of a grid with P + jQ of each unit, MW.

    stored_mva : largest mismatch of the stored voltages, P where it is not a slack's, Q at load buses.
    stored_bus : where that is. moved_pu, moved_deg : largest change from the stored voltages.
    """

    voltages: dict[int, complex]
    generation: list[complex]
    slacks: tuple[int, ...]
    stored_mva: float
    stored_bus: int
    moved_pu: float
    moved_deg: float


class _Arrays:
    """The grid as arrays, pu of its base."""

    def __init__(self, grid: StaticGrid) -> None:
        self.grid = grid
        self.numbers = list(grid.buses)
        self.at = {number: k for k, number in enumerate(self.numbers)}
        n, base = len(self.numbers), grid.base_mva
        on = [b for b in grid.branches if b.on]
        values = np.array([(b.r, b.x, b.b, b.tap, b.shift) for b in on], dtype=float).reshape(-1, 5)
        ends = np.array([(self.at[b.first], self.at[b.second]) for b in on], dtype=int).reshape(-1, 2)
        diagonal = np.zeros(n, dtype=complex)
        for shunt in grid.shunts:
            diagonal[self.at[shunt.bus]] += complex(shunt.p, shunt.q) / base
        self.power = np.zeros(n, dtype=complex)  # into the network
        self.current = np.zeros(n, dtype=complex)
        for load in grid.loads:
            k = self.at[load.bus]
            diagonal[k] += complex(load.yp, -load.yq) / base
            self.power[k] -= complex(load.p, load.q) / base
            self.current[k] -= complex(load.ip, load.iq) / base
        for unit in grid.units:
            self.power[self.at[unit.bus]] += complex(unit.p, unit.q) / base
        self.Y: Any = assembled(ends, series_stamps(*values.T), diagonal)
        buses = list(grid.buses.values())
        self.start: npt.NDArray[np.complex128] = np.array(
            [bus.v * np.exp(1j * np.deg2rad(bus.angle)) for bus in buses], dtype=complex
        )
        self.kind = np.array([bus.kind for bus in buses])
        self.stars = np.array([bus.star for bus in buses], dtype=bool)
        self._set_stars()

    def _set_stars(self) -> None:
        """A star's voltage follows from those of its windings: nothing is connected to it."""
        for k in np.flatnonzero(self.stars):
            row = self.Y.getrow(k)
            own = row[0, k]
            rest = row @ self.start - own * self.start[k]
            if own:
                self.start[k] = complex(-rest[0] / own)

    def off(self, V: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
        """Power into the network less what is given, (buses,) pu."""
        result: npt.NDArray[np.complex128] = V * np.conj(self.Y @ V) - self.power - self.current * np.abs(V)
        return result


def solve_stored(grid: StaticGrid, slacks: Sequence[StaticBus], report: Report) -> Solution:
    """Return the solution beside the stored voltages of `grid`, which it also gives to the free Q.

    Held: the stored magnitude (not the set-point VS, which a unit at its limit has left; but that where the
    stored voltages are no solution at buses without units) and P of the units at buses of type 2 and 3, angle
    at the slacks, one in each island; taps, shunts and dc lines stay. Units at load buses keep P and Q.

    Raises
    ------
    PowerFlowError : Newton's method converges neither from the stored voltages nor from a flat start.
    """
    of_converters = [load for load in grid.loads if load.q_free]
    arrays, is_held, free_angle, free_magnitude = _prepared(grid, [bus.number for bus in slacks], report)
    stored_mva, stored_bus = _largest(arrays, free_angle, free_magnitude)
    start = arrays.start
    holding: list[StaticLoad] = []
    if _hold_set_points(grid, arrays, report):
        holding = _set_converters(grid, of_converters, report)
        is_held[[arrays.at[load.bus] for load in holding]] = True
        arrays = _Arrays(grid)
    report.lines.append(_verdict(stored_mva, stored_bus, grid))
    if stored_mva > _limits_mva(grid)[1]:
        where = grid.buses[stored_bus].where
        report.assume("the stored voltages are not a solution; the power flow is solved again", where)
    V, arrays = _solved(arrays, free_angle, is_held, holding, report)
    moved_pu = float(np.max(np.abs(np.abs(V) - np.abs(start))))
    moved_deg = float(np.max(np.abs(np.degrees(np.angle(V / start)))))
    report.lines.append(
        f"power flow: voltages {np.abs(V).min():.4f} to {np.abs(V).max():.4f} pu, differing by at most "
        f"{moved_pu:.2g} pu and {moved_deg:.2g} deg from the stored ones"
    )
    generation = _generation(grid, arrays, V, is_held)
    change = sum(generation[k].real - grid.units[k].p for k in range(len(grid.units)))
    named = ", ".join(str(bus.number) for bus in slacks)
    which = f"slack bus {named}: takes" if len(slacks) == 1 else f"slack buses {named}: take"
    report.lines.append(f"{which} {change:+.4g} MW more than stored")
    voltages = {number: complex(V[k]) for k, number in enumerate(arrays.numbers)}
    return Solution(
        voltages, generation, tuple(bus.number for bus in slacks), stored_mva, stored_bus, moved_pu, moved_deg
    )


def _solved(
    arrays: _Arrays,
    free_angle: npt.NDArray[np.int_],
    held: npt.NDArray[np.bool_],
    holding: Sequence[StaticLoad],
    report: Report,
) -> tuple[npt.NDArray[np.complex128], _Arrays]:
    """Return the voltages, and the grid with the Q of the converters `holding` their bus.

    One that would give more than its largest current gives that; where none is left, `held` loses the bus.
    """
    while True:
        V = _newton(arrays, free_angle, np.flatnonzero(~held), held)
        if not holding:
            return V, arrays
        _balance(arrays, V, holding)
        beyond = [load for load in holding if not abs(load.q) <= load.most_mva * abs(V[arrays.at[load.bus]])]
        for load in beyond:
            load.iq, load.q = float(np.copysign(load.most_mva, load.q)), 0.0
            report.assume("FACTS device gives its SHMX, with which it does not hold VSET", load.where)
        arrays = _Arrays(arrays.grid)
        if not beyond:
            return V, arrays
        holding = [load for load in holding if all(load is not other for other in beyond)]
        for bus in {load.bus for load in beyond} - {load.bus for load in holding}:
            held[arrays.at[bus]] = False


def decide_units_at_load_buses(grid: StaticGrid, report: Report) -> None:
    """Keep the units in service at buses of type 1, or leave them out, as the stored voltages say; report it.

    Programs differ: some leave such a unit out, some let it inject its P and Q. The voltages at a bus and
    its neighbours give the power that goes into the network there, so they tell with which of the two the
    file was solved. Where neither fits the unit is kept.
    """
    at_load: dict[int, list[StaticUnit]] = {}
    for unit in grid.units:
        if grid.buses[unit.bus].kind == LOAD:
            at_load.setdefault(unit.bus, []).append(unit)
    if not at_load or len(grid.units) == sum(map(len, at_load.values())):
        return
    arrays = _Arrays(grid)
    off = arrays.off(arrays.start) * grid.base_mva
    of_p = {load.bus for load in grid.loads if load.q_free}
    for bus, units in at_load.items():
        provided = sum((complex(unit.p, unit.q) for unit in units), 0j)
        both = (complex(off[arrays.at[bus]]), complex(off[arrays.at[bus]]) + provided)
        within, without = (abs(z.real if bus in of_p else z) for z in both)
        if _fits(without, within, grid):
            grid.units = [unit for unit in grid.units if unit not in units]
            what = "left out: the stored voltages are a solution without it"
        elif _fits(within, without, grid):
            what = "kept with its P and Q: the stored voltages are a solution with it"
        else:
            what = "kept with its P and Q: the stored voltages do not decide"
        size = f"(off by {within:.3g} MVA with it, by {without:.3g} without it)"
        report.assume(f"unit in service at a bus of type 1 {what} {size}", units[0].where, len(units))


def _limits_mva(grid: StaticGrid) -> tuple[float, float]:
    """Return the largest mismatch of a solution, and of one written with few digits, MVA."""
    provided = sum(abs(complex(unit.p, unit.q)) for unit in grid.units)
    taken = sum(abs(complex(load.p + load.ip + load.yp, load.q + load.iq + load.yq)) for load in grid.loads)
    power = max(provided, taken) or grid.base_mva
    return min(GOOD_MVA, _GOOD * power), min(FAIR_MVA, _FAIR * power)


def _fits(one: float, other: float, grid: StaticGrid) -> bool:
    """Whether a mismatch of `one` MVA is that of a solution beside `other`."""
    good, fair = _limits_mva(grid)
    return one <= fair and other > max(good, 10.0 * one)


def _hold_set_points(grid: StaticGrid, arrays: _Arrays, report: Report) -> bool:
    """Give buses with units their set-point when the voltages of the others are no solution; say whether."""
    sourced = {unit.bus for unit in grid.units}
    others = np.array([number not in sourced for number in arrays.numbers])
    off = np.abs(np.where(others, arrays.off(arrays.start), 0.0)) * grid.base_mva
    if not off.size or not off.max() > _limits_mva(grid)[1]:
        return False
    done: set[int] = set()
    for unit in grid.units:
        bus = grid.buses[unit.bus]
        if bus.kind == LOAD or unit.bus in done:
            continue
        if unit.v is None:
            report.assume("unit that regulates another bus: holds the stored voltage of its own", unit.where)
        elif unit.v > 0.0:
            done.add(unit.bus)
            if unit.v != bus.v:
                report.assume(
                    "unit holds its set-point, because the stored voltages are not a solution", unit.where
                )
                bus.v = unit.v
    return True


def _prepared(
    grid: StaticGrid, slacks: Sequence[int], report: Report
) -> tuple[_Arrays, npt.NDArray[np.bool_], npt.NDArray[np.int_], npt.NDArray[np.int_]]:
    """The grid as arrays, which magnitudes are held, which angles and magnitudes are free."""
    sourced = {unit.bus for unit in grid.units}
    for number, bus in grid.buses.items():
        if bus.kind in (UNIT, SLACK) and number not in sourced:
            bus.kind = LOAD
            report.assume("bus of type 2 or 3 without a unit in service: treated as a load bus", bus.where)
    _free_reactive(grid)
    arrays = _Arrays(grid)
    is_held = np.array([bus.kind != LOAD for bus in grid.buses.values()])
    fixed = [arrays.at[slack] for slack in slacks]
    is_held[fixed] = True
    free_angle = np.delete(np.arange(len(is_held)), fixed)
    return arrays, is_held, free_angle, np.flatnonzero(~is_held)


def _largest(
    arrays: _Arrays, free_angle: npt.NDArray[np.int_], free_magnitude: npt.NDArray[np.int_]
) -> tuple[float, int]:
    """The largest mismatch of the stored voltages, MVA, and its bus."""
    stored = arrays.off(arrays.start) * arrays.grid.base_mva
    size = np.zeros(len(stored))
    size[free_angle] = np.abs(stored.real[free_angle])
    size[free_magnitude] = np.maximum(size[free_magnitude], np.abs(stored.imag[free_magnitude]))
    worst = int(np.argmax(size))
    return float(size[worst]), arrays.numbers[worst]


def _verdict(size: float, bus: int, grid: StaticGrid) -> str:
    good, fair = _limits_mva(grid)
    word = "a solution" if size <= good else "a solution with few digits" if size <= fair else "no solution"
    return f"stored voltages of {len(grid.buses)} buses: largest mismatch {size:.3g} MVA at bus {bus}: {word}"


def _free_reactive(grid: StaticGrid) -> None:
    """Q of a load that holds a voltage is what the stored voltages leave over at its bus."""
    free = [load for load in grid.loads if load.q_free]
    if not free:
        return
    arrays = _Arrays(grid)
    _balance(arrays, arrays.start, free)
    for load in free:
        load.q_free = False


def _balance(arrays: _Arrays, V: npt.NDArray[np.complex128], loads: Sequence[StaticLoad]) -> None:
    """Give `loads` the Q that voltages `V` leave over at their buses, in equal parts at one bus."""
    off = arrays.off(V) * arrays.grid.base_mva
    for load in loads:
        load.q -= float(off[arrays.at[load.bus]].imag) / sum(other.bus == load.bus for other in loads)


def _set_converters(grid: StaticGrid, loads: Sequence[StaticLoad], report: Report) -> list[StaticLoad]:
    """Give converters the set-points of the file; return those that hold the voltage of their bus.

    At a bus whose units hold the voltage a converter gives no reactive power.
    """
    sourced = {unit.bus for unit in grid.units if grid.buses[unit.bus].kind != LOAD}
    holding = []
    for load in loads:
        if load.set_q is None and load.set_v is None:
            report.assume(
                "Q of a dc line or FACTS device is what stored voltages leave over that are not a solution",
                load.where,
            )
            continue
        report.assume(
            "converter holds its set-point, because the stored voltages are not a solution", load.where
        )
        load.q = -(load.set_q or 0.0)
        if load.set_v is not None and load.bus not in sourced:
            grid.buses[load.bus].v = load.set_v
            holding.append(load)
    return holding


def _newton(
    arrays: _Arrays,
    free_angle: npt.NDArray[np.int_],
    free_magnitude: npt.NDArray[np.int_],
    held: npt.NDArray[np.bool_],
) -> npt.NDArray[np.complex128]:
    magnitude = np.where(held, np.abs(arrays.start), 1.0)
    attempts: list[tuple[float, Iterate, npt.NDArray[np.float64]]] = []
    for start in (arrays.start, magnitude * np.exp(1j * _flat_angles(arrays, free_angle))):
        result = newton(
            arrays.Y,
            start,
            arrays.power,
            free_angle,
            free_magnitude,
            current=arrays.current,
            tolerance_pu=_TOLERANCE_PU,
        )
        if result is not None and result.converged:
            return result.voltages
        if result is not None:
            size = result.at_bus(free_angle, free_magnitude) * arrays.grid.base_mva
            attempts.append((float(size.max()), result, size))
    grid, numbers = arrays.grid, arrays.numbers
    if not attempts:
        raise PowerFlowError(f"{grid.source}: the power flow has no finite iterate")
    worst, best, size = min(attempts, key=lambda each: each[0])
    at, volts = numbers[int(np.argmax(size))], np.abs(best.voltages)
    low, high = int(np.argmin(volts)), int(np.argmax(volts))
    raise PowerFlowError(
        f"{grid.source}: the power flow does not converge: largest mismatch {worst:.4g} MVA at bus {at} "
        f"({grid.buses[at].where}); its best voltages range from {volts[low]:.4g} pu at bus {numbers[low]} "
        f"to {volts[high]:.4g} pu at bus {numbers[high]}",
        voltages=dict(zip(numbers, map(complex, best.voltages), strict=True)),
    )


def _flat_angles(arrays: _Arrays, free_angle: npt.NDArray[np.int_]) -> npt.NDArray[np.float64]:
    """The angle of the slack of its island at each bus, (buses,) rad."""
    fixed = set(range(len(arrays.numbers))) - set(free_angle.tolist())
    angles, stored = np.zeros(len(arrays.numbers)), np.angle(arrays.start)
    for island in live_islands(arrays.grid):
        rows = [arrays.at[bus] for bus in island]
        angles[rows] = next(stored[k] for k in rows if k in fixed)
    return angles


def _generation(
    grid: StaticGrid, arrays: _Arrays, V: npt.NDArray[np.complex128], held: npt.NDArray[np.bool_]
) -> list[complex]:
    """P + jQ of each unit in MW: as stored, with what changed at its bus shared by rating."""
    change = arrays.off(V) * grid.base_mva
    rating: dict[int, float] = {}
    for unit in grid.units:
        rating[unit.bus] = rating.get(unit.bus, 0.0) + unit.base
    result = []
    for unit in grid.units:
        k = arrays.at[unit.bus]
        share = unit.base / rating[unit.bus]
        extra = complex(change[k]) if held[k] else 0j
        result.append(complex(unit.p, unit.q) + share * extra)
    return result
