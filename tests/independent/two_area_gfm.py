"""Two areas with two grid-forming converters of the Power System Toolbox, written apart from the package.

Rates of 36 states and their eigenvalues; with the Toolbox's own terms of speed (EMFs multiplied by speed,
torques as powers over speed), which PSTess has and the package has not, or without; and with the lags of 5 ms
that PSTess puts into a converter for its linearisation (function ns_file), or without. Numbers: file
d2asbegp_gfma of PSTess 1.1, which reads the saturation of its machines and does not use it. The integrators
of the limits of P and Q wait at 0 and are left out, as in PSTess.
"""

from __future__ import annotations

import numpy as np
from independent.two_area_svc import (
    BUSES,
    LINES,
    OMEGA,
    Ra,
    Xd2,
    matrix_of,
    rotor_at_rest,
    solved,
    subtransient_emf,
    winding_rates,
)

TAPS = {(3, 4): 0.975, (13, 14): 0.9688}
SHUNT = {3: 3.33, 13: 4.85, 101: 1.27}
HELD = dict.fromkeys((1, 2, 11, 12), 1.01)
POWER = {1: 1.68, 11: 1.68, 12: 12.3, 4: -9.76, 14: -17.65}
REACTIVE = {4: -1.0, 14: -1.0}
SLACK = (2, 0.0)
MACHINES, CONVERTERS, LOADS = (2, 12), (1, 11), (4, 14)
RATIO, H = 18.0, 5.75
TR, KA, TA = 0.02, 100.0, 0.05
PSS, TW, LEAD, LAG = 10.0, 10.0, 0.05, 0.01  #: two equal lead-lags
GAIN, TS, TC3, T4, T5 = 20.0, 0.5, 0.01, 1.25, 5.0
CONVERTER = {"mp": 0.05, "mq": 0.01, "Tpf": 0.01, "Tqf": 0.01, "Re": 0.02, "Xe": 0.15}  #: on 200 MVA
BASE = 2.0  #: of a converter, by that of the system
TE = 0.005  #: E follows; PSTess takes 5 ms for 0, and 5 ms each for E and its angle once more
TSOURCE = 0.005
EXACT = 1e-13  #: miss of current, pu, at which a network is solved


def admittance() -> np.ndarray:
    """Return the bus matrix of lines and shunts, (13, 13); a tap stands at the first bus of its line."""
    at = {bus: k for k, bus in enumerate(BUSES)}
    Y = np.zeros((len(BUSES),) * 2, dtype=complex)
    for one, other, r, x, b in LINES:
        y, k, j, tap = 1.0 / complex(r, x), at[one], at[other], TAPS.get((one, other), 1.0)
        Y[k, k] += (y + 0.5j * b) / tap**2
        Y[j, j] += y + 0.5j * b
        Y[[k, j], [j, k]] -= y / tap
    for bus, b in SHUNT.items():
        Y[at[bus], at[bus]] += 1j * b
    return Y


