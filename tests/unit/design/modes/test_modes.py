"""Modes: printed numbers, names by shape, invariance."""

import itertools

import control
import numpy as np
import pytest
from independent.two_area import AREAS, OMEGA_B, linear_plant

from interarea.design.certificates.closed_loop import closed_loop_matrix, swing_poles
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.design.modes.modes import ModeError, modes_of
from interarea.design.modes.patterns import pattern_energies


def plant(name: str = "two-area-thesis") -> control.StateSpace:
    return speeds_in_rad(remove_reference(linear_plant(name)), OMEGA_B)


def oscillators(stiffness: np.ndarray, damping: float = 0.1) -> control.StateSpace:
    """Machines of 2 H = 1 s on springs: n angles, n speeds, one torque on the first."""
    n = stiffness.shape[0]
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping * np.eye(n)]])
    names = [f"G{i + 1}.delta" for i in range(n)] + [f"G{i + 1}.slip" for i in range(n)]
    C = np.hstack([np.zeros((n, n)), np.eye(n)])
    return control.ss(
        A,
        np.eye(2 * n)[:, n : n + 1],
        C,
        0.0,
        states=names,
        inputs=["G1_vs"],
        outputs=[f"G{i + 1}_dw" for i in range(n)],
    )


def laplacian(weights: np.ndarray) -> np.ndarray:
    """Spring network: symmetric weights (n, n)."""
    return np.diag(weights.sum(axis=1)) - weights


def test_thesis_modes_by_name() -> None:
    modes = modes_of(plant(), AREAS)
    printed = {
        "inter-area": (0.6227, 0.0806),
        "local area 1": (1.1393, 0.2466),
        "local area 2": (1.2109, 0.2041),
    }
    assert list(modes) == list(printed)
    for name, (f, z) in printed.items():
        assert modes[name].frequency_hz == pytest.approx(f, abs=5e-5)
        assert modes[name].damping_ratio == pytest.approx(z, abs=5e-5)
        assert sum(modes[name].participation.values()) == pytest.approx(1.0, abs=1e-12)


def test_area_machines_swing_against_each_other() -> None:
    modes = modes_of(plant("kundur-thyristor-z"), AREAS)
    inter = modes["inter-area"].shape
    assert inter["G1"].real < 0 < inter["G3"].real and inter["G2"].real < 0 < inter["G4"].real
    local = modes["local area 1"].shape
    assert local["G1"].real * local["G2"].real < 0 and abs(local["G3"]) < 0.2
    assert modes["inter-area"].eigenvalue == pytest.approx(0.0141 + 3.829j, abs=5e-4)


def test_permuting_and_scaling_states_changes_nothing() -> None:
    system = plant()
    rng = np.random.default_rng(3)
    order = rng.permutation(system.nstates)
    scale = 10.0 ** rng.uniform(-2, 2, system.nstates)
    moved = control.ss(
        (system.A * scale / scale[:, None])[np.ix_(order, order)],
        (system.B / scale[:, None])[order],
        (system.C * scale)[:, order],
        system.D,
        states=[system.state_labels[i] for i in order],
        inputs=system.input_labels,
        outputs=system.output_labels,
    )
    one, two = modes_of(system, AREAS), modes_of(moved, AREAS)
    for name in one:
        assert two[name].eigenvalue == pytest.approx(one[name].eigenvalue, rel=1e-8)
        for machine in AREAS:
            assert two[name].shape[machine] == pytest.approx(one[name].shape[machine], abs=1e-6)
        for state, part in one[name].participation.items():
            assert two[name].participation[state] == pytest.approx(part, abs=1e-7)


def test_spring_network_of_three_areas_and_seven_machines() -> None:
    areas = {f"G{i + 1}": a for i, a in enumerate([1, 1, 1, 2, 2, 3, 3])}
    number = list(areas.values())
    rng = np.random.default_rng(0)
    W = np.array([[60.0 if a == b else 1.0 for b in number] for a in number])
    W += rng.uniform(0, 0.2, W.shape)
    W = np.triu(W, 1)
    W += W.T
    modes = modes_of(oscillators(laplacian(W)), areas)
    assert sorted(modes) == sorted(
        ["inter-area 1", "inter-area 2", "local area 1.1", "local area 1.2", "local area 2", "local area 3"]
    )
    # closed form: lambda^2 + 0.1 lambda + mu = 0 for each eigenvalue mu of the springs
    springs = np.sort(np.linalg.eigvalsh(laplacian(W)))[1:]
    result = sorted(m.eigenvalue.imag for m in modes.values())
    assert result == pytest.approx(np.sqrt(springs - 0.0025), rel=1e-9)


