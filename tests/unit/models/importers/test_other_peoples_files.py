"""What other people's grid files hold: nothing of it is skipped in silence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from grid_text import dyr_text, raw_text
from raw_grids import raw_grid

import interarea as ia
from interarea.models.case.case import load_case
from interarea.models.errors import CaseError
from interarea.models.importers.dynamics import machine_dynamics, read_dynamics
from interarea.models.importers.dyr import read_dyr
from interarea.models.importers.file import import_grid
from interarea.models.importers.imported import Imported, ImportOptions
from interarea.models.importers.report import Report

CASE = load_case("kundur-pss")
RAW, DYR = raw_text(CASE), dyr_text(CASE)


def taken(folder: Path, text: str, name: str = "grid.raw", *, dyr: str | None = None, **options) -> Imported:
    """Write a grid file and import it."""
    (folder / name).write_text(text)
    if dyr is None:
        return import_grid(folder / name, options=ImportOptions(**options))
    (folder / "grid.dyr").write_text(dyr)
    return import_grid(folder / name, folder / "grid.dyr", ImportOptions(**options))


# ---------------------------------------------------------------- DYR text


LOST = {
    "a letter for a digit": ("1 'EXST1' 1", "l 'EXST1' 1"),
    "a label before it": ("1 'EXST1' 1", "G1 exciter: 1 'EXST1' 1"),
    "a bus by its name": ("1 'EXST1' 1", "'NORTH' 'EXST1' 1"),
    "a machine's number": ("1 'GENROU' 1", "1a 'GENROU' 1"),
}


@pytest.mark.parametrize("spoiled", LOST)
def test_a_line_of_comment_that_looks_like_a_record_is_named(spoiled: str, tmp_path: Path) -> None:
    old, new = LOST[spoiled]
    text = DYR.replace(f"\n{old}", f"\n{new}", 1)
    line = text[: text.index(new)].count("\n") + 1
    model = old.split("'")[1]
    result = read_dyr(_written(tmp_path, text)) if model == "EXST1" else None
    if result is None:  # its second line begins with a number, which is no bus
        with pytest.raises(CaseError, match=rf"grid\.dyr:{line + 1}: bus = "):
            read_dyr(_written(tmp_path, text))
        return
    said = f"line {line}, which names {model}, has no bus number"
    assert [note for note in result.notes if said in note and f"grid.dyr:{line}:" in note]
    assert result.comments == 2
    with pytest.raises(CaseError, match=r"names EXST1.*--strict"):
        name_of = {(m.bus, "1"): m.name for m in CASE.machines}
        machine_dynamics(read_dynamics(tmp_path / "grid.dyr"), name_of, (), Report(strict=True))


def _written(folder: Path, text: str) -> Path:
    (folder / "grid.dyr").write_text(text)
    return folder / "grid.dyr"


def test_a_record_behind_the_slash_of_another_is_read(tmp_path: Path) -> None:
    lines = DYR.splitlines()
    k = next(k for k, line in enumerate(lines) if "'EXST1'" in line)
    joined = "\n".join([*lines[: k - 1], lines[k - 1] + " " + lines[k], *lines[k + 1 :]])
    result, whole = (read_dyr(_written(tmp_path, text)) for text in (joined, DYR))
    assert [r.fields for r in result.records] == [r.fields for r in whole.records]
    assert result.notes == (
        f"{tmp_path}/grid.dyr:{k}: EXST1 begins after the / of another record; read as two records",
    )
    remark = DYR.replace(" /\n", " / GENROU of NORTH, from the works\n", 1)
    assert read_dyr(_written(tmp_path, remark)).notes == ()
    with pytest.raises(CaseError, match=r"bus = '1\.5', allowed: a whole number"):
        read_dyr(_written(tmp_path, "1.5 'SEXS' 1 0.1 10 100 0.1 -5 5 /\n"))


# ---------------------------------------------------------------- out of service at a bus that does not exist

ABSENT = {
    "load": "9999,'9',0,1,1,967.0,100.0,0,0,0,0,1",
    "fixed shunt": "9999,'9',0,0.0,200.0",
    "generator": "9999,'9',0,0,99,-99,1.02,0,150.0,0,0.2,0,0,1.0,0,100,999,0",
    "branch": "3,9999,'9',0.0,0.1,0.0,0,0,0,0,0,0,0,0",
    "transformer": "3,9999,0,'9',1,1,1,0,0,2,'T',0,1,1\n0,0.1,100\n1,0,0\n1,0",
    "induction machine": "9999,'9',0,1,1,1,1,1,0,0,100,0,2,10",
    "switched shunt": "9999,1,0,0,1.1,0.9,0,100,'',10.0",
}


@pytest.mark.parametrize("section", ABSENT)
def test_a_record_out_of_service_may_stand_at_a_bus_that_is_not_there(section: str, tmp_path: Path) -> None:
    plain = taken(tmp_path, raw_grid(33)).case
    imported = taken(tmp_path, raw_grid(33, extra={section: [ABSENT[section]]}))
    assert imported.report.dropped[f"{section} out of service at a bus that does not exist"] == 1
    assert imported.case == plain
    fields = ABSENT[section].split(",")
    at = {"load": 2, "fixed shunt": 2, "generator": 14, "branch": 13, "transformer": 11}.get(section)
    fields[at if at else {"induction machine": 2, "switched shunt": 3}[section]] = "1"
    with pytest.raises(CaseError, match="bus 9999 does not exist"):
        taken(tmp_path, raw_grid(33, extra={section: [",".join(fields)]}))


def test_a_winding_out_of_service_may_end_at_a_bus_that_is_not_there(tmp_path: Path) -> None:
    """The two windings left are in series: z12 = 0.01 + 0.2j between buses 1 and 3."""
    star = (
        "1,3,9999,'9',1,1,1,0,0,2,'T',3,1,1\n0.01,0.2,100,0.01,0.2,100,0.01,0.2,100,1,0\n1,0,0\n1,0,0\n1,0,0"
    )
    imported = taken(tmp_path, raw_grid(33, extra={"transformer": [star]}))
    assert imported.report.dropped["winding out of service at a bus that does not exist"] == 1
    legs = [b for b in imported.case.branches if "winding" in b.name and "9999" in b.name]
    assert sum(complex(b.r, b.x) for b in legs) == pytest.approx(0.01 + 0.2j)
    with pytest.raises(CaseError, match="bus 9999 does not exist"):
        taken(tmp_path, raw_grid(33, extra={"transformer": [star.replace("'T',3", "'T',1")]}))


# ---------------------------------------------------------------- names of files


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("n" * 65 + ".raw", "n" * 64),
        ("a.b.c.raw", "a.b.c"),
        ("Netz \u00fc 1.raw", "Netz-1"),
        ("grid.raw", "grid"),
    ],
)
def test_a_case_is_named_by_its_file_and_what_is_changed_is_told(
    file: str, name: str, tmp_path: Path
) -> None:
    imported = taken(tmp_path, raw_grid(33), file)
    assert imported.case.name == name
    reported = [line for line in imported.report.lines if "the case is named" in line]
    assert bool(reported) == (name != file.removesuffix(".raw"))


# ---------------------------------------------------------------- a unit at a bus of type 1


def test_a_unit_at_a_bus_of_type_1_is_decided_by_the_stored_voltages(tmp_path: Path) -> None:
    solved = taken(tmp_path, RAW)
    stored = _stored(RAW, solved)
    unit = "8,'1 ',100.0,20.0,99,-99,1.0,0,150.0,0.0,0.25,0,0,1,1,100,999,0"
    extra = stored.replace("\n0 / END OF GENERATOR", f"\n{unit}\n0 / END OF GENERATOR")
    with_one = taken(tmp_path, extra)
    (reported,) = (what for what in with_one.report.assumed if "bus of type 1" in what)
    assert "left out" in reported and len(with_one.case.machines) == 4
    assert with_one.case.machines == taken(tmp_path, stored).case.machines
    of_type_1 = stored.replace("\n2,'a/b, 2',0.0,2,", "\n2,'a/b, 2',0.0,1,")
    retained = taken(tmp_path, of_type_1)
    (reported,) = (what for what in retained.report.assumed if "bus of type 1" in what)
    assert "a solution with it" in reported and len(retained.case.machines) == 4


def _stored(raw: str, solved: Imported) -> str:
    """`raw` with the voltages and the powers of `solved` written into it."""
    lines = raw.splitlines()
    power = {m.bus: (m.P_mw, m.Q_mvar) for m in solved.case.machines}
    section = 0
    for k, line in enumerate(lines[3:], 3):
        if line.startswith("0 /"):
            section += 1
        elif section == 0:
            V = solved.solution.voltages[int(line.split(",")[0])]
            head = line.rsplit(",", 2)[0]
            lines[k] = f"{head},{abs(V)!r},{float(np.degrees(np.angle(V)))!r}"
        elif section == 3:
            words = line.split(",")
            words[2:4] = map(repr, power[int(words[0])])
            lines[k] = ",".join(words)
    return "\n".join(lines) + "\n"


# ---------------------------------------------------------------- statements of a MATPOWER file

FEEDER = """function mpc = feeder
mpc.version = '2';
mpc.baseMVA = 1;
mpc.bus = [
  1 3 0   0   0 0 1 1 0 12.66 1 1.1 0.9;
  2 1 0.6 0.3 0 0 1 1 0 12.66 1 1.1 0.9;
  3 1 0.5 0.2 0 0 1 1 0 12.66 1 1.1 0.9;
];
mpc.gen = [ 1 0 0 10 -10 1 1 1 10 0; ];
mpc.branch = [
  1 2 0.02 0.04 0 0 0 0 0 0 1 -360 360;
  2 3 0.02 0.04 0 0 0 0 0 0 1 -360 360;
];
"""
OHMS = """[PQ, PV, REF, NONE, BUS_I, BUS_TYPE, PD, QD, GS, BS, BUS_AREA, VM, ...
    VA, BASE_KV] = idx_bus;
