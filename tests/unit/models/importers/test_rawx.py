"""RAWX, the JSON form of RAW: the grid of the same RAW, and messages with the lines of its rows."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from interarea.models.errors import CaseError
from interarea.models.importers.file import import_grid
from interarea.models.importers.imported import ImportOptions

RAW = """0, 100.0, 35, 0, 0, 60.0 / a test


0 /END OF SYSTEM-WIDE DATA, BEGIN BUS DATA
1,'WEST',230.0,3,1,1,1,1.02,0.0,1.1,0.9,1.1,0.9
2,'EAST',115.0,1,1,1,1,1.0,-3.0,1.1,0.9,1.1,0.9
3,'SOUTH',115.0,2,1,1,1,1.01,-2.0,1.1,0.9,1.1,0.9
0 /END OF BUS DATA, BEGIN LOAD DATA
2,'1',1,1,1,80.0,25.0,5.0,2.0,0.0,0.0,1,1,0
0 /END OF LOAD DATA, BEGIN FIXED SHUNT DATA
2,'1',1,0.5,12.0
0 /END OF FIXED SHUNT DATA, BEGIN GENERATOR DATA
1,'1',50.0,10.0,99.0,-99.0,1.02,0,0,120.0,0.0,0.2
3,'1',40.0,5.0,99.0,-99.0,1.01,0,0,60.0,0.0,0.25
0 /END OF GENERATOR DATA, BEGIN BRANCH DATA
2,3,'1',0.01,0.12,0.02
0 /END OF BRANCH DATA, BEGIN SYSTEM SWITCHING DEVICE DATA
0 /END OF SYSTEM SWITCHING DEVICE DATA, BEGIN TRANSFORMER DATA
1,2,0,'1',2,2,1,0.001,-0.002,2,'T1',1
0.004,0.09,150.0
235.0,230.0,2.5
115.0,115.0
0 /END OF TRANSFORMER DATA
Q
"""
TABLES = {
    "caseid": (["rev", "sbase", "basfrq", "title1"], [[35, 100.0, 60.0, "a test"]]),
    "bus": (
        ["ibus", "name", "baskv", "ide", "vm", "va"],
        [
            [1, "WEST", 230.0, 3, 1.02, 0.0],
            [2, "EAST", 115.0, 1, 1.0, -3.0],
            [3, "SOUTH", 115.0, 2, 1.01, -2.0],
        ],
    ),
    "load": (["ibus", "loadid", "stat", "pl", "ql", "ip", "iq"], [[2, "1", 1, 80.0, 25.0, 5.0, 2.0]]),
    "fixshunt": (["ibus", "shntid", "stat", "gl", "bl"], [[2, "1", 1, 0.5, 12.0]]),
    "generator": (
        ["ibus", "machid", "pg", "qg", "qt", "qb", "vs", "mbase", "zr", "zx"],
        [
            [1, "1", 50.0, 10.0, 99.0, -99.0, 1.02, 120.0, 0.0, 0.2],
            [3, "1", 40.0, 5.0, 99.0, -99.0, 1.01, 60.0, 0.0, 0.25],
        ],
    ),
    "acline": (["ibus", "jbus", "ckt", "rpu", "xpu", "bpu"], [[2, 3, "1", 0.01, 0.12, 0.02]]),
    "transformer": (
        [
            *("ibus", "jbus", "kbus", "ckt", "cw", "cz", "cm", "mag1", "mag2", "nmet", "name", "stat"),
            *("r1_2", "x1_2", "sbase1_2", "windv1", "nomv1", "ang1", "windv2", "nomv2"),
        ],
        [
            [
                *(1, 2, 0, "1", 2, 2, 1, 0.001, -0.002, 2, "T1", 1),
                *(0.004, 0.09, 150.0, 235.0, 230.0, 2.5, 115.0, 115.0),
            ]
        ],
    ),
}


def rawx(tables: dict = TABLES, **more) -> str:
    """A row a line, as programs write it; a table of one row as one list."""
    parts = []
    for name, (fields, rows) in (tables | more).items():
        shown = [json.dumps(row) for row in (rows[0] if name == "caseid" else rows)]
        parts.append(
            f'"{name}": {{\n"fields": {json.dumps(fields)},\n"data": [\n' + ",\n".join(shown) + "\n]}"
        )
    return '{"network": {\n' + ",\n".join(parts) + "\n}}\n"


def written(folder: Path, text: str, name: str = "grid.rawx") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def test_the_grid_is_that_of_the_raw_file(tmp_path: Path) -> None:
    ours, theirs = import_grid(written(tmp_path, rawx())), import_grid(written(tmp_path, RAW, "grid.raw"))
    assert ours.case.model_dump(exclude={"source"}) == theirs.case.model_dump(exclude={"source"})
    assert ours.solution.stored_mva == theirs.solution.stored_mva and len(ours.case.branches) == 2


def test_tables_without_a_part_are_counted_and_settings_taken(tmp_path: Path) -> None:
    imported = import_grid(
        written(tmp_path, rawx(owner=(["iowner", "owname"], [[1, "A"]]), general=(["thrshz"], [[1e-4]])))
    )
    assert imported.report.dropped["owner record: ignored"] == 1


WRONG = {
    "no json": ("{", r"grid\.rawx:1: no JSON"),
    "another form": ('{"a": 1}', r"no tables of a grid; allowed: .*network"),
    "no bus": (rawx({"caseid": TABLES["caseid"]}), "no rows in the table bus"),
    "too long": (
        rawx(load=(["ibus", "loadid"], [[2, "1", 5.0]])),
        r"rawx:\d+: load row of 3 values, allowed: 2",
    ),
    "word": (rawx(load=(["ibus", "loadid", "pl"], [[2, "1", "x"]])), r"rawx:\d+: load record: PL .* 'x'"),
    "bus": (rawx(load=(["ibus", "loadid", "pl"], [[7, "1", 5.0]])), r"rawx:\d+: bus 7 does not exist"),
    "unread": (rawx(gne=(["name"], [["G"]])), r"rawx:\d+: RAWX table 'gne' is not read, allowed: empty"),
    "change": (rawx(caseid=(["ic"], [[1]])), "ic = 1, allowed: 0"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_named_with_its_line(what: str, tmp_path: Path) -> None:
    text, said = WRONG[what]
    with pytest.raises(CaseError, match=said):
        import_grid(written(tmp_path, text))
    if r"rawx:\d+: load" in said:
        line = text[: text.index('[2, "1"')].count("\n") + 1
        with pytest.raises(CaseError, match=f"rawx:{line}: load"):
            import_grid(tmp_path / "grid.rawx")


def test_correction_tables_are_those_of_the_raw_file(tmp_path: Path) -> None:
    points = [[1, 0.9, 0.8, 0.0], [1, 1.0, 1.0, 0.05], [1, 1.1, 1.3, 0.1]]
    fields, rows = TABLES["transformer"]
    tables = TABLES | {"transformer": ([*fields, "tab1"], [[*rows[0], 1]])}
    theirs = RAW.replace("235.0,230.0,2.5\n", f"235.0,230.0,2.5{',' * 21}1\n").replace(
        "0 /END OF TRANSFORMER DATA\n",
        "0 /END OF TRANSFORMER DATA, BEGIN AREA DATA\n"
        + "0 /\n" * 3
        + "1,0.9,0.8,0,1.0,1.0,0.05,1.1,1.3,0.1,0,0,0\n0 /\n",
    )
    names = ["itable", "tap", "refact", "imfact"]
    ours = import_grid(written(tmp_path, rawx(tables, impcor=(names, points))))
    other = import_grid(written(tmp_path, theirs, "grid.raw"))
    assert ours.case.model_dump(exclude={"source"}) == other.case.model_dump(exclude={"source"})
    assert ours.case.branches != import_grid(written(tmp_path, rawx())).case.branches


def load(fields: list, row: list) -> str:
    return rawx(TABLES | {"load": (fields, [row])})


FIELDS, ROW = TABLES["load"][0], TABLES["load"][1][0]
LOST = {
    "a row cut": (load(FIELDS, ROW[:4]), r"rawx:\d+: load row of 4 values, allowed: 7"),
    "a field twice": (
        load([*FIELDS[:4], "pl", *FIELDS[5:]], ROW),
        "fields of load: 'pl', allowed: .*each once",
    ),
    "a field no text": (load([*FIELDS[:4], 7, *FIELDS[5:]], ROW), "fields of load: 7, allowed: texts"),
    "a field null": (load([*FIELDS[:4], None, *FIELDS[5:]], ROW), "fields of load: None, allowed: texts"),
    "a base of 400 digits": (
        rawx(caseid=(["sbase"], [[10**400]])),
        r"caseid: sbase = '10+', allowed: a number",
    ),
    "a revision without end": (rawx(caseid=(["rev"], [[float("inf")]])), "caseid: rev = 'inf', allowed"),
    "a nominal voltage of 1e308 kV": (
        rawx().replace("235.0, 230.0", "235.0, 1e308"),
        r"NOMV .*1e\+308.* allowed: within a factor 1000 of 230 kV of its bus",
    ),
    "rows of another table": (
        rawx().replace('"load": {\n', '"load": {"fields": ["ibus"]},\n"loads": {\n'),
        "RAWX table 'load' has no data",
    ),
    "a table twice": (
        rawx().replace('"load": {\n', '"load": {"fields": [], "data": []},\n"load": {\n'),
        "'load' is given twice, allowed: once",
    ),
    "thousands of digits": (rawx().replace("80.0", "8" * 5000), "rawx: no number: Exceeds the limit"),
}


@pytest.mark.parametrize("what", LOST)
def test_nothing_is_lost_or_read_as_another_table(what: str, tmp_path: Path) -> None:
    text, said = LOST[what]
    with pytest.raises(CaseError, match=said):
        import_grid(written(tmp_path, text))


def test_a_field_that_raw_does_not_have_is_told(tmp_path: Path) -> None:
    text = load([*FIELDS[:3], "pi", *FIELDS[4:]], ROW)
    line = text[: text.index('"pi"')].count("\n") + 1
    remark = "field 'pi' of load, which RAW 35 does not have, ignored; did you mean "
    first = import_grid(written(tmp_path, text)).report.first
    assert [at for what, at in first.items() if what.startswith(remark) and " pl" in what] == [
        f"{tmp_path}/grid.rawx:{line}"
    ]
    with pytest.raises(CaseError, match=r"field 'pi' .*--strict"):
        import_grid(tmp_path / "grid.rawx", options=ImportOptions(strict=True))
    later = import_grid(written(tmp_path, load([*FIELDS, "droopname"], [*ROW, "A"]))).report.first
    assert not any("which RAW" in what for what in later)
