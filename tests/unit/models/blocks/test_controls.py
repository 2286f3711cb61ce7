"""Exciters, stabilizers and governors in C against transfer functions, closed forms and other integrators."""

from __future__ import annotations

import itertools

import control
import numpy as np
import pytest
from plant_shim import BlockFailure, BlockShim
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import CaseError, load_case

CASE = "kundur-thyristor-z"
STATIC = {"kind": "static", "KA": 200.0, "TA": 0.02, "TR": 0.01, "Efd_min": -5.0, "Efd_max": 5.0}
TGR = {"kind": "static_tgr", "KA": 200.0, "TA": 0.02, "TR": 0.01, "TC": 1.0, "TB": 10.0}
ST1A = {
    "kind": "st1a",
    "KA": 200.0,
    "TA": 0.02,
    "TR": 0.01,
    "TC": 1.0,
    "TB": 10.0,
    "VRmin": -6.0,
    "VRmax": 6.4,
}
DROOP = ST1A | {"KC": 0.2}
DC1 = {"kind": "dc1", "KA": 20.0, "TA": 0.055, "TR": 0.05, "TC": 0.1, "TB": 0.3, "KE": 1.0, "TE": 0.36}
DC1 |= {"KF": 0.125, "TF": 1.8, "Aex": 0.0056, "Bex": 1.075, "VRmin": -3.0, "VRmax": 5.0}
SELF = DC1 | {"KE": "self-excited", "TC": 0.0, "TB": 0.0}
EXCITERS = {
    "static": STATIC,
    "tgr": TGR,
    "st1a": ST1A,
    "st1a droop": DROOP,
    "dc1": DC1,
    "dc1 self-excited": SELF,
}
PSS = {
    "K": 20.0,
    "Tw": 10.0,
    "T1": 0.05,
    "T2": 0.02,
    "T3": 3.0,
    "T4": 5.4,
    "T5": 0.07,
    "T6": 0.03,
    "TR": 0.01,
}
STEAM = {"kind": "steam", "Kp": 1.5, "Rp": 0.05, "Tsr": 0.1, "Tsm": 0.3, "vg_min": -0.1, "vg_max": 0.1}
STEAM |= {
    "gate_min": 0.0,
    "gate_max": 1.2,
    "T5": 0.5,
    "T4": 3.3,
    "T3": 10.0,
    "F5": 0.36,
    "F4": 0.36,
    "F3": 0.28,
}
TGOV1 = {"kind": "tgov1", "R": 0.05, "T1": 0.5, "T2": 3.0, "T3": 10.0, "Dt": 0.2, "Vmin": 0.0, "Vmax": 1.1}
s = control.tf("s")


def plant_with(exciter=STATIC, stabilizer=None, governor=None, **parameters) -> BlockShim:
    """Machine G1 with these controls, the others with constant field voltage."""
    row = {"exciter": exciter}
    row |= {"stabilizer": stabilizer} if stabilizer else {}
    row |= {"governor": governor} if governor else {}
    change = {"defaults": {"exciter": {"kind": "constant"}}, "G1": row}
    return BlockShim(plant_block(load_case(CASE).with_changes({"machines": change})), parameters)


def index(plant: BlockShim, *names: str) -> list[int]:
    return [plant.state_names.index(name) for name in names]


def device_states(plant: BlockShim, device: str) -> list[int]:
    return [k for k, name in enumerate(plant.state_names) if name.startswith(f"G1.{device}.")]


def response(A, b, c, d, w):
    """C (jwI - A)^-1 B + D at each w."""
    return np.array([(c @ np.linalg.solve(1j * x * np.eye(len(A)) - A, b)) + d for x in w])


def efd_output(plant: BlockShim) -> tuple[np.ndarray, np.ndarray]:
    """Row of Efd against states and inputs: d eq1/dt = (Efd - ...)/Td01, other states held."""
    A, B, _, _ = plant.jacobians()
    Td01 = load_case(CASE).machines[0].Td01
    (k,) = index(plant, "G1.eq1")
    return A[k] * Td01, B[k] * Td01


W = np.geomspace(1e-2, 1e3, 23)


def lead(T1, T2):
    return (1 + T1 * s) / (1 + T2 * s)


