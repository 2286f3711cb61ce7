"""Newton power flow in polar form with the exact Jacobian."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..case.case import Case, CaseError
from .network import ComplexArray, admittance_matrix, branch_stamp, bus_index, load_power, machine_bus_index

TOLERANCE_PU = 1e-10
_MOST_ITERATIONS = 40


class PowerFlowError(CaseError):
    """The power flow has no solution that Newton's method finds from a flat start."""


@dataclass(frozen=True)
class PowerFlow:
    """Solved bus voltages; arrays read-only, pu on the base of the case, in its bus and machine order."""

    case: Case
    voltages: ComplexArray  #: (buses,)
    injections: ComplexArray  #: (buses,) generation less load, shunts belong to the network
    generation: ComplexArray  #: (machines,) P + jQ of each machine
    iterations: int
    mismatch_pu: float  #: largest |P| or |Q| mismatch left

    @property
    def magnitudes(self) -> npt.NDArray[np.float64]:
        """Voltage magnitudes, pu."""
        return np.abs(self.voltages)

    @property
    def angles_deg(self) -> npt.NDArray[np.float64]:
        """Voltage angles, degrees."""
        return np.degrees(np.angle(self.voltages))

    def voltage(self, bus: int) -> complex:
        """Return the voltage of bus number `bus`, pu; CaseError when there is no such bus."""
        index = bus_index(self.case)
        if bus not in index:
            raise CaseError(f"{self.case.name}: bus {bus} does not exist")
        return complex(self.voltages[index[bus]])

    def flow(self, branch: str, from_bus: int) -> complex:
        """Return P + jQ that enters `branch` at its end `from_bus`, pu (0 when out of service)."""
        row = self.case.branch(branch)
        if from_bus not in (row.from_bus, row.to_bus):
            raise CaseError(
                f"{self.case.name}: branch {branch!r} ends at {row.from_bus} and {row.to_bus}, got {from_bus}"
            )
        if not row.in_service:
            return 0j
        ends = np.array([self.voltage(row.from_bus), self.voltage(row.to_bus)])
        power = ends * np.conj(branch_stamp(row) @ ends)
        return complex(power[0 if from_bus == row.from_bus else 1])

    @property
    def tie_p(self) -> float:
        """Active power over the tie of the case, pu; CaseError when the case names none."""
        tie = self.case.tie
        if tie is None:
            raise CaseError(f"{self.case.name}: no [tie] in the case")
        return sum(self.flow(name, tie.from_bus).real for name in tie.branches)


def solve_powerflow(case: Case) -> PowerFlow:
    r"""Solve the power flow of `case` from a flat start.

    Slack: voltage and angle given; other machine buses: P and voltage; the rest: P and Q. Loads are constant
    P and Q, shunts are admittances. With :math:`S = V \circ (YV)^*` the Newton step uses

    .. math::
        \partial S/\partial\theta = j\,\mathrm{diag}(V)\,(\mathrm{diag}(I) - Y\,\mathrm{diag}(V))^*, \qquad
        \partial S/\partial|V| = \mathrm{diag}(V)\,(Y\,\mathrm{diag}(\hat V))^* + \mathrm{diag}(I^*\hat V).

    Machine reactive limits are not enforced. Machines at one bus share its Q by their ratings, the slack
    machine takes what P is left.

    Raises
    ------
    PowerFlowError : no convergence; names the bus with the worst mismatch.
    """
    Y = admittance_matrix(case)
    machine_bus = machine_bus_index(case)
    slack = bus_index(case)[case.slack.bus]
    load = _load_at_buses(case)
    scheduled = -load
    np.add.at(scheduled, machine_bus, [m.P_mw / case.base_mva for m in case.machines])

    n = len(case.buses)
    magnitude = np.ones(n)
    magnitude[machine_bus] = [m.V_pu for m in case.machines]
    angle = np.full(n, np.deg2rad(case.slack.angle_deg))
    free_angle = np.array([k for k in range(n) if k != slack], dtype=int)
    free_magnitude = np.array(sorted(set(range(n)) - set(machine_bus.tolist())), dtype=int)

    best: tuple[float, ComplexArray, int] | None = None
    for iteration in range(_MOST_ITERATIONS):
        V: ComplexArray = np.asarray(magnitude * np.exp(1j * angle), dtype=complex)
        off = V * np.conj(Y @ V) - scheduled
        residual = np.concatenate([off.real[free_angle], off.imag[free_magnitude]])
        worst = float(np.max(np.abs(residual), initial=0.0))
        if not np.isfinite(worst):
            break
        if best is not None and worst <= TOLERANCE_PU and worst > 0.5 * best[0]:
            break  # converged, and rounding keeps it from getting better
        if best is None or worst < best[0]:
            best = (worst, V, iteration)
        if worst == 0.0:
            break
        try:
            step = np.linalg.solve(_jacobian(Y, V, free_angle, free_magnitude), residual)
        except np.linalg.LinAlgError:
            break
        angle[free_angle] -= step[: len(free_angle)]
        magnitude[free_magnitude] -= step[len(free_angle) :]
    if best is None or not best[0] <= TOLERANCE_PU:
        raise PowerFlowError(_no_convergence(case, Y, best, scheduled, free_angle, free_magnitude))
    return _solved(case, Y, best, load, slack)


