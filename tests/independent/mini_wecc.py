"""The mini-WECC, written apart from the package: only the numbers are those of its case file.

Rates of 437 states and balances of 120 buses in real arithmetic, so that a complex step gives every
derivative to rounding. With the terms of speed of PSTess 1.1, which the package has not, or without: EMFs
times speed, the mechanical torque as power over speed, the bridge voltage of exciters from an EMF without it.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np

CASE = Path(__file__).resolve().parents[2] / "models" / "cases" / "mini-wecc.toml"
MACHINE = (
    "base_mva",
    "P_mw",
    "V_pu",
    "H",
    "Xd",
    "Xq",
    "Xl",
    "Xd1",
    "Xq1",
    "Xd2",
    "Td01",
    "Tq01",
    "Td02",
    "Tq02",
)
STEP, OMEGA = 1e-30, 2.0 * np.pi * 60.0


def merged(defaults: dict, row: dict) -> dict:
    """Return a row with what its table has by default, controls of the same kind key by key."""
    out = {**defaults, **row}
    for key, value in defaults.items():
        if isinstance(value, dict) and key in row:
            out[key] = {**value, **row[key]}
    return out


def complex_step(function, z: np.ndarray) -> np.ndarray:
    """Return the derivatives of `function` at `z`, (rows, len(z))."""
    columns = []
    for k in range(len(z)):
        moved = z.astype(complex)
        moved[k] += 1j * STEP
        columns.append(function(moved).imag / STEP)
    return np.array(columns).T


class MiniWecc:
    """Power flow, rest and linear model; per unit of 100 MVA in the network, of each machine inside it."""

    def __init__(self, *, speed_terms: bool) -> None:
        self.speed_terms = speed_terms
        table = tomllib.loads(CASE.read_text())
        rows = {
            key: {
                name: merged(table[key].get("defaults", {}), row)
                for name, row in table[key].items()
                if name not in ("source", "defaults")
            }
            for key in ("buses", "branches", "shunts", "loads", "machines")
        }
        self.at = {int(bus): k for k, bus in enumerate(rows["buses"])}
        self.names, machines = list(rows["machines"]), list(rows["machines"].values())
        self.bus = np.array([self.at[m["bus"]] for m in machines])
        self.m = {key: np.array([m[key] for m in machines]) for key in MACHINE}
        self.exciter, self.pss = machines[0]["exciter"], machines[0]["stabilizer"]
        self.gain = self.exciter["KM"] * self.exciter["KA"] * self.exciter["KP"]
        self.governed = np.array([k for k, m in enumerate(machines) if "governor" in m])
        self.droop, self.ts, self.tc, self.b, self.d, self.t5 = np.array(
            [self.turbine(machines[k]["governor"]) for k in self.governed]
        ).T
        self.slack = next(k for k, m in enumerate(machines) if m.get("slack"))
        n = len(self.at)
        self.Y = np.zeros((n, n), dtype=complex)
        for row in rows["branches"].values():
            y, i, j = 1.0 / complex(row.get("r", 0.0), row["x"]), self.at[row["from"]], self.at[row["to"]]
            self.Y[[i, j], [i, j]] += y
            self.Y[[i, j], [j, i]] -= y
        for row in rows["shunts"].values():
            self.Y[self.at[row["bus"]], self.at[row["bus"]]] += 1j * row["Q_mvar"] / 100.0
        self.load = np.zeros(n, dtype=complex)
        for row in rows["loads"].values():
            self.load[self.at[row["bus"]]] += complex(row["P_mw"], row["Q_mvar"]) / 100.0
        self.V0 = self.power_flow()
        self.x0 = self.rest()
        self.z0 = np.concatenate([self.x0, self.V0.real, self.V0.imag])

    @staticmethod
    def turbine(row: dict) -> tuple[float, ...]:
        """Return gain, Ts, Tc, T3/Tc, T4/T5, T5 of (1 + T3 s)(1 + T4 s)/((1 + Ts s)(1 + Tc s)(1 + T5 s))."""
        hydro = row["kind"] == "ieeeg2"
        t4, t5 = (-row["T4"], 0.5 * row["T4"]) if hydro else (0.0, row["T4"])
        return row["K"], row["T3"], row["T1"], row["T2"] / row["T1"], t4 / t5, t5

    def injected(self, vr: np.ndarray, vi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the currents that the network takes from its buses, real and imaginary part."""
        return self.Y.real @ vr - self.Y.imag @ vi, self.Y.real @ vi + self.Y.imag @ vr

    def power_flow(self) -> np.ndarray:
        """Return the bus voltages, (120,), by Newton's method."""
        n = len(self.at)
        p, q = -self.load.real.copy(), -self.load.imag.copy()
        np.add.at(p, self.bus, self.m["P_mw"] / 100.0)
        turning = np.setdiff1d(np.arange(n), self.bus[self.slack])
        free = np.setdiff1d(np.arange(n), self.bus)

        def voltages(z):
            angle, size = np.zeros(n, z.dtype), np.ones(n, z.dtype)
            size[self.bus] = self.m["V_pu"]
            angle[turning], size[free] = z[: len(turning)], z[len(turning) :]
            return size * np.cos(angle), size * np.sin(angle)

        def mismatch(z):
            vr, vi = voltages(z)
            ir, ii = self.injected(vr, vi)
            return np.concatenate([(vr * ir + vi * ii - p)[turning], (vi * ir - vr * ii - q)[free]])

        z = np.concatenate([np.zeros(len(turning)), np.ones(len(free))])
        for _ in range(30):
            miss = mismatch(z)
            if np.max(np.abs(miss)) < 1e-11:
                break
            z -= np.linalg.solve(complex_step(mismatch, z), miss)
        assert np.max(np.abs(miss)) < 1e-11
        vr, vi = voltages(z)
        return vr + 1j * vi

    def rest(self) -> np.ndarray:
        """Return the states at rest, and keep the set-points."""
        m, v = self.m, self.V0[self.bus]
        current = (self.Y @ self.V0 + np.conj(self.load / self.V0))[self.bus]
        i = current / (m["base_mva"] / 100.0)
        delta = np.angle(v + 1j * m["Xq"] * i)
        turned, emf = i * np.exp(-1j * delta), (v + 1j * m["Xd2"] * i) * np.exp(-1j * delta)
        iq, id_ = turned.real, -turned.imag
        eq1 = emf.real + (m["Xd1"] - m["Xd2"]) * id_
        ed1 = -emf.imag - (m["Xq1"] - m["Xd2"]) * iq
        psi_d, psi_q = eq1 - (m["Xd1"] - m["Xl"]) * id_, ed1 + (m["Xq1"] - m["Xl"]) * iq
        efd = eq1 + (m["Xd"] - m["Xd1"]) * id_
        self.pm0 = (v * np.conj(i)).real
        field = efd / np.abs(v)
        lead = field / self.gain
        self.vref, zero = np.abs(v) + lead, 0.0 * delta
        machines = [delta, zero, eq1, psi_d, ed1, psi_q, lead, field, zero, zero, zero]
        order = self.pm0[self.governed]
        return np.concatenate([*machines, order, (1.0 - self.b) * order, (1.0 - self.d) * order])

    def residual(self, z: np.ndarray) -> np.ndarray:
        """Return dx/dt and the currents missing at the buses, of the states and the voltages (677,)."""
        m, x, n = self.m, z[: len(self.x0)], len(self.at)
        vr, vi = z[len(x) : len(x) + n], z[len(x) + n :]
        k = len(self.names)
        delta, slip, eq1, psi_d, ed1, psi_q, lead, field, washout, s1, s2 = x[: 11 * k].reshape(11, k)
        g1, g2, g3 = x[11 * k :].reshape(3, -1)
        by_d, by_q = m["Xd1"] - m["Xl"], m["Xq1"] - m["Xl"]
        a, c = (m["Xd2"] - m["Xl"]) / by_d, (m["Xd2"] - m["Xl"]) / by_q
        eq2, ed2 = a * eq1 + (1.0 - a) * psi_d, c * ed1 + (1.0 - c) * psi_q
        cos, sin = np.cos(delta), np.sin(delta)
        speed = 1.0 + slip if self.speed_terms else 1.0
        er, ei = eq2 * cos + ed2 * sin, eq2 * sin - ed2 * cos
        ur, ui = vr[self.bus], vi[self.bus]
        ir, ii = (speed * ei - ui) / m["Xd2"], -(speed * er - ur) / m["Xd2"]
        iq, id_ = ir * cos + ii * sin, ir * sin - ii * cos
        seen = np.sqrt(ur * ur + ui * ui)
        br, bi = er + m["Xd2"] * ii, ei - m["Xd2"] * ir  # voltage behind that EMF without the speed
        bridge = np.sqrt(br * br + bi * bi) if self.speed_terms else seen
        deq, ded = eq1 - psi_d - by_d * id_, ed1 - psi_q + by_q * iq
        current = eq1 + (m["Xd"] - m["Xd1"]) * (id_ + (m["Xd1"] - m["Xd2"]) / by_d**2 * deq)
        across = ed1 - (m["Xq"] - m["Xq1"]) * (iq - (m["Xq1"] - m["Xd2"]) / by_q**2 * ded)
        p, e = self.pss, self.exciter
        w = p["K"] * slip - washout
        y1 = p["T1"] / p["T2"] * w + s1
        error = self.vref - seen + p["T3"] / p["T4"] * y1 + s2
        pm = self.pm0 + 0.0 * slip
        y2 = g2 + self.b * g1
        pm[self.governed] = g3 + self.d * y2
        regulated = self.gain * (e["TC"] / e["TB"] * error + (1.0 - e["TC"] / e["TB"]) * lead)
        rates = [
            OMEGA * slip,
            (pm / speed - eq2 * iq - ed2 * id_) / (2.0 * m["H"]),
            (field * bridge - current) / m["Td01"],
            deq / m["Td02"],
            -across / m["Tq01"],
            ded / m["Tq02"],
            (error - lead) / e["TB"],
            (regulated - field) / e["TM"],
            w / p["Tw"],
            ((1.0 - p["T1"] / p["T2"]) * w - s1) / p["T2"],
            ((1.0 - p["T3"] / p["T4"]) * y1 - s2) / p["T4"],
            (self.pm0[self.governed] - self.droop * slip[self.governed] - g1) / self.ts,
            ((1.0 - self.b) * g1 - g2) / self.tc,
            ((1.0 - self.d) * y2 - g3) / self.t5,
        ]
        square = vr * vr + vi * vi
        P = self.load.real * np.sqrt(square) / np.abs(self.V0)
        Q = self.load.imag * square / np.abs(self.V0) ** 2
        nr, ni = self.injected(vr, vi)
        nr, ni = nr + (P * vr + Q * vi) / square, ni + (P * vi - Q * vr) / square
        rate = m["base_mva"] / 100.0
        nr[self.bus] -= rate * ir
        ni[self.bus] -= rate * ii
        return np.concatenate([*rates, nr, ni])

    def matrix(self) -> np.ndarray:
        """Return A, (437, 437)."""
        n = len(self.x0)
        J = complex_step(self.residual, self.z0)
        return J[:n, :n] - J[:n, n:] @ np.linalg.solve(J[n:, n:], J[n:, :n])
