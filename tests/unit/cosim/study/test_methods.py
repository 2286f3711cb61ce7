"""Methods as printed, prices of order reduction, and the error of the Padé model, by paths of their own."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import control
import numpy as np
import pytest

from interarea.cosim.run.artefacts import linear_plant
from interarea.cosim.run.controllers import design_controller
from interarea.cosim.study.delay import least_damping, least_swing, pade_poles
from interarea.cosim.study.methods import hankel_row, inter_area_roots, order_rows
from interarea.design.controllers.controller import Controller
from interarea.design.errors import UncertifiedDesign
from interarea.design.linear.linearise import remove_reference, select, speeds_in_rad
from interarea.design.modes.modes import modes_of
from interarea.design.reduction.balanced import balanced_truncation
from interarea.design.synthesis.generalized_plant import effort_plant, mixed_sensitivity
from interarea.design.synthesis.printed_iteration import printed_iteration
from interarea.design.synthesis.reduced_order import closed_norm, reduction_price
from interarea.design.synthesis.study_designs import WdcSpec, design_wdc
from interarea.models.case.case import Case

DIFFERENCE = {"dw24": {"G2_dw": 1.0, "G4_dw": -1.0}}


@pytest.fixture(scope="module")
def relative(two_area: Case, cache: Path) -> control.StateSpace:
    return remove_reference(linear_plant(two_area, cache))


@pytest.fixture(scope="module")
def plant(relative: control.StateSpace, two_area: Case) -> control.StateSpace:
    return speeds_in_rad(relative, two_area.omega_b)


@pytest.mark.slow
def test_the_norm_of_the_closed_loop_is_the_peak_over_frequency(
    plant: control.StateSpace, hand_controller: Controller
) -> None:
    G = select(plant, ["G4_vs"], DIFFERENCE)
    K = hand_controller.system
    k = control.ss(K.A, K.B[:, [0]], K.C, K.D[:, [0]])
    W1, W2 = WdcSpec(low_pass=20.0, high_pass=(5.0, 80.0)).weights()
    jw = 1j * np.geomspace(1e-3, 1e4, 20000)
    g, c = (system(jw).ravel() for system in (G, k))
    s = 1.0 / (1.0 - g * c)
    low, high = 20.0 / (jw + 20.0), 5.0 * jw / (jw + 80.0)
    peak = np.sqrt(np.abs(low * s) ** 2 + np.abs(high * c * s) ** 2).max()
    assert closed_norm(mixed_sensitivity(G, W1, W2), k) == pytest.approx(peak, rel=1e-4)
    effort = np.abs(c * s).max()
    assert closed_norm(effort_plant(G), k) == pytest.approx(effort, rel=1e-4)


@pytest.mark.slow
def test_a_reduction_that_costs_too_much_is_refused(relative: control.StateSpace, two_area: Case) -> None:
    """Order 4 doubles the effort of the wide-area controller: .246 to .502; order 6 costs nothing."""
    with pytest.raises(UncertifiedDesign, match=r"from 8 to 4 raises the effort .*0\.246.* to 0\.502"):
        design_wdc(relative, WdcSpec(price_cap=1.5), omega_b=two_area.omega_b)
    design = design_wdc(relative, WdcSpec(order=6, price_cap=1.01), omega_b=two_area.omega_b)
    before, after = design.design["reduction_price"]["effort"]
    assert after <= 1.01 * before


def test_the_price_counts_the_norm_as_well_as_the_effort(
    plant: control.StateSpace, hand_controller: Controller
) -> None:
    K = hand_controller.system
    more = control.ss(
        np.block([[K.A, np.zeros((2, 1))], [np.zeros((1, 2)), -np.eye(1)]]),
        np.vstack([K.B, np.zeros((1, 2))]),
        np.hstack([K.C, np.zeros((1, 1))]),
        K.D,
        inputs=K.input_labels,
        outputs=K.output_labels,
    )
    same = reduction_price("k", plant, more, K, None, 0.05, 2.0)
    assert same["effort"][1] == 0.05 and same["norm"] == same["effort"]
    with pytest.raises(UncertifiedDesign, match="raises the norm"):
        reduction_price("k", plant, more, K, (1.0, 2.1), same["effort"][0], 2.0)
    with pytest.raises(UncertifiedDesign, match="raises the norm"):
        reduction_price("k", plant, more, K, (1.0, float("nan")), same["effort"][0], 2.0)


def test_hankel_reduction_attains_the_next_hankel_value(plant: control.StateSpace) -> None:
    G = select(plant, ["G4_vs"], DIFFERENCE)
    sigma = balanced_truncation(G, 6).hankel_values
    row = hankel_row(G, 6)
    assert row["relative_hankel_error"] == pytest.approx(sigma[6] / sigma[0], rel=1e-4)
    assert row["relative_error"] <= row["relative_bound"]


@pytest.mark.slow
def test_both_roots_that_share_the_mode_are_shown(
    plant: control.StateSpace, two_area: Case, cache: Path
) -> None:
    """The report gave .337, `certify` .304: two roots of one loop, 0.57 and 0.76 Hz."""
    roots = inter_area_roots(plant, design_controller(two_area, "wdc", cache), "G2_dw")["normal"]
    assert [round(z, 3) for _, z in roots] == [0.337, 0.304]
    rows = order_rows(
        plant, design_controller(two_area, "wdc", cache, reduce=False), modes_of(plant, two_area.areas)
    )
    by_order = {row["order"]: row for row in rows}
    assert [round(by_order[k]["norm"], 3) for k in (6, 4)] == [1.0, 1.469]
    assert by_order[3]["failed"] and round(by_order[4]["effort"], 3) == 0.502


def test_pade_is_exact_without_latency_and_near_it_with_little(
    plant: control.StateSpace, hand_controller: Controller
) -> None:
    K = hand_controller.system
    for latency, error in ((0.0, 1e-8), (0.02, 1e-6), (0.1, 1e-3)):
        late = dict.fromkeys(K.input_labels, latency)
        model = least_swing(pade_poles(plant, K, late, 2))
        assert model == pytest.approx(least_damping(plant, K, late), abs=error), latency


def test_least_swing_looks_at_its_band_only() -> None:
    poles = np.array([-0.1 + 0.1j, -1.0 + 6.0j, -0.5 + 30.0j, -3.0])
    assert least_swing(poles) == pytest.approx(1.0 / np.hypot(1.0, 6.0))
    assert least_swing(np.array([-3.0 + 0j])) == 1.0


@pytest.mark.slow
def test_the_printed_iteration_narrows_the_sector_until_it_stops() -> None:
    """Two lightly damped modes, two speeds: every half-step is no wider, the loop keeps what is claimed."""
    A = np.array([[0.0, 1, 0, 0], [-16, -0.4, 2, 0], [0, 0, 0, 1], [2, 0, -50, -2.0]])
    B = np.array([[0.0], [1], [0], [2]])
    C = np.array([[0.0, 1, 0, 0], [0, 0, 0, 1]])
    G = control.ss(A, B, C, np.zeros((2, 1)), inputs=["u"], outputs=["remote", "local"])
    designs = printed_iteration(G, {"remote_lost": ("remote",)}, half_steps=4)
    theta = designs.facts["theta_rad"]
    assert all(b <= a for a, b in pairwise(theta)) and len(theta) >= 3
    open_loop = np.linalg.eigvals(A)
    widest = np.arccos(np.min(-open_loop.real / np.abs(open_loop)))
    assert theta[0] == pytest.approx(widest, abs=4e-3)  # step (i): B^ = 0, nothing is fed back
    K = designs.controller
    for keep in (np.array([1.0, 1.0]), np.array([0.0, 1.0])):
        poles = np.linalg.eigvals(np.block([[A, B @ K.C], [(K.B * keep) @ C, K.A]]))
        assert np.min(-poles.real / np.abs(poles)) >= 0.98 * np.cos(theta[-1]) - 1e-3
