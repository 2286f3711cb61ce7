"""Loads of any characteristic and saturated machines: the C against a network solved without ports."""

from __future__ import annotations

import numpy as np
import pytest
from plant_shim import BlockFailure, BlockShim
from scipy.optimize import fsolve

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import Case, load_case
from interarea.models.case.events import events_of
from interarea.models.grid.equilibrium import operating_point
from interarea.models.grid.network import admittance_matrix, bus_index, load_power

SATURATED = {"Asat": 0.015, "Bsat": 9.6, "psiT1": 0.9, "use": "total"}
CHANGES = {
    "constant power": {"loads": {"defaults": {"P_exponent": 0.0, "Q_exponent": 0.0}}},
    "zip": {
        "loads": {
            "L7": {"P_exponent": "none", "P_zip": [0.3, 0.3, 0.4]},
            "L9": {"Q_exponent": "none", "Q_zip": [-0.2, 0.5, 0.7]},
        }
    },
    "exponents": {"loads": {"L7": {"P_exponent": 1.3, "Q_exponent": 3.1}, "L9": {"P_exponent": 0.4}}},
    "saturation": {"machines": {"defaults": {"saturation": SATURATED}}},
    "leakage": {"machines": {"G1": {"Xl": 0.25, "saturation": SATURATED}, "G3": {"saturation": SATURATED}}},
    "saliency": {"machines": {"G1": {"Xq2": 0.3}, "G3": {"Xd2": 0.22, "Xq2": 0.4, "saturation": SATURATED}}},
}


def case_of(change: str) -> Case:
    """The manual case of Kundur without saturation, changed."""
    base = load_case("kundur-manual").with_changes({"machines": {"defaults": {"saturation": "none"}}})
    return base.with_changes(CHANGES[change])


@pytest.fixture(scope="module", params=CHANGES)
def case(request):
    return case_of(request.param)


def started(case: Case, *events: dict) -> BlockShim:
    return BlockShim(plant_block(case), event_parameters(case, events_of(events, where="test")))


def away(plant: BlockShim, size: float, seed: int = 5) -> np.ndarray:
    return plant.x + size * np.random.default_rng(seed).standard_normal(len(plant.x))


def demand(load, letter: str, volt: float, rest: float) -> float:
    """P or Q relative to that at rest, from the definition; limits of constant current and power apply."""
    u = volt / rest

    def share(exponent: float) -> float:
        low = (0.5 if exponent >= 1.0 else 0.7) / rest
        if exponent >= 2.0 or u >= low:
            return u**exponent if u > 0.0 else 0.0
        return low**exponent * (u / low) ** 2

    mix = getattr(load, f"{letter}_zip")
    if mix is None:
        exponent = getattr(load, f"{letter}_exponent")
        if exponent > 2.0:  # an exponent above 2 ends at half the voltage as well
            low = 0.5 / rest
            return u**exponent if u >= low else low**exponent * (u / low) ** 2
        return share(exponent)
    return mix[0] * share(2.0) + mix[1] * share(1.0) + mix[2] * share(0.0)


