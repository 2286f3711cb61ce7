"""The two-area system with an SVC of the Power System Toolbox, written apart from the package.

Rates of its 54 states and their eigenvalues; with the Toolbox's own terms of speed (EMFs multiplied by speed,
torques as powers over speed), which PSTess has and the package has not, or without. Numbers: file d2adcensvc
of PSTess 1.1; as released, buses 3 and 101 have sources of constant reactive power.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

BUSES = (1, 2, 3, 4, 10, 11, 12, 13, 14, 20, 101, 110, 120)
LINES = (
    (1, 10, 0.0, 0.0167, 0.0), (2, 20, 0.0, 0.0167, 0.0), (3, 4, 0.0, 0.005, 0.0),
    (3, 20, 0.001, 0.01, 0.0175), (3, 101, 0.011, 0.11, 0.1925), (3, 101, 0.011, 0.11, 0.1925),
    (10, 20, 0.0025, 0.025, 0.0437), (11, 110, 0.0, 0.0167, 0.0), (12, 120, 0.0, 0.0167, 0.0),
    (13, 14, 0.0, 0.005, 0.0), (13, 101, 0.011, 0.11, 0.1925), (13, 101, 0.011, 0.11, 0.1925),
    (13, 120, 0.001, 0.01, 0.0175), (110, 120, 0.0025, 0.025, 0.0437),
)  # fmt: skip
HELD = {1: 1.03, 2: 1.01, 3: 1.0, 11: 1.03, 12: 1.01, 13: 1.0, 101: 1.05}
POWER = {2: 7.0, 11: 7.16, 12: 7.0, 4: -9.76, 14: -17.67}
REACTIVE = {4: -1.0, 14: -1.0}
SHUNT = {3: 3.0, 13: 5.0, 101: 1.0}
MACHINES = (1, 2, 11, 12)
SLACK_DEG, RATIO, OMEGA = 18.5, 9.0, 2.0 * np.pi * 60.0
Ra, Xl, Xd, Xd1, Xd2, Xq, Xq1 = 0.0025, 0.2, 1.8, 0.3, 0.25, 1.7, 0.55
Td01, Td02, Tq01, Tq02, H = 8.0, 0.03, 0.4, 0.05, 6.5
TR, KA, TA, TE, KF, TF, E1, S1, E2, S2 = 0.01, 46.0, 0.06, 0.46, 0.1, 1.0, 3.1, 0.33, 2.3, 0.1
GAIN, TS, TC3, T3, T4, T5 = 25.0, 0.1, 0.5, 0.0, 1.25, 5.0
SVC = {"K": 10.0, "TR": 0.05, "TC": 0.65, "TB": 0.2}  #: gain on 100 MVA
B_SATURATION = np.log(E1 * S1 / (E2 * S2)) / (E1 - E2)
A_SATURATION = S1 / np.exp(B_SATURATION * E1)


SERIES = 4  #: place in LINES of the one that a series capacitor may stand in


def admittance(series: float = 0.0) -> np.ndarray:
    """Return the bus matrix of lines and shunts, (13, 13), with that capacitive reactance in a line."""
    at = {bus: k for k, bus in enumerate(BUSES)}
    Y = np.zeros((len(BUSES),) * 2, dtype=complex)
    for place, (one, other, r, x, b) in enumerate(LINES):
        y = 1.0 / complex(r, x - series * (place == SERIES))
        k, j = at[one], at[other]
        Y[[k, j], [k, j]] += y + 0.5j * b
        Y[[k, j], [j, k]] -= y
    for bus, b in SHUNT.items():
        Y[at[bus], at[bus]] += 1j * b
    return Y


def solved(
    Y: np.ndarray, buses: tuple, held: dict, power: dict, reactive: dict, slack: tuple[int, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return voltages and injected powers of the buses by Newton's method; slack: bus and its angle, deg."""
    n, at = len(buses), {bus: k for k, bus in enumerate(buses)}
    free = [k for k, bus in enumerate(buses) if bus not in held]
    turning = [k for k, bus in enumerate(buses) if bus != slack[0]]
    p, q = np.zeros(n), np.zeros(n)
    for values, table in ((p, power), (q, reactive)):
        for bus, value in table.items():
            values[at[bus]] = value
    size = np.array([held.get(bus, 1.0) for bus in buses])
    angle = np.full(n, np.radians(slack[1]))
    for _ in range(30):
        V = size * np.exp(1j * angle)
        current = Y @ V
        S = V * np.conj(current)
        miss = np.concatenate([(S.real - p)[turning], (S.imag - q)[free]])
        if np.max(np.abs(miss)) < 1e-13:
            break
        by_angle = 1j * np.diag(V) @ np.conj(np.diag(current) - Y @ np.diag(V))
        by_size = np.diag(V / size) @ np.conj(np.diag(current)) + np.diag(V) @ np.conj(Y @ np.diag(V / size))
        J = np.block(
            [
                [by_angle.real[np.ix_(turning, turning)], by_size.real[np.ix_(turning, free)]],
                [by_angle.imag[np.ix_(free, turning)], by_size.imag[np.ix_(free, free)]],
            ]
        )
        step = np.linalg.solve(J, -miss)
        angle[turning] += step[: len(turning)]
        size[free] += step[len(turning) :]
    V = size * np.exp(1j * angle)
    return V, V * np.conj(Y @ V)


