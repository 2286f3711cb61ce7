"""Exact delays and synthesis for any linear system: closed forms, the loop itself, public problems."""

from __future__ import annotations

import control
import numpy as np
import pytest
import scipy.linalg

import interarea as ia


@pytest.mark.parametrize("k", [0.3, 2.0, 40.0])
def test_the_margin_of_an_integrator_is_a_quarter_turn(k: float) -> None:
    """|k / s| = 1 at k with a phase of -90 degrees: pi / 2 left, over k."""
    margin = ia.delay_margin(control.ss(0, 1, k, 0))
    assert margin.margin_s == pytest.approx(np.pi / 2.0 / k, rel=1e-12)
    assert margin.frequency_rad == pytest.approx(k, rel=1e-12)
    assert ia.delay_margin((0, 1, -k, 0), sign=1).margin_s == pytest.approx(margin.margin_s, rel=1e-12)


def test_the_smallest_of_several_crossings_counts() -> None:
    """A resonance crosses gain one three times; the margin is the least of the delays."""
    L = control.ss(control.tf([0.4], [1, 0]) + control.tf([0.5, 0.0], [1, 0.2, 9.0]))
    w = np.linspace(0.01, 10.0, 2_000_001)
    L_w = 0.4 / (1j * w) + 0.5j * w / (9.0 - w**2 + 0.2j * w)
    k = np.flatnonzero(np.diff(np.sign(np.abs(L_w) - 1.0)))
    delays = (np.angle(L_w[k]) + np.pi) % (2.0 * np.pi) / w[k]
    margin = ia.delay_margin(L)
    assert len(k) == 3 and margin.margin_s == pytest.approx(delays.min(), rel=1e-4)
    assert margin.frequency_rad == pytest.approx(w[k][np.argmin(delays)], rel=1e-4)


def test_a_loop_below_gain_one_bears_any_delay_and_an_unstable_one_none() -> None:
    assert ia.delay_margin(control.ss(-1, 1, 0.5, 0)).margin_s == np.inf
    with pytest.raises(ia.UserError, match="not stable without latency"):
        ia.delay_margin(control.ss(1, 1, 0.5, 0))


def test_poles_solve_the_exact_equation() -> None:
    """s + k exp(-s T) = 0: by Lambert's function; at the margin a pair lies on the axis."""
    k, T = 1.3, 0.7
    poles = ia.delayed_poles(control.ss(0, 1, k, 0), T, right_of=-4.0)
    exact = [scipy.special.lambertw(-k * T, b) / T for b in (0, -1, 1, -2)]
    for z in (e for e in exact if e.real > -4.0):
        assert np.abs(poles - z).min() < 1e-9
    margin = ia.delay_margin(control.ss(0, 1, k, 0)).margin_s
    assert abs(ia.delayed_poles(control.ss(0, 1, k, 0), margin)[0].real) < 1e-9
    assert ia.delayed_poles(control.ss(0, 1, k, 0), [0.0])[0] == pytest.approx(-k)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: ia.delay_margin(control.ss(-1, 1, 1, 1)), "neutral"),
        (lambda: ia.delay_margin(control.ss(-1, 1, 1, 0, 0.1)), "discrete time"),
        (lambda: ia.delay_margin(control.tf([1], [1, 1])), "control.ss"),
        (lambda: ia.delay_margin(control.ss(-1, [[1, 1]], 1, 0)), "as many of both"),
        (lambda: ia.delayed_poles(control.ss(-1, 1, 1, 0), -0.1), "0 s or more"),
        (lambda: ia.delayed_poles(control.ss(-1, 1, 1, 0), 0.1, sign=2), "sign = 2"),
        (
            lambda: ia.hinfsyn(control.ss(-1, 1, 1, 0), 2, 1),
            "measurements = 2, allowed: no number",
        ),
        (lambda: ia.h2syn(control.ss(-1, 1, 1, 0, True), 1, 1), "discrete time"),
    ],
)
def test_what_does_not_apply_is_refused(call, says: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ia.UserError, match=says):
        call()


def regulator(a: float, d22: float = 0.0) -> control.StateSpace:
    """x' = a x + w1 + u, z = (x, u), y = x + w2 + d22 u."""
    return control.ss(a, [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, d22]])


def closed(P: control.StateSpace, K: control.StateSpace) -> control.StateSpace:
    return P.lft(K, 1, 1)


