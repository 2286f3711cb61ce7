"""Sensitivity of swing modes: closed forms, and eigenvalues of cases computed again at other values."""

from __future__ import annotations

import json

import numpy as np
import pytest

from interarea.cosim.designs.sensitivities import (
    all_mode_sensitivities,
    parameter_sensitivities,
    state_matrix,
)
from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.design.modes.all_modes import all_modes as all_modes_of
from interarea.design.modes.modes import Mode, Modes, Participation
from interarea.design.modes.sensitivity import eigenvalue_sensitivity
from interarea.models.case.case import CaseError, load_case
from interarea.models.case.parameter_path import parameter_value, with_parameter

CASE = "kundur-thyristor-z"


def all_modes(A: np.ndarray) -> Modes:
    """Every eigenvalue of A as a mode."""
    values, right = np.linalg.eig(A)
    left = np.linalg.inv(right)
    result = {
        f"{k}": Mode(f"{k}", z, {}, Participation(), 1.0, right[:, k], left[k]) for k, z in enumerate(values)
    }
    return Modes(result, values)


def test_against_the_derivative_of_a_known_family():
    """A(p) = T diag(p, p^2, 3 sin p) T^-1 with T(p): the eigenvectors turn, the slopes are 1, 2p, 3 cos p."""
    rng = np.random.default_rng(1)
    S = rng.standard_normal((3, 3))

    def A(p):
        T = np.eye(3) + 0.3 * np.sin(p) * S
        return T @ np.diag([p, p * p, 3 * np.sin(p)]) @ np.linalg.inv(T)

    p = 0.7
    modes = eigenvalue_sensitivity(all_modes(A(p)), A, p, parameter="p")
    expected = {p: 1.0, p * p: 2 * p, 3 * np.sin(p): 3 * np.cos(p)}
    for s in modes.values():
        value = min(expected, key=lambda z, s=s: abs(z - s.eigenvalue))
        assert s.derivative == pytest.approx(expected[value], abs=1e-10)
        assert abs(s.derivative - expected[value]) <= max(s.error, 1e-11)


def test_damping_ratio_and_frequency_slopes_are_those_of_their_formulas():
    """x'' + c x' + x = 0: zeta = c/2, frequency sqrt(1 - c^2/4)/2 pi."""
    c = 0.3

    def A(c):
        return np.array([[0.0, 1.0], [-1.0, -c]])

    modes = all_modes(A(c))
    for s in eigenvalue_sensitivity(modes, A, c, parameter="c").values():
        assert s.damping_slope == pytest.approx(0.5, abs=1e-9)
        up = np.sign(s.eigenvalue.imag)
        assert s.frequency_slope == pytest.approx(
            -up * c / 4 / np.sqrt(1 - c * c / 4) / (2 * np.pi), abs=1e-9
        )


def test_a_parameter_that_is_zero_is_moved_upwards_only():
    def A(p):
        assert p >= 0.0
        return np.array([[-1.0 + p + p**2, 1.0], [0.0, -2.0 - 3.0 * p]])

    result = sorted(
        eigenvalue_sensitivity(all_modes(A(0.0)), A, 0.0, parameter="D").values(),
        key=lambda s: s.eigenvalue.real,
    )
    assert [s.derivative for s in result] == [pytest.approx(-3.0, abs=1e-9), pytest.approx(1.0, abs=1e-9)]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused(bad):
    with pytest.raises(ValueError, match="allowed: finite"):
        eigenvalue_sensitivity(all_modes(np.eye(1)), lambda p: np.eye(1), bad, parameter="x")


def test_a_parameter_that_changes_the_number_of_states_is_refused():
    with pytest.raises(ValueError, match="must not add or remove states"):
        eigenvalue_sensitivity(all_modes(np.eye(2)), lambda p: np.eye(3), 1.0, parameter="TA")


PATHS = ("machines.G1.exciter.KA", "loads.L9.P_mw", "machines.G3.H", "branches.8-9 a.x", "machines.G2.V_pu")


@pytest.mark.parametrize("path", [PATHS[0], *(pytest.param(p, marks=pytest.mark.slow) for p in PATHS[1:])])
def test_plant_sensitivity_is_the_slope_of_its_eigenvalues(path, cache):
    """Gain, inertia, network, load, set-point: eigenvalues of the whole case at values on both sides."""
    case = load_case(CASE)
    value = parameter_value(case, path)
    result = parameter_sensitivities(case, [path], cache)[path]

    def near(p: float, target: complex) -> complex:
        values = np.linalg.eigvals(state_matrix(with_parameter(case, path, p), cache))
        return complex(values[np.argmin(np.abs(values - target))])

    h = 4e-3 * value
    for s in result.values():
        slopes = [
            (near(value + k, s.eigenvalue) - near(value - k, s.eigenvalue)) / (2 * k) for k in (h, h / 2)
        ]
        slope = (4 * slopes[1] - slopes[0]) / 3
        assert s.derivative == pytest.approx(slope, abs=1e-6 * max(1.0, abs(s.eigenvalue)) / abs(value))