def power_flow(series: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return voltages and injected powers of the buses, (13,) each."""
    return solved(admittance(series), BUSES, HELD, POWER, REACTIVE, (1, SLACK_DEG))


def rotor_at_rest(v: np.ndarray, i: np.ndarray) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Return delta, eq1, ed1, psi_d, psi_q, then the field voltage and the torque."""
    delta = np.angle(v + complex(Ra, Xq) * i)
    frame = np.exp(-1j * delta)
    iq, id_ = (i * frame).real, -(i * frame).imag
    e = (v + complex(Ra, Xd2) * i) * frame
    eq2, ed2 = e.real, -e.imag
    eq1, ed1 = eq2 + (Xd1 - Xd2) * id_, ed2 - (Xq1 - Xd2) * iq
    psi_d, psi_q = eq1 - (Xd1 - Xl) * id_, ed1 + (Xq1 - Xl) * iq
    torque = (e * np.conj(i * frame)).real
    return [delta, eq1, ed1, psi_d, psi_q], eq1 + (Xd - Xd1) * id_, torque


def subtransient_emf(eq1: np.ndarray, ed1: np.ndarray, psi_d: np.ndarray, psi_q: np.ndarray) -> np.ndarray:
    """Return the EMF behind Ra + j X'' in the frame of the rotor, q axis real."""
    a, c = (Xd2 - Xl) / (Xd1 - Xl), (Xd2 - Xl) / (Xq1 - Xl)
    return a * eq1 + (1.0 - a) * psi_d - 1j * (c * ed1 + (1.0 - c) * psi_q)


def winding_rates(
    eq1: np.ndarray, ed1: np.ndarray, psi_d: np.ndarray, psi_q: np.ndarray, i: np.ndarray, efd: np.ndarray
) -> list[np.ndarray]:
    """Return the rates of eq1, ed1, psi_d, psi_q for a current in the frame of the rotor."""
    iq, id_ = i.real, -i.imag
    deq = eq1 - psi_d - (Xd1 - Xl) * id_
    ded = ed1 - psi_q + (Xq1 - Xl) * iq
    field = eq1 + (Xd - Xd1) * (id_ + (Xd1 - Xd2) / (Xd1 - Xl) ** 2 * deq)
    d_axis = ed1 - (Xq - Xq1) * (iq - (Xq1 - Xd2) / (Xq1 - Xl) ** 2 * ded)
    return [(efd - field) / Td01, -d_axis / Tq01, deq / Td02, ded / Tq02]


def matrix_of(rates: Callable[[np.ndarray], np.ndarray], x0: np.ndarray, step: float = 1e-4) -> np.ndarray:
    """Return A by differences of fourth order."""
    columns = []
    for k in range(len(x0)):
        d = np.zeros(len(x0))
        d[k] = step
        near, far = rates(x0 + d) - rates(x0 - d), rates(x0 + 2.0 * d) - rates(x0 - 2.0 * d)
        columns.append((8.0 * near - far) / (12.0 * step))
    return np.array(columns).T


class TwoAreaSvc:
    """Rates of 54 states: delta, slip, eq1, ed1, psi_d, psi_q, exciter 4, governor 3 of all machines; SVC."""

    def __init__(self, *, speed_terms: bool, series: float = 0.0) -> None:
        self.speed_terms = speed_terms
        self.at = {bus: k for k, bus in enumerate(BUSES)}
        self.machine = np.array([self.at[bus] for bus in MACHINES])
        V, S = power_flow(series)
        self.V0, self.S0 = V, S
        Y = admittance(series)
        for bus in (3, 101):  # constant reactive power of sources, as admittances
            Y[self.at[bus], self.at[bus]] += 1j * S[self.at[bus]].imag / abs(V[self.at[bus]]) ** 2
        self.loads = np.array([self.at[4], self.at[14]])
        drawn = -S[self.loads]
        Y[self.loads, self.loads] += (0.5 * drawn.real - 1j * drawn.imag) / np.abs(V[self.loads]) ** 2
        self.current = 0.5 * drawn.real / np.abs(V[self.loads])  # constant current half of P
        norton = RATIO / complex(Ra, Xd2)
        Y[self.machine, self.machine] += norton
        self.Y, self.norton = Y, norton
        self.svc = self.at[13]
        self.x0 = self.rest(V, S)

    def rest(self, V: np.ndarray, S: np.ndarray) -> np.ndarray:
        """Return the states at rest, and keep the set-points."""
        v, s = V[self.machine], S[self.machine]
        (delta, *windings), efd, self.pm0 = rotor_at_rest(v, np.conj(s / v) / RATIO)
        saturation = A_SATURATION * np.exp(B_SATURATION * efd)
        self.KE = -saturation / efd  # the Toolbox's, where KE is given as 0
        vr = (self.KE + saturation) * efd
        self.vref = np.abs(v) + vr / KA
        self.gref = self.pm0.copy()
        y1, y2 = self.gref * (1.0 - T3 / TC3), self.gref * (1.0 - T4 / T5)
        v13, b = abs(V[self.svc]), S[self.svc].imag / abs(V[self.svc]) ** 2
        self.sref = v13 + b / SVC["K"]
        bc = b * (1.0 - SVC["TC"] / SVC["TB"]) / SVC["K"]
        machines = [delta, 0.0 * delta, *windings, np.abs(v), vr, efd, efd, self.gref, y1, y2]
        return np.concatenate([*machines, [bc, b]])

    def network(self, emf: np.ndarray, b: float) -> np.ndarray:
        """Return the bus voltages for EMFs behind Ra + j X''."""
        V = self.V0.copy()
        Y = self.Y.copy()
        Y[self.svc, self.svc] += 1j * b
        lu = np.linalg.inv(Y)
        for _ in range(200):
            injected = np.zeros(len(V), dtype=complex)
            injected[self.machine] = self.norton * emf
            at = V[self.loads]
            injected[self.loads] = -self.current * at / np.abs(at)
            new = lu @ injected
            moved = np.max(np.abs(new - V))
            V = new
            if moved < 1e-14:
                break
        return V

    def rates(self, x: np.ndarray, v_mod: float = 0.0) -> np.ndarray:
        """Return dx/dt."""
        delta, slip, *windings, vm, vr, efd, rf, g1, g2, g3 = x[:52].reshape(13, 4)
        bc, b = x[52:]
        speed = 1.0 + slip if self.speed_terms else 1.0
        emf = speed * subtransient_emf(*windings) * np.exp(1j * delta)
        V = self.network(emf, b)
        v = V[self.machine]
        i = (emf - v) / complex(Ra, Xd2) * np.exp(-1j * delta)
        power = (emf * np.exp(-1j * delta) * np.conj(i)).real
        demand = self.gref - GAIN * slip
        y1 = g2 + T3 / TC3 * g1
        pm = g3 + T4 / T5 * y1
        feedback = KF / TF * (efd - rf)
        svc_error = self.sref + v_mod - abs(V[self.svc])
        lead = SVC["TC"] / SVC["TB"]
        return np.concatenate(
            [
                OMEGA * slip,
                (pm - power) / speed / (2.0 * H),
                *winding_rates(*windings, i, efd),
                (np.abs(v) - vm) / TR,
                (KA * (self.vref - vm - feedback) - vr) / TA,
                (vr - (self.KE + A_SATURATION * np.exp(B_SATURATION * efd)) * efd) / TE,
                (efd - rf) / TF,
                (demand - g1) / TS,
                ((1.0 - T3 / TC3) * g1 - g2) / TC3,
                ((1.0 - T4 / T5) * y1 - g3) / T5,
                [(svc_error * (1.0 - lead) - bc) / SVC["TB"]],
                [(SVC["K"] * (svc_error * lead + bc) - b) / SVC["TR"]],
            ]
        )

    def matrix(self) -> np.ndarray:
        """Return A (54, 54)."""
        return matrix_of(self.rates, self.x0)

    def input_column(self, step: float = 1e-4) -> np.ndarray:
        """Return B (54,) of the SVC's modulation."""
        return (self.rates(self.x0, step) - self.rates(self.x0, -step)) / (2.0 * step)


class TwoAreaTcsc(TwoAreaSvc):
    """The same with the reactance x of a capacitor in a line as state 55: T x' = x0 + x_mod - x."""

    def __init__(self, series: float, T: float) -> None:
        super().__init__(speed_terms=False, series=series)
        self.series, self.T, self.rest_Y = series, T, self.Y
        self.x0 = np.append(self.x0, series)

    def rates(self, x: np.ndarray, x_mod: float = 0.0) -> np.ndarray:
        """Return dx/dt; the bus matrix is made anew with the line as it is."""
        self.Y = self.rest_Y + admittance(x[54]) - admittance(self.series)
        return np.append(super().rates(x[:54]), (self.series + x_mod - x[54]) / self.T)
