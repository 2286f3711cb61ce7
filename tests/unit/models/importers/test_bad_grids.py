"""Bad input through the command: one line with file and line number, exit code 2, nothing written."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest
from grid_text import dyr_text, raw_text
from raw_grids import VERSIONS, raw_grid

from interarea.cli.app import main
from interarea.models.case.case import load_case
from interarea.models.errors import CaseError
from interarea.models.grid.powerflow import PowerFlowError
from interarea.models.importers.dyr import read_dyr
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.psse import import_psse, static_grid
from interarea.models.importers.raw.file import read_raw
from interarea.models.importers.report import Report

CASE = load_case("kundur-pss")
RAW, DYR = raw_text(CASE), dyr_text(CASE)
LINES = DYR.count("\n")
MACHINE = DYR[DYR.index("1 'GENROU'") : DYR.index("1 'EXST1'")]
FOUR = raw_grid(33)
SVC = "'SVC',3,0,1,0,0,1.0,50"


def printed(folder: Path, monkeypatch, capsys, raw: bytes, dyr: str | None, *options: str) -> str:
    """Return the one line of `interarea import`, which must fail and leave its output as it was."""
    (folder / "grid.raw").write_bytes(raw)
    out = folder / "case.toml"
    out.write_text("before\n")
    argv = ["interarea", "import", str(folder / "grid.raw"), "--out", str(out), *options]
    if dyr is not None:
        (folder / "grid.dyr").write_text(dyr)
        argv += ["--dyr", str(folder / "grid.dyr")]
    monkeypatch.setattr(sys, "argv", argv)
    with pytest.raises(SystemExit) as stopped:
        main()
    captured = capsys.readouterr()
    assert stopped.value.code == 2 and captured.out == "" and captured.err.count("\n") == 1
    assert out.read_text() == "before\n"
    assert {p.name for p in folder.iterdir()} <= {"grid.raw", "grid.dyr", "case.toml"}
    return captured.err.replace(str(folder), "")


IN_RAW = {
    "a record that is short": (
        ("0.01,0.1,0.04,0", "0.01\n9,0"),
        "branch record: X (field 5) is missing, 4 fields",
    ),
    "a field that is no number": (
        ("80.0,20.0", "80.0,2o.0"),
        "/grid.raw:9: load record: QL (field 7) = '2o.0'",
    ),
    "a load given twice": (
        ("3,'1 ',1,1,1,80", "3,1,1,1,1,7.0\n3,'1 ',1,1,1,80"),
        "/grid.raw:10: load '1' at bus 3 is",
    ),
    "a shunt given twice": (
        ("3,'1 ',1,1.5", "3,1,1,7.0\n3,'1 ',1,1.5"),
        "/grid.raw:12: fixed shunt '1' at bus 3 is",
    ),
    "a device given twice": (
        ("0 / END OF FACTS", f"{SVC}\n{SVC}\n0 / END OF FACTS"),
        "/grid.raw:33: FACTS 'SVC' is",
    ),
    "a bus given twice": (
        ("\n4,'BUS", "\n3,'BUS"),
        "/grid.raw:7: bus 3 is given twice, first at /grid.raw:6",
    ),
    "a machine without bus": (("\n1,'1 ',0,0,99", "\n77,'1 ',0,0,99"), "/grid.raw:13: bus 77 does not exist"),
    "a flow that does not converge": (
        ("80.0,20.0,5.0", "8000.0,20.0,5.0"),
        "largest mismatch 6218 MVA at bus 3 (/grid.raw:6); its best voltages range from 1.02 pu at bus 1 to",
    ),
    "a version that is no number": (
        ("100.0, 33", "100.0, v33"),
        "/grid.raw:1: header record: REV (field 3) = 'v33'",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", IN_RAW)
def test_a_mistake_in_a_raw_file(tmp_path: Path, monkeypatch, capsys, what: str) -> None:
    (old, new), expected = IN_RAW[what]
    assert old in FOUR
    text = FOUR.replace(old, new, 1)
    assert expected in printed(tmp_path, monkeypatch, capsys, text.encode(), None)


IN_DYR = {
    "an unknown model": (
        DYR + "1 'FOOBAR' 1 0.1 /\n",
        f"/grid.dyr:{LINES + 1}: model 'FOOBAR' at bus 1 is not",
    ),
    "a record that is short": (
        DYR.replace(" 0.0 0.0 /", " /", 1),
        "/grid.dyr:2: GENROU has 12 parameters, allowed: 14",
    ),
    "a field that is no number": (
        DYR.replace(" 6.5 ", " 6.S ", 1),
        "/grid.dyr:2: GENROU record: H (field 5) = '6.S'",
    ),
    "a machine given twice": (
        DYR + MACHINE,
        f"/grid.dyr:{LINES + 1}: second machine model of G1, the first is at /grid.dyr:2",
    ),
    "a control given twice": (
        DYR + DYR[DYR.index("1 'EXST1'") : DYR.index("1 'IEEEST'")],
        f"/grid.dyr:{LINES + 1}: second exciter of G1, the first is at /grid.dyr:4",
    ),
    "a file of another kind": (
        RAW,
        "/grid.dyr:1: model = '100.0', allowed: the name of a model after the bus",
    ),
}


@pytest.mark.parametrize("what", IN_DYR)
def test_a_mistake_in_a_dyr_file(tmp_path: Path, monkeypatch, capsys, what: str) -> None:
    text, expected = IN_DYR[what]
    assert expected in printed(tmp_path, monkeypatch, capsys, RAW.encode(), text)


def test_a_machine_whose_bus_the_grid_does_not_have_is_told_with_its_line(tmp_path: Path) -> None:
    raw, dyr = tmp_path / "grid.raw", tmp_path / "grid.dyr"
    raw.write_text(RAW)
    dyr.write_text(DYR + MACHINE.replace("1 'GENROU'", "99 'GENROU'"))
    what = "DYR record of a unit that is not in the grid: ignored"
    report = import_psse(raw, dyr).report
    assert report.assumed[what] == 1 and report.first[what].endswith(f"grid.dyr:{LINES + 1}")


@pytest.mark.parametrize("end", ["\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-16", "cp1252", "utf-8-sig"])
def test_a_mistake_keeps_its_line_in_other_encodings_and_line_ends(
    tmp_path: Path, monkeypatch, capsys, encoding: str, end: str
) -> None:
    text = FOUR.replace("a title\n", "Malmö\n", 1).replace("80.0,20.0", "80.0,2o.0").replace("\n", end)
    line = printed(tmp_path, monkeypatch, capsys, text.encode(encoding), None)
    assert "/grid.raw:9: load record: QL (field 7) = '2o.0'" in line


@pytest.mark.slow
def test_a_flow_without_solution_keeps_its_voltages(tmp_path: Path) -> None:
    raw = tmp_path / "grid.raw"
    raw.write_text(FOUR.replace("80.0,20.0,5.0", "8000.0,20.0,5.0"))
    with pytest.raises(PowerFlowError) as error:
        import_psse(raw)
    voltages = error.value.voltages
    assert sorted(voltages) == [1, 2, 3] and abs(voltages[1]) == pytest.approx(1.02)
    assert f"to {max(map(abs, voltages.values())):.4g} pu at bus 3" in str(error.value)


def test_whatever_version_a_file_says_it_is_read_rightly_or_refused_with_its_line(tmp_path: Path) -> None:
    """Only what no shape tells is refused: 31 against 32, 34 against 35; and there the lie is named."""
    path, refused = tmp_path / "grid.raw", set()

    def elements(version: int, said: int) -> tuple[list, list[str]]:
        path.write_text(raw_grid(version, revision=said))
        file = read_raw(path)
        grid = static_grid(file, Report())
        rows = [*grid.buses.values(), *grid.branches, *grid.units, *grid.loads, *grid.shunts]
        return sorted(map(_plain, rows)), file.notes

    for version in VERSIONS:
        expected = elements(version, version)[0]
        for said in VERSIONS:
            try:
                result, notes = elements(version, said)
            except CaseError as error:
                assert "grid.raw:" in str(error)
                refused.add((version, said))
                if (version, said) not in {(34, 35), (35, 34), (34, 36), (31, 32), (31, 33)}:
                    assert f"says version {said} and is laid out as" in str(error)
                continue
            assert result == expected, (version, said)
            assert bool(notes) == ((version, said) not in {(29, 30), (30, 29), (32, 33)} and version != said)
    assert {version for version, _ in refused} == {31, 34, 35}


def _plain(row: object) -> str:
    keys = [key for key in type(row).__dataclass_fields__ if key not in ("where", "position")]  # type: ignore[attr-defined]
    return f"{type(row).__name__} {[getattr(row, key) for key in keys]}"


@pytest.mark.slow
def test_a_dyr_file_that_never_ends_a_record_is_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "grid.dyr"
    path.write_text("1 'MINE' 1\n" + "0.1 0.2 0.3 0.4 0.5\n" * 1_000_000)
    start = time.process_time()
    with pytest.raises(
        CaseError, match=r"grid\.dyr:1: MINE has more than 4000 fields, allowed: fewer \(is the"
    ):
        read_dyr(path)
    assert time.process_time() - start < 5.0


def test_a_second_branch_of_one_identifier_is_a_further_circuit_which_is_said(tmp_path: Path) -> None:
    path = tmp_path / "grid.raw"
    rows = [f"{ends},'1',0.01,0.1,0.04,0,0,0,0.001,0.002,0.003,0.004,1" for ends in ("3,2", "2,3")]
    path.write_text(raw_grid(33, extra={"branch": rows}))
    imported = import_psse(path)
    between = [b for b in imported.case.branches if {b.from_bus, b.to_bus} == {2, 3}]
    assert [complex(b.r, b.x) for b in between] == [0.01 + 0.1j] * 3 and len({b.name for b in between}) == 3
    what = "branch whose identifier is given twice: read as another circuit"
    assert imported.report.assumed[what] == 2
    with pytest.raises(CaseError, match=rf"grid\.raw:\d+: {what}, which --strict does not allow"):
        import_psse(path, options=ImportOptions(strict=True))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"leave_out": "SEXS"}, r"leave_out = 'SEXS', allowed: a list, \['SEXS'\]"),
        ({"devices": "own.toml"}, r"devices = 'own.toml', allowed: a list"),
        ({"replace": "SEXS"}, "replace = 'SEXS', allowed: a dict such as"),
    ],
)
def test_one_name_in_place_of_a_list_is_refused(options: dict, says: str) -> None:
    with pytest.raises(CaseError, match=says):
        ImportOptions(**options)
