"""Records that no model here reads: one of them does not cost the grid, and what was done is said."""

from __future__ import annotations

from pathlib import Path

import pytest
from grid_text import raw_text

from interarea.models.case.case import load_case
from interarea.models.errors import CaseError
from interarea.models.importers.file import import_grid
from interarea.models.importers.imported import Imported, ImportOptions

RAW = raw_text(load_case("kundur-thyristor-z"))
MACHINES = "".join(
    f"{k} 'GENROU' '1' 8.0 0.03 0.4 0.05 {H} 0.0 1.8 1.7 0.3 0.55 0.25 0.2 0.0 0.0 /\n"
    for k, H in ((1, 6.5), (2, 6.5), (3, 6.175), (4, 6.175))
)
SEXS = "1 'SEXS' 1 0.1 10 100 0.1 -5 5 /\n"
TURBINE = "0 0 20 1 0 0.1 0.1 -0.1 1 0 0.2 0.3 0 5 0.7 0 0 0 0 0 0 0"


def taken(folder: Path, records: str, **options) -> Imported:  # type: ignore[no-untyped-def]
    (folder / "grid.raw").write_text(RAW)
    (folder / "grid.dyr").write_text(MACHINES + records)
    return import_grid(folder / "grid.raw", dyr=folder / "grid.dyr", options=ImportOptions(**options))


def loads(imported: Imported) -> dict[str, tuple[float, float, float, float]]:
    return {q.name: (q.P_mw, q.P_exponent, q.Q_mvar, q.Q_exponent) for q in imported.case.loads}


def test_a_record_left_out_is_said(tmp_path: Path) -> None:
    limiter = "1 'MAXEX1' 1 1.0 2.6 1.05 40 1.1 20 1.25 5 1.0 -0.05 0.0 /\n"
    with pytest.raises(CaseError, match=r"an over-excitation .* without it .*--leave-out MAXEX1 omits it"):
        taken(tmp_path, SEXS + limiter)
    left = taken(tmp_path, SEXS + limiter, leave_out=["maxex1"])
    assert left.report.assumed["MAXEX1 left out as requested"] == 1
    assert left.case == taken(tmp_path, SEXS).case


def test_a_classical_machine_without_reactance_names_the_line_of_its_unit(tmp_path: Path) -> None:
    unit = "1,'1 ',700.0,0,99,-99,1.03,0,900.0,0.0025,"
    line = RAW[: RAW.index(unit)].count("\n") + 1
    (tmp_path / "grid.raw").write_text(RAW.replace(f"{unit}0.3", f"{unit}0.0"))
    (tmp_path / "grid.dyr").write_text("1 'GENCLS' '1' 0 0 /\n" + MACHINES.split("\n", 1)[1])
    with pytest.raises(CaseError, match=rf"grid\.raw:{line}: ZX = 0, allowed: above 0, .*grid\.dyr:1"):
        import_grid(tmp_path / "grid.raw", dyr=tmp_path / "grid.dyr")


@pytest.mark.parametrize("option", ["leave_out", "replace"])
def test_a_model_that_the_file_does_not_have_is_refused(tmp_path: Path, option: str) -> None:
    option_value = {"OLTC": "SEXS"} if option == "replace" else ["OLTC"]
    with pytest.raises(CaseError, match=r"'OLTC': no record of that model, allowed: GENROU, SEXS"):
        taken(tmp_path, SEXS, **{option: option_value})


def test_a_record_read_as_another_model_is_that_model(tmp_path: Path) -> None:
    """WSIEG1 begins with the fields of IEEEG1; a deadband is what the other does not have."""
    curve = "0.01 0 0 0 0 0 0 0 0 0 0 0 0 0"
    western = f"1 'WSIEG1' 1 {TURBINE} {curve} /\n"
    governor = taken(tmp_path, western).case.machine("G1").governor
    assert governor.kind == "wsieg1" and governor.DB1 == 0.01
    read = taken(tmp_path, western, replace={"WSIEG1": "IEEEG1"})
    plain = taken(tmp_path, f"1 'IEEEG1' 1 {TURBINE} /\n")
    assert read.case.machine("G1").governor == plain.case.machine("G1").governor
    assert f"WSIEG1 read as IEEEG1 as requested, its last 14 field(s) {curve} left out" in (
        read.report.assumed
    )


def test_wsieg1_without_deadbands_and_curve_is_ieeeg1(tmp_path: Path) -> None:
    western = taken(tmp_path, f"1 'WSIEG1' 1 {TURBINE} {' '.join(['0'] * 14)} /\n").case.machine("G1")
    plain = taken(tmp_path, f"1 'IEEEG1' 1 {TURBINE} /\n").case.machine("G1")
    governors = [m.governor.model_dump(exclude={"source"}) for m in (western, plain)]
    assert governors[0] == governors[1]


def test_a_field_that_is_not_used_is_named_where_it_is_not_0(tmp_path: Path) -> None:
    """The share K2 of a second machine, and that the valve is blocked (IBLOCK), even without deadbands."""
    with_share = TURBINE.replace("0.3 0 5", "0.3 0.2 5")
    western = f"1 'WSIEG1' 1 {with_share} {' '.join(['0'] * 13)} 2 /\n"
    assumed = taken(tmp_path, western).report.assumed
    assert {line for line in assumed if "WSIEG1" in line} == {
        "K2 of WSIEG1 is not 0, and is not used",
        "IBLOCK of WSIEG1 is not 0, and is not used",
    }
    plain = taken(tmp_path, f"1 'IEEEG1' 1 {TURBINE} /\n").report.assumed
    assert not [line for line in plain if "IEEEG1" in line]