def test_two_machines_have_one_mode() -> None:
    W = np.array([[0.0, 8.0], [8.0, 0.0]])
    modes = modes_of(oscillators(laplacian(W)), {"G1": 1, "G2": 2})
    assert list(modes) == ["inter-area"]
    assert modes.inter_area.eigenvalue == pytest.approx(-0.05 + 1j * np.sqrt(16 - 0.0025), rel=1e-9)


def test_sensitivity_is_the_derivative_of_the_eigenvalue() -> None:
    system = plant()
    mode = modes_of(system, AREAS)["inter-area"]
    dA = np.zeros((system.nstates, system.nstates))
    i = system.state_labels.index("G1.slip")
    dA[i, i] = -1.0  # damping torque at G1
    moved = [
        modes_of(
            control.ss(system.A + h * dA, system.B, system.C, system.D, states=system.state_labels,
                       inputs=system.input_labels, outputs=system.output_labels),
            AREAS,
        )["inter-area"].eigenvalue
        for h in (1e-4, -1e-4)
    ]  # fmt: skip
    assert mode.sensitivity(dA) == pytest.approx((moved[0] - moved[1]) / 2e-4, rel=1e-6)
    with pytest.raises(ValueError, match="shape"):
        mode.sensitivity(np.eye(2))


def test_missing_modes_and_machines_are_errors() -> None:
    with pytest.raises(ModeError, match="G5_dw"):
        modes_of(plant(), {**AREAS, "G5": 2})
    with pytest.raises(ModeError, match="3 swing modes, but 0"):
        modes_of(plant(), AREAS, band_hz=(3.0, 4.0))
    with pytest.raises(ModeError, match="local area 9"):
        modes_of(plant(), AREAS)["local area 9"]


def closed_loop(system: control.StateSpace, name: str, gain: float, lost: tuple[str, ...]) -> tuple:
    """The plant under a shipped controller with its output scaled; the controller alone."""
    K = shipped_controller(name).system
    K = control.ss(K.A, K.B, gain * K.C, gain * K.D, inputs=K.input_labels, outputs=K.output_labels)
    A = closed_loop_matrix(system, K, lost=lost)
    own = [f"K.x{i + 1}" for i in range(K.nstates)]
    C = np.hstack([system.C, np.zeros((system.noutputs, K.nstates))])
    states = [*system.state_labels, *own]
    closed = control.ss(
        A, np.zeros((len(A), 1)), C, 0.0, states=states, inputs=["none"], outputs=system.output_labels
    )
    return closed, K


@pytest.mark.slow
@pytest.mark.parametrize("lost", [(), ("G2_dw",)])
@pytest.mark.parametrize("name", ["robust", "robust_latency", "robust_linear"])
def test_names_in_a_closed_loop_are_those_followed_from_the_open_one(
    name: str, lost: tuple[str, ...]
) -> None:
    """A controller that drives the machines along has swings of its own: none is taken for one of theirs."""
    open_loop = plant()
    for gain in (0.25, 0.5, 0.75, 1.0):
        closed, K = closed_loop(open_loop, name, gain, lost)
        followed = swing_poles(open_loop, K, modes_of(open_loop, AREAS), lost=lost)
        modes = modes_of(closed, AREAS)
        assert {n: m.eigenvalue for n, m in modes.items()} == {
            n: pytest.approx(complex(z.real, abs(z.imag)), abs=1e-6) for n, z in followed.items()
        }


@pytest.mark.slow
def test_a_name_that_fits_another_mode_as_well_is_told() -> None:
    """At twice its gain a controller and the machines swing as one: what was not followed is in doubt."""
    open_loop = plant()
    differing = 0
    for name, lost in itertools.product(("robust", "robust_linear", "robust_latency"), ((), ("G2_dw",))):
        closed, K = closed_loop(open_loop, name, 2.0, lost)
        followed = swing_poles(open_loop, K, modes_of(open_loop, AREAS), lost=lost)
        modes = modes_of(closed, AREAS)
        for mode in followed:
            poles = [complex(z.real, abs(z.imag)) for z in followed.values()]
            if min(abs(modes[mode].eigenvalue - p) for p in poles) > 1e-6:
                differing += 1
                assert f"{mode} may also be the mode at" in modes[mode].caveat
    assert differing > 0
    assert not any(m.caveat for m in modes_of(open_loop, AREAS).values())


def test_pattern_energies_of_pure_patterns() -> None:
    assert pattern_energies(np.array([1, 1, -1, -1]), [1, 1, 2, 2])["inter-area"] == pytest.approx(1.0)
    assert pattern_energies(np.array([1, -1, 0, 0]), [1, 1, 2, 2])["local area 1"] == pytest.approx(1.0)


def test_a_mode_shows_itself_as_a_person_reads_it() -> None:
    shown = repr(modes_of(plant(), AREAS).inter_area)
    assert shown.startswith("Mode(inter-area: 0.6227 Hz, damping 0.0806; G4 1.00 at 0 deg, ")
    assert "array" not in shown and "\n" not in shown
