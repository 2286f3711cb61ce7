"""Modes of a sparse plant with a late controller, against a dense discretisation that is written here."""

from functools import cache

import control
import numpy as np
import pytest

from interarea.cosim.run.artefacts import linear_matrices, sparse_linear_plant
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.delay.late_plant import LatePlant
from interarea.design.linear.sparse_plant import SparsePlant
from interarea.design.modes.all_modes import all_modes
from interarea.design.modes.mode_count import Region, count_modes
from interarea.design.modes.modes import ModeError
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case

BAND_HZ, BELOW = (0.1, 2.5), 0.3
REGION = Region((0.2 * np.pi, 5.0 * np.pi), BELOW)


@cache
def plant_of(name: str) -> SparsePlant:
    return sparse_linear_plant(load_case(name), default_cache())


def two_loops(gain: float) -> control.StateSpace:
    """Two own speeds to two exciters of the 68-bus grid, a washout of 5 s in each."""
    machines = ("G9", "G13")
    return control.ss(
        *(-0.2 * np.eye(2), np.eye(2), -0.2 * gain * np.eye(2), gain * np.eye(2)),
        inputs=[f"{m}_dw" for m in machines],
        outputs=[f"{m}_vs" for m in machines],
    )


CONTROLLERS = {
    "two-area-thesis": lambda: shipped_controller("robust").system,
    "new-england": lambda: shipped_controller("new_england").system,
    "nets-nyps": lambda: two_loops(0.03),
}


def generator(name: str, K: control.StateSpace, latency_s: np.ndarray, nodes: int = 40) -> np.ndarray:
    """Plant, controller and the past of each late signal at Chebyshev points, by differentiation there."""
    m = linear_matrices(load_case(name), default_cache())
    n, nk, p = len(m.A), K.nstates, len(K.input_labels)
    B = m.B[:, [list(m.input_labels).index(u) for u in K.output_labels]]
    C = load_case(name).omega_b * m.C[[list(m.output_labels).index(y) for y in K.input_labels]]
    theta = np.cos(np.pi * np.arange(nodes + 1) / nodes)
    weight = np.array([(-1.0) ** j * (0.5 if j in (0, nodes) else 1.0) for j in range(nodes + 1)])
    gap = theta[:, None] - theta[None, :]
    np.fill_diagonal(gap, 1.0)
    D = weight[None, :] / weight[:, None] / gap
    np.fill_diagonal(D, 0.0)
    D -= np.diag(D.sum(axis=1))
    whole = np.zeros((n + nk + p * nodes,) * 2)
    past = [slice(n + nk + k * nodes, n + nk + (k + 1) * nodes) for k in range(p)]
    whole[:n, :n], whole[:n, n : n + nk], whole[n : n + nk, n : n + nk] = m.A, B @ K.C, K.A
    for k, tau in enumerate(latency_s):
        read = np.vstack([B @ K.D[:, k : k + 1], K.B[:, k : k + 1]])
        if tau > 0.0:
            whole[past[k], past[k]] = 2.0 / tau * D[1:, 1:]
            whole[past[k], :n] = 2.0 / tau * np.outer(D[1:, 0], C[k])
            whole[: n + nk, past[k].stop - 1] = read[:, 0]
        else:
            whole[: n + nk, :n] += read @ C[k : k + 1]
            whole[past[k], past[k]] = -1e3 * np.eye(nodes)
    return whole


@pytest.mark.slow
@pytest.mark.parametrize("latency", [0.0, 0.15, 0.5])
@pytest.mark.parametrize("name", list(CONTROLLERS))
def test_modes_are_those_of_a_fine_discretisation(name: str, latency: float) -> None:
    case, K = load_case(name), CONTROLLERS[name]()
    late = latency * np.array([1.0, *[0.6] * (len(K.input_labels) - 1)])  # of two kinds
    loop = LatePlant(
        plant_of(name),
        K,
        dict(zip(K.input_labels, late.tolist(), strict=True)),
        omega_b=case.omega_b,
        high_hz=BAND_HZ[1],
    )
    result = all_modes(plant_of(name), case.areas, band_hz=BAND_HZ, below=BELOW, loop=loop)
    values = np.linalg.eigvals(generator(name, K, late))
    dense = values[REGION.holds(values)]
    assert result.counted == len(result.modes) == len(dense) >= 2
    for mode in result.modes:
        assert np.min(np.abs(mode.eigenvalue - dense)) < 1e-7 * abs(mode.eigenvalue)
    assert result.residual <= 1e-9


def test_the_count_of_a_late_loop_needs_no_search() -> None:
    """The controller moves two modes over the line; 0.3 s later there are others."""
    K, name = two_loops(0.2), "nets-nyps"
    for latency in (0.0, 0.3):
        late = dict.fromkeys(K.input_labels, latency)
        loop = LatePlant(plant_of(name), K, late, omega_b=load_case(name).omega_b, high_hz=2.5)
        values = np.linalg.eigvals(generator(name, K, np.full(2, latency)))
        assert count_modes(loop, REGION, []).modes == np.sum(REGION.holds(values))


def test_vectors_of_a_late_mode_tell_how_a_parameter_moves_it() -> None:
    """left' dA right, scaled with the derivative of the late loop: against two discretisations."""
    name, K, latency = "two-area-thesis", CONTROLLERS["two-area-thesis"](), 0.2
    late = dict.fromkeys(K.input_labels, latency)
    loop = LatePlant(plant_of(name), K, late, omega_b=load_case(name).omega_b, high_hz=2.5)
    result = all_modes(plant_of(name), load_case(name).areas, band_hz=BAND_HZ, below=BELOW, loop=loop)
    mode = result.modes[0]
    at = plant_of(name).speed[1]
    whole, ends = generator(name, K, np.full(2, latency)), []
    for h in (1e-4, -1e-4):
        moved = whole.copy()
        moved[at, at] += h
        values = np.linalg.eigvals(moved)
        ends.append(values[np.argmin(np.abs(values - mode.eigenvalue))])
    assert mode.left[at] * mode.right[at] == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=1e-4)


@pytest.mark.parametrize(
    ("latency", "high_hz", "said"),
    [
        ({"G9_dw": -0.1}, 2.5, "latency of G9_dw = -0.1 s, wanted: 0 or more"),
        ({"G9_dw": float("nan")}, 2.5, "latency of G9_dw = nan s"),
        ({"G1_dw": 0.1}, 2.5, "of G9_dw, G13_dw"),
        ({"G9_dw": 0.1}, float("inf"), "modes up to inf Hz"),
        ({"G9_dw": 1e4}, 2.5, "too many phase turns for the search"),
    ],
)
def test_a_latency_that_is_none_is_refused(latency: dict[str, float], high_hz: float, said: str) -> None:
    with pytest.raises(ModeError, match=said):
        LatePlant(plant_of("nets-nyps"), two_loops(1.0), latency, omega_b=377.0, high_hz=high_hz)