def test_comp_is_a_compensation_by_a_reactance(tmp_path: Path) -> None:
    comp = taken(tmp_path, SEXS + "1 'COMP' 1 0.05 /\n").case.machine("G1").compensator
    same = taken(tmp_path, SEXS + "1 'IEEEVC' 1 0.0 0.05 /\n").case.machine("G1").compensator
    assert comp.model_dump(exclude={"source"}) == same.model_dump(exclude={"source"})


def test_a_third_field_of_gencls_is_left_out_and_said(tmp_path: Path) -> None:
    (tmp_path / "grid.raw").write_text(RAW)
    text = "".join(f"{k} 'GENCLS' 1 6.5 0.0 0.3 /\n" for k in (1, 2, 3, 4))
    (tmp_path / "grid.dyr").write_text(text)
    read = import_grid(tmp_path / "grid.raw", dyr=tmp_path / "grid.dyr")
    assert {m.model for m in read.case.machines} == {"classical"}
    assert read.report.assumed["third field of GENCLS ignored: the reactance of the RAW is used"] == 4


@pytest.mark.parametrize(("subtransient", "reported"), [("0.3002", True), ("0.31", False)])
def test_a_transient_reactance_below_the_subtransient_by_rounding(
    tmp_path: Path, subtransient: str, reported: bool
) -> None:
    (tmp_path / "grid.raw").write_text(RAW)
    (tmp_path / "grid.dyr").write_text(MACHINES.replace("0.3 0.55 0.25", f"0.3 0.55 {subtransient}"))
    if not reported:
        with pytest.raises(CaseError, match=r"Xd2"):
            import_grid(tmp_path / "grid.raw", dyr=tmp_path / "grid.dyr")
        return
    read = import_grid(tmp_path / "grid.raw", dyr=tmp_path / "grid.dyr")
    assert read.case.machine("G1").Xd2 == read.case.machine("G1").Xd1 == 0.3
    assert read.report.assumed["Xd2 above Xd1 by rounding: Xd1 used"] == 4


ALL = "0 'IEELAL' '*' 0.0 1.0 0.0 0.0 0.0 1.0 0.0 0.0 1.0 1.0 1.0 2.0 0.0 0.0 /\n"
ONE = "7 'IEELBL' 1 0.4 0.6 0.0 1.0 0.0 0.0 1.5 0.0 2.0 0.5 0.0 2.0 0.0 0.0 /\n"


def test_how_loads_follow_the_voltage_stands_in_the_file(tmp_path: Path) -> None:
    """P = P0 (a1 V^n1 + ..): all by one record, one load by its own, and no exponent is assumed."""
    read = taken(tmp_path, ALL)
    assert loads(read) == {"L7": (967.0, 1.0, 100.0, 0.0), "L9": (1767.0, 1.0, 100.0, 0.0)}
    assert not any("constant impedance" in line for line in read.report.assumed)
    own = taken(tmp_path, ONE + ALL)
    assert own.report.assumed["IEELBL: frequency dependence of loads (a7, a8) ignored"] == 1
    rows = loads(own)
    assert rows.pop("L9") == (1767.0, 1.0, 100.0, 0.0)
    parts = sorted(rows.values())
    assert sum(p for p, *_ in parts) == pytest.approx(967.0)
    assert sum(q for _, _, q, _ in parts) == pytest.approx(100.0)
    assert {(round(p, 6), n) for p, n, *_ in parts} == {(386.8, 2.0), (580.2, 0.5)}


@pytest.mark.parametrize(
    ("record", "said"),
    [
        (ALL.replace(" 0.0 0.0 /", " 0.0 /"), "IEELAL has 13 fields, allowed: 14"),
        (ALL.replace("0.0 1.0 0.0 0.0 0.0 1.0", "0.0 0.0 0.0 0.0 0.0 1.0"), "the shares of P are"),
        (ALL.replace("1.0 1.0 1.0 2.0", "1.0 -1.0 1.0 2.0"), "an exponent of -1, allowed: 0 or above"),
    ],
)
def test_a_load_record_that_says_nothing_is_refused(tmp_path: Path, record: str, said: str) -> None:
    with pytest.raises(CaseError, match=said):
        taken(tmp_path, record)


def test_the_options_of_the_command(interarea, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "grid.raw").write_text(RAW)
    (tmp_path / "grid.dyr").write_text(MACHINES)
    arguments = ("import", str(tmp_path / "grid.raw"), "--dyr", str(tmp_path / "grid.dyr"))
    arguments = (*arguments, "--out", str(tmp_path / "g.toml"))
    for option, said in (
        (("--replace", "WSIEG1"), "--replace 'WSIEG1', allowed: MODEL=MODEL"),
        (("--leave-out", "OLTC"), "leave_out 'OLTC': no record of that model"),
    ):
        code, _, err = interarea(*arguments, *option)
        assert (code, said in err) == (2, True)
