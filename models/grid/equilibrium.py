"""The exact operating point: states and set-points for which every derivative is zero."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import splu

from ..case.case import Case, CaseError
from ..case.checks import require_dynamics
from ..case.schema import Machine
from .bus_devices import AirGap, air_gap, has_port, port_loads, saturation_factor, saturation_of
from .control_tables import Controls, controls_at_rest
from .coupling import AtRest, bus_points
from .machine_tables import NETWORK, MachinePoint, State
from .network import bus_index, load_power, machine_bus_index, machine_norton_admittance, sparse_admittance
from .powerflow import PowerFlow, solve_powerflow, with_nodes
from .series import with_series_nodes

VOLTAGE_TOLERANCE_PU = 1e-8  #: most by which the dynamic network may differ from the power flow
_REPETITIONS = 20  #: of the linear network; each brings the loads' volts about a digit closer


@dataclass(frozen=True)
class OperatingPoint:
    """Equilibrium of a case; arrays read-only.

    States come quantity by quantity for the machines (all `delta`, all `slip`, ...), then for each group of
    devices of one kind and structure.
    """

    case: Case
    power_flow: PowerFlow
    machines: tuple[MachinePoint, ...]  #: per unit on each machine's base
    controls: Controls
    states: tuple[State, ...]
    load_volts: npt.NDArray[np.float64]  #: (loads,) voltage magnitude at each load, as the plant solves it
    gaps: tuple[AirGap | None, ...]  #: of machines that saturate or have X''d != X''q
    x0: npt.NDArray[np.float64]  #: (states,)
    u0: npt.NDArray[np.float64]  #: (inputs,) zero: the set-points are in the devices

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states in order."""
        return tuple(s.name for s in self.states)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs: one per exciter, then one per SVC or STATCOM, two per converter."""
        return tuple(named_input.name for named_input in self.controls.inputs)


def operating_point(case: Case, power_flow: PowerFlow | None = None) -> OperatingPoint:
    r"""Return the equilibrium of `case` at its power flow (computed if not given).

    With terminal voltage V and current I of a machine, :math:`\delta = \arg(V + (R_a + jX_q) I)`; in the
    rotor frame :math:`(v_q - j v_d) = V e^{-j\delta}`, :math:`(i_q - j i_d) = I e^{-j\delta}` and

    .. math::
        e''_q = v_q + R_a i_q + X''_d i_d, \quad e''_d = v_d + R_a i_d - X''_q i_q, \quad
        e'_q = e''_q + (X'_d - X''_d) i_d, \quad e'_d = e''_d - (X'_q - X''_q) i_q, \quad
        E_{fd} = e'_q + (X_d - X'_d) i_d .

    With saturation, X_q in the angle becomes :math:`X_l + K_s (X_q - X_l)` and the rotor circuits see
    :math:`i_d + i_{sd}`, :math:`i_q + i_{sq}` (plant/machine/saturation.h).

    The currents are then recomputed from the EMFs by the network solution of the plant, so that the
    set-points match the plant to rounding. [Kundur1994, sec. 13.3]

    Raises
    ------
    CaseError : a machine without dynamic data, a limit that excludes the operating point, or the power flow
    of another case.

    >>> from interarea.models.case.case import load_case
    >>> point = operating_point(load_case("kundur-thyristor-z"))
    >>> len(point.x0), point.input_names[0]
    (32, 'G1_vs')
    """
    case = with_series_nodes(case)
    power_flow = solve_powerflow(case) if power_flow is None else with_nodes(power_flow, case)
    return _assemble(case, power_flow, *machine_points(case, power_flow))


def machine_points(
    case: Case, power_flow: PowerFlow
) -> tuple[
    tuple[MachinePoint, ...],
    npt.NDArray[np.float64],
    tuple[AirGap | None, ...],
    tuple[AtRest, ...],
]:
    """Return the machines at rest, the loads' volts, the machines' air gaps and the devices at buses, without
    any control.

    Raises
    ------
    CaseError : a machine without dynamic data, or the power flow of another case.
    """
    require_dynamics(case)
    bus = machine_bus_index(case)
    base = np.array([m.base_mva / case.base_mva for m in case.machines])
    voltage = power_flow.voltages[bus]
    current = np.conj(power_flow.generation / voltage)
    emf = np.empty(len(base), dtype=complex)
    delta = np.empty(len(base))
    for k, m in enumerate(case.machines):
        i = current[k] / base[k]
        delta[k] = rotor_angle(m, complex(voltage[k]), complex(i))
        emf[k] = voltage[k] + complex(m.Ra, m.number("Xd1" if m.has_constant_emf else "Xd2")) * i
    solved, current, load_volts = _network(case, power_flow, emf)
    worst = int(np.argmax(np.abs(solved - power_flow.voltages)))
    error = abs(solved[worst] - power_flow.voltages[worst])
    if not error <= VOLTAGE_TOLERANCE_PU:
        raise CaseError(
            f"{case.name}: the equilibrium of the network differs from the power flow by {error:.3g} pu "
            "at bus "
            f"{case.buses[worst].number}, allowed: {VOLTAGE_TOLERANCE_PU:g}; use the power flow of this case"
        )
    points, gaps = [], []
    for k, m in enumerate(case.machines):
        i, gap = complex(current[k] / base[k]), None
        if has_port(m):
            terminal = complex(emf[k]) - complex(m.Ra, m.number("Xd2")) * i
            delta[k] = rotor_angle(m, terminal, i)
            gap = air_gap(m, terminal, i, float(delta[k]))
        points.append(_machine_point(m, float(delta[k]), complex(emf[k]), i, gap))
        gaps.append(gap)
    return tuple(points), load_volts, tuple(gaps), bus_points(case, power_flow.at_buses, solved)


def rotor_angle(m: Machine, voltage: complex, current: complex) -> float:
    """Return the angle of the q axis (classical: of the EMF) at a terminal phasor, machine base, rad."""
    if m.has_constant_emf:
        return float(np.angle(voltage + complex(m.Ra, m.number("Xd1")) * current))
    Xq, Xl = m.number("Xq"), m.number("Xl")
    if saturation_of(m) is not None:
        factor = saturation_factor(m, abs(voltage + complex(m.Ra, Xl) * current))
        Xq = Xl + (Xq - Xl) / (1.0 + factor)
    if m.flux_saturation is not None and m.flux_saturation.axes == "both":
        Xl, Xq2 = m.number("Xl"), m.number("Xq2")
        behind = voltage + complex(m.Ra, Xq2) * current
        share = m.flux_saturation.factor(abs(behind)) * (Xq - Xl) / (m.number("Xd") - Xl)
        return float(np.angle((1.0 + share) * behind + 1j * (Xq - Xq2) * current))
    return float(np.angle(voltage + complex(m.Ra, Xq) * current))


def _network(
    case: Case, power_flow: PowerFlow, emf: npt.NDArray[np.complex128]
) -> tuple[npt.NDArray[np.complex128], npt.NDArray[np.complex128], npt.NDArray[np.float64]]:
    """Bus voltages, machine currents (system base) and the loads' volts, from the EMFs.

    Loads and devices at buses are admittances that draw their power at those volts. Those with a port must
    draw it at the voltages found, or the port would not be at rest: their volts are found by repetition, from
    those of the power flow, for as long as it leads nearer.
    """
    index, loads = bus_index(case), len(case.loads)
    rows = (*case.loads, *case.at_buses)
    at = np.array(
        [index[row.bus] for row in rows] + [index[row.seen_bus] for row in case.links], dtype=np.int64
    )
    volts = np.abs(power_flow.voltages[at])
    ports = [*port_loads(case), *range(loads, len(at))]
    drawn = [load_power(case, load) if load.in_service else 0j for load in case.loads]
    solve = _linear_network(
        case, emf, at, np.array([*drawn, *(-power_flow.at_buses), *(-power_flow.inverters)], dtype=complex)
    )
    voltages, current = solve(volts)
    moved = np.inf
    for _ in range(_REPETITIONS if ports else 0):
        nearer = volts.copy()
        nearer[ports] = np.abs(voltages[at[ports]])
        last, moved = moved, float(np.max(np.abs(nearer - volts)))
        if not 1e-15 <= moved < last:
            break
        volts = nearer
        voltages, current = solve(volts)
    return voltages, current, volts[:loads]


def _linear_network(
    case: Case,
    emf: npt.NDArray[np.complex128],
    at: npt.NDArray[np.int64],
    drawn: npt.NDArray[np.complex128],
) -> Callable[[npt.NDArray[np.float64]], tuple[npt.NDArray[np.complex128], npt.NDArray[np.complex128]]]:
    """Return what gives bus voltages and machine currents for the volts of what is `drawn` at buses `at`."""
    index, admittance = bus_index(case), sparse_admittance(case)
    bus, norton = machine_bus_index(case), machine_norton_admittance(case)
    drawn = np.conj(drawn)
    injected = np.zeros(len(index), dtype=complex)
    np.add.at(injected, bus, norton * emf)

    def solve(
        volts: npt.NDArray[np.float64],
    ) -> tuple[npt.NDArray[np.complex128], npt.NDArray[np.complex128]]:
        diagonal = np.zeros(len(index), dtype=complex)
        for bus_of, power, volt in zip(at, drawn, volts, strict=True):
            diagonal[bus_of] += power / volt**2
        np.add.at(diagonal, bus, norton)
        Y = (admittance + sparse.diags(diagonal)).tocsc()
        factors = splu(Y)
        voltages = factors.solve(injected)
        voltages = voltages + factors.solve(injected - Y @ voltages)  # once refined
        return np.asarray(voltages, dtype=complex), np.asarray(norton * (emf - voltages[bus]), dtype=complex)

    return solve


def _machine_point(
    m: Machine, delta: float, emf: complex, current: complex, gap: AirGap | None
) -> MachinePoint:
    """The machine at equilibrium; `emf` is behind Ra + j Xd2, which with a port is not eq2 - j ed2."""
    if m.has_constant_emf:
        drop = complex(m.Ra, m.number("Xd1")) * current
        power = float((emf * np.conj(current)).real)
        turn = np.exp(-1j * delta)
        v, i = (emf - drop) * turn, current * turn
        at_terminal = {"vd": -v.imag, "vq": v.real, "id": -i.imag, "iq": i.real}
        return MachinePoint(delta, 0.0, 0.0, abs(emf), 0.0, abs(emf), power, abs(v), **at_terminal)
    Xd, Xd1, Xd2, Xq1, Xq2 = (m.number(key) for key in ("Xd", "Xd1", "Xd2", "Xq1", "Xq2"))
    turn = np.exp(-1j * delta)
    e, i = emf * turn, current * turn
    eq2, ed2, iq, id_ = e.real, -e.imag, i.real, -i.imag
    if gap is not None:
        ed2 -= (Xq2 - Xd2) * iq
    isd, isq = (0.0, 0.0) if gap is None else (gap.isd, gap.isq)
    Xl = m.number("Xl")
    eq2_rotor, ed2_rotor = eq2 + (Xd2 - Xl) * isd, ed2 - (Xq2 - Xl) * isq
    eq1 = eq2_rotor + (Xd1 - Xd2) * (id_ + isd)
    vd, vq = ed2 - m.Ra * id_ + Xq2 * iq, eq2 - m.Ra * iq - Xd2 * id_
    return MachinePoint(
        delta=delta,
        eq1=eq1,
        ed1=0.0 if m.one_q_winding else ed2_rotor - (Xq1 - Xq2) * (iq + isq),
        eq2=eq2_rotor,
        ed2=ed2_rotor,
        efd=eq1 + (Xd - Xd1) * (id_ + isd) + _field_saturation(m, eq1, eq2_rotor, ed2_rotor),
        pm=ed2 * id_ + eq2 * iq + (Xq2 - Xd2) * id_ * iq,
        vt=float(np.hypot(vd, vq)),
        vd=float(vd),
        vq=float(vq),
        id=float(id_),
        iq=float(iq),
    )


def _field_saturation(m: Machine, eq1: float, eq2: float, ed2: float) -> float:
    """What explicit saturation adds to the field current."""
    s = m.flux_saturation
    if s is None:
        return 0.0
    return s.factor(eq1) * eq1 if s.of == "transient_emf" else s.factor(float(np.hypot(eq2, ed2))) * eq2


def _assemble(
    case: Case,
    power_flow: PowerFlow,
    points: tuple[MachinePoint, ...],
    load_volts: npt.NDArray[np.float64],
    gaps: tuple[AirGap | None, ...],
    buses: tuple[AtRest, ...],
) -> OperatingPoint:
    controls = controls_at_rest(case, points, buses)
    states = _machine_states(case, points, controls.outputs("exciter"), controls.outputs("governor"))
    states += controls.states()
    x0 = np.array([s.start for s in states])
    u0 = np.zeros(len(controls.inputs))
    for array in (x0, u0, load_volts):
        array.flags.writeable = False
    return OperatingPoint(case, power_flow, points, controls, tuple(states), load_volts, gaps, x0, u0)


def _machine_states(
    case: Case,
    points: tuple[MachinePoint, ...],
    field_voltage: tuple[frozenset[str], ...],
    power: tuple[frozenset[str], ...],
) -> list[State]:
    network = frozenset({NETWORK})
    words = {
        "delta": ("rad", "rotor angle to the synchronous frame"),
        "slip": ("pu", "speed deviation"),
        "eq1": ("pu", "transient EMF, q axis"),
        "ed1": ("pu", "transient EMF, d axis"),
        "eq2": ("pu", "subtransient EMF, q axis"),
        "ed2": ("pu", "subtransient EMF, d axis"),
    }
    states = []
    for key, (unit, description) in words.items():
        for k, (m, point) in enumerate(zip(case.machines, points, strict=True)):
            if m.has_constant_emf and key not in ("delta", "slip"):
                continue
            own = frozenset({f"{m.name}.{key}"})
            depends = {
                "delta": frozenset({f"{m.name}.slip"}),
                "slip": network | power[k] | (own if m.D or m.torque_by_speed else frozenset()),
                "eq1": network | own | field_voltage[k],
                "ed1": network | own,
                "eq2": network | {f"{m.name}.eq1"} | field_voltage[k],
                "ed2": network | {f"{m.name}.ed1"},
            }[key]
            start = 0.0 if key == "slip" else float(getattr(point, key))
            states.append(State(f"{m.name}.{key}", start, unit, description, depends))
    return states
