"""One clear message for each way in which a design cannot be: modes, caps, orders, matrices."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

from interarea.cosim.designs.design_file import load_design, run_design
from interarea.cosim.errors import ScenarioError
from interarea.design.delay.signal_conditions import Condition
from interarea.design.errors import InfeasibleDesign
from interarea.design.modes.modes import Mode, Modes, Participation
from interarea.design.robust.design import design_robust
from interarea.design.robust.spec import RobustSpec, require_moved
from interarea.design.synthesis.check import modal_parts
from interarea.design.synthesis.hinf import PoleRegion, conventional
from interarea.models.errors import UserError

SPEC = RobustSpec(("G2_dw", "G4_dw"), ("G4_vs",), (Condition("N"),), order=2, starts=1)
TEMPLATES = Path(load_design.__code__.co_filename).parent


def resonances(*, reached: float = 1.0, seen: float = 1.0, zeta: float = 0.05) -> control.StateSpace:
    """Two swings at 3 and 7 rad/s; of the first (damping `zeta`) little is reached by u or seen in y."""
    A = np.zeros((4, 4))
    A[:2, :2] = [[0.0, 3.0], [-3.0, -6.0 * zeta]]
    A[2:, 2:] = [[0.0, 7.0], [-7.0, -0.7]]
    B = np.array([[0.0], [reached], [0.0], [1.0]])
    C = np.array([[0.0, seen, 0.0, -1.0], [0.0, seen, 0.0, 1.0]])
    return control.ss(A, B, C, np.zeros((2, 1)), inputs=["G4_vs"], outputs=["G2_dw", "G4_dw"])


def inter_area(zeta: float = 0.05) -> Modes:
    z = complex(-3.0 * zeta, 3.0 * np.sqrt(1.0 - zeta**2))
    zero = np.zeros(4, complex)
    return Modes({"inter-area": Mode("inter-area", z, {}, Participation(), 1.0, zero, zero)}, np.array([z]))


def test_modal_parts_are_those_of_uncoupled_modes() -> None:
    """A mode that is reached or seen half as much is half as far from fixed; one that is not is fixed."""
    matrices = [tuple(getattr(resonances(reached=r, seen=r), M) for M in "ABC") for r in (2e-4, 1e-4, 0.0)]
    slow = [min(np.linalg.eigvals(A), key=abs) for A, _, _ in matrices]
    parts = [modal_parts(*M, v) for M, v in zip(matrices, slow, strict=True)]
    for k in range(2):
        assert parts[0][k] == pytest.approx(2.0 * parts[1][k], rel=1e-3)
        assert parts[1][k] > 1e-6 and parts[2][k] < 1e-15


@pytest.mark.parametrize(
    ("plant", "word"),
    [
        (resonances(reached=0.0), r"controllability (0\.0e\+00|\d\.\de-1[6-9])"),
        (resonances(seen=0.0), r"observability (0\.0e\+00|\d\.\de-1[6-9])"),
    ],
)
def test_a_target_mode_out_of_reach_is_named(plant: control.StateSpace, word: str) -> None:
    with pytest.raises(InfeasibleDesign, match=rf"'base'.*'inter-area' at 0\.4769 Hz.*{word}") as error:
        require_moved("base", plant, SPEC, inter_area())
    assert error.value.constraint == "controllability"
    require_moved("base", resonances(), SPEC, inter_area())
    with pytest.raises(InfeasibleDesign, match=word):
        conventional(plant, PoleRegion(0.1))


def test_an_unstable_hidden_mode_is_named_before_any_search() -> None:
    hidden = resonances(reached=0.0, zeta=-0.02)
    with pytest.raises(InfeasibleDesign, match=r"unstable mode at 0\.477\d Hz.*cannot be stabilised"):
        design_robust({"base": hidden}, SPEC, 1.0)
    with pytest.raises(InfeasibleDesign, match="it is unstable and cannot be stabilised"):
        conventional(hidden, PoleRegion(0.0))


def test_feedthrough_is_refused_and_the_loop_shift_offered() -> None:
    G = resonances()
    G.D[0, 0] = 0.1
    with pytest.raises(ValueError, match=r"'base': .*D is not zero \(largest 0\.1\).*loop_shift"):
        design_robust({"base": G}, SPEC, 1.0)


def test_matrices_that_are_not_finite_are_refused() -> None:
    G = resonances()
    G.B[1, 0] = np.inf
    with pytest.raises(ValueError, match=r"'base': .*B has numbers that are not finite"):
        design_robust({"base": G}, SPEC, 1.0)


def test_an_order_above_the_plants_is_refused() -> None:
    with pytest.raises(ValueError, match="order 5 of the controller is above the plant's 4"):
        design_robust({"base": resonances()}, replace(SPEC, order=5), 1.0)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"slowest_pole": 300.0}, "contradict each other"),
        ({"effort_cap": ((1.0, 0.0),)}, "a cap of 0 leaves no controller"),
        ({"effort_cap": ((1.0, 0.1), (0.5, 0.1))}, "rising"),
        ({"washout_s": 2.0, "dc_block": False, "order": 1}, "at least 2 are needed"),
        ({"conditions": (Condition("x", ("G9_dw",)),)}, "names \\['G9_dw'\\]"),
    ],
)
def test_contradictory_specifications(change: dict[str, Any], word: str) -> None:
    with pytest.raises(ValueError, match=word):
        replace(SPEC, **change)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("effort = 0.16", "effort = 0.1", r"ask\.effort = 0\.1 contradicts every effort_cap \(0\.155\)"),
        ("fastest_pole = 300.0", "fastest_pole = 0.2", r"ask\.fastest_pole = 0\.2 contradicts slowest_pole"),
        ("worst_swing = 0.24", "worst_swing = 1.2", r"ask\.worst_swing = 1\.2"),
        ("slowest_pole = 0.3", "slowest_pole = 281.0", "contradict each other"),
        (
            'name = "base"',
            'name = "base"\nmore = [[2.0, 0.1], [1.0, 0.1]]',
            r"point 1\.more.* 1 rad/s after 2 rad/s, allowed: rising ones",
        ),
        ('name = "base"', 'name = "tie +100"', r"point: has \['tie \+100'\] twice, allowed: each name once"),
        ('remote = "G2_dw"', 'remote = "G4_dw"', r"remote, local: has \['G4_dw'\] twice"),
        (
            'name = "robust_linear"',
            'name = "robust 2"',
            "name: is 'robust 2', allowed: letters, digits and _",
        ),
        ("seed = ", "guard = {watched={G9_vs='G4_dw'},sides={G9_vs=1.0},threshold=0.2}\nseed = ", "G9_vs"),
        ("bus = 8\n", "bus = 8\nclear_s = 0.5\n", "clear_s = 0.5, .*allowed: rising"),
        ("bus = 8\n", "bus = 8\nlost_s = 20.0\n", "lost_s = 20, allowed: before stop_s = 13"),
        ("seed = ", "acceptance = {fault=[{bus=8}],never_lost=['G9_dw']}\nseed = ", "never_lost names G9_dw"),
        ("seed = ", "offset = [[0.0, 0.1], [nan, 0.1]]\nseed = ", "finite"),
    ],
)
def test_contradictory_design_files(tmp_path: Path, old: str, new: str, word: str) -> None:
    text = (TEMPLATES / "design_robust_linear.toml").read_text()
    assert old in text
    path = tmp_path / "bad.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ScenarioError, match=word):
        load_design(path)


def test_a_guard_that_follows_no_output_is_refused_before_the_search(tmp_path: Path, cache: Path) -> None:
    text = (TEMPLATES / "design_two_actuators.toml").read_text()
    path = tmp_path / "bad.toml"
    path.write_text(text.replace('follows = "tie_p"', 'follows = "tie_power"'), encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"guard\.follows: output 'tie_power' is not in .*tie_p"):
        run_design(load_design(path), cache)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        (
            "seed = ",
            "acceptance = {fault=[{bus=99}]}\nseed = ",
            r"acceptance\.fault\.bus 99 is .*did you mean 9",
        ),
        (
            "seed = ",
            "acceptance = {fault=[{bus=8, trip='8-'}]}\nseed = ",
            r"acceptance\.fault\.trip '8-' is not",
        ),
        ("bus = 8", "bus = 99", r"fault\.bus 99 is not in two-area-thesis"),
    ],
)
def test_a_fault_where_the_grid_has_no_place_is_refused_before_the_search(
    tmp_path: Path, cache: Path, old: str, new: str, word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("interarea.cosim.designs.design_file.family_plants", lambda *_: pytest.fail("plants"))
    text = (TEMPLATES / "design_robust_linear.toml").read_text()
    path = tmp_path / "bad.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ScenarioError, match=word):
        run_design(load_design(path), cache)


@pytest.mark.slow
def test_a_controller_of_another_loop_to_start_from_is_refused(tmp_path: Path, cache: Path) -> None:
    text = (TEMPLATES / "design_robust_linear.toml").read_text()
    path = tmp_path / "bad.toml"
    path.write_text(f"start_from = 'nets_nyps'\n{text}", encoding="utf-8")
    with pytest.raises(UserError, match=r"to start from has 24 states, .*; wanted 6, G2_dw, G4_dw -> G4_vs"):
        run_design(load_design(path), cache)


@pytest.mark.slow
def test_a_design_names_an_inter_area_mode_that_its_signal_does_not_show(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the plant of the case with the signals' rows set to zero
    from interarea.cosim.designs import design_file as robust_design
    from interarea.cosim.designs import family
    from interarea.cosim.designs.family import FamilyPlant

    plants = robust_design.family_plants(load_design("robust_linear"), cache)

    def blind(*_: object) -> dict[str, FamilyPlant]:
        for plant in plants.values():
            for name in ("G2_dw", "G4_dw"):
                plant.searched.C[list(plant.searched.output_labels).index(name)] *= 0.0
        return plants

    monkeypatch.setattr(family, "modes_of", lambda plant, areas: inter_area())
    monkeypatch.setattr(robust_design, "family_plants", blind)
    with pytest.raises(InfeasibleDesign, match=r"'base'.*mode 'inter-area'"):
        run_design(load_design("robust_linear"), cache)


def test_a_start_must_have_the_loops_and_the_order_of_the_design() -> None:
    plants = {"base": resonances()}
    wrong = control.ss(-np.eye(3), np.ones((3, 2)), np.ones((1, 3)), 0.0, inputs=2, outputs=1)
    start = control.ss(wrong, inputs=["G2_dw", "G4_dw"], outputs=["G4_vs"])
    with pytest.raises(ValueError, match=r"has 3 states, G2_dw, G4_dw -> G4_vs; wanted 2"):
        design_robust(plants, replace(SPEC, start=start), 1.0)
    with pytest.raises(ValueError, match="starts = 0, allowed only with an initial controller"):
        replace(SPEC, starts=0)


@pytest.mark.slow
def test_a_search_goes_on_from_the_controller_it_is_given() -> None:
    """No random start, and nothing worse than what was given."""
    plants = {"base": resonances()}
    first = design_robust(plants, replace(SPEC, evaluations=300, polishes=0), 1.0)
    again = design_robust(
        plants, replace(SPEC, start=first.system, starts=0, evaluations=300, polishes=0), 1.0
    )
    assert len(again.starts) == 1
    assert again.objective <= first.objective + 1e-9