def solved(
    case: Case, plant: BlockShim, x: np.ndarray, fault: tuple[int, complex] | None = None
) -> np.ndarray:
    """Bus voltages by solving Kirchhoff's law at every bus and the stator equations of every machine."""
    Y, index = admittance_matrix(case), bus_index(case)
    if fault:
        Y[index[fault[0]], index[fault[0]]] += 1.0 / fault[1]
    at = dict(zip(plant.state_names, x, strict=True))
    rest = operating_point(case).power_flow

    def currents(m, V):
        """id, iq of a machine at its terminal voltage, by its own equations."""
        delta, eq2, ed2 = (at[f"{m.name}.{key}"] for key in ("delta", "eq2", "ed2"))
        v = V * np.exp(-1j * delta)
        vd, vq = -v.imag, v.real

        def wrong(i):
            d, q = i
            psi_ad, psi_aq = vq + m.Ra * q + m.Xl * d, -(vd + m.Ra * d - m.Xl * q)
            s = 0.0
            if m.saturation is not None and m.saturation.use == "total":
                flux = np.hypot(psi_ad, psi_aq)
                s = m.saturation.Asat * np.exp(m.saturation.Bsat * (flux - m.saturation.psiT1)) / flux
            isd, isq = s * psi_ad / (m.Xd - m.Xl), s * psi_aq / (m.Xq - m.Xl)
            return [
                eq2 - (m.Xd2 - m.Xl) * (d + isd) - psi_ad,
                ed2 + (m.Xq2 - m.Xl) * (q + isq) + psi_aq,
            ]

        d, q = fsolve(wrong, [0.5, 0.5], xtol=1e-12, full_output=True)[0]
        return (q - 1j * d) * np.exp(1j * delta) * m.base_mva / case.base_mva

    def mismatch(z):
        V = z[: len(Y)] + 1j * z[len(Y) :]
        I = -Y @ V
        for m in case.machines:
            I[index[m.bus]] += currents(m, V[index[m.bus]])
        for load in case.loads:
            k, s = index[load.bus], load_power(case, load)
            v0 = abs(rest.voltage(load.bus))
            p, q = (demand(load, letter, abs(V[k]), v0) for letter in "PQ")
            I[k] -= np.conj(complex(s.real * p, s.imag * q) / V[k]) if V[k] else 0.0
        return np.r_[I.real, I.imag]

    guess = rest.voltages if fault is None else 0.6 * rest.voltages
    z, _, flag, text = fsolve(mismatch, np.r_[guess.real, guess.imag], xtol=1e-13, full_output=True)
    assert flag == 1 or np.abs(mismatch(z)).max() < 1e-9, text
    return z[: len(Y)] + 1j * z[len(Y) :]


def test_nothing_moves_at_rest(case):
    plant = started(case)
    dx, _ = plant.derivatives(plant.x)
    assert np.abs(dx).max() < 1e-11
    point = operating_point(case)
    np.testing.assert_allclose(plant.w[: len(case.buses)], point.power_flow.magnitudes, atol=1e-9)


def test_bus_voltages_are_those_of_kirchhoffs_law(case):
    plant = started(case)
    x = away(plant, 0.02)
    plant.derivatives(x)
    np.testing.assert_allclose(plant.w[: len(case.buses)], np.abs(solved(case, plant, x)), atol=1e-9)


def test_voltages_under_a_fault_too(case):
    """Low voltages: below .5 pu constant current and below .7 pu constant power become impedances."""
    fault = {"kind": "bus_fault", "bus": 7, "start_s": 0.0, "end_s": 1.0, "x_pu": 0.02}
    plant = started(case, fault)
    x = away(plant, 0.01)
    plant.derivatives(x)
    volts = plant.w[: len(case.buses)]
    assert volts[6] < 0.5
    np.testing.assert_allclose(volts, np.abs(solved(case, plant, x, (7, 0.02j))), atol=1e-8)


@pytest.mark.parametrize("fault", [False, True])
def test_directional_derivatives_agree_with_central_differences(case, fault):
    event = {"kind": "bus_fault", "bus": 7, "start_s": 0.0, "end_s": 1.0, "x_pu": 0.03}
    plant = started(case, *([event] if fault else []))
    x = away(plant, 0.01)
    A, _, C, _ = plant.jacobians(x)
    h = 1e-5
    for k in range(len(x)):
        step = np.zeros(len(x))
        step[k] = h
        up, down = plant.derivatives(x + step), plant.derivatives(x - step)
        for exact, high, low in ((A[:, k], up[0], down[0]), (C[:, k], up[1], down[1])):
            difference = (high - low) / (2 * h)
            np.testing.assert_allclose(difference, exact, atol=3e-6 * max(1.0, np.abs(exact).max()))


def test_incremental_factor_is_the_slope_along_the_line():
    """Same rest; the incremental machine answers with Kundur's constant Bsat psi_I in both axes."""
    rest, slopes = [], []
    for use in ("total", "incremental"):
        changed = load_case("kundur-manual").with_changes(
            {"machines": {"defaults": {"saturation": SATURATED | {"use": use}}}}
        )
        plant = started(changed)
        rest.append(plant.x.copy())
        slopes.append(plant.jacobians()[0])
        assert np.abs(plant.derivatives(plant.x)[0]).max() < 1e-11
    np.testing.assert_allclose(rest[0], rest[1], atol=1e-13)
    assert np.abs(slopes[0] - slopes[1]).max() > 1e-2


