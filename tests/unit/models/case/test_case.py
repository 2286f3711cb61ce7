"""Cases: what loads, what is refused and how it is said, how changes merge."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from interarea.models.case.case import CaseError, case_names, case_of, load_case
from interarea.models.case.checks import require_dynamics, require_one_network
from interarea.models.case.variants import operating_variant
from interarea.models.case.write_toml import export_toml
from interarea.models.grid.powerflow import solve_powerflow


@pytest.mark.parametrize("name", case_names())
def test_a_case_written_out_loads_back_to_the_same_content(name: str, tmp_path: Path) -> None:
    case = load_case(name)
    assert case.name == name
    export_toml(case, tmp_path / "copy.toml")
    copy = load_case(tmp_path / "copy.toml")
    assert copy.hash == case.hash
    assert copy.sources == case.sources


@pytest.mark.parametrize("name", case_names())
def test_every_table_of_a_bundled_case_names_its_source(name: str) -> None:
    case = load_case(name)
    filled = {t for t in ("buses", "branches", "shunts", "loads", "machines") if getattr(case, t)}
    assert filled <= set(case.sources)
    assert case.source and case.title


def test_sizes_of_the_bundled_systems() -> None:
    expected = {"new-england": (39, 10), "nets-nyps": (68, 16), "wecc-240": (243, 103)}
    assert {n: (len(load_case(n).buses), len(load_case(n).machines)) for n in expected} == expected


def test_base_angular_frequency() -> None:
    assert load_case("kundur-manual").omega_b == pytest.approx(2.0 * math.pi * 60.0, rel=1e-15)


def test_branch_on_its_own_base_is_converted() -> None:
    # 0.15 on 900 MVA is 0.15/9 on 100 MVA
    assert load_case("kundur-manual").branch("1-5").x == pytest.approx(0.15 / 9.0, rel=1e-15)


def test_parts_that_no_branch_connects_have_a_slack_each() -> None:
    case = load_case("two-area-thesis")
    apart = {"8-9 a": {"in_service": False}, "8-9 b": {"in_service": False}}
    with pytest.raises(CaseError, match="buses 1, 2, 5, 6, 7, 8 have no path in service"):
        case.with_changes({"branches": apart})
    two = case.with_changes({"branches": apart, "machines": {"G1": {"slack": True}}})
    assert [m.name for m in two.slacks] == ["G1", "G3"] and str(two) == repr(two)
    with pytest.raises(CaseError, match=r"2 parts that no branch connects \(bus 1 of 6, bus 3 of 5\)"):
        require_one_network(two, "it is a test")
    require_one_network(case, "it is a test")


def test_hash_follows_numbers_not_words() -> None:
    case = load_case("kundur-manual")
    assert case.with_changes({"title": "other", "buses": {"source": "other"}}).hash == case.hash
    assert case.with_changes({"machines": {"G1": {"H": 6.6}}}).hash != case.hash


REFUSED = [
    ({"branches": {"8-9 a": {"to": 99}}}, r"branches\.8-9 a\.to = 99"),
    ({"machines": {"G1": {"slack": True}}}, r"slack = true at 2 \(G1, G3\)"),
    ({"machines": {"G3": {"slack": False, "angle_deg": 0.0}}}, "slack = true at none"),
    ({"machines": {"G1": {"Xd1": 1.8}}}, r"machines\.G1: Xd = 1.8 with Xd1 = 1.8"),
    ({"machines": {"G1": {"Xl": 0.31}}}, r"Xd1 = 0.3 with Xl = 0.31, allowed: Xl < Xd1"),
    ({"machines": {"G1": {"Td02": -1.0}}}, r"machines\.G1\.Td02 = -1.0, allowed: greater than 0"),
    ({"machines": {"G1": {"exciter": {"TA": -0.01}}}}, r"machines\.G1\.exciter\.TA = -0.01"),
    ({"machines": {"G1": {"exciter": {"KA": "200"}}}}, r"exciter\.KA = '200', allowed: a number"),
    ({"machines": {"G1": {"exciter": {"KB": 1.0}}}}, r"exciter\.KB = 1.0: no such key"),
    (
        {"machines": {"G1": {"exciter": {"kind": "ac"}}}},
        r"exciter\.kind: exciter 'ac' does not exist",
    ),
    ({"machines": {"G1": {"stabilizer": {"T2": 0.0}}}}, "T2 = 0; give T2 > 0"),
    ({"machines": {"G1": {"H": math.nan}}}, r"machines\.G1\.H = nan"),
    ({"machines": {"G1": {"V_pu": math.inf}}}, r"machines\.G1\.V_pu = inf"),
    ({"machines": {"G1": {"governor": {"F5": 0.5}}}}, "F2 .* F5 = 0.5; the shares must add to 1"),
    ({"machines": {"G1": "none", "G2": "none", "G3": "none", "G4": "none"}}, "machines"),
    (
        {"branches": {"1-5": {"r": 0.0, "x": 0.0}}},
        r"branches\.1-5: r \+ jx = 0 \+ j0, allowed: a size of at least",
    ),
    ({"branches": {"1-5": {"in_service": False}}}, r"machines\.G1: isolated, bus 1"),
    ({"branches": {"8-9 a": "none", "8-9 b": "none"}}, "buses 1, 2, 5, 6, 7, 8 have no path"),
    ({"branches": {"5-6": {"to": 5}}}, "from = to = 5"),
    ({"loads": {"L7": {"P_zip": [0.5, 0.5, 0.5]}}}, "sums to 1.5"),
    ({"loads": {"L7": {"P_exponent": 1.0, "P_zip": [1.0, 0.0, 0.0]}}}, "P_zip and P_exponent are both given"),
    ({"tie": {"branches": ["7-8a"]}}, "branch '7-8a' does not exist; did you mean 7-8 a"),
    ({"frequency_hz": 0.0}, "frequency_hz = 0.0"),
    ({"event": [{"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": 0.5}]}, "event 1 .*end_s > start_s"),
]


@pytest.mark.parametrize(("change", "message"), REFUSED, ids=lambda value: str(value)[:60])
def test_what_is_wrong_is_refused_in_one_line_with_key_value_and_what_is_allowed(
    change: dict, message: str
) -> None:
    with pytest.raises(CaseError, match=message) as caught:
        load_case("two-area-thesis").with_changes(change)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("two-area-thesis with changes: ")


def test_unknown_case_names_the_nearest() -> None:
    with pytest.raises(CaseError, match="did you mean kundur-manual"):
        load_case("kundur-manul")


def _file(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "grid.toml"
    path.write_text(text)
    return path


def test_an_id_given_twice_is_named_with_its_line(tmp_path: Path) -> None:
    path = _file(tmp_path, "[loads]\nL7 = { bus = 7 }\nL7 = { bus = 9 }\n")
    with pytest.raises(CaseError, match=r"grid\.toml: .*id given twice\?"):
        load_case(path)


def test_missing_file_and_missing_key_name_the_file(tmp_path: Path) -> None:
    with pytest.raises(CaseError, match=r"no\.toml: no such file, wanted: a case file"):
        load_case(tmp_path / "no.toml")
    with pytest.raises(CaseError, match=r"grid\.toml: name is missing"):
        load_case(_file(tmp_path, 'title = "x"\n'))


def test_variant_is_base_plus_change_and_nothing_else(tmp_path: Path) -> None:
    text = 'base = "kundur-manual"\nname = "mine"\n[change.machines.defaults]\nD = 2.0\n'
    case = load_case(_file(tmp_path, text))
    assert [m.D for m in case.machines] == [2.0] * 4
    assert (
        case.with_changes({"machines": {"defaults": {"D": 0.0}}, "name": "x"}).branches
        == load_case("kundur-manual").branches
    )
    with pytest.raises(CaseError, match=r"machines stands outside \[change\]"):
        load_case(_file(tmp_path, 'base = "kundur-manual"\n[machines.G1]\nH = 1.0\n'))
    with pytest.raises(CaseError, match="leads back"):
        load_case(_file(tmp_path, 'base = "grid.toml"\n'))


def test_defaults_of_a_change_reach_every_row_and_kinds_replace() -> None:
    case = load_case("two-area-thesis")
    other = case.with_changes(
        {"machines": {"defaults": {"exciter": {"kind": "constant"}, "stabilizer": "none"}}}
    )
    assert {m.exciter.kind for m in other.machines} == {"constant"}
    assert all(m.stabilizer is None for m in other.machines)
    assert [m.H for m in other.machines] == [m.H for m in case.machines]
    own = case.with_changes({"machines": {"defaults": {"H": 5.0}, "G4": {"H": 4.0}}})
    assert [m.H for m in own.machines] == [5.0, 5.0, 5.0, 4.0]


def test_bus_keys_are_numbers() -> None:
    document = load_case("kundur-manual").document()
    document["buses"]["x1"] = {}
    with pytest.raises(CaseError, match=r"here: buses\.x1: a bus is named by its number"):
        case_of(document, where="here")


def test_moving_load_moves_the_tie_flow_and_only_losses_reach_the_slack() -> None:
    case = load_case("two-area-thesis")
    before, after = (solve_powerflow(c) for c in (case, operating_variant(case, tie_flow_mw=100.0)))
    assert after.tie_p - before.tie_p == pytest.approx(
        1.0, abs=0.05
    )  # the rest is the line losses before bus 7
    losses = [sum(f.generation.real) - 27.34 for f in (before, after)]
    slack = [f.generation[2].real for f in (before, after)]
    assert slack[1] - slack[0] == pytest.approx(losses[1] - losses[0], abs=1e-9)


def test_variants_compose_and_are_named() -> None:
    case = load_case("two-area-thesis")
    variant = operating_variant(case, tie_flow_mw=-200.0, out=["8-9 a"], load_scale=1.1)
    assert variant.name == "two-area-thesis-load-1.1-tie-minus-200-out-8-9-a"
    assert operating_variant(case, tie_flow_mw=2e6).name == "two-area-thesis-tie-plus-2e06"
    assert variant.load("L7").P_mw == pytest.approx(967.0 * 1.1 + 200.0)
    assert variant.load("L9").Q_mvar == pytest.approx(110.0)
    assert variant.machine("G1").P_mw == pytest.approx(770.0)
    assert not variant.branch("8-9 a").in_service
    with pytest.raises(CaseError, match="did you mean 8-9 b or 8-9 a"):
        operating_variant(case, out=["8-9"])
    with pytest.raises(CaseError, match="load_scale = 0"):
        operating_variant(case, load_scale=0.0)


def test_a_machine_without_dynamic_data_is_named() -> None:
    case = load_case("kundur-manual")
    bare = case.with_changes({"machines": {"G2": {"model": "power_flow"}}})
    require_dynamics(case)
    with pytest.raises(CaseError, match="machines G2 have no dynamic data"):
        require_dynamics(bare)
    with pytest.raises(CaseError, match="no field circuit"):
        load_case("two-area-thesis").with_changes({"machines": {"G2": {"model": "classical"}}})