@pytest.mark.parametrize("kind", EXCITERS)
def test_exciter_is_its_transfer_function(kind):
    """From the summing point to the field voltage with the terminal voltage held."""
    e = EXCITERS[kind]
    plant = plant_with(e)
    own = device_states(plant, "exciter")
    A, B, _, _ = plant.jacobians()
    row, direct = efd_output(plant)
    regulator = e["KA"] / (1 + e["TA"] * s) * (lead(e["TC"], e["TB"]) if e.get("TB") else 1)
    if e["kind"] == "dc1":
        efd = plant.x[index(plant, "G1.exciter.efd")[0]]
        S = e["Aex"] * np.exp(e["Bex"] * efd)
        KE = -S if e["KE"] == "self-excited" else e["KE"]
        loss = KE + S * (1 + e["Bex"] * efd)  # slope of (KE + SE) Efd
        regulator = control.feedback(regulator / (e["TE"] * s + loss), e["KF"] * s / (1 + e["TF"] * s))
    expected = regulator(1j * W)
    ours = response(A[np.ix_(own, own)], B[own, 0], row[own], direct[0], W)
    np.testing.assert_allclose(ours, expected, rtol=1e-9)


@pytest.mark.parametrize("kind", EXCITERS)
def test_terminal_voltage_acts_through_the_transducer_with_the_opposite_sign(kind):
    """A field-axis disturbance changes Vt; Efd answers as -G/(1 + s TR)."""
    e = EXCITERS[kind]
    plant = plant_with(e)
    own = device_states(plant, "exciter")
    A, B, C, _ = plant.jacobians()
    row, direct = efd_output(plant)
    (k,) = index(plant, "G1.delta")
    slope = C[plant.output_names.index("G1_vt"), k]  # of the terminal voltage
    from_input = response(A[np.ix_(own, own)], B[own, 0], row[own], direct[0], W)
    from_angle = response(A[np.ix_(own, own)], A[own, k], row[own], 0.0, W)
    np.testing.assert_allclose(from_angle, -from_input * slope / (1 + 1j * W * e["TR"]), rtol=1e-8)


@pytest.mark.parametrize("stages", [0, 1, 2, 3])
def test_stabilizer_is_its_transfer_function(stages):
    p = {key: PSS[key] for key in ("K", "Tw", "TR", "T1", "T2", "T3", "T4", "T5", "T6")[: 3 + 2 * stages]}
    plant = plant_with(STATIC | {"TA": 0.0, "TR": 0.0}, p)
    own = device_states(plant, "stabilizer")
    assert len(own) == 2 + stages
    A, _, _, _ = plant.jacobians()
    row, _ = efd_output(plant)
    (slip,) = index(plant, "G1.slip")
    expected = p["K"] * p["Tw"] * s / (1 + p["Tw"] * s) / (1 + p["TR"] * s)
    for k in range(stages):
        expected = expected * lead(p[f"T{2 * k + 1}"], p[f"T{2 * k + 2}"])
    ours = response(A[np.ix_(own, own)], A[own, slip], row[own], row[slip], W) / STATIC["KA"]
    np.testing.assert_allclose(ours, expected(1j * W), rtol=1e-9)


@pytest.mark.parametrize("governor", [STEAM, TGOV1], ids=["steam", "tgov1"])
def test_governor_is_its_transfer_function(governor):
    """From speed to mechanical power: 2H d slip/dt = Pm - Te."""
    plant = plant_with(governor=governor)
    own = device_states(plant, "governor")
    A, _, _, _ = plant.jacobians()
    (slip,) = index(plant, "G1.slip")
    H = load_case(CASE).machines[0].H
    ours = 2 * H * response(A[np.ix_(own, own)], A[own, slip], A[slip, own], A[slip, slip], W)
    g = governor
    if g["kind"] == "tgov1":
        expected = -1 / g["R"] / (1 + g["T1"] * s) * lead(g["T2"], g["T3"]) - g["Dt"]
    else:
        chest = 1 / (1 + g["T5"] * s)
        reheat = chest / (1 + g["T4"] * s)
        turbine = g["F5"] * chest + g["F4"] * reheat + g["F3"] * reheat / (1 + g["T3"] * s)
        expected = -g["Kp"] / g["Rp"] / (1 + g["Tsr"] * s) / (1 + g["Tsm"] * s) * turbine
    np.testing.assert_allclose(ours, expected(1j * W), rtol=1e-9)


@pytest.mark.parametrize("kind", EXCITERS)
@pytest.mark.parametrize("governor", [STEAM, TGOV1], ids=["steam", "tgov1"])
def test_every_set_of_controls_starts_at_rest_and_has_exact_derivatives(kind, governor):
    plant = plant_with(EXCITERS[kind], PSS, governor)
    assert np.abs(plant.derivatives(plant.x)[0]).max() < 1e-9
    A, B, C, _ = plant.jacobians()
    rng = np.random.default_rng(5)
    for _ in range(6):
        vx, vu = rng.standard_normal(len(plant.x)) * 1e-2, rng.standard_normal(1) * 1e-2

        def slope(h, vx=vx, vu=vu):
            up, down = (plant.derivatives(plant.x + k * h * vx, k * h * vu) for k in (1, -1))
            return (np.concatenate(up) - np.concatenate(down)) / (2 * h)

        exact = np.concatenate([A @ vx + B @ vu, C @ vx])
        size = np.concatenate([abs(A) @ abs(vx) + abs(B) @ abs(vu), abs(C) @ abs(vx)])
        worst = np.max(np.abs(romberg(slope) - exact) / np.maximum(size, 1e-3))
        assert worst < 1e-10


