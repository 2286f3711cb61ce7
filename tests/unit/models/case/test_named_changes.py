"""Parameters changed by name, against cases edited by hand: the same matrices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from interarea.cosim.designs.design_file import design_of
from interarea.cosim.designs.family import family_cases
from interarea.cosim.run.artefacts import linear_matrices
from interarea.cosim.scenario.scenario import load_scenario
from interarea.models.case.case import CaseError, load_case
from interarea.models.case.named_changes import changes_of, with_named_changes

#: name -> change of the case file, its numbers made by hand of those printed in the bundled file
BY_HAND = {
    "exciter gain +30 %": "[change.machines.defaults.exciter]\nKA = 260.0",
    "exciter gain of G4 -30 %": "[change.machines.G4.exciter]\nKA = 140.0",
    "inertia -20 %": "".join(
        f"[change.machines.{name}]\nH = {H}\n"
        for name, H in (("G1", 5.2), ("G2", 5.2), ("G3", 4.94), ("G4", 4.94))
    ),
    "inertia of area 2 -30 %": "[change.machines.G3]\nH = 4.3225\n[change.machines.G4]\nH = 4.3225",
    "tie reactance +20 %": "[change.branches]\n"
    + "\n".join(f'"{name}" = {{ x = 0.132 }}' for name in ("7-8 a", "7-8 b", "8-9 a", "8-9 b")),
    "reactance of 8-9 a -20 %": '[change.branches]\n"8-9 a" = { x = 0.088 }',
    "loads of constant power": "[change.loads.defaults]\nP_exponent = 0.0\nQ_exponent = 0.0",
    "loads of constant current P, impedance Q": "[change.loads.defaults]\nP_exponent = 1.0",
    "no stabilizer at G3": '[change.machines]\nG3 = { stabilizer = "none" }',
}


@pytest.mark.slow
@pytest.mark.parametrize("text", BY_HAND)
def test_a_point_by_name_has_the_matrices_of_the_case_edited_by_hand(
    text: str, cache: Path, tmp_path: Path
) -> None:
    file = tmp_path / "by_hand.toml"
    file.write_text(f'base = "two-area-thesis"\nname = "by-hand"\n{BY_HAND[text]}\n', encoding="utf-8")
    design = {
        "name": "mine",
        "case": "two-area-thesis",
        "remote": "G2_dw",
        "local": "G4_dw",
        "actuator": "G4_vs",
        "conditions": ["N"],
        "point": [{"name": "there", "vary": [text]}],
    }
    named = linear_matrices(family_cases(design_of(design))["there"], cache)
    by_hand = linear_matrices(load_case(file), cache)
    as_it_is = linear_matrices(load_case("two-area-thesis"), cache)
    for matrix in "ABCD":
        np.testing.assert_allclose(
            getattr(named, matrix), getattr(by_hand, matrix), rtol=1e-12, atol=1e-12, err_msg=matrix
        )
    assert named.A.shape != as_it_is.A.shape or not np.allclose(named.A, as_it_is.A, rtol=1e-3)


def test_governors_go_and_their_states_with_them() -> None:
    case = load_case("two-area-thesis")
    changed = with_named_changes(case, ["no governors", "no stabilizers"])
    assert {m.governor.kind for m in changed.machines} == {"none"}
    assert {m.stabilizer for m in changed.machines} == {None}
    # the parameters of everything else stay
    assert [m.H for m in changed.machines] == [m.H for m in case.machines]


def test_the_list_of_a_case_has_what_it_can_have_alone() -> None:
    two_areas = changes_of(load_case("two-area-thesis"))
    assert len(two_areas) == 15 and "no stabilizer at G2" not in two_areas
    textbook = changes_of(load_case("kundur-manual"))  # constant field voltage, no stabilizer, no governor
    assert not [text for text in textbook if text.startswith(("exciter", "no "))]


def test_a_path_of_lines_that_does_not_part_is_one_tie() -> None:
    case = load_case("new-england")
    changed = with_named_changes(case, ["tie reactance +20 %"])
    longer = {b.name for b, old in zip(changed.branches, case.branches, strict=True) if b.x != old.x}
    # nothing stands at buses 1 and 9, and each has two neighbours
    assert longer == {"1-39", "9-39", "1-2", "8-9"}


def test_changes_apply_one_after_the_other_and_a_long_name_is_cut() -> None:
    case = load_case("two-area-thesis")
    texts = ["inertia -20 %", "inertia of G1 +50 %", "exciter gain -30 %", "tie reactance -20 %"]
    changed = with_named_changes(case, texts)
    assert pytest.approx(6.5 * 0.8 * 1.5) == changed.machine("G1").H
    assert len(changed.name) <= 64
    assert changed.name != with_named_changes(case, [*texts[:3], "tie reactance +20 %"]).name


def test_a_scenario_takes_them_too() -> None:
    keys = {"case": "two-area-thesis", "stop_s": 1.0, "operating_point": {"vary": ["inertia -20 %"]}}
    assert [m.H for m in load_scenario(keys).load_case().machines] == pytest.approx([5.2, 5.2, 4.94, 4.94])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("inertia -20", "'inertia -20' is no change of parameters; allowed: such as exciter gain"),
        ("inertia of G9 -20 %", "no machine or area 'G9'; did you mean G4"),
        ("inertia -100 %", "nothing is left, allowed: above -100 %"),
        ("no stabilizer at G2", "the case has nothing of that kind"),
        ("reactance -20 %", "wanted reactance of BRANCH, or tie reactance"),
        ("reactance of 8-9 +20 %", "did you mean 8-9 b or 8-9 a"),
        ("no governors +2 %", "is no change of parameters"),
        ("no stabilizer", "is no change of parameters"),
    ],
)
def test_refused(text: str, said: str) -> None:
    with pytest.raises(CaseError, match=said):
        with_named_changes(load_case("two-area-thesis"), [text])
