"""The independent two-area model itself: printed numbers first, then it may judge others."""

import numpy as np
import pytest
from independent.two_area import linear_plant, two_area


def swing(name: str) -> np.ndarray:
    """Eigenvalues of a variant between 2 and 9 rad/s and below damping .5, by frequency."""
    w = np.linalg.eigvals(linear_plant(name).A)
    w = w[(w.imag > 2) & (w.imag < 9) & (-w.real < 0.5 * abs(w))]
    return w[np.argsort(w.imag)]


def test_thesis_modes_and_order() -> None:
    w = swing("two-area-thesis")
    assert linear_plant("two-area-thesis").nstates == 56
    # thesis_match: six numbers to the printed digits
    assert w.imag / (2 * np.pi) == pytest.approx([0.6227, 1.1393, 1.2109], abs=5e-5)
    assert -w.real / abs(w) == pytest.approx([0.0806, 0.2466, 0.2041], abs=5e-5)


@pytest.mark.parametrize(
    ("name", "printed"),
    [
        ("kundur-thyristor-z", [0.0141 + 3.829j, -0.6604 + 7.180j, -0.6586 + 7.403j]),
        ("kundur-manual-z", [-0.0921 + 3.409j, -0.5759 + 6.807j, -0.5787 + 7.030j]),
    ],
)
def test_eigenvalues_of_a_second_code(name: str, printed: list[complex]) -> None:
    w = swing(name)
    assert w.real == pytest.approx([p.real for p in printed], abs=7e-5)
    assert w.imag == pytest.approx([p.imag for p in printed], abs=6e-4)


def test_power_flow_of_kundur() -> None:
    V = two_area("kundur-thyristor-z").V0
    printed = [1.03, 1.01, 1.03, 1.01, 1.0065, 0.9781, 0.961, 0.9486, 0.9714, 0.9835, 1.0083]
    assert np.abs(V) == pytest.approx(printed, abs=5.1e-5)
    assert np.rad2deg(np.angle(V[:4])) == pytest.approx([20.27, 10.51, -6.8, -16.99], abs=5.1e-3)


def test_equilibrium_is_exact() -> None:
    plant = two_area("two-area-thesis")
    assert np.max(np.abs(plant.derivatives(plant.x0, np.zeros(4))[0])) < 1e-9


@pytest.mark.slow
def test_small_pulse_follows_the_linear_model() -> None:
    plant = two_area("two-area-thesis")
    t, y = plant.simulate(3.0, vref_pulse=("G1", 0.1, 0.3, 1e-4))
    system = linear_plant("two-area-thesis")
    u = np.where((t >= 0.1) & (t < 0.3), 1e-4, 0.0)
    from scipy.linalg import expm

    h = t[1] - t[0]
    M = expm(h * np.block([[system.A, system.B[:, :1]], [np.zeros((1, 57))]]))
    x, z = np.zeros(56), []
    for k in range(t.size):
        z.append(x[system.state_labels.index("G1.slip")])
        x = M[:56, :56] @ x + M[:56, 56] * u[k]
    dw = y[:, plant.output_names.index("G1_dw")]
    # first-order in the pulse: 1e-4 pu leaves second-order terms of about 1e-4 relative
    assert np.max(np.abs(dw - np.array(z))) < 1e-2 * np.max(np.abs(z))
