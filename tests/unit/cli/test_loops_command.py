"""`interarea loops`: every signal at every actuator for every inter-area mode."""

import json
import re
from pathlib import Path

import pytest

from interarea.models.case.case import load_case
from interarea.models.case.write_toml import export_toml


def test_tables_of_loops_and_sets(interarea) -> None:  # type: ignore[no-untyped-def]
    code, out, _ = interarea(
        "loops", "two-area-thesis", "--below", "0.2", "--latency", "0.1", "--most", "3", "--signals", "speed"
    )
    assert code == 0
    lines = out.splitlines()
    assert lines[0] == "two-area-thesis: loops for inter-area, signals 0.1 s late"
    assert lines[2].split()[:3] == ["G4_vs", "dw24", "1.000"]
    assert "sets of actuators for inter-area" in out
    assert out.count("G4_vs") >= 3


def test_the_json_has_the_same(interarea) -> None:  # type: ignore[no-untyped-def]
    arguments = (
        "loops",
        "nets-nyps",
        "--below",
        "0.2",
        "--together",
        "4",
        "--mode",
        "inter-area 2",
        "--json",
    )
    document = json.loads(interarea(*arguments)[1])
    assert document["targets"] == ["inter-area 2"]
    best = document["loops"]["inter-area 2"][0]
    assert best["index"] == pytest.approx(1.0)
    assert {"actuator", "signal", "kind", "residue", "lead_deg", "beside"} <= set(best)
    assert len(document["sets"][0]["actuators"]) == 4


def test_a_single_allowed_actuator_is_a_set(interarea) -> None:  # type: ignore[no-untyped-def]
    arguments = ("loops", "two-area-thesis", "--signals", "speed", "--actuator", "G2_vs", "--json")
    assert [one["actuators"] for one in json.loads(interarea(*arguments)[1])["sets"]] == [["G2_vs"]]


@pytest.mark.slow
def test_sets_are_ranked_over_operating_points(interarea) -> None:  # type: ignore[no-untyped-def]
    points = ("--point", "out=8-9 a", "--point", "tie=100", "--point", "load=0.9")
    document = json.loads(interarea("loops", "two-area-thesis", "--signals", "speed", *points, "--json")[1])
    assert {one["weakest_point"] for one in document["sets"]} <= {"out=8-9 a", "tie=100", "load=0.9"}
    assert all(0.0 < one["holds"] <= 1.0 for one in document["sets"])
    assert document["remarks"] == []


@pytest.mark.slow
def test_sets_are_designed_shortly(interarea) -> None:  # type: ignore[no-untyped-def]
    """The open loop has .081; each set is tried with its own machine and the two of its signal."""
    arguments = ("loops", "two-area-thesis", "--signals", "speed", "--together", "1", "--try", "2")
    document = json.loads(interarea(*arguments, "--json")[1])
    dampings = [one["damping"] for one in document["designs"]]
    assert dampings == sorted(dampings, reverse=True) and dampings[-1] > 0.3
    tried = {tuple(one["actuators"]) for one in document["designs"]}
    assert tried == {tuple(one["actuators"]) for one in document["sets"][:2]}
    # beside each set its own machines' speeds alone: the better damped of the two is what the sentence says
    for one in document["designs"]:
        assert one["own"] > 0.08
        pays = one["damping"] - one["own"] >= 0.02
        assert one["worth"].startswith("the link adds" if pays else "a local stabilizer performs as well")
    out = interarea(*arguments)[1]
    assert document["designs"][0]["worth"] in out
    assert "after a short design" in out and f"{dampings[0]:.3f}" in out
    code, _, err = interarea("loops", "two-area-thesis", "--signals", "angle", "--try", "1")
    assert code == 2 and "rank with speeds alone (--signals speed)" in err


def twin(folder: Path) -> str:
    """Kundur's four machines, the first as two equal units: they swing against each other at one bus."""
    case = load_case("kundur-pss")
    first = case.machines[0]
    half = {"base_mva": 0.5 * first.base_mva, "P_mw": 0.5 * first.P_mw}
    units = (first.model_copy(update=half), first.model_copy(update={**half, "name": "G1b"}))
    export_toml(
        case.model_copy(update={"machines": (*units, *case.machines[1:]), "name": "twin"}),
        folder / "twin.toml",
    )
    return str(folder / "twin.toml")


def test_a_target_that_no_allowed_signal_shows_is_one_line(interarea, tmp_path) -> None:  # type: ignore[no-untyped-def]
    """Two equal units against each other: nothing beyond their bus moves, only their own speeds show it."""
    grid, mode = twin(tmp_path), ("--below", "0.5", "--mode", "local area 1.2")
    code, _, err = interarea("loops", grid, *mode, "--signals", "angle")
    assert code == 2
    assert "no allowed actuator and signal control and observe it; allow more actuators or more kinds" in err
    assert len(err.strip().splitlines()) == 1
    assert interarea("loops", grid, *mode, "--signals", "speed")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--point", "x=3"), "--point 'x=3', wanted out=BRANCH, tie=MW or load=FACTOR"),
        (("--point", "load=much"), "--point 'load=much', wanted out=BRANCH"),
        (("--point", "load=4"), "the power flow does not converge: worst mismatch"),
        (("--point", "out=zz"), "branch 'zz' does not exist"),
        (("--latency", "-0.1"), "--latency S: got -0.1, allowed: at least 0 and at most 10, in s"),
        (("--below", "0.01"), "no inter-area mode in this band and below this damping ratio"),
        (("--below", "0.2", "--mode", "x"), "no mode 'x'"),
    ],
)
def test_a_mistake_is_one_line(interarea, arguments, said) -> None:  # type: ignore[no-untyped-def]
    code, _, err = interarea("loops", "two-area-thesis", *arguments)
    assert code == 2
    assert said in err
    assert len(err.strip().splitlines()) == 1


def one_area(folder: Path) -> str:
    """A grid whose machines are all of one area: it has no inter-area mode and no differences of areas."""
    case = load_case("kundur-thyristor-z")
    machines = tuple(m.model_copy(update={"area": 1}) for m in case.machines)
    case = case.model_copy(update={"machines": machines, "tie": None, "swing": None, "name": "one-area"})
    export_toml(case, folder / "one-area.toml")
    return str(folder / "one-area.toml")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "no inter-area mode .* there are: local area 1.1, .* or assign machines to areas"),
        (
            ("--mode", "local area 1.1", "--signals", "angle"),
            "no signal of kind angle: .* all machines are in one; allow other kinds, or assign machines",
        ),
    ],
)
def test_one_area_has_nothing_between_areas(interarea, tmp_path, arguments, said) -> None:  # type: ignore[no-untyped-def]
    code, _, err = interarea("loops", one_area(tmp_path), "--below", "0.3", *arguments)
    assert code == 2
    assert re.search(said, err)
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("case", "arguments", "said"),
    [
        ("kundur-manual", (), "no machine has an exciter that takes a signal .* add an exciter"),
        ("two-area-thesis", ("--circuit-out", "7-9"), "branch '7-9' does not exist; did you mean"),
    ],
)
def test_a_grid_without_actuator_or_branch_is_one_line(interarea, case, arguments, said) -> None:  # type: ignore[no-untyped-def]
    code, _, err = interarea("loops", case, "--below", "0.9", *arguments)
    assert code == 2
    assert re.search(said, err)
    assert len(err.strip().splitlines()) == 1