def _load_at_buses(case: Case) -> ComplexArray:
    index = bus_index(case)
    load = np.zeros(len(index), dtype=complex)
    for row in case.loads:
        if row.in_service:
            load[index[row.bus]] += load_power(case, row)
    return load


def _jacobian(
    Y: ComplexArray,
    V: ComplexArray,
    free_angle: npt.NDArray[np.int_],
    free_magnitude: npt.NDArray[np.int_],
) -> npt.NDArray[np.float64]:
    current = Y @ V
    unit = V / np.abs(V)
    by_angle = 1j * V[:, None] * np.conj(np.diag(current) - Y * V)
    by_magnitude = V[:, None] * np.conj(Y * unit) + np.diag(np.conj(current) * unit)
    return np.block(
        [
            [
                by_angle.real[np.ix_(free_angle, free_angle)],
                by_magnitude.real[np.ix_(free_angle, free_magnitude)],
            ],
            [
                by_angle.imag[np.ix_(free_magnitude, free_angle)],
                by_magnitude.imag[np.ix_(free_magnitude, free_magnitude)],
            ],
        ]
    )


def _no_convergence(
    case: Case,
    Y: ComplexArray,
    best: tuple[float, ComplexArray, int] | None,
    scheduled: ComplexArray,
    free_angle: npt.NDArray[np.int_],
    free_magnitude: npt.NDArray[np.int_],
) -> str:
    start = f"{case.name}: the power flow does not converge"
    advice = "reduce the loads or the transfer, or check branches and voltages"
    if best is None:
        return f"{start} (no finite iterate); {advice}"
    _, V, iteration = best
    off = V * np.conj(Y @ V) - scheduled
    size = np.zeros(len(V))
    size[free_angle] = np.abs(off.real[free_angle])
    size[free_magnitude] = np.maximum(size[free_magnitude], np.abs(off.imag[free_magnitude]))
    k = int(np.argmax(size))
    return (
        f"{start}: worst mismatch {size[k]:.3g} pu at bus {case.buses[k].number} "
        f"(best of {_MOST_ITERATIONS} iterations: number {iteration}), allowed: {TOLERANCE_PU:g} pu; {advice}"
    )


def _solved(
    case: Case, Y: ComplexArray, best: tuple[float, ComplexArray, int], load: ComplexArray, slack: int
) -> PowerFlow:
    mismatch, V, iterations = best
    injections = V * np.conj(Y @ V)
    at_bus = injections + load
    machine_bus = machine_bus_index(case)
    rating = np.array([m.base_mva for m in case.machines])
    generation = np.zeros(len(case.machines), dtype=complex)
    for k, machine in enumerate(case.machines):
        here = machine_bus == machine_bus[k]
        share = rating[k] / rating[here].sum()
        generation[k] = complex(machine.P_mw / case.base_mva, at_bus[machine_bus[k]].imag * share)
    others = [k for k, m in enumerate(case.machines) if machine_bus[k] == slack and not m.slack]
    own = next(k for k, m in enumerate(case.machines) if m.slack)
    generation[own] = complex(at_bus[slack].real - generation[others].real.sum(), generation[own].imag)
    for array in (V, injections, generation):
        array.flags.writeable = False
    return PowerFlow(case, V, injections, generation, iterations, mismatch)
