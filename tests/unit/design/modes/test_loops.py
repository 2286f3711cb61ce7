"""Loop selection: the published choice, invariance, unreachable modes."""

import control
import numpy as np
import pytest
from independent.two_area import AREAS, OMEGA_B, linear_plant

from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.design.modes.loop_selection import difference_signals, rank_loops
from interarea.design.modes.modes import ModeError, modes_of


@pytest.fixture(scope="module")
def system() -> control.StateSpace:
    return speeds_in_rad(remove_reference(linear_plant("two-area-thesis")), OMEGA_B)


def test_g4_with_dw24_is_first(system: control.StateSpace) -> None:
    loops = rank_loops(system, modes_of(system, AREAS)["inter-area"], areas=AREAS)
    assert (loops.selected.actuator, loops.selected.signal) == ("G4_vs", "dw24")  # [Sundaria2016] table 5.2
    assert len(loops.ranking) == 8  # the eight entries of the table
    # G4 before G2 before the rest, as in the table
    assert [loop.actuator for loop in loops.ranking[:4]] == ["G4_vs", "G4_vs", "G2_vs", "G2_vs"]
    # the geometric index of a six-state reduction lies in the table's range
    assert all(0.09 < loop.geometric < 0.20 for loop in loops.ranking)


def test_residue_is_the_partial_fraction(system: control.StateSpace) -> None:
    mode = modes_of(system, AREAS)["inter-area"]
    best = rank_loops(system, mode, areas=AREAS).selected
    # near the pole G(s) = R / (s - lambda) + regular: average over a small circle
    radius, turns = 1e-3, np.exp(2j * np.pi * np.arange(8) / 8)
    j = system.input_labels.index("G4_vs")
    c = system.C[system.output_labels.index("G2_dw")] - system.C[system.output_labels.index("G4_dw")]
    values = [
        c
        @ np.linalg.solve((mode.eigenvalue + radius * z) * np.eye(system.nstates) - system.A, system.B[:, j])
        for z in turns
    ]
    assert best.residue == pytest.approx(np.mean(np.array(values) * radius * turns), rel=1e-7)


def test_index_does_not_see_state_scaling(system: control.StateSpace) -> None:
    scale = 10.0 ** np.random.default_rng(1).uniform(-2, 2, system.nstates)
    moved = control.ss(
        system.A * scale / scale[:, None],
        system.B / scale[:, None],
        system.C * scale,
        system.D,
        states=system.state_labels,
        inputs=system.input_labels,
        outputs=system.output_labels,
    )
    one = rank_loops(system, modes_of(system, AREAS)["inter-area"], areas=AREAS)
    two = rank_loops(moved, modes_of(moved, AREAS)["inter-area"], areas=AREAS)
    for a, b in zip(one.ranking, two.ranking, strict=True):
        assert (a.actuator, a.signal) == (b.actuator, b.signal)
        assert b.index == pytest.approx(a.index, rel=1e-7)
        assert b.geometric == pytest.approx(a.geometric, rel=1e-4)


def test_single_local_signals(system: control.StateSpace) -> None:
    signals = {f"{m}_dw": {f"{m}_dw": 1.0} for m in AREAS}
    loops = rank_loops(system, modes_of(system, AREAS)["local area 1"], signals=signals)
    assert {loops.ranking[0].actuator, loops.ranking[1].actuator} == {"G1_vs", "G2_vs"}


def test_a_mode_that_nothing_reaches_is_an_error(system: control.StateSpace) -> None:
    mode = modes_of(system, AREAS)["inter-area"]
    blind = control.ss(
        system.A,
        system.B - np.real(2 * np.outer(mode.right, mode.left @ system.B)),
        system.C,
        system.D,
        states=system.state_labels,
        inputs=system.input_labels,
        outputs=system.output_labels,
    )
    with pytest.raises(ModeError, match="controllable from"):
        rank_loops(blind, modes_of(blind, AREAS)["inter-area"], areas=AREAS)
    with pytest.raises(ModeError, match="no machine has an exciter"):
        rank_loops(system, modes_of(system, AREAS)["inter-area"], areas=AREAS, actuators=[])
    with pytest.raises(ModeError, match="not a mode of this system"):
        rank_loops(speeds_in_rad(linear_plant("two-area-thesis"), OMEGA_B), mode, areas=AREAS)
    with pytest.raises(ValueError, match="areas"):
        rank_loops(system, mode)


def test_difference_names() -> None:
    assert list(difference_signals(AREAS)) == ["dw13", "dw14", "dw23", "dw24"]
    assert list(difference_signals({"G1": 1, "G12": 2})) == ["dw_G1_G12"]