@pytest.mark.slow
@pytest.mark.parametrize("d22", [0.0, 0.4])
def test_least_norms_of_a_scalar_plant(d22: float) -> None:
    """gamma = a + sqrt(a^2 + 2); H2: X = Y = a + sqrt(a^2 + 1), norm^2 = X + X^2 Y. The loop has them."""
    a = 1.0
    P = regulator(a, d22)
    hinf, h2 = ia.hinfsyn(P, 1, 1), ia.h2syn(P, 1, 1)
    assert hinf.facts["gamma_optimum"] == pytest.approx(a + np.sqrt(a * a + 2.0), rel=1e-7)
    X = a + np.sqrt(a * a + 1.0)
    assert h2.gamma == pytest.approx(np.sqrt(X + X**3), rel=1e-9)
    loop = closed(P, hinf.controller)
    w = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 20_000)])
    peak = max(np.linalg.norm(loop(1j * x), 2) for x in w[::20])
    assert loop.poles().real.max() < 0.0 and peak <= hinf.gamma * (1.0 + 1e-6)
    loop = closed(P, h2.controller)
    gramian = scipy.linalg.solve_continuous_lyapunov(loop.A, -loop.B @ loop.B.T)
    assert np.sqrt(np.trace(loop.C @ gramian @ loop.C.T)) == pytest.approx(h2.gamma, rel=1e-9)


def test_mixed_sensitivity_without_a_cost_of_control() -> None:
    """python-control issue 973: mixsyn(G, Wp) never returned.

    S is 1 at infinity, where Wp is 2/3; G has no zero to the right, so nothing else keeps |Wp S| up.
    """
    G, W = control.tf([1, 1], [1, 0.5, 4]), control.tf([2, -2.2, 1], [3, 0.2, 0.01])
    P = control.augw(control.ss(G), control.ss(W))
    design = ia.hinfsyn(P, 1, 1, radius=2000.0)
    assert 2.0 / 3.0 * (1.0 - 1e-6) <= design.norm_of["normal"] <= 0.70
    assert np.abs(design.poles_of["normal"]).max() <= 2000.0 * 1.001


@pytest.mark.slow
def test_tracking_without_a_cost_of_control() -> None:
    """python-control issue 152: hinfsyn took minutes to say that there is no controller.

    There is one: with S = s/(s + k), of a PI controller, |W S| stays below its value at infinity, which
    is 0.8 whatever the controller.
    """
    P = control.ss(
        [[-0.01, -0.992], [0.0, -0.75]],
        [[0.992, 0.0], [0.0, 1.0]],
        [[1.0, -0.8], [0.0, -1.0]],
        [[0.8, 0.0], [1.0, 0.0]],
    )
    design = ia.hinfsyn(P, 1, 1)
    w = np.logspace(-5, 12, 3000)
    peak = np.abs(closed(P, design.controller)(1j * w)).max()
    assert design.gamma == pytest.approx(0.8, rel=1e-5) and peak == pytest.approx(0.8, rel=1e-4)


def test_regions_hold() -> None:
    design = ia.hinfsyn(regulator(1.0), 1, 1, decay_rate=3.0, radius=50.0)
    poles = closed(regulator(1.0), design.controller).poles()
    assert poles.real.max() <= -3.0 * (1.0 - 1e-3) and np.abs(poles).max() <= 50.0 * (1.0 + 1e-3)
    assert design.gamma > 1.0 + np.sqrt(3.0)


def test_an_inadmissible_plant_is_named() -> None:
    """As in python-control issue 367: a measurement without dynamics; here a mode is not seen."""
    P = control.ss(
        np.diag([1.0, -1.0]),
        [[1, 0, 1], [0, 0, 1]],
        [[1, 0], [0, 0], [0, 1]],
        [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
    )
    for synthesis in (ia.hinfsyn, ia.h2syn):
        with pytest.raises(
            ia.InfeasibleDesign, match=r"mode at 1 1/s \(real\).*cannot be moved.*cannot be stabilised"
        ):
            synthesis(P, 1, 1)


@pytest.mark.parametrize(
    ("place", "says"), [((0, 0), "D11 is not zero"), ((1, 2), "D12 has rank 0"), ((2, 1), "D21 has rank 0")]
)
def test_h2_problems_without_an_optimum_are_named(place: tuple[int, int], says: str) -> None:
    P = regulator(1.0)
    P.D[place] = 1.0 - P.D[place]
    with pytest.raises(ia.InfeasibleDesign, match=says):
        ia.h2syn(P, 1, 1)
