"""Import from PSS/E and MATPOWER: the same grid in another form, and refusals with file and line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from grid_text import dyr_text, matpower_text, raw_text
from plant_shim import BlockShim

from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import Case, CaseError, load_case
from interarea.models.case.checks import require_dynamics
from interarea.models.case.variants import operating_variant
from interarea.models.case.write_toml import export_toml
from interarea.models.grid.network import admittance_matrix
from interarea.models.grid.powerflow import solve_powerflow
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.matpower import import_matpower
from interarea.models.importers.psse import import_psse

Write = Callable[[str, str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write_file(name: str, text: str) -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return write_file


@pytest.mark.parametrize("name", ["kundur-pss", "new-england", "nets-nyps"])
def test_raw_gives_the_same_admittances_and_the_same_power_flow(write: Write, name: str) -> None:
    case = load_case(name)
    copy = import_psse(write("grid.raw", raw_text(case))).case
    assert admittance_matrix(copy) == pytest.approx(admittance_matrix(case), rel=1e-12, abs=1e-9)
    assert solve_powerflow(copy).voltages == pytest.approx(solve_powerflow(case).voltages, abs=1e-10)
    with pytest.raises(CaseError, match="no dynamic data"):
        require_dynamics(copy)


def test_dyr_gives_the_same_machines_and_controls(write: Write) -> None:
    case = load_case("kundur-pss")
    copy = import_psse(
        write("grid.raw", raw_text(case)),
        write("grid.dyr", dyr_text(case)),
        options=ImportOptions(P_exponent=1.0),
    ).case
    for ours, theirs in zip(copy.machines, case.machines, strict=True):
        keys = ("H", "D", "Xd", "Xq", "Xl", "Xd1", "Xq1", "Xd2", "Xq2", "Td01", "Tq01", "Td02", "Tq02", "Ra")
        assert [getattr(ours, k) for k in keys] == [getattr(theirs, k) for k in keys]
        assert (ours.exciter.KA, ours.exciter.TR, ours.exciter.kind) == (200.0, 0.01, "exst1")
        assert all(
            getattr(ours.stabilizer, f"T{k}") == getattr(theirs.stabilizer, f"T{k}") for k in range(1, 5)
        )
        assert (ours.stabilizer.KS, ours.stabilizer.T6, ours.stabilizer.LSMAX) == (20.0, 10.0, 0.05)
        assert ours.saturation is None
    assert [(q.P_exponent, q.Q_exponent) for q in copy.loads] == [(1.0, 2.0)] * 2
    require_dynamics(copy)


def test_relays_and_units_that_are_not_there_are_counted(write: Write) -> None:
    case = load_case("kundur-pss")
    text = dyr_text(case) + "1 'VTGTPA' 1 0 0 0 /\n9 'GENCLS' 1 4.0 0.0 /\n"
    report = import_psse(write("grid.raw", raw_text(case)), write("grid.dyr", text)).report
    assert report.dropped["relay or meter"] == 1
    assert report.assumed["DYR record of a unit that is not in the grid: ignored"] == 1


def test_another_reactance_in_the_raw_file_is_told(write: Write) -> None:
    case = load_case("kundur-pss")
    dyr = write("grid.dyr", dyr_text(case))
    text = raw_text(case)
    report = import_psse(write("grid.raw", text), dyr).report
    other = import_psse(write("grid.raw", text.replace(f",{case.machines[0].Xd1},", ",0.25,")), dyr).report
    what = "X''d of the DYR used; ZX of the RAW differs"
    assert (report.assumed[what], other.assumed[what]) == (4, 0)


def test_saturation_goes_through_both_points(write: Write) -> None:
    case = load_case("kundur-pss")
    text = dyr_text(case).replace(" 0.0 0.0 /", " 0.04 0.3 /")
    s = (
        import_psse(write("grid.raw", raw_text(case)), write("grid.dyr", text))
        .case.machines[0]
        .flux_saturation
    )
    assert (s.shape, s.axes, s.of) == ("quadratic", "both", "subtransient_flux")
    assert s.factor(1.0) == pytest.approx(0.04, rel=1e-12)
    assert s.factor(1.2) == pytest.approx(0.3, rel=1e-12)


MAPPED = [
    (
        "'SEXS' 1 0.1 10.0 100 0.05 -4 5 /",
        {"kind": "sexs", "K": 100.0, "TA_TB": 0.1, "TB": 10.0, "TE": 0.05, "EMIN": -4.0, "EMAX": 5.0},
    ),
    (
        "'IEEEX1' 1 0.02 40 0.05 0 0 5 -5 1 0.5 0.03 1 0 3 0.08 4 0.3 /",
        {
            "kind": "ieeet1",
            "TR": 0.02,
            "KA": 40.0,
            "KE": 1.0,
            "TE": 0.5,
            "KF": 0.03,
            "VRMIN": -5.0,
            "S2": 0.3,
        },
    ),
    (
        "'ESST1A' 1 1 1 0.01 99 -99 1 10 1 1 200 0 4 -4 4 -4 0 0 1 0 3 /",
        {"kind": "esst1a", "TC": 1.0, "TB": 10.0, "TB1": 1.0, "VRMAX": 4.0},
    ),
]


@pytest.mark.parametrize(("record", "expected"), MAPPED)
def test_exciter_records_map(write: Write, record: str, expected: dict) -> None:
    case = load_case("kundur-manual")
    text = dyr_text(case) + f"2, {record}\n2 'TGOV1' 1 0.05 0.1 1.0 0.0 0.2 7.0 0.01 /\n"
    machine = import_psse(write("grid.raw", raw_text(case)), write("grid.dyr", text)).case.machine("G2")
    assert {k: getattr(machine.exciter, k) for k in expected} == expected
    assert (machine.governor.kind, machine.governor.R, machine.governor.T3) == ("tgov1", 0.05, 7.0)


def full_dyr(case: Case) -> str:
    """Every kind of control of `case` as the PSS/E record that is the same block."""
    lines = [dyr_text(case)]
    for m in case.machines:
        e, g = m.exciter, m.governor
        if e.kind == "static_tgr":
            lines.append(f"{m.bus} 'SEXS' 1 {e.TC / e.TB!r} {e.TB} {e.KA} {e.TA} {e.Efd_min} {e.Efd_max} /")
        elif e.kind == "st1a":
            times = f"{e.TC} {e.TB} {e.KA} {e.TA} {e.VRmax} {e.VRmin} {e.KC}"
            lines.append(f"{m.bus} 'EXST1' 1 {e.TR} 9 -9 {times} 0 1 /")
        elif e.kind == "dc1":
            rest = f"{e.VRmax} {e.VRmin} {e.KE} {e.TE} {e.KF} {e.TF} 0 3 0 4 0"
            lines.append(f"{m.bus} 'ESDC1A' 1 {e.TR} {e.KA} {e.TA} {e.TB} {e.TC} {rest} /")
        if g.kind == "tgov1":
            lines.append(f"{m.bus} 'TGOV1' 1 {g.R} {g.T1} {g.Vmax} {g.Vmin} {g.T2} {g.T3} {g.Dt} /")
    return "\n".join(lines) + "\n"


CONTROLS = {
    "SEXS": {
        "kind": "static_tgr",
        "KA": 200.0,
        "TA": 0.02,
        "TC": 1.0,
        "TB": 10.0,
        "Efd_min": -6.0,
        "Efd_max": 6.0,
    },
    "EXST1": {"kind": "st1a", "KA": 200.0, "TA": 0.02, "TR": 0.01, "VRmin": -6.0, "VRmax": 6.0, "KC": 0.1},
    "ESDC1A": {"kind": "dc1", "KA": 20.0, "TA": 0.055, "TR": 0.05, "TE": 0.36, "KF": 0.125, "TF": 1.8}
    | {"VRmin": -3.0, "VRmax": 5.0},  # without saturation, which is of another shape
}


@pytest.mark.parametrize("model", CONTROLS)
def test_an_imported_grid_has_the_linear_plant_of_the_case_it_was_written_from(
    write: Write, tmp_path: Path, model: str
) -> None:
    """Case -> RAW + DYR -> case -> TOML -> case: the same eigenvalues, of other devices with other states."""
    stabilizer = {
        "K": 20.0,
        "Tw": 10.0,
        "T1": 0.05,
        "T2": 0.02,
        "T3": 3.0,
        "T4": 5.4,
        "Vs_min": -0.05,
        "Vs_max": 0.05,
    }
    governor = {
        "kind": "tgov1",
        "R": 0.05,
        "T1": 0.5,
        "T2": 3.0,
        "T3": 10.0,
        "Dt": 0.1,
        "Vmin": 0.0,
        "Vmax": 1.2,
    }
    row = {"exciter": CONTROLS[model], "stabilizer": stabilizer, "governor": governor}
    row["torque_by_speed"] = True  # as every machine of a DYR file
    case = load_case("kundur-thyristor-z").with_changes({"machines": {"defaults": row}})
    copy = import_psse(write("grid.raw", raw_text(case)), write("grid.dyr", full_dyr(case))).case
    export_toml(copy, tmp_path / "grid.toml")
    read_back = load_case(tmp_path / "grid.toml")
    assert read_back.hash == copy.hash
    got, expected = (np.linalg.eigvals(BlockShim(plant_block(c)).jacobians()[0]) for c in (read_back, case))
    assert len(got) == len(expected)
    moving = expected[
        abs(expected) > 1e-2
    ]  # the reference angle's zero is a multiple one, and ill conditioned
    assert all(np.abs(got - z).min() < 1e-7 * abs(z) for z in moving)


def test_a_salient_pole_machine_is_the_round_rotor_one_without_transient_in_q(write: Write) -> None:
    """GENSAL: psi''q is the only q-axis flux, Tq02 d psi''q/dt = -psi''q - (Xq - Xq2) iq."""
    case = load_case("kundur-manual")
    m = case.machines[0]
    values = f"{m.Td01} {m.Td02} {m.Tq02} {m.H} {m.D} {m.Xd} 0.9 {m.Xd1} {m.Xd2} {m.Xl}"
    lines = [f"{b.bus} 'GENSAL' 1 {values} 0 0 /" for b in case.machines]
    copy = import_psse(write("grid.raw", raw_text(case)), write("grid.dyr", "\n".join(lines) + "\n")).case
    plant = BlockShim(plant_block(copy))
    name = copy.machines[0].name
    index = {s: plant.state_names.index(f"{name}.{s}") for s in ("delta", "ed1", "ed2")}
    A = plant.jacobians()[0]
    assert np.count_nonzero(np.delete(A[index["ed1"]], index["ed1"])) == 0  # nothing drives ed1
    assert plant.x[index["ed1"]] == pytest.approx(0.0, abs=1e-12)
    slow = BlockShim(plant_block(copy.with_changes({"machines": {"defaults": {"Tq01": 7.0}}})))
    rest = [k for k, s in enumerate(plant.state_names) if not s.endswith(".ed1")]
    np.testing.assert_array_equal(slow.jacobians()[0][np.ix_(rest, rest)], A[np.ix_(rest, rest)])
    with pytest.raises(CaseError, match=r"saturation S\(1\.0\) = 0\.3, S\(1\.2\) = 0\.1"):
        text = "\n".join(line.replace(" 0 0 /", " 0.3 0.1 /") for line in lines)
        import_psse(write("grid.raw", raw_text(case)), write("bad.dyr", text + "\n"))


def test_a_subtransient_reactance_below_the_leakage_is_taken_and_told(write: Write) -> None:
    """New England as GridDyn has it, and others: the equations are sound (test_leakage.py)."""
    case = load_case("kundur-manual").with_changes(
        {"machines": {"defaults": {"saturation": "none", "Xd2": 0.15, "Xq2": 0.15}}}
    )
    imported = import_psse(write("grid.raw", raw_text(case)), write("grid.dyr", dyr_text(case)))
    assert {m.Xd2 for m in imported.case.machines} == {0.15}
    assert imported.report.assumed["X''d below the leakage reactance Xl: used unchanged"] == 4


@pytest.mark.parametrize(("converters_as_current", "exponent"), [(False, 0.0), (True, 1.0)])
def test_a_unit_without_dynamic_data_is_an_injection_which_is_said(
    write: Write, converters_as_current: bool, exponent: float
) -> None:
    case = load_case("kundur-manual")
    records = dyr_text(case.with_changes({"machines": {"G4": "none"}, "swing": ["G1", "G3"]}))
    imported = import_psse(
        write("grid.raw", raw_text(case)),
        write("grid.dyr", records),
        options=ImportOptions(converters="current" if converters_as_current else "model"),
    )
    injection = next(load for load in imported.case.loads if load.name == "G4")
    assert (injection.P_exponent, injection.Q_exponent) == (exponent, exponent)
    assert injection.P_mw == pytest.approx(-case.machine("G4").P_mw)
    said = {0.0: "constant P and Q", 1.0: "a constant current"}[exponent]
    assert imported.report.assumed[f"unit without DYR record modelled as {said}"] == 1


RAW_REFUSED = [
    (
        "7,'1 ',1,1,1,967.0",
        "7,'1 ',1,1,1,inf",
        r"grid\.raw:16: load record: PL \(field 6\) = 'inf', allowed: a finite number",
    ),
    ("\n1,'a/b", "\nnan,'a/b", r"grid\.raw:4: bus record: I \(field 1\) = 'nan', allowed: a finite number"),
    (
        "7,'1 ',1,1,1,967.0",
        "7,'1 ',1,1,1,1.0,0,0,0,0,0,1,1\n7,'1 ',1,1,1,967.0",
        r"grid\.raw:17: load '1' at bus 7 is given twice, first at .*grid\.raw:16",
    ),
    (
        "1,'1 ',700.0",
        "1,'1 ',1.0,0,99,-99,1,0,9,0,1,0,0,1,1,100,999,0\n1,'1 ',700.0",
        r"grid\.raw:\d+: generator '1' at bus 1 is given twice",
    ),
    ("7,'1 ',1,1,1,967.0", "7,'1 ',1,1,1,9x7", r"grid\.raw:16: load record: PL \(field 6\) = '9x7', allowed"),
    ("7,'1 ',1,1,1", "77,'1 ',1,1,1", r"grid\.raw:16: bus 77 does not exist, allowed: a bus of this file"),
    ("1,5,0,'0'", "1,5,6,'0'", r"grid\.raw:41: transformer record: J \(field 2\) = 0\.05"),
    ("1,1.0,0.0\n2,", "1,1.0,0.0\n1,", r"grid\.raw:5: bus 1 is given twice"),
    ("1.25,0.0\n0 / END OF TR", "0 / END OF TR", r"grid\.raw:\d+: transformer winding record: WINDV"),
    ("0\n0\nQ", "0\n'dc',1\n0\nQ", r"grid\.raw:\d+: two-terminal dc record: VSCHD"),
    ("0, 100.0, 33", "1, 100.0, 33", r"grid\.raw:1: header record: IC \(field 1\) = 1, allowed: 0"),
]


@pytest.mark.parametrize(("old", "new", "message"), RAW_REFUSED)
def test_a_wrong_raw_file_is_named_with_its_line(write: Write, old: str, new: str, message: str) -> None:
    text = raw_text(load_case("kundur-manual"))
    assert old in text
    with pytest.raises(CaseError, match=message):
        import_psse(write("grid.raw", text.replace(old, new, 1)))


def test_a_raw_file_cut_short_is_named(write: Write) -> None:
    text = raw_text(load_case("kundur-manual"))
    with pytest.raises(
        CaseError, match=r"grid\.raw:\d+: the file ends inside the generator data, allowed: .* \(cut off\?\)"
    ):
        import_psse(write("grid.raw", text[: text.index("0 / END OF GENERATOR")]))


DYR_REFUSED = [
    ("// made by a test", "7 'REGFMC1' 1 0.1 /", r"grid\.dyr:1: model 'REGFMC1' at bus 7 is not supported"),
    ("'EXST1'", "'AC4A'", r"grid\.dyr:4: model 'AC4A' at bus 1 is not supported; did you mean EXAC4"),
    (" 0.0 0.0 /", " 0.0 /", r"grid\.dyr:2: GENROU has 13 parameters, allowed: 14 \(cut off\?\)"),
    (" 0.0 0.0 /", " 0.0 0.0 7.0 /", r"grid\.dyr:2: GENROU has 15 parameters, allowed: 14 \(is the /"),
    ("1.7 0.3 0.55", "1.7 nan 0.55", r"grid\.dyr:2: GENROU record: Xd1 .* 'nan', allowed: a finite number"),
    ("'IEEEST' 1 1 0", "'IEEEST' 1 9 0", r"grid\.dyr:5: IEEEST ICS = 9, allowed: 0 to 6"),
    (
        "'IEEEST' 1 1 0",
        "'IEEEST' 1 1 7",
        r"grid\.dyr:5: IEEEST field 2 \(BUS\) = 7, allowed: 0 \(its function",
    ),
    ("'IEEEST' 1 1 0", "'IEEEST' 1 1 x", r"grid\.dyr:5: IEEEST field 2 \(BUS\) = 'x', allowed: a number"),
    ("'IEEEST' 1 1 0", "'IEEEST' 1 1", r"grid\.dyr:5: IEEEST has 18 fields, allowed: 19, ICS 0:BUS A1"),
    ("1.7 0.3 0.55", "1.7 1.9 0.55", r"Xd = 1.8 with Xd1 = 1.9.*\(given at .*grid\.dyr:2\)"),
    ("1 'EXST1'", "1 'GENROU'", r"grid\.dyr:4: GENROU has 12 parameters"),
    ("2 'GENROU' 1", "2 'WT3G1' 1", r"model 'WT3G1' at bus 2 .*--converters current"),
    ("2 'GENROU' 1", "2 'REGCA1' 1", r"REGCA1 has \d+ fields, allowed: 15"),
]


@pytest.mark.parametrize(("old", "new", "message"), DYR_REFUSED)
def test_a_wrong_dyr_file_is_named_with_its_line(write: Write, old: str, new: str, message: str) -> None:
    case = load_case("kundur-pss")
    text = dyr_text(case)
    assert old in text
    raw = write("grid.raw", raw_text(case))
    with pytest.raises(CaseError, match=message):
        import_psse(raw, write("grid.dyr", text.replace(old, new, 1)))


def test_a_dyr_file_cut_short_or_without_a_machine_is_named(write: Write) -> None:
    case = load_case("kundur-pss")
    raw, text = write("grid.raw", raw_text(case)), dyr_text(case)
    with pytest.raises(CaseError, match=r"grid\.dyr:17: IEEEST has no / to the end of the file"):
        import_psse(raw, write("grid.dyr", text.rstrip()[:-1]))
    text_without = text.replace(text[text.index("2 'GENROU'") : text.index("2 'EXST1'")], "")
    with pytest.raises(CaseError, match=r"grid\.dyr:\d+: machine G2 has controls but no machine model"):
        import_psse(raw, write("grid.dyr", text_without))


@pytest.mark.parametrize("name", ["kundur-manual", "new-england", "nets-nyps"])
def test_matpower_gives_the_same_power_flow(write: Write, name: str) -> None:
    case = load_case(name)
    copy = import_matpower(write("grid.m", matpower_text(case))).case
    assert solve_powerflow(copy).voltages == pytest.approx(solve_powerflow(case).voltages, abs=1e-10)
    assert len(copy.branches) == len(case.branches)


MATPOWER_REFUSED = [
    (
        "0.0025 0.025 ",
        "0.0025 Inf ",
        r"grid\.m:\d+: mpc\.branch: column 4 is inf, allowed: a finite number",
    ),
    ("'2'", "'1'", r"grid\.m: MATPOWER case version 1, allowed: 2"),
    ("mpc.branch = [", "mpc.lines = [", r"grid\.m: mpc\.branch is missing"),
    ("\t1, 700.0, 0,", "\t99, 700.0, 0,", r"grid\.m:18: bus 99 does not exist"),
    (" 230 1 1.1 0.9;", ";", r"grid\.m:5: mpc\.bus: 9 columns, allowed: 13"),
    ("\t1 2 0 0", "\t1 2 0 zero", r"grid\.m:5: mpc\.bus: 'zero' is not a number"),
    ("1 -360 360;\n];", "1 -360 360;", r"grid\.m:\d+: mpc\.branch begins in line \d+ and does not end"),
]


@pytest.mark.parametrize(("old", "new", "message"), MATPOWER_REFUSED)
def test_a_wrong_matpower_file_is_named_with_its_line(write: Write, old: str, new: str, message: str) -> None:
    text = matpower_text(load_case("kundur-manual"))
    assert old in text
    with pytest.raises(CaseError, match=message):
        import_matpower(write("grid.m", text.replace(old, new, 1)))


@pytest.mark.parametrize(("base_mva", "angle_deg"), [(1.0, 0.0), (100.0, 0.0), (1.0, -0.5729), (1.0, -0.57)])
def test_a_flat_start_is_no_solution_however_small_the_grid(
    write: Write, base_mva: float, angle_deg: float
) -> None:
    """A load of 0.1 pu behind 0.1 pu: sin(angle) = -0.01 / v, thus -0.5729 deg; .0029 deg are 5e-4 pu."""
    path = write(
        "feeder.m",
        f"mpc.version = '2'; mpc.baseMVA = {base_mva};\n"
        "mpc.bus = [1 3 0 0 0 0 1 1 0 11 1 1.1 0.9;"
        f" 2 1 {0.1 * base_mva} 0 0 0 1 0.99995 {angle_deg} 11 1 1.1 0.9];\n"
        f"mpc.gen = [1 {0.1 * base_mva} 0 9 -9 1 {base_mva} 1 99 0];\n"
        "mpc.branch = [1 2 0 0.1 0 0 0 0 0 0 1 -360 360];\n",
    )
    (line,) = [t for t in import_matpower(path).report.lines if t.startswith("stored voltages")]
    word = {0.0: ": no solution", -0.5729: ": a solution", -0.57: ": a solution with few digits"}[angle_deg]
    assert line.endswith(word)


def test_import_command_writes_a_case_that_loads_and_refuses_other_files(
    write, tmp_path, monkeypatch, capsys
):
    import sys

    from interarea.cli.app import main

    def call(*arguments: object) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["interarea", "import", *map(str, arguments)])
        try:
            main()
        except SystemExit as stopped:
            return int(stopped.code or 0), capsys.readouterr().err
        return 0, capsys.readouterr().err

    case = load_case("kundur-pss")
    raw, dyr = write("grid.raw", raw_text(case)), write("grid.dyr", dyr_text(case))
    out = tmp_path / "case.toml"
    assert call(raw, "--dyr", dyr, "--out", out, "--p-exponent", 1.0)[0] == 0
    assert load_case(out).hash == import_psse(raw, dyr, options=ImportOptions(P_exponent=1.0)).case.hash
    code, message = call(write("grid.epc", ""), "--out", out)
    assert code == 2 and "suffix '.epc', allowed: .raw" in message
    code, message = call(raw, "--dyr", dyr, "--out", out, "--strict")
    assert code == 2 and "because the stored voltages are not a solution, which --strict does not" in message


def test_export_command_writes_a_variant_that_loads(tmp_path, monkeypatch, capsys):
    import sys

    from interarea.cli.app import main

    out = tmp_path / "variant.toml"
    arguments = ["export", "two-area-thesis", "--out", str(out), "--tie-flow", "50", "--circuit-out", "8-9 a"]
    monkeypatch.setattr(sys, "argv", ["interarea", *arguments])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert not stopped.value.code and capsys.readouterr().out.strip() == str(out)
    expected = operating_variant(load_case("two-area-thesis"), tie_flow_mw=50.0, out=["8-9 a"])
    assert load_case(out).hash == expected.hash and load_case(out).name == expected.name