@pytest.mark.slow
def test_a_redispatch_moves_modes_as_the_grid_solved_again_says(cache):
    """Eigenvalues of the grid with 20 MW more and less from G4 in place of G2, dense and sparse alike."""
    case, path = load_case(CASE), "redispatch.G2:G4"
    moved = with_parameter(case, path, 20.0)
    assert moved.machine("G4").P_mw - case.machine("G4").P_mw == pytest.approx(20.0)
    assert case.machine("G2").P_mw - moved.machine("G2").P_mw == pytest.approx(20.0)
    dense = parameter_sensitivities(case, [path], cache)[path]
    around = [np.linalg.eigvals(state_matrix(with_parameter(case, path, p), cache)) for p in (20.0, -20.0)]
    inter_area = dense["inter-area"]
    near = [z[np.argmin(np.abs(z - inter_area.eigenvalue))] for z in around]
    assert inter_area.derivative == pytest.approx((near[0] - near[1]) / 40.0, rel=2e-3)
    result = all_modes_of(sparse_linear_plant(case, cache), case.areas, band_hz=(0.3, 2.0), below=0.3).modes
    sparse = all_mode_sensitivities(case, result, [path], cache)[path]
    one = min(sparse.values(), key=lambda s: abs(s.eigenvalue - inter_area.eigenvalue))
    assert one.derivative == pytest.approx(inter_area.derivative, rel=1e-5)


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("redispatch.G1", "wanted redispatch.FROM:TO, two machines"),
        ("redispatch.G1:G1", "wanted redispatch.FROM:TO, two machines"),
        ("redispatch.G1:G9", "no machine 'G9'"),
        ("machine.G1.H", r"no table 'machine'; did you mean machines"),
        ("machines.G9.H", r"no row 'G9' in machines"),
        ("machines.G1.exciter.Ka", r"no field 'Ka'; did you mean KA"),
        ("machines.G1.exciter.kind", "allowed: the path of a number"),
        ("machines.G1.stabilizer.K", "no field 'K'"),
        ("machines.G1.slack", "allowed: the path of a number"),
    ],
)
def test_paths_that_are_no_number_are_refused_with_the_nearest_name(path, says):
    with pytest.raises(CaseError, match=says):
        parameter_value(load_case(CASE), path)


def test_with_parameter_changes_one_number():
    case = load_case(CASE)
    changed = with_parameter(case, "branches.8-9 a.x", 0.2)
    assert changed.branch("8-9 a").x == 0.2
    assert changed.branch("8-9 b") == case.branch("8-9 b")
    with pytest.raises(CaseError, match="finite"):
        with_parameter(case, "branches.8-9 a.x", float("nan"))


@pytest.mark.slow
def test_modes_command_prints_shapes_participation_sensitivities_and_writes_plots(
    tmp_path, monkeypatch, capsys
):
    import sys

    from interarea.cli.app import main

    arguments = ["modes", CASE, "--json", "--participation", "2", "--plot", str(tmp_path)]
    arguments += ["--sensitivity", "machines.G1.exciter.KA", "--circuit-out", "8-9 a", "--load-scale", "0.95"]
    monkeypatch.setattr(sys, "argv", ["interarea", *arguments])
    main_code = 0
    try:
        main()
    except SystemExit as stopped:
        main_code = int(stopped.code or 0)
    document = json.loads(capsys.readouterr().out)
    assert main_code == 0
    assert document["case"] == f"{CASE}-load-0.95-out-8-9-a"
    mode = document["modes"]["inter-area"]
    assert mode["frequency_hz"] == pytest.approx(0.5, abs=0.04)  # one of two circuits out: 0.61 Hz before
    assert len(mode["participation"]) == 2 and all(0 < share < 1 for share in mode["participation"].values())
    angles = {name: row["angle_deg"] for name, row in mode["shape"].items()}
    assert abs(angles["G1"] - angles["G2"]) < 20 and abs(abs(angles["G1"] - angles["G4"]) - 180) < 20
    assert set(document["sensitivity"]["machines.G1.exciter.KA"]) == set(document["modes"])
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "inter-area.svg",
        "local-area-1.svg",
        "local-area-2.svg",
    ]