def romberg(slope, h=0.2, levels=5):
    """Central differences at h, h/2, h/4, .. extrapolated to h = 0: error of order h^10."""
    row = [slope(h / 2**k) for k in range(levels)]
    for order in range(1, levels):
        row = [(4**order * fine - coarse) / (4**order - 1) for coarse, fine in itertools.pairwise(row)]
    return row[0]


@pytest.mark.parametrize("kind", EXCITERS)
def test_declared_dependencies_hold_for_every_control(kind):
    plant = plant_with(EXCITERS[kind], PSS, TGOV1)
    A, B, C, D = plant.jacobians()
    columns = [*plant.state_names, *plant.input_names]
    rows = [v for v in plant.table.reals if v.role in ("derivative", "output")]
    for row, values in zip(rows, np.block([[A, B], [C, D]]), strict=True):
        assert {columns[k] for k in np.flatnonzero(values)} <= set(row.depends_on), row.name


@pytest.mark.parametrize(
    ("exciter", "change"),
    [
        (DC1, {"KA": 31.0, "KE": 0.7, "Aex": 0.01, "Bex": 0.9, "TC": 0.2}),
        (DC1 | {"TA": 0.0, "TR": 0.0}, {"KA": 31.0, "KE": 0.7}),
        (ST1A, {"KA": 150.0, "VRmax": 5.0}),
        (TGR, {"KA": 150.0, "TB": 8.0}),
    ],
)
def test_any_parameter_keeps_the_equilibrium(exciter, change):
    plant = plant_with(exciter, **{f"G1.exciter.{key}": value for key, value in change.items()})
    assert np.abs(plant.derivatives(plant.x)[0]).max() < 1e-9


@pytest.mark.parametrize(
    ("exciter", "parameters", "says"),
    [
        (DC1, {"VRmax": 0.5}, r"regulator .* above VRmax = 0.5; set VRmax to at least"),
        (ST1A, {"VRmax": 1.0}, r"efd .* above vt\*VRmax - KC\*ifd = "),
    ],
)
def test_limits_that_exclude_the_operating_point_are_refused(exciter, parameters, says):
    with pytest.raises(BlockFailure, match=r"G1.exciter: no equilibrium .* a limit excludes it"):
        plant_with(exciter, **{f"G1.exciter.{key}": value for key, value in parameters.items()})
    with pytest.raises(CaseError, match=says):
        plant_with(exciter | parameters)


def exciter_alone(plant: BlockShim, u: float):
    """Right-hand side of the exciter's states only; everything else stays at rest."""
    own, x, signal = device_states(plant, "exciter"), plant.x.copy(), np.array([u])

    def rhs(t, z):
        x[own] = z
        return plant.derivatives(x, signal)[0][own]

    return rhs, plant.x[own]


def runge_kutta(rhs, z, stop, h):
    for _ in range(round(stop / h)):
        k1 = rhs(0, z)
        k2 = rhs(0, z + h / 2 * k1)
        k3 = rhs(0, z + h / 2 * k2)
        z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + rhs(0, z + h * k3))
    return z


