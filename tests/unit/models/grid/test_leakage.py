"""Machines of published data whose X''d is below the leakage reactance: odd circuits, sound equations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from plant_shim import BlockShim

from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import CaseError, case_of
from interarea.models.grid.equilibrium import operating_point

OMEGA = 2.0 * math.pi * 60.0
#: the second machine of IEEE39.dyr of GridDyn, X''d = 0.2 below Xl = 0.35
MACHINE = {
    "bus": 1, "base_mva": 100.0, "model": "round_rotor", "P_mw": 80.0, "V_pu": 1.0,
    "H": 3.03, "Xd": 2.95, "Xq": 2.82, "Xl": 0.35, "Xd1": 0.697, "Xq1": 0.697, "Xd2": 0.2, "Xq2": 0.2,
    "Td01": 6.56, "Td02": 0.03, "Tq01": 1.5, "Tq02": 0.04,
}  # fmt: skip
DOCUMENT = {
    "name": "omib", "source": "closed form", "frequency_hz": 60.0, "base_mva": 100.0,
    "buses": {"1": {}, "2": {"area": 2}},
    "branches": {"1-2": {"from": 1, "to": 2, "x": 0.4}},
    "machines": {
        "A": MACHINE,
        "INF": {"bus": 2, "base_mva": 100.0, "model": "infinite_bus", "Xd1": 0.05, "P_mw": 0.0, "V_pu": 1.0}
        | {"slack": True},
    },
}  # fmt: skip


class Circuit:
    """Coupled windings of one axis, what they store and what they lose: no reactance is divided by."""

    def __init__(self, X: float, X1: float, X2: float, T1: float, T2: float) -> None:
        xl = MACHINE["Xl"]
        self.mutual = X - xl
        outer = self.mutual * (X1 - xl) / (X - X1)
        self.damper = (X1 - xl) * (X2 - xl) / (X1 - X2)  # below 0 with X2 < Xl
        self.L = np.full((3, 3), self.mutual)
        self.L += np.diag([xl, outer, self.damper])
        self.R = np.array([self.L[1, 1] / T1, (self.damper + X1 - xl) / T2])

    def currents(self, psi: np.ndarray, stator: complex) -> np.ndarray:
        """Return the rotor currents from rotor flux linkages and the current out of the stator."""
        return np.linalg.solve(self.L[1:, 1:], psi + self.mutual * stator)


D = Circuit(*(float(MACHINE[k]) for k in ("Xd", "Xd1", "Xd2", "Td01", "Td02")))
Q = Circuit(*(float(MACHINE[k]) for k in ("Xq", "Xq1", "Xq2", "Tq01", "Tq02")))


def derivatives(z: np.ndarray, E: float, Xe: float, field: float, pm: float) -> np.ndarray:
    """delta, slip, two flux linkages on each axis: against a source E behind Xe."""
    delta, slip, d, q = z[0], z[1], z[2:4], z[4:6]
    # the stator's linkages are linear in its currents: X'' and what the rotor's linkages leave
    shares = [c.mutual * np.linalg.solve(c.L[1:, 1:], np.ones(2)) for c in (D, Q)]
    x = [c.L[0, 0] - c.mutual * float(s.sum()) for c, s in zip((D, Q), shares, strict=True)]
    emf_q, emf_d = shares[0] @ d, -(shares[1] @ q)
    id_ = (emf_q - E * np.cos(delta)) / (x[0] + Xe)
    iq = (E * np.sin(delta) - emf_d) / (x[1] + Xe)
    psi_d, psi_q = emf_q - x[0] * id_, -emf_d - x[1] * iq
    i_d, i_q = D.currents(d, id_), Q.currents(q, iq)
    rates_d = np.array([D.R[0] * field - D.R[0] * i_d[0], -D.R[1] * i_d[1]])
    torque = psi_d * iq - psi_q * id_
    return np.array(
        [OMEGA * slip, (pm - torque) / (2.0 * MACHINE["H"]), *rates_d, *(-Q.R * i_q)], dtype=complex
    )


def test_the_equations_are_those_of_a_circuit_that_stores_positive_energy() -> None:
    """Its damper has a negative leakage inductance, its inductance matrix is positive definite."""
    case = case_of(DOCUMENT, where="test")
    point, source = operating_point(case).machines
    E, Xe, delta = source.efd, 0.45, point.delta - source.delta
    field = point.efd / D.mutual
    d = D.L[1:] @ np.array([-point.id, field, 0.0])
    q = Q.L[1:] @ np.array([-point.iq, 0.0, 0.0])
    rest = np.array([delta, 0.0, *d, *q], dtype=complex)
    np.testing.assert_allclose(derivatives(rest, E, Xe, field, point.pm), 0.0, atol=1e-9)
    A = np.array([derivatives(rest + 1e-30j * e, E, Xe, field, point.pm).imag for e in np.eye(6)]).T / 1e-30
    plant = BlockShim(plant_block(case))
    own = [k for k, name in enumerate(plant.state_names) if name.startswith("A.")]
    got, expected = np.linalg.eigvals(plant.jacobians()[0][np.ix_(own, own)]), np.linalg.eigvals(A)
    np.testing.assert_allclose(np.sort_complex(got), np.sort_complex(expected), rtol=1e-9)
    assert expected.real.max() < 0.0
    assert D.damper < 0.0 and min(np.linalg.eigvalsh(c.L).min() for c in (D, Q)) > 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"Xq2": 0.25}, "Xd2 = 0.2 with Xl = 0.35, allowed: Xl <= Xd2"),
        ({"saturation": {"Asat": 0.015, "Bsat": 9.6, "psiT1": 0.9}}, "allowed: Xl <= Xd2"),
        ({"Xl": 0.7}, "Xd1 = 0.697 with Xl = 0.7, allowed: Xl < Xd1"),
    ],
)
def test_what_needs_the_air_gap_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(CaseError, match=message):
        case_of(DOCUMENT, where="test").with_changes({"machines": {"A": change}})