def test_field_voltage_at_rest_is_the_saturated_phasor_diagram():
    """Efd = psi_ad/K_s + (Xd - Xl) id and psi_aq = -K_s (Xq - Xl) iq.  [Kundur1994, sec. 3.8]"""
    case = case_of("saturation")
    point = operating_point(case)
    for k, (m, p) in enumerate(zip(case.machines, point.machines, strict=True)):
        V = point.power_flow.voltage(m.bus)
        I = np.conj(point.power_flow.generation[k] / V) * case.base_mva / m.base_mva
        gap, i = (V + complex(m.Ra, m.Xl) * I) * np.exp(-1j * p.delta), I * np.exp(-1j * p.delta)
        psi = m.saturation.Asat * np.exp(m.saturation.Bsat * (abs(gap) - m.saturation.psiT1))
        Ks = abs(gap) / (abs(gap) + psi)
        assert p.efd == pytest.approx(gap.real / Ks - (m.Xd - m.Xl) * i.imag, abs=1e-9)
        assert gap.imag == pytest.approx(-Ks * (m.Xq - m.Xl) * i.real, abs=1e-9)


def test_constant_impedance_written_otherwise_has_no_port():
    case = load_case("two-area-thesis")
    other = case.with_changes({"loads": {"L7": {"P_exponent": "none", "P_zip": [1.0, 0.0, 0.0]}}})
    assert len(plant_block(other).data["port.table"]) == 0
    near = case.with_changes({"loads": {"defaults": {"P_exponent": 2.0 - 1e-9, "Q_exponent": 2.0 + 1e-9}}})
    plain, ported = started(case), started(near)
    assert len(plant_block(near).data["port.table"]) == 2
    x = away(plain, 0.02)
    np.testing.assert_allclose(ported.derivatives(x)[1], plain.derivatives(x)[1], atol=1e-8)


def test_result_does_not_depend_on_where_newton_starts(case):
    plant = started(case)
    x = away(plant, 0.02)
    first = plant.derivatives(x)
    for seed in range(5):
        plant.derivatives(away(plant, 0.1, seed))
    again = plant.derivatives(x)
    np.testing.assert_allclose(again[0], first[0], atol=1e-11)
    np.testing.assert_allclose(again[1], first[1], atol=1e-12)


def test_same_memory_same_bits(case):
    plant = started(case)
    memory = plant.memory.copy()
    x = away(plant, 0.05)
    first = plant.derivatives(x)
    plant.memory[:] = memory
    again = plant.derivatives(x)
    np.testing.assert_array_equal(again[0], first[0])
    np.testing.assert_array_equal(again[1], first[1])


def test_load_step_is_more_of_the_same_load():
    case = case_of("constant power")
    more = {"kind": "load_step", "load": "L7", "start_s": 0.0, "p_pu": 1.0, "q_pu": 0.2}
    plant = started(case, more)
    plant.derivatives(plant.x)
    stepped = case.with_changes({"loads": {"L7": {"P_mw": 1067.0, "Q_mvar": 120.0}}})
    expected = solved_with_rest_of(case, stepped, plant)
    np.testing.assert_allclose(plant.w[: len(case.buses)], np.abs(expected), atol=1e-9)


def solved_with_rest_of(case: Case, stepped: Case, plant: BlockShim) -> np.ndarray:
    """Voltages with the loads of `stepped`; constant power does not ask for the voltage at rest."""
    assert all(load.P_exponent == load.Q_exponent == 0.0 for load in stepped.loads)
    return solved(stepped, plant, plant.x)


@pytest.mark.parametrize(("change", "element"), [("zip", "a load"), ("saturation", "the saturation")])
def test_a_state_that_is_not_finite_is_refused_with_its_bus(change, element):
    plant = started(case_of(change))
    x = plant.x.copy()
    x[plant.state_names.index("G2.eq2")] = np.nan
    with pytest.raises(BlockFailure, match=rf"bus \d+ with {element}.* t = 0") as failure:
        plant.derivatives(x)
    assert failure.value.status == 1  # the step is given up, the state before it stays good
    assert np.abs(plant.derivatives(plant.x)[0]).max() < 1e-11


def test_controls_of_a_tripped_machine_stand_still():
    case = load_case("two-area-thesis")
    plant = started(case, {"kind": "machine_trip", "machine": "G2", "start_s": 0.0})
    x = away(plant, 0.05)
    dx, _ = plant.derivatives(x)
    own = np.array([name.startswith("G2.") for name in plant.state_names])
    assert own.sum() > 10
    assert not dx[own].any()
    assert np.all(dx[~own] != 0.0)