class TwoAreaGfm:
    """Rates of delta, slip, eq1, ed1, psi_d, psi_q, exciter 2, stabilizer 3, governor 3 of both machines, and
    of delta, pf, qf, E of both converters; then, with lags in their sources, of the angle and the size of
    the voltage behind Re + j Xe."""

    def __init__(self, *, speed_terms: bool, source_lags: bool) -> None:
        self.speed_terms, self.source_lags = speed_terms, source_lags
        at = {bus: k for k, bus in enumerate(BUSES)}
        self.machine, self.source, self.loads = (
            np.array([at[bus] for bus in buses]) for buses in (MACHINES, CONVERTERS, LOADS)
        )
        Y = admittance()
        self.V0, self.S0 = solved(Y, BUSES, HELD, POWER, REACTIVE, SLACK)
        v, drawn = np.abs(self.V0[self.loads]), -self.S0[self.loads]
        self.current = drawn.real / v
        self.v, self.stops_at = self.V0[self.loads], EXACT
        Y[self.loads, self.loads] -= 1j * drawn.imag / v**2
        self.norton = RATIO / complex(Ra, Xd2)
        self.impedance = complex(CONVERTER["Re"], CONVERTER["Xe"]) / BASE
        Y[self.machine, self.machine] += self.norton
        Y[self.source, self.source] += 1.0 / self.impedance
        self.inverse = np.linalg.inv(Y)
        self.x0 = self.rest()

    def rest(self) -> np.ndarray:
        """Return the states at rest, and keep the set-points."""
        v = self.V0[self.machine]
        (delta, *windings), efd, self.pm0 = rotor_at_rest(v, np.conj(self.S0[self.machine] / v) / RATIO)
        self.vref = np.abs(v) + efd / KA
        none = 0.0 * delta
        governor = [self.pm0, self.pm0, self.pm0 * (1.0 - T4 / T5)]
        machines = [delta, none, *windings, np.abs(v), efd, none, none, none, *governor]
        v, s = self.V0[self.source], self.S0[self.source]
        E = v + self.impedance * np.conj(s / v)
        self.pset, qf = s.real / BASE, s.imag / BASE
        self.vset = np.abs(E) + CONVERTER["mq"] * qf
        lags = [np.angle(E), np.abs(E)] if self.source_lags else []
        return np.concatenate([*machines, np.angle(E), self.pset, qf, np.abs(E), *lags])

    def network(self, emf: np.ndarray, source: np.ndarray) -> np.ndarray:
        """Return the bus voltages for EMFs behind Ra + j X'' and voltages behind Re + j Xe.

        Newton's method for the voltages of the loads begins at those of the last call."""
        injected = np.zeros(len(self.V0), dtype=complex)
        injected[self.machine] = self.norton * emf
        injected[self.source] = source / self.impedance
        unloaded = self.inverse @ injected
        v, Y = self.v, np.linalg.inv(self.inverse[np.ix_(self.loads, self.loads)])
        for _ in range(20):
            miss = Y @ (v - unloaded[self.loads]) + self.current * v / np.abs(v)
            if np.max(np.abs(miss)) < self.stops_at:
                break
            # slopes of the miss by v and by its conjugate
            half = 0.5 * self.current / np.abs(v)
            by_v, by_conj = Y + np.diag(half), -np.diag(half * v / np.conj(v))
            plus, minus = by_v + by_conj, by_v - by_conj
            J = np.block([[plus.real, -minus.imag], [plus.imag, minus.real]])
            step = np.linalg.solve(J, -np.concatenate([miss.real, miss.imag]))
            v = v + step[: len(v)] + 1j * step[len(v) :]
        self.v = v
        return unloaded + self.inverse[:, self.loads] @ Y @ (v - unloaded[self.loads])

    def rates(self, x: np.ndarray) -> np.ndarray:
        """Return dx/dt."""
        delta, slip, *windings, vm, efd, w, s1, s2, g1, g2, g3 = x[:28].reshape(14, 2)
        angle, pf, qf, E, *lags = x[28:].reshape(-1, 2)
        shown_angle, shown = lags if self.source_lags else (angle, E)
        speed = 1.0 + slip if self.speed_terms else 1.0
        emf = speed * subtransient_emf(*windings) * np.exp(1j * delta)
        source = shown * np.exp(1j * shown_angle)
        V = self.network(emf, source)
        v = V[self.machine]
        i = (emf - v) / complex(Ra, Xd2) * np.exp(-1j * delta)
        power = (emf * np.exp(-1j * delta) * np.conj(i)).real
        pm = g3 + T4 / T5 * g2
        washed = PSS * slip - w  # w' = washed/TW
        out1 = s1 + LEAD / LAG * (washed - s1)
        out2 = s2 + LEAD / LAG * (out1 - s2)
        v2 = V[self.source]
        s = v2 * np.conj((source - v2) / self.impedance) / BASE
        follow = [(angle - shown_angle) / TSOURCE, (E - shown) / TSOURCE] if self.source_lags else []
        return np.concatenate(
            [
                OMEGA * slip,
                (pm - power) / speed / (2.0 * H),
                *winding_rates(*windings, i, efd),
                (np.abs(v) - vm) / TR,
                (KA * (self.vref + out2 - vm) - efd) / TA,
                washed / TW,
                (washed - s1) / LAG,
                (out1 - s2) / LAG,
                (self.pm0 - GAIN * slip - g1) / TS,
                (g1 - g2) / TC3,
                ((1.0 - T4 / T5) * g2 - g3) / T5,
                OMEGA * CONVERTER["mp"] * (self.pset - pf),
                (s.real - pf) / CONVERTER["Tpf"],
                (s.imag - qf) / CONVERTER["Tqf"],
                (self.vset - CONVERTER["mq"] * qf - E) / TE,
                *follow,
            ]
        )

    def matrix(self) -> np.ndarray:
        """Return A, (36, 36), or (40, 40) with lags in the sources."""
        return matrix_of(self.rates, self.x0)

    def matrix_of_pstess(self) -> np.ndarray:
        """Return A as PSTess finds it, by central differences of 1e-4 of a state and at least 1e-4.

        Each network solution begins at the voltages of the last and ends at a miss of 1e-6 pu of current.
        """
        columns = []
        for k, size in enumerate(np.maximum(np.abs(self.x0), 1.0)):
            d = np.zeros(len(self.x0))
            d[k] = 1e-4 * size
            self.v, self.stops_at = self.V0[self.loads], 1e-6
            columns.append((self.rates(self.x0 + d) - self.rates(self.x0 - d)) / (2.0 * d[k]))
            self.stops_at = EXACT
        return np.array(columns).T
