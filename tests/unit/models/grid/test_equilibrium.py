"""The operating point against the phasor diagram and the steady state of the machine equations."""

from __future__ import annotations

import numpy as np
import pytest

from interarea.models.case.case import CaseError, load_case
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.network import machine_bus_index
from interarea.models.grid.powerflow import solve_powerflow


@pytest.fixture(scope="module")
def point():
    return operating_point(load_case("two-area-thesis"))


def test_field_voltage_is_the_emf_behind_the_synchronous_reactances(point):
    """Efd = |E_q| with E_q = V + Ra I + j Xd i_d + j Xq i_q: the steady-state phasor diagram."""
    bus = machine_bus_index(point.case)
    V = point.power_flow.voltages[bus]
    for k, (m, p) in enumerate(zip(point.case.machines, point.machines, strict=True)):
        I = np.conj(point.power_flow.generation[k] / V[k]) * point.case.base_mva / m.base_mva
        turn = np.exp(-1j * p.delta)
        v, i = V[k] * turn, I * turn
        vd, vq, id_, iq = -v.imag, v.real, -i.imag, i.real
        assert p.efd == pytest.approx(vq + m.Ra * iq + m.Xd * id_, abs=1e-10)
        assert vd + m.Ra * id_ - m.Xq * iq == pytest.approx(0.0, abs=1e-10)
        assert p.pm == pytest.approx(vd * id_ + vq * iq + m.Ra * abs(I) ** 2, abs=1e-10)
        assert p.vt == pytest.approx(abs(V[k]), abs=1e-12)


def test_states_and_inputs_are_named_in_order(point):
    assert point.state_names[:5] == ("G1.delta", "G2.delta", "G3.delta", "G4.delta", "G1.slip")
    assert point.input_names == ("G1_vs", "G2_vs", "G3_vs", "G4_vs")
    assert len(set(point.state_names)) == len(point.x0) == 56
    assert not point.u0.any()


def test_power_flow_of_another_case_is_refused(point):
    other = point.case.with_changes({"branches": {"8-9 a": {"in_service": False}}})
    with pytest.raises(CaseError, match="differs from the power flow"):
        operating_point(point.case, solve_powerflow(other))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            {"machines": {"G1": {"exciter": {"Efd_min": -1.0, "Efd_max": 0.5}}}},
            r"G1\.exciter: efd .* above Efd_max = 0.5; set Efd_max to at least 1",
        ),
        (
            {"machines": {"G1": {"governor": {"gate_max": 0.5}}}},
            r"G1\.governor: gate .* above gate_max = 0.5; set gate_max to",
        ),
        ({"machines": {"G1": {"exciter": {"kind": "constant"}}}}, "constant excitation"),
    ],
)
def test_an_operating_point_beyond_the_limits_is_refused(change, says):
    with pytest.raises(CaseError, match=says):
        operating_point(load_case("two-area-thesis").with_changes(change))
