"""Directional derivatives against complex steps of other code, on a small grid with everything nonlinear."""

from __future__ import annotations

import numpy as np
import pytest
from plant_shim import BlockShim
from scipy.optimize import fsolve

from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import Case, case_of, load_case
from interarea.models.grid.network import admittance_matrix

SATURATION = {"Asat": 0.02, "Bsat": 8.0, "psiT1": 0.85, "use": "total"}


def small(use: str) -> Case:
    """A saturated machine with X''d != X''q, a classical one, a load of each characteristic."""
    G1 = load_case("kundur-manual").machine("G1").model_dump(exclude={"name", "bus", "exciter", "governor"})
    G1 |= {"bus": 1, "Xq2": 0.3, "D": 1.0, "saturation": SATURATION | {"use": use}, "P_mw": 700.0}
    G2 = {"bus": 2, "area": 2, "base_mva": 600.0, "model": "classical", "H": 4.0, "Xd1": 0.3, "Ra": 0.01}
    return case_of(
        {
            "name": "small",
            "source": "made up",
            "frequency_hz": 60.0,
            "base_mva": 100.0,
            "buses": {"1": {}, "2": {}, "3": {}},
            "branches": {
                "1-3": {"from": 1, "to": 3, "r": 0.001, "x": 0.02, "b": 0.1},
                "3-2": {"from": 3, "to": 2, "r": 0.002, "x": 0.03, "b": 0.2, "tap": 1.02},
            },
            "loads": {
                "a": {"bus": 3, "P_mw": 600.0, "Q_mvar": 100.0, "P_exponent": 1.0, "Q_exponent": 2.6},
                "b": {"bus": 2, "P_mw": 300.0, "Q_mvar": 80.0, "P_zip": [0.2, 0.3, 0.5], "Q_exponent": 0.0},
            },
            "machines": {
                "G1": {k: v for k, v in G1.items() if v is not None},
                "G2": G2 | {"P_mw": 0.0, "V_pu": 1.0, "slack": True},
            },
        },
        where="test",
    )


def product(a, b):
    """Complex product of (re, im) pairs whose parts may carry a complex step."""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


