"""The two-area systems with a dc link of the Power System Toolbox, written apart from the package.

Rates of all states and their eigenvalues; with the Toolbox's own terms of speed (EMFs multiplied by speed,
torques as powers over speed), which PSTess has and the package has not, or without. Numbers: files dtestdc
and dtestdcr of PSTess 1.1. The converters are quasi-static at the voltages behind the commutation reactance,
solved with the network by repetition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from independent.two_area_svc import matrix_of

OMEGA = 2.0 * np.pi * 60.0
Xl, Xd, Xd1, Xd2, Xq = 0.2, 1.8, 0.3, 0.25, 1.7
Td01, Td02, Tq01, H = 8.0, 0.03, 0.4, 6.5
TR, KA, TS, TC3, T4, T5, GAIN = 0.01, 200.0, 0.1, 0.5, 1.25, 5.0, 25.0
PSS, TW, LEADS = 15.0, 20.0, ((0.06, 0.04), (0.08, 0.04))
BRIDGES, XC, KV, DC_KV = 4, 3.0, 110.0, 500.0
BEHIND = XC / BRIDGES * 100.0 / KV**2  #: commutation reactance, pu
NO_LOAD, DROP = 3.0 * np.sqrt(2.0) / np.pi * BRIDGES * KV, 3.0 / np.pi * BRIDGES * XC  #: kV a pu, ohm


@dataclass(frozen=True)
class Numbers:
    """One of the two files."""

    lines: tuple
    held: dict
    power: dict
    reactive: dict
    shunts: dict
    machines: tuple
    ratio: tuple  #: of each machine's base to that of the system
    xq1: tuple
    tq02: tuple  #: the Toolbox takes 999 s for 0, and X'q = X''q there
    slacks: dict  #: bus -> angle, deg
    current: dict  #: bus -> share of P that is constant current
    order: float  #: kA
    ohm: float
    gains: tuple  #: Ko Kp, Ko Ki of the rectifier by kA, those of the inverter by pu
    gamma: float = np.radians(18.0)
    henry: float = 2.05
    ends: tuple = (5, 15)


DTESTDC = Numbers(
    lines=(
        (1, 10, 0.0, 0.0167, 0.0, 1.0), (2, 20, 0.0, 0.0167, 0.0, 1.0), (3, 4, 0.0, 0.005, 0.0, 1.0),
        (3, 5, 0.0, 0.01, 0.0, 1.0), (3, 20, 0.001, 0.01, 0.0175, 1.0), (3, 101, 0.011, 0.11, 0.1925, 1.0),
        (3, 101, 0.011, 0.11, 0.1925, 1.0), (10, 20, 0.0025, 0.025, 0.0437, 1.0),
        (11, 110, 0.0, 0.0167, 0.0, 1.0), (12, 120, 0.0, 0.0167, 0.0, 1.0), (13, 14, 0.0, 0.005, 0.0, 1.0),
        (13, 15, 0.0, 0.01, 0.0, 1.125), (13, 101, 0.011, 0.11, 0.1925, 1.0),
        (13, 101, 0.011, 0.11, 0.1925, 1.0), (13, 120, 0.001, 0.01, 0.0175, 1.0),
        (110, 120, 0.0025, 0.025, 0.0437, 1.0),
    ),
    held={1: 1.03, 2: 1.01, 3: 1.0, 11: 1.03, 12: 1.01, 13: 1.0},
    power={2: 7.5, 3: -1.0, 4: -9.76, 11: 7.16, 12: 7.0, 14: -17.67},
    reactive={4: -1.0, 14: -1.0, 101: 2.0},
    shunts={3: 6.0, 15: 1.0},
    machines=(1, 2, 11, 12),
    ratio=(10.0,) * 4,
    xq1=(0.55, 0.25, 0.55, 0.55),
    tq02=(0.05, 999.0, 0.05, 0.05),
    slacks={1: 18.5},
    current={4: 0.5},
    order=0.2,
    ohm=100.0,
    gains=(0.1, 0.1, 0.1, 0.1),
)  # fmt: skip

DTESTDCR = Numbers(
    lines=(
        (1, 10, 0.0, 0.0167, 0.0, 1.0), (2, 20, 0.0, 0.0167, 0.0, 1.0), (3, 4, 0.0, 0.005, 0.0, 1.0),
        (16, 5, 0.0, 0.001, 0.0, 1.0), (3, 20, 0.001, 0.01, 0.0175, 1.0), (3, 101, 0.011, 0.11, 0.1925, 1.0),
        (3, 101, 0.011, 0.11, 0.1925, 1.0), (10, 20, 0.0025, 0.025, 0.0437, 1.0),
        (11, 110, 0.0, 0.0167, 0.0, 1.0), (12, 120, 0.0, 0.0167, 0.0, 1.0), (13, 14, 0.0, 0.005, 0.0, 1.0),
        (13, 15, 0.0, 0.001, 0.0, 1.115), (13, 101, 0.011, 0.11, 0.1925, 1.0),
        (13, 101, 0.011, 0.11, 0.1925, 1.0), (13, 120, 0.001, 0.01, 0.0175, 1.0),
        (110, 120, 0.0025, 0.025, 0.0437, 1.0),
    ),
    held={1: 1.03, 2: 1.01, 3: 1.0, 11: 1.03, 12: 1.01, 13: 1.0, 16: 1.0},
    power={2: 5.0, 3: -1.0, 4: -9.76, 11: 5.0, 12: 5.0, 14: -17.67},
    reactive={4: -1.0, 14: -1.0, 101: 2.0},
    shunts={3: 6.0, 15: 6.0},
    machines=(1, 2, 11, 12, 16),
    ratio=(9.0,) * 4 + (19.0,),
    xq1=(0.55, 0.25, 0.55, 0.55, 0.55),
    tq02=(0.05, 999.0, 0.05, 0.05, 0.05),
    slacks={1: 18.5, 16: -10.0},
    current={},
    order=1.6,
    ohm=10.0,
    gains=(1.0, 1.0, 0.1, 0.1),
)  # fmt: skip


class TwoAreaDc:
    """Rates of 13 states a machine (delta, slip, eq1, ed1, psi_d, psi_q, exciter, stabilizer 3, governor 3),
    xr, xi and the dc current in kA."""

    def __init__(self, numbers: Numbers, *, speed_terms: bool) -> None:
        self.n, self.speed_terms = numbers, speed_terms
        self.buses = sorted({bus for line in numbers.lines for bus in line[:2]})
        self.at = {bus: k for k, bus in enumerate(self.buses)}
        self.machine = np.array([self.at[bus] for bus in numbers.machines])
        self.ratio, self.tq02 = np.array(numbers.ratio), np.array(numbers.tq02)
        self.xq1 = np.array(numbers.xq1)
        self.ends = np.array([self.at[bus] for bus in numbers.ends])
        self.Y0 = self.admittance()
        V, S = self.power_flow()
        self.V0, self.S0 = V, S
        Y = self.Y0.copy()
        drawn = -S.copy()
        drawn[self.machine] = 0.0
        drawn[self.ends] = 0.0
        share = np.zeros(len(V))
        for bus, part in numbers.current.items():
            share[self.at[bus]] = part
        self.current = share * drawn.real / np.abs(V)
        Y[np.diag_indices(len(V))] += ((1.0 - share) * drawn.real - 1j * drawn.imag) / np.abs(V) ** 2
        self.norton = self.ratio / (1j * Xd2)
        Y[self.machine, self.machine] += self.norton
        self.inverse = np.linalg.inv(Y)
        self.V = V.copy()
        self.x0 = self.rest()

    def admittance(self) -> np.ndarray:
        """Return the bus matrix of lines and shunts; a tap stands at the first bus of its line."""
        Y = np.zeros((len(self.buses),) * 2, dtype=complex)
        for one, other, r, x, b, tap in self.n.lines:
            y, k, j = 1.0 / complex(r, x), self.at[one], self.at[other]
            Y[k, k] += (y + 0.5j * b) / tap**2
            Y[j, j] += y + 0.5j * b
            Y[k, j] -= y / tap
            Y[j, k] -= y / tap
        for bus, b in self.n.shunts.items():
            Y[self.at[bus], self.at[bus]] += 1j * b
        return Y

    def converter(self, v: complex, voltage: float, current: float, sign: float) -> tuple[complex, float]:
        """Return the current that a converter draws from its bus, and the voltage that commutates;
        `voltage` in kV, sign 1 for the rectifier. The bus behind -jX' has v + jX' I."""
        drawn = 0.0j
        for _ in range(200):
            h = v + 1j * BEHIND * drawn
            no_load = NO_LOAD * abs(h)
            p = sign * voltage * current
            q = np.sqrt((no_load * current) ** 2 - p * p)
            new = np.conj(complex(p, q) / 100.0 / h)
            moved, drawn = abs(new - drawn), new
            if moved < 1e-16:
                break
        return drawn, abs(v + 1j * BEHIND * drawn)

    def at_rest_dc(self, V: np.ndarray) -> tuple[np.ndarray, float, float, float]:
        """Return drawn currents, Vdr, Vdi in kV and alpha."""
        vi, i = V[self.ends[1]], self.n.order
        vdi, h = 500.0, abs(vi)
        for _ in range(200):
            vdi = NO_LOAD * h * np.cos(self.n.gamma) - DROP * i
            drawn_i, h = self.converter(vi, vdi, i, -1.0)
        vdr = vdi + self.n.ohm * i
        drawn_r, h = self.converter(V[self.ends[0]], vdr, i, 1.0)
        return np.array([drawn_r, drawn_i]), vdr, vdi, float(np.arccos((vdr + DROP * i) / (NO_LOAD * h)))

    def power_flow(self) -> tuple[np.ndarray, np.ndarray]:
        """Return voltages and injected powers of the buses."""
        n, Y, size = len(self.buses), self.Y0, np.ones(len(self.buses))
        for bus, v in self.n.held.items():
            size[self.at[bus]] = v
        free = [k for k, bus in enumerate(self.buses) if bus not in self.n.held]
        turning = [k for k, bus in enumerate(self.buses) if bus not in self.n.slacks]
        p, q = np.zeros(n), np.zeros(n)
        for values, table in ((p, self.n.power), (q, self.n.reactive)):
            for bus, value in table.items():
                values[self.at[bus]] = value
        angle = np.radians([next(iter(self.n.slacks.values()))] * n)
        for bus, value in self.n.slacks.items():
            angle[self.at[bus]] = np.radians(value)
        for _ in range(60):
            V = size * np.exp(1j * angle)
            drawn = V[self.ends] * np.conj(self.at_rest_dc(V)[0])
            p[self.ends], q[self.ends] = -drawn.real, -drawn.imag
            for _ in range(20):
                V = size * np.exp(1j * angle)
                current = Y @ V
                S = V * np.conj(current)
                miss = np.concatenate([(S.real - p)[turning], (S.imag - q)[free]])
                if np.max(np.abs(miss)) < 2e-13:
                    break
                by_angle = 1j * np.diag(V) @ np.conj(np.diag(current) - Y @ np.diag(V))
                by_size = np.diag(V / size) @ np.conj(np.diag(current)) + np.diag(V) @ np.conj(
                    Y @ np.diag(V / size)
                )
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

    def rest(self) -> np.ndarray:
        """Return the states at rest, and keep the set-points."""
        V, S = self.V0, self.S0
        v, s = V[self.machine], S[self.machine]
        i = np.conj(s / v) / self.ratio
        delta = np.angle(v + 1j * Xq * i)
        frame = np.exp(-1j * delta)
        iq, id_ = (i * frame).real, -(i * frame).imag
        e = (v + 1j * Xd2 * i) * frame
        eq2, ed2 = e.real, -e.imag
        eq1, ed1 = eq2 + (Xd1 - Xd2) * id_, ed2 - (self.xq1 - Xd2) * iq
        psi_d, psi_q = eq1 - (Xd1 - Xl) * id_, ed1 + (self.xq1 - Xl) * iq
        efd = eq1 + (Xd - Xd1) * id_
        self.pm0 = (e * np.conj(i * frame)).real
        self.vref = np.abs(v) + efd / KA
        none = 0.0 * delta
        governor = [self.pm0, self.pm0, self.pm0 * (1.0 - T4 / T5)]
        _, _, self.vdi, alpha = self.at_rest_dc(V)
        machines = [delta, none, eq1, ed1, psi_d, psi_q, np.abs(v), none, none, none, *governor]
        return np.concatenate([*machines, [alpha, self.n.gamma, self.n.order]])

    def network(
        self, emf: np.ndarray, angles: tuple[float, float], i: float
    ) -> tuple[np.ndarray, float, float]:
        """Return bus voltages, Vdr and Vdi in kV; angles: alpha, and xi of the inverter (gamma after Vdi)."""
        V, g = self.V, self.n.gamma
        for _ in range(400):
            drawn, volts = np.zeros(2, dtype=complex), [0.0, 0.0]
            for k, sign in enumerate((1.0, -1.0)):
                v, h = V[self.ends[k]], abs(V[self.ends[k]])
                for _ in range(60):
                    before, angle = h, angles[0] if k == 0 else g
                    volts[k] = NO_LOAD * h * np.cos(angle) - DROP * i
                    drawn[k], h = self.converter(v, volts[k], i, sign)
                    if k == 1:
                        g = angles[1] + self.n.gains[2] * (volts[1] / self.vdi - 1.0)
                    if abs(h - before) < 1e-16:
                        break
            injected = -self.current * V / np.abs(V)
            injected[self.machine] += self.norton * emf
            injected[self.ends] -= drawn
            new = self.inverse @ injected
            moved, V = np.max(np.abs(new - V)), new
            if moved < 3e-15:
                break
        self.V = V
        return V, volts[0], volts[1]

    def rates(self, x: np.ndarray, mod: float = 0.0) -> np.ndarray:
        """Return dx/dt; mod: added to the current order, kA."""
        n = len(self.machine)
        delta, slip, eq1, ed1, psi_d, psi_q, vm, w, s1, s2, g1, g2, g3 = x[: 13 * n].reshape(13, n)
        xr, xi, idc = x[13 * n :]
        a, c = (Xd2 - Xl) / (Xd1 - Xl), (Xd2 - Xl) / (self.xq1 - Xl)
        eq2, ed2 = a * eq1 + (1.0 - a) * psi_d, c * ed1 + (1.0 - c) * psi_q
        speed = 1.0 + slip if self.speed_terms else 1.0
        emf = speed * (eq2 - 1j * ed2) * np.exp(1j * delta)
        error = idc - self.n.order - mod
        V, vdr, vdi = self.network(emf, (xr + self.n.gains[0] * error, xi), idc)
        v = V[self.machine]
        i = (emf - v) / (1j * Xd2) * np.exp(-1j * delta)
        iq, id_ = i.real, -i.imag
        power = (emf * np.exp(-1j * delta) * np.conj(i)).real
        y1 = g2
        pm = g3 + T4 / T5 * y1
        deq, ded = eq1 - psi_d - (Xd1 - Xl) * id_, ed1 - psi_q + (self.xq1 - Xl) * iq
        washed = PSS * slip - w  # w' = (PSS slip - w)/TW
        (lead1, lag1), (lead2, lag2) = LEADS
        out1 = s1 + lead1 / lag1 * (washed - s1)
        out2 = s2 + lead2 / lag2 * (out1 - s2)
        efd = KA * (self.vref + out2 - vm)
        field = eq1 + (Xd - Xd1) * (id_ + (Xd1 - Xd2) / (Xd1 - Xl) ** 2 * deq)
        d_axis = ed1 - (Xq - self.xq1) * (iq - (self.xq1 - Xd2) / (self.xq1 - Xl) ** 2 * ded)
        return np.concatenate(
            [
                OMEGA * slip,
                (pm - power) / speed / (2.0 * H),
                (efd - field) / Td01,
                -d_axis / Tq01,
                deq / Td02,
                ded / self.tq02,
                (np.abs(v) - vm) / TR,
                washed / TW,
                (washed - s1) / lag1,
                (out1 - s2) / lag2,
                (self.pm0 - GAIN * slip - g1) / TS,
                (g1 - g2) / TC3,
                ((1.0 - T4 / T5) * y1 - g3) / T5,
                [self.n.gains[1] * error],
                [self.n.gains[3] * (vdi / self.vdi - 1.0)],
                [(vdr - vdi - self.n.ohm * idc) / self.n.henry],
            ]
        )

    def matrix(self) -> np.ndarray:
        """Return A."""
        return matrix_of(self.rates, self.x0)

    def input_column(self, step: float = 1e-4) -> np.ndarray:
        """Return the column of the current order."""
        return (self.rates(self.x0, step) - self.rates(self.x0, -step)) / (2.0 * step)
