"""Power flow: closed form of two buses, balance of power, Jacobian, what is said without a solution."""

from __future__ import annotations

import math

import numpy as np
import pytest

from interarea.models.case.case import Case, CaseError, case_of, load_case
from interarea.models.grid import newton
from interarea.models.grid.network import admittance_matrix, sparse_admittance
from interarea.models.grid.powerflow import PowerFlowError, solve_powerflow


def two_buses(P_mw: float, Q_mvar: float, x: float = 0.1) -> Case:
    machine = {"bus": 1, "model": "power_flow", "base_mva": 100.0, "P_mw": 0.0, "V_pu": 1.0, "slack": True}
    return case_of(
        {
            "name": "two",
            "source": "test",
            "frequency_hz": 50.0,
            "base_mva": 100.0,
            "buses": {"1": {}, "2": {}},
            "branches": {"1-2": {"from": 1, "to": 2, "x": x}},
            "loads": {"L": {"bus": 2, "P_mw": P_mw, "Q_mvar": Q_mvar}},
            "machines": {"G": machine},
        },
        where="two buses",
    )


def test_two_buses_closed_form() -> None:
    # P + jQ over x from 1 pu: V^4 + (2 Q x - 1) V^2 + x^2 (P^2 + Q^2) = 0, sin(angle) = -P x / V
    P, Q, x = 1.5, 0.4, 0.1
    b = 1.0 - 2.0 * Q * x
    V = math.sqrt(0.5 * (b + math.sqrt(b * b - 4.0 * x * x * (P * P + Q * Q))))
    flow = solve_powerflow(two_buses(150.0, 40.0))
    assert abs(flow.voltage(2)) == pytest.approx(V, rel=1e-12)
    assert np.angle(flow.voltage(2)) == pytest.approx(-math.asin(P * x / V), rel=1e-12)
    assert flow.flow("1-2", 1).real == pytest.approx(P, abs=1e-12)
    assert flow.flow("1-2", 2) == pytest.approx(-(P + 1j * Q), abs=1e-12)


def test_beyond_the_largest_transfer_the_error_names_bus_and_mismatch() -> None:
    # without Q the most that x = 0.1 carries from 1 pu is 1/(2x) = 5 pu
    assert solve_powerflow(two_buses(499.0, 0.0)).mismatch_pu <= 1e-10
    with pytest.raises(PowerFlowError, match=r"two: .*worst mismatch [0-9.e-]+ pu at bus 2"):
        solve_powerflow(two_buses(501.0, 0.0))
    assert issubclass(PowerFlowError, CaseError)


@pytest.mark.parametrize("name", ["kundur-manual", "two-area-thesis", "new-england", "nets-nyps"])
def test_power_balances_at_every_bus(name: str) -> None:
    case = load_case(name)
    flow = solve_powerflow(case)
    index = {bus.number: k for k, bus in enumerate(case.buses)}
    off = flow.voltages * np.conj(admittance_matrix(case) @ flow.voltages)
    for k, machine in enumerate(case.machines):
        off[index[machine.bus]] -= flow.generation[k]
    for load in case.loads:
        off[index[load.bus]] += complex(load.P_mw, load.Q_mvar) / case.base_mva
    assert np.max(np.abs(off)) < 1e-10
    assert flow.mismatch_pu < 1e-10


@pytest.mark.parametrize("name", ["kundur-manual", "nets-nyps"])
def test_generation_less_load_is_what_branches_and_shunts_lose(name: str) -> None:
    case = load_case(name)
    flow = solve_powerflow(case)
    lost = sum(flow.flow(b.name, b.from_bus) + flow.flow(b.name, b.to_bus) for b in case.branches)
    for shunt in case.shunts:
        lost -= 1j * shunt.Q_mvar / case.base_mva * abs(flow.voltage(shunt.bus)) ** 2
    taken = sum(complex(q.P_mw, q.Q_mvar) for q in case.loads) / case.base_mva
    assert flow.generation.sum() - taken == pytest.approx(lost, abs=1e-9)


def test_jacobian_is_the_derivative_of_the_mismatch() -> None:
    Y = sparse_admittance(load_case("kundur-manual"))
    flow = solve_powerflow(load_case("kundur-manual"))
    V, n = flow.voltages, 11
    every = np.arange(n)
    rng = np.random.default_rng(0)
    current = rng.standard_normal(n) + 1j * rng.standard_normal(n)
    J = newton._jacobian(Y, V, current, every, every)
    angle, magnitude = rng.standard_normal(n), rng.standard_normal(n)

    def power(h: float) -> np.ndarray:
        W = (np.abs(V) + h * magnitude) * np.exp(1j * (np.angle(V) + h * angle))
        S = W * np.conj(Y @ W) - current * np.abs(W)
        return np.concatenate([S.real, S.imag])

    h = 1e-4  # Richardson: error of order h^4
    step = (8.0 * (power(h) - power(-h)) - (power(2 * h) - power(-2 * h))) / (12.0 * h)
    assert J @ np.concatenate([angle, magnitude]) == pytest.approx(step, abs=1e-7)


def test_machines_at_one_bus_share_by_rating_and_the_slack_takes_the_rest() -> None:
    document = two_buses(150.0, 40.0).document()
    second = {"bus": 1, "model": "power_flow", "base_mva": 300.0, "P_mw": 60.0, "V_pu": 1.0}
    document["machines"]["H"] = second
    alone = solve_powerflow(two_buses(150.0, 40.0)).generation[0]
    together = solve_powerflow(case_of(document, where="x")).generation
    assert together.real == pytest.approx([0.9, 0.6], abs=1e-12)
    assert together.imag == pytest.approx([0.25 * alone.imag, 0.75 * alone.imag], abs=1e-12)


def test_questions_about_what_is_not_there() -> None:
    flow = solve_powerflow(two_buses(100.0, 0.0))
    with pytest.raises(CaseError, match="bus 3 does not exist"):
        flow.voltage(3)
    with pytest.raises(CaseError, match="ends at 1 and 2, got 3"):
        flow.flow("1-2", 3)
    with pytest.raises(CaseError, match=r"no \[tie\]"):
        _ = flow.tie_p
    with pytest.raises(ValueError, match="read-only"):
        flow.voltages[0] = 0.0