class Other:
    """The grid as 0 = F(z, x), dx/dt = f(z, x): Kirchhoff's law and the stator equations as they stand.

    z: real and imaginary parts of the three bus voltages, then id, iq of the round-rotor machine.
    Everything is written over real parts, so that both may be differentiated by complex steps.
    """

    def __init__(self, case: Case, names: tuple[str, ...], data: dict) -> None:
        self.case, self.names, self.data = case, names, data
        self.Y = admittance_matrix(case)
        self.efd, self.pm = data["machine.table"][-3], data["machine.table"][-2]
        self.port = next(row for row in data["port.table"] if row[0] == 2.0)

    def flux(self, z, at):
        """psi_ad, psi_aq, isd, isq of the round-rotor machine."""
        m, d, q = self.case.machines[0], z[6], z[7]
        c, s = np.cos(at["G1.delta"]), np.sin(at["G1.delta"])
        vq, vd = z[0] * c + z[3] * s, z[0] * s - z[3] * c
        psi_d, psi_q = vq + m.Ra * q + m.Xl * d, -(vd + m.Ra * d - m.Xl * q)
        shape = m.saturation
        if shape.use == "total":
            size = np.sqrt(psi_d**2 + psi_q**2)
            S = shape.Asat * np.exp(shape.Bsat * (size - shape.psiT1)) / size
            return psi_d, psi_q, S * psi_d / (m.Xd - m.Xl), S * psi_q / (m.Xq - m.Xl)
        d0, q0, isd0, isq0, slope = self.port[11:16]
        isd, isq = slope * (psi_d - d0) / (m.Xd - m.Xl), slope * (psi_q - q0) / (m.Xq - m.Xl)
        return psi_d, psi_q, isd0 + isd, isq0 + isq

    def classical_current(self, z, at):
        """Current of the classical machine on its own base, (re, im)."""
        c = self.case.machines[1]
        y = 1.0 / complex(c.Ra, c.Xd1)
        e = self.efd[1] * np.cos(at["G2.delta"]), self.efd[1] * np.sin(at["G2.delta"])
        return product((y.real, y.imag), (e[0] - z[1], e[1] - z[4])), e

    def network(self, z, x):
        """F: zero where the network is solved."""
        at, (m, c) = dict(zip(self.names, x, strict=True)), self.case.machines
        kind = np.result_type(z, x)
        re, im = np.zeros(3, kind), np.zeros(3, kind)
        for k in range(3):
            for j in range(3):
                part = product((self.Y[k, j].real, self.Y[k, j].imag), (z[j], z[3 + j]))
                re[k], im[k] = re[k] - part[0], im[k] - part[1]
        turned = product((z[7], -z[6]), (np.cos(at["G1.delta"]), np.sin(at["G1.delta"])))
        (gre, gim), _ = self.classical_current(z, at)
        for k, machine, current in ((0, m, turned), (1, c, (gre, gim))):
            re[k] += machine.base_mva / 100.0 * current[0]
            im[k] += machine.base_mva / 100.0 * current[1]
        rest = self.data["load.table"][2]
        loads = (
            (2, rest[0], lambda u: 6.0 * u, lambda u: u**2.6),
            (1, rest[1], lambda u: 3.0 * (0.2 * u**2 + 0.3 * u + 0.5), lambda u: 0.8),
        )
        for k, volt, P, Q in loads:
            size = z[k] ** 2 + z[3 + k] ** 2
            u = np.sqrt(size) / volt
            re[k] -= (P(u) * z[k] + Q(u) * z[3 + k]) / size  # conj(S/V)
            im[k] -= (P(u) * z[3 + k] - Q(u) * z[k]) / size
        psi_d, psi_q, isd, isq = self.flux(z, at)
        stator = [
            at["G1.eq2"] - (m.Xd2 - m.Xl) * (z[6] + isd) - psi_d,
            at["G1.ed2"] + (m.Xq2 - m.Xl) * (z[7] + isq) + psi_q,
        ]
        return np.array([*re, *im, *stator])

    def rates(self, z, x):
        """f: dx/dt."""
        at, (m, c) = dict(zip(self.names, x, strict=True)), self.case.machines
        psi_d, psi_q, isd, isq = self.flux(z, at)
        D, Q = z[6] + isd, z[7] + isq
        a, b = (m.Xd2 - m.Xl) / (m.Xd1 - m.Xl), (m.Xq2 - m.Xl) / (m.Xq1 - m.Xl)
        eq1, ed1, eq2, ed2 = (at[f"G1.{k}"] for k in ("eq1", "ed1", "eq2", "ed2"))
        deq1 = (self.efd[0] - eq1 - (m.Xd - m.Xd1) * (a * D + (eq1 - eq2) / (m.Xd1 - m.Xl))) / m.Td01
        ded1 = (-ed1 + (m.Xq - m.Xq1) * (b * Q - (ed1 - ed2) / (m.Xq1 - m.Xl))) / m.Tq01
        (gre, gim), e = self.classical_current(z, at)
        rate = {
            "G1.delta": self.case.omega_b * at["G1.slip"],
            "G2.delta": self.case.omega_b * at["G2.slip"],
            "G1.slip": (self.pm[0] - (psi_d * z[7] - psi_q * z[6]) - m.D * at["G1.slip"]) / (2 * m.H),
            "G2.slip": (self.pm[1] - (e[0] * gre + e[1] * gim)) / (2 * c.H),
            "G1.eq1": deq1,
            "G1.ed1": ded1,
            "G1.eq2": a * deq1 + (eq1 - eq2 - (m.Xd1 - m.Xd2) * D) / m.Td02,
            "G1.ed2": b * ded1 + (ed1 - ed2 + (m.Xq1 - m.Xq2) * Q) / m.Tq02,
        }
        return np.array([rate[name] for name in self.names])

    def solve(self, x):
        """z at x: fsolve, then Newton steps to rounding."""
        z = fsolve(self.network, [1.0] * 3 + [0.0] * 3 + [0.5, 0.5], args=(x,))
        for _ in range(4):
            z = z - np.linalg.solve(slopes(lambda v: self.network(v, x), z), self.network(z, x))
        return z

    def jacobian(self, x):
        """d f(z(x), x)/dx by the implicit function theorem, every part by complex steps."""
        z = self.solve(x)
        F_z, F_x = slopes(lambda v: self.network(v, x), z), slopes(lambda v: self.network(z, v), x)
        f_z, f_x = slopes(lambda v: self.rates(v, x), z), slopes(lambda v: self.rates(z, v), x)
        return f_x - f_z @ np.linalg.solve(F_z, F_x)


def slopes(function, at):
    """Jacobian of `function` at `at` by complex steps."""
    columns = []
    for k in range(len(at)):
        point = np.array(at, dtype=complex)
        point[k] += 1e-30j
        columns.append(np.imag(function(point)) / 1e-30)
    return np.array(columns).T


@pytest.mark.parametrize("use", ["total", "incremental"])
def test_rates_and_their_derivatives_to_1e_10(use):
    block = plant_block(small(use))
    plant = BlockShim(block)
    other = Other(small(use), plant.state_names, block.data)
    x = plant.x + 0.02 * np.random.default_rng(4).standard_normal(len(plant.x))
    np.testing.assert_allclose(
        plant.derivatives(x)[0], other.rates(other.solve(x), x), rtol=1e-11, atol=1e-11
    )
    exact, ours = other.jacobian(x), plant.jacobians(x)[0]
    np.testing.assert_allclose(ours, exact, rtol=1e-10, atol=1e-12 * np.abs(exact).max())
    assert np.abs(plant.derivatives(plant.x)[0]).max() < 1e-11