def test_limited_lag_reaches_its_limit_and_leaves_it_at_the_closed_form_times():
    """Efd0 + (KA u)(1 - exp(-t/TA)) until the limit; after the step back down it leaves the limit at once."""
    plant = plant_with(STATIC | {"TR": 0.0})
    rhs, z0 = exciter_alone(plant, 0.05)
    efd0, rise, TA, high = z0[0], 200.0 * 0.05, 0.02, 5.0
    hit = brentq(lambda t: efd0 + rise * (1 - np.exp(-t / TA)) - high, 0.0, 1.0)
    held = solve_ivp(rhs, (0.0, 3 * hit), z0, rtol=1e-10, atol=1e-10, max_step=1e-4)
    before = held.t < hit
    np.testing.assert_allclose(held.y[0][before], efd0 + rise * (1 - np.exp(-held.t[before] / TA)), rtol=1e-8)
    assert held.y[0].max() < high + 1e-3
    back, _ = exciter_alone(plant, 0.0)
    away = solve_ivp(back, (0.0, 0.05), [high], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(away.y[0], efd0 + (high - efd0) * np.exp(-away.t / TA), rtol=1e-7)


def test_a_large_step_past_the_limit_never_shows_and_does_not_wind_up():
    """The solver's overshoot is not in the field voltage, and is gone before the signal turns."""
    plant = plant_with(STATIC | {"TR": 0.0})
    rhs, z0 = exciter_alone(plant, 1.0)  # asks for 200 pu
    z = runge_kutta(rhs, z0, 0.4, 0.002)
    assert z[0] == pytest.approx(5.0, abs=1e-6)
    x = plant.x.copy()
    x[device_states(plant, "exciter")] = 9.0  # anything beyond the limit
    plant.derivatives(x)
    assert plant_field(plant, x) == pytest.approx(5.0, abs=1e-12)


def plant_field(plant: BlockShim, x) -> float:
    """Field voltage of G1 from d eq1/dt against the same state with the field voltage at rest."""
    m = load_case(CASE).machines[0]
    (k,) = index(plant, "G1.eq1")
    rest = plant.x[device_states(plant, "exciter")[-1]]
    return rest + m.Td01 * plant.derivatives(x)[0][k]


def test_st1a_limits_follow_the_terminal_voltage_and_the_field_current():
    plant = plant_with(DROOP)
    own = device_states(plant, "exciter")
    x = plant.x.copy()
    x[own[-1]] = 50.0
    values = dict(zip(plant.output_names, plant.derivatives(x)[1], strict=True))
    current = plant.x[own[-1]]  # at rest the field current is the field voltage
    assert plant_field(plant, x) == pytest.approx(6.4 * values["G1_vt"] - 0.2 * current, rel=1e-9)
    x[own[-1]] = -50.0
    assert plant_field(plant, x) == pytest.approx(-6.0 * values["G1_vt"], rel=1e-9)


@pytest.mark.slow
def test_dc1_against_its_equations_written_again():
    """Large step through the regulator's limit, integrated from a second writing of the equations."""
    e = DC1
    plant = plant_with(e)
    rhs, z0 = exciter_alone(plant, 0.4)
    vt, _, r0, _, _ = z0
    vref = vt + r0 / e["KA"]

    def written_again(t, z):
        v, lag, r, efd, f = z
        error = vref + 0.4 - v - e["KF"] / e["TF"] * (efd - f)
        y = error * e["TC"] / e["TB"] + lag * (1 - e["TC"] / e["TB"])
        want = (e["KA"] * y - r) / e["TA"]
        dr = 0.0 if (r >= e["VRmax"] and want > 0) or (r <= e["VRmin"] and want < 0) else want
        r = min(max(r, e["VRmin"]), e["VRmax"])
        loss = e["KE"] + e["Aex"] * np.exp(e["Bex"] * efd)
        return [
            (vt - v) / e["TR"],
            (error - lag) / e["TB"],
            dr,
            (r - loss * efd) / e["TE"],
            (efd - f) / e["TF"],
        ]

    other = solve_ivp(written_again, (0.0, 1.5), z0, rtol=1e-9, atol=1e-9, max_step=2e-4).y[:, -1]
    ours = runge_kutta(rhs, z0, 1.5, 0.001)
    assert other[2] == pytest.approx(5.0, abs=2e-2)  # the limit acts
    np.testing.assert_allclose(ours[[0, 1, 3, 4]], other[[0, 1, 3, 4]], rtol=2e-5)


@pytest.mark.parametrize(("governor", "state"), [(STEAM, "gate"), (TGOV1, "valve")])
def test_gate_limits_hold_and_let_go(governor, state):
    plant = plant_with(governor=governor | {"gate_max": 1.0} if state == "gate" else governor | {"Vmax": 1.0})
    (k,) = index(plant, f"G1.governor.{state}")
    (slip,) = index(plant, "G1.slip")
    x = plant.x.copy()
    x[k] = 1.0
    relay = [j for j, name in enumerate(plant.state_names) if name == "G1.governor.relay"]
    x[relay] = 1.5
    x[slip] = -0.05
    assert plant.derivatives(x)[0][k] == 0.0
    x[relay] = 0.5
    x[slip] = 0.05
    assert plant.derivatives(x)[0][k] < 0.0


def test_servomotor_moves_no_faster_than_its_rate_limit():
    plant = plant_with(governor=STEAM)
    (gate,), (relay,) = index(plant, "G1.governor.gate"), index(plant, "G1.governor.relay")
    x = plant.x.copy()
    x[relay] += 1.0
    assert plant.derivatives(x)[0][gate] == 0.1
    x[relay] -= 2.0
    assert plant.derivatives(x)[0][gate] == -0.1