[F_BUS, T_BUS, BR_R, BR_X] = idx_brch;
Vbase = mpc.bus(1, BASE_KV) * 1e3;   %% in volts
Sbase = mpc.baseMVA * 1e6;
mpc.branch(:, [BR_R BR_X]) = mpc.branch(:, [BR_R BR_X]) / (Vbase^2 / Sbase);
"""


def test_columns_that_a_file_scales_are_scaled(tmp_path: Path) -> None:
    """Zbase = 12.66^2/1 ohm by hand; and PD as apparent power with a power factor."""
    Zbase = 12.66**2
    short = "mpc.branch(:, [3 4]) = mpc.branch(:, [3 4]) / (12.66^2 / mpc.baseMVA);\n"
    for code in (OHMS, short, "mpc.branch(:,3:4) = mpc.branch(:,3:4)*(1/12.66^2);\n"):
        imported = taken(tmp_path, FEEDER + code, "grid.m")
        assert [b.r for b in imported.case.branches] == pytest.approx([0.02 / Zbase] * 2, rel=1e-14)
        assert [b.x for b in imported.case.branches] == pytest.approx([0.04 / Zbase] * 2, rel=1e-14)
        assert imported.report.read["statements that change a table: executed"] == 1
    code = "define_constants;\npf = 0.8;\nmpc.bus(:, QD) = mpc.bus(:, PD) * sin(acos(pf));\n"
    code += "mpc.bus(:, PD) = mpc.bus(:, PD) * pf;\nmpc.bus(3, 3) = 0.7;\n"
    loads = {load.bus: load for load in taken(tmp_path, FEEDER + code, "grid.m").case.loads}
    assert (loads[2].P_mw, loads[2].Q_mvar) == pytest.approx((0.48, 0.36))
    assert (loads[3].P_mw, loads[3].Q_mvar) == pytest.approx((0.7, 0.3))


@pytest.mark.parametrize(
    "code",
    [
        "mpc.branch(:, 3) = mpc.branch(:, 3) .* x;",
        "mpc.branch(end, 3) = 1;",
        "mpc.branch(2, :) = [];",
        "mpc.branch(:, 3) = mpc.branch(:, 3) * mpc.branch(:, 4);",
        "mpc.branch(:, 30) = 1;",
        "mpc.bus(mpc.bus(:, 1) == 3, 3) = 5;",
        "mpc = scale_load(2, mpc);",
        "mpc.bus = [mpc.bus; 4 1 0 0 0 0 1 1 0 12.66 1 1.1 0.9];",
        "for k = 1:3, mpc.bus(k, 3) = 0; end",
        "mpc.branch(:, 3) *= 2;",
        "if 1, mpc.bus(1,3) = 5; end",
        "mpc2.bus = 1;",
        "mpcs.baseMVA = 50;",
    ],
)
def test_any_other_statement_is_refused_with_its_line(code: str, tmp_path: Path) -> None:
    line = FEEDER.count("\n") + 1
    with pytest.raises(CaseError, match=rf"grid\.m:{line}: "):
        taken(tmp_path, FEEDER + code + "\n", "grid.m")


def test_what_plays_no_part_in_a_matpower_file_is_told(tmp_path: Path) -> None:
    more = "mpc.gencost = [2 0 0 3 0.1 5 0;];\nmpc.bus_name = {\n'A; ]'; 'B % b'; 'C';\n};\n"
    imported = taken(tmp_path, FEEDER + more + "%{\nmpc.bus(1,3) = 9;\n%}\n", "grid.m")
    left_out = {f"mpc.{name}: ignored" for name in ("gencost", "bus_name")}
    assert left_out <= set(imported.report.dropped)
    imported = taken(tmp_path, FEEDER + "mpc.baseMVA = 2;\n", "grid.m")
    assert imported.case.base_mva == 2.0
    assert imported.report.assumed["mpc.baseMVA is given twice: the later one used"]
    uneven = FEEDER.replace("2 3 0.02 0.04", "2 3 0.020.04")
    with pytest.raises(CaseError, match=r"grid\.m:12: mpc\.branch: '0\.020\.04' is not a number"):
        taken(tmp_path, uneven, "grid.m")
    with pytest.raises(CaseError, match=r"grid\.m:6: mpc\.bus: 12 columns, allowed: 13 as in its other rows"):
        taken(tmp_path, FEEDER.replace("2 1 0.6 0.3", "2 1 0.6"), "grid.m")
    imported = taken(tmp_path, FEEDER.replace("10 0; ];", "10 0;\n99 0 0 10 -10 1 1 0 10 0; ];"), "grid.m")
    assert imported.report.dropped["unit out of service at a bus that does not exist"] == 1


# ---------------------------------------------------------------- negative damping coefficient


@pytest.mark.slow
def test_a_negative_damping_coefficient_lets_a_swing_grow(tmp_path: Path) -> None:
    """2H s^2 + D s + K w0 = 0 by hand, K = E' V cos(delta)/X from the case's own start."""
    dyr = "1 'GENCLS' 1 3.5 -10.0 /\n2 'GENCLS' 1 0 0 /\n"
    case = taken(tmp_path, SMIB, dyr=dyr).case
    swing = max(np.linalg.eigvals(ia.linearise(case).A), key=lambda z: z.imag)
    assert swing.real == pytest.approx(10.0 / (4 * 3.5), rel=1e-6)
    assert swing.imag == pytest.approx(np.sqrt(0.75743 * 120 * np.pi / 7 - (10.0 / 14) ** 2), rel=1e-3)


SMIB = """0, 2220.0, 33, 0, 1, 60.0
one machine
by hand
1,'GEN',24.0,2,1,1,1,1.0,36.0
2,'INF',24.0,3,1,1,1,0.995,0.0
0 / END OF BUS DATA
0 / END OF LOAD DATA
0 / END OF FIXED SHUNT DATA
1,'1',1998.0,666.0,9999.0,-9999.0,1.0,0,2220.0,0.0,0.3,0,0,1,1,100,9999,-9999,1,1
2,'1',-1998.0,0.0,9999.0,-9999.0,0.995,0,99999.0,0.0,0.0001,0,0,1,1,100,9999,-9999,1,1
0 / END OF GENERATOR DATA
1,2,'1',0.0,0.65,0.0,0,0,0,0,0,0,0,1,1,0,1,1
0 / END OF BRANCH DATA
0 / END OF TRANSFORMER DATA
Q
"""


def test_a_line_that_begins_with_two_slashes_is_comment_in_a_raw_file_too(tmp_path: Path) -> None:
    text = RAW.rstrip().removesuffix("Q").rstrip() + "\n//Generated by a program; 629.3\n"
    imported = taken(tmp_path, text)
    assert "a line that begins with // treated as comment" in imported.report.assumed
    assert [bus.number for bus in imported.case.buses] == [bus.number for bus in CASE.buses]
