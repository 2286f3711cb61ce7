"""Elements of RAW files against closed forms: transformers, stars, converters, motors, islands."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from raw_grids import raw_grid

from interarea.models.errors import CaseError
from interarea.models.grid.network import admittance_matrix
from interarea.models.grid.powerflow import PowerFlowError, solve_powerflow
from interarea.models.importers.imported import Imported, ImportOptions
from interarea.models.importers.psse import import_psse, static_grid
from interarea.models.importers.raw.file import read_raw
from interarea.models.importers.raw.lines import corrections
from interarea.models.importers.report import Report
from interarea.models.importers.static import StaticGrid

SECTIONS = {
    "two_terminal_dc": "two-terminal dc",
    "multi_terminal_dc": "multi-terminal dc",
    "VSC_dc": "VSC dc",
    "impedance_correction": "impedance correction",
    "induction_machine": "induction machine",
}


def of_text(folder: Path, text: str, **options) -> Imported:
    path = folder / "grid.raw"
    path.write_text(text)
    return import_psse(path, options=ImportOptions(**options))


def static(folder: Path, version: int = 33, **extra: list[str]) -> StaticGrid:
    path = folder / "grid.raw"
    path.write_text(raw_grid(version, extra={SECTIONS.get(k, k): v for k, v in extra.items()}))
    return static_grid(read_raw(path), Report())


def two_winding(codes: str, impedance: str, first: str, second: str, mag: str = "0,0") -> list[str]:
    return [f"2,3,0,'X',{codes},{mag},2,'T',1", impedance, first, second]


CODES = [
    # CW 1, CZ 1: as given, whatever NOMV is
    ("1,1,1", "0.01,0.1,100", "1.1,999.0,0", "1.0,0", 0.01 + 0.1j, 1.1),
    # CW 2: kV of the windings; the bus base is 110 kV
    ("2,1,1", "0.01,0.1,100", "121.0,0,0", "104.5,0", (0.01 + 0.1j) * 0.95**2, 1.1 / 0.95),
    # CW 3: pu of the nominal voltage
    ("3,1,1", "0.01,0.1,100", "1.0,115.5,0", "1.0,110.0", 0.01 + 0.1j, 1.05),
    # CZ 2: own base in MVA and the nominal voltage of winding 1
    ("1,2,1", "0.01,0.1,50", "1.0,0,0", "1.0,0", 2 * (0.01 + 0.1j), 1.0),
    ("1,2,1", "0.01,0.1,50", "1.0,121.0,0", "1.0,0", 2 * 1.21 * (0.01 + 0.1j), 1.0),
    # CZ 3: 500 kW of losses on 50 MVA are 0.01 pu of it
    ("1,3,1", "500000.0,0.1,50", "1.0,0,0", "1.0,0", 2 * (0.01 + 1j * math.sqrt(0.0099)), 1.0),
]


@pytest.mark.parametrize(("codes", "impedance", "first", "second", "z", "tap"), CODES)
def test_impedance_and_ratio_codes(tmp_path, codes, impedance, first, second, z, tap) -> None:
    grid = static(tmp_path, transformer=two_winding(codes, impedance, first, second))
    row = grid.branches[-1]
    assert complex(row.r, row.x) == pytest.approx(z, rel=1e-12)
    assert row.tap == pytest.approx(tap, rel=1e-12)


def test_magnetising_admittance_by_both_codes(tmp_path: Path) -> None:
    plain = static(tmp_path, transformer=two_winding("1,1,1", "0,0.1,50", "1,0,0", "1,0", "0.001,-0.02"))
    assert [s for s in plain.shunts if s.letter == "M"][-1].q == -2.0
    rows = two_winding("1,1,2", "0,0.1,50", "1,121.0,0", "1,0", "50000.0,0.02")
    shunt = [s for s in static(tmp_path, transformer=rows).shunts if s.letter == "M"][-1]
    scale = 0.5 / 1.21 * 100.0  # 50 MVA in the 100 MVA of the grid, at 1.1 of the base voltage
    assert (shunt.p, shunt.q) == pytest.approx((0.001 * scale, -math.sqrt(0.02**2 - 0.001**2) * scale))


STAR = [
    "1,2,3,'S',1,1,1,0,0,2,'THREE',{status}",
    "0.01,0.10,100,0.02,0.20,100,0.03,0.16,100,1,0",
    "1.05,0,30.0,0,0,0,0,0,1.1,0.9,1.1,0.9,33,{table}",
    "1.0,0,0",
    "0.98,0,-30.0",
]


def star(status: int = 1, table: int = 0) -> list[str]:
    return [line.format(status=status, table=table) for line in STAR]


def test_three_windings_are_the_two_port_of_each_pair(tmp_path: Path) -> None:
    """With the third winding open, what is seen between two is their test impedance and the ratios."""
    pairs = {(1, 2): 0.01 + 0.10j, (2, 3): 0.02 + 0.20j, (1, 3): 0.03 + 0.16j}
    turns = {1: 1.05 * np.exp(1j * np.deg2rad(30)), 2: 1.0, 3: 0.98 * np.exp(-1j * np.deg2rad(30))}
    out = {1: 4, 2: 2, 3: 3}  # STAT -> winding that is out
    for (i, j), z in pairs.items():
        third = 6 - i - j
        status = out[third]
        grid = static(tmp_path, transformer=star(status))
        legs = [b for b in grid.branches if b.winding and b.on]
        assert {b.first for b in legs} == {i, j}
        total = sum(complex(b.r, b.x) for b in legs)
        assert total == pytest.approx(z, rel=1e-12)
        for leg in legs:
            t = leg.tap * np.exp(1j * np.deg2rad(leg.shift))
            assert t == pytest.approx(turns[leg.first], rel=1e-12)


def test_a_star_in_the_case_is_the_reduced_network(tmp_path: Path) -> None:
    imported = of_text(tmp_path, raw_grid(33, extra={"transformer": star()}))
    case = imported.case
    assert [b.number for b in case.buses] == [1, 2, 3, 5] and case.buses[-1].name == "star 1-2-3 S"
    legs = np.array([0.5 * (0.01 + 0.10j + 0.03 + 0.16j - 0.02 - 0.20j), 0, 0])
    legs[1] = 0.01 + 0.10j - legs[0]
    legs[2] = 0.03 + 0.16j - legs[0]
    t = np.array([1.05 * np.exp(1j * np.pi / 6), 1.0, 0.98 * np.exp(-1j * np.pi / 6)])
    y = 1.0 / legs
    expected = np.diag(y / abs(t) ** 2) - np.outer(y / np.conj(t), y / t) / y.sum()
    plain = of_text(tmp_path, raw_grid(33)).case
    Y = admittance_matrix(case)
    reduced = Y[:3, :3] - Y[:3, 3:] @ np.linalg.solve(Y[3:, 3:], Y[3:, :3])
    assert reduced - admittance_matrix(plain) == pytest.approx(expected, abs=1e-10)


TABLES = {
    33: ["1, 0.9, 0.8, 1.0, 1.0, 1.1, 1.3, 0, 0", "2,-30,0.5,0,1.0,30,2.0"],
    34: ["1, 0.9, 0.8,0.0, 1.0, 1.0,0.0, 1.1, 1.3,0.1, 0,0,0", "2,-30,0.5,0,0,1.0,0,30,2.0,0"],
}


@pytest.mark.parametrize("version", [33, 34])
def test_correction_tables_are_linear_and_held_at_the_ends(tmp_path: Path, version: int) -> None:
    path = tmp_path / "grid.raw"
    path.write_text(raw_grid(version, extra={"impedance correction": TABLES[version]}))
    one, two = (corrections(read_raw(path))[k] for k in (1, 2))
    top = 1.3 if version == 33 else 1.3 + 0.1j
    assert [one.factor(r, 50.0) for r in (0.5, 0.95, 1.1, 2.0)] == pytest.approx([0.8, 0.9, top, top])
    assert [two.factor(1.0, a) for a in (-40.0, 0.0, 15.0)] == pytest.approx([0.5, 1.0, 1.5])


@pytest.mark.parametrize(("version", "field"), [(33, r"F2 \(field 5\)"), (34, r"Re\(F\)2 \(field 6\)")])
def test_a_word_in_a_correction_table_is_named(tmp_path: Path, version: int, field: str) -> None:
    rows = [TABLES[version][0].replace(" 1.0, 1.0", " 1.0, one"), TABLES[version][1]]
    path = tmp_path / "grid.raw"
    path.write_text(raw_grid(version, extra={"impedance correction": rows}))
    with pytest.raises(CaseError, match=rf"impedance correction record: {field} = 'one'"):
        corrections(read_raw(path))


def test_a_long_table_of_version_34_goes_over_several_lines(tmp_path: Path) -> None:
    points = [(0.80 + 0.05 * k, 1.0 + 0.1 * k) for k in range(8)]
    triples = [f"{t:.2f},{f:.1f},0.0" for t, f in points] + ["0,0,0"] * 4
    rows = ["7," + ",".join(triples[:6]), ",".join(triples[6:])]
    path = tmp_path / "grid.raw"
    path.write_text(raw_grid(35, extra={"impedance correction": [*rows, TABLES[34][1]]}))
    tables = corrections(read_raw(path))
    assert sorted(tables) == [2, 7] and len(tables[7].points) == 8


def test_a_table_multiplies_the_impedance_of_its_winding(tmp_path: Path) -> None:
    rows = two_winding("1,1,1", "0.01,0.1,100", "1.05,0,0,0,0,0,0,0,1.1,0.9,1.1,0.9,33,1", "1,0")
    grid = static(tmp_path, transformer=rows, impedance_correction=TABLES[33])
    assert grid.branches[-1].x == pytest.approx(0.1 * 1.15)
    grid = static(tmp_path, transformer=star(table=1), impedance_correction=TABLES[33])
    legs = [b.x for b in grid.branches if b.winding]
    assert legs == pytest.approx([0.03 * 1.15, 0.07, 0.13])


DC = ["'POLE 1',1,10.0,{setting},200.0,0,0,0,'I',0,20,1", "2,2,90,5,0.1,6.0,110.0,0.9,1.0,1.5,0.5,0.00625"]
DC.append("3,2,90,15,0.1,6.0,110.0,0.9,1.0,1.5,0.5,0.00625")


def test_a_dc_line_takes_and_gives_its_power(tmp_path: Path) -> None:
    """200 kV at the inverter, 10 ohm: I from (200 + 10 I) I = 50 at the rectifier."""
    current = (-200.0 + math.sqrt(200.0**2 + 4.0 * 10.0 * 50.0)) / 20.0
    for setting, into, out in (
        (50.0, 50.0, 200.0 * current),
        (-50.0, 50.0 + 10.0 * 0.25**2, 50.0),
    ):
        rows = [line.format(setting=setting) for line in DC]
        loads = {q.bus: q for q in static(tmp_path, two_terminal_dc=rows).loads if q.letter == "D"}
        assert (loads[2].p, -loads[3].p) == pytest.approx((into, out), rel=1e-12)
        assert loads[2].q > 0.0 and loads[3].q > 0.0


def test_the_reactive_power_of_a_converter_is_that_of_its_overlap_integral(tmp_path: Path) -> None:
    """Fundamental of the trapezoidal phase current, integrated over the commutation by quadrature."""
    rows = [line.format(setting=50.0) for line in DC]
    rows[1] = rows[1].replace("0.1,6.0", "0.0,6.0")
    load = next(q for q in static(tmp_path, two_terminal_dc=rows).loads if q.letter == "D" and q.bus == 2)
    current = (-200.0 + math.sqrt(200.0**2 + 4.0 * 10.0 * 50.0)) / 20.0
    line, x, bridges = 1.02 * 110.0 * 0.9, 6.0, 2
    volts = 200.0 + 10.0 * current
    cos_a = (volts / bridges + 3.0 / math.pi * x * current) / (3.0 * math.sqrt(2.0) / math.pi * line)
    cos_e = cos_a - math.sqrt(2.0) * x * current / line
    a, e = math.acos(cos_a), math.acos(cos_e)
    # phase current: rises as (cos a - cos t) over the overlap, flat for 120 degrees, falls likewise
    t = np.linspace(a, a + 2.0 * math.pi / 3.0 + (e - a), 200_001)
    rise = np.clip((math.cos(a) - np.cos(t)) / (math.cos(a) - math.cos(e)), 0.0, 1.0)
    rise[t > e] = 1.0
    after = t - 2.0 * math.pi / 3.0
    fall = np.where(
        after > a, (math.cos(a) - np.cos(np.minimum(after, e))) / (math.cos(a) - math.cos(e)), 0.0
    )
    wave = current * (rise - fall)
    step = t[1] - t[0]
    phase = t + math.pi / 6.0  # of the phase voltage, from the crossing of the line voltages
    trapezoid = lambda f: step * (f.sum() - 0.5 * (f[0] + f[-1]))  # noqa: E731
    in_phase = trapezoid(wave * np.sin(phase)) * 2.0 / math.pi
    behind = -trapezoid(wave * np.cos(phase)) * 2.0 / math.pi
    assert load.q / load.p == pytest.approx(behind / in_phase, rel=2e-3)


CONVERTER = "{bus},2,20,8,0.0,6.0,110.0,0.9,1.0,1.5,0.5,0.01,{setting},1.0,0.1,1"
STAR_DC = [
    "'MT',3,4,3,1,1,0,0",
    CONVERTER.format(bus=1, setting=200.0),  # holds 200 kV
    CONVERTER.format(bus=2, setting=30.0),
    CONVERTER.format(bus=3, setting=-50.0),
    *(f"{k},{k},1,1,'D{k}',0,0,1" for k in (1, 2, 3)),
    "4,0,1,1,'MIDDLE',0,0,1",
    *(f"{k},4,'1',1,{r},0" for k, r in ((1, 4.0), (2, 6.0), (3, 10.0))),
]


def test_a_multi_terminal_line_balances_at_the_converter_that_holds_its_voltage(tmp_path: Path) -> None:
    grid = static(tmp_path, multi_terminal_dc=STAR_DC)
    p = {q.bus: q.p for q in grid.loads if q.letter == "D"}
    assert (p[2], p[3]) == pytest.approx((30.0, -50.0), rel=1e-12)
    i1 = p[1] / 200.0
    middle = 200.0 - 4.0 * i1
    v2 = 0.5 * (middle + math.sqrt(middle**2 + 4.0 * 6.0 * 30.0))  # v2 (v2 - middle)/6 = 30
    v3 = 0.5 * (middle + math.sqrt(middle**2 - 4.0 * 10.0 * 50.0))
    assert i1 + 30.0 / v2 - 50.0 / v3 == pytest.approx(0.0, abs=1e-12)
    assert all(q.q > 0.0 for q in grid.loads if q.letter == "D")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("'MT',3,4,3,1,1,", "'MT',3,4,3,1,9,", "VCONV .* = 9, allowed: the bus of one of its converters"),
        (
            "3,4,'1',1,10.0",
            "3,7,'1',1,10.0",
            r"JDC \(field 2\) = 7, allowed: a dc bus of the line: 1, 2, 3, 4",
        ),
        ("3,4,'1',1,10.0", "2,4,'2',1,10.0", "the dc network is not connected"),
        ("0.01,-50.0,", "0.01,-5000.0,", "no dc voltages allow the powers"),
        ("3,3,1,1,'D3'", "3,8,1,1,'D3'", "no dc bus belongs to the converter at bus 3"),
    ],
)
def test_a_wrong_multi_terminal_line_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert any(old in row for row in STAR_DC)
    with pytest.raises(CaseError, match=rf"grid\.raw:\d+: multi-terminal .*{message}"):
        static(tmp_path, multi_terminal_dc=[row.replace(old, new) for row in STAR_DC])


def test_a_vsc_line_loses_what_its_converters_and_its_resistance_do(tmp_path: Path) -> None:
    rows = [
        "'V',1,2.0,1,1.0",
        "2,2,1,40.0,1.0,100.0,0.5,0.0,0,0,1,99,-99,0,100",
        "3,1,1,300.0,1.0,200.0,0.0,250.0,0,0,1,99,-99,0,100",
    ]
    loads = {q.bus: q for q in static(tmp_path, VSC_dc=rows).loads if q.letter == "D"}
    drawn, delivered = loads[3].p, -loads[2].p
    current = (drawn - 0.25) / 300.0  # kA; the loss at the voltage end is its least, 250 kW
    loss = 0.1 + 0.0005 * 1000.0 * current
    assert delivered == 40.0 and loads[2].q_free
    assert drawn == pytest.approx(40.0 + loss + 0.25 + 2.0 * current**2, rel=1e-12)


def test_free_reactive_power_is_what_the_stored_voltages_leave_over(tmp_path: Path) -> None:
    """A shunt FACTS device without VSET gives what makes the stored voltages a solution at bus 3 in Q."""
    facts = ["'SVC',3,0,1,0,0,0.0,50,0,0.9,1.1,1.0,0,0.05,100,1,0,0,0,3,''"]
    imported = of_text(tmp_path, raw_grid(33, extra={"FACTS": facts}))
    q = next(row for row in imported.case.loads if row.name.startswith("F")).Q_mvar
    v = 1.02
    line = v * v * (0.02 + 0.004 + 0.12 + 0.06) * 100.0  # charging, line shunt, fixed and switched shunt
    assert q == pytest.approx(line - (20.0 + 2.0 * v + 3.0 * v * v), abs=1e-9)


@pytest.mark.parametrize(("most", "holds"), [(9999.0, True), (5.0, False)])
def test_a_shunt_facts_device_holds_its_voltage_from_a_flat_start(
    tmp_path: Path, most: float, holds: bool
) -> None:
    """With a load of 60 MW more the stored voltages are no solution; their Q would be no device's."""
    facts = [f"'SVC',3,0,1,0,0,0.98,{most},0,0.9,1.1,1.0,0,0.05,100,1,0,0,0,3,''"]
    loads = ["3,'X',1,1,1,60.0,30.0,0,0,0,0,1,1,0"]
    imported = of_text(tmp_path, raw_grid(33, extra={"FACTS": facts, "load": loads}))
    q = next(row for row in imported.case.loads if row.name.startswith("F")).Q_mvar
    v = abs(solve_powerflow(imported.case).voltage(3))
    assert (v == pytest.approx(0.98, abs=1e-9)) is holds
    assert (abs(q) == pytest.approx(most * v)) is not holds  # a current: MVA at unity voltage
    assert any("gives its SHMX" in text for text in imported.report.assumed) is not holds


SVC = "'{name}',3,0,1,0,0,0.98,{most},0,0.9,1.1,1.0,0,0.05,100,1,0,0,0,{regulates},''"
HEAVY = ["3,'X',1,1,1,60.0,30.0,0,0,0,0,1,1,0"]


def test_a_facts_device_holds_the_voltage_beside_one_at_its_limit(tmp_path: Path) -> None:
    pair = [SVC.format(name=n, most=most, regulates=0) for n, most in (("A", 5.0), ("B", 9999.0))]
    imported = of_text(tmp_path, raw_grid(33, extra={"FACTS": pair, "load": HEAVY}))
    assert abs(solve_powerflow(imported.case).voltage(3)) == pytest.approx(0.98, abs=1e-9)
    limited, other = (row.Q_mvar for row in imported.case.loads if row.name.startswith("F"))
    assert sorted((limited, other))[1] == pytest.approx(-5.0 * 0.98, abs=1e-9)
    one = [SVC.format(name="B", most=9999.0, regulates=0)]
    alone = of_text(tmp_path, raw_grid(33, extra={"FACTS": one, "load": HEAVY})).case
    assert limited + other == pytest.approx(next(q.Q_mvar for q in alone.loads if q.name[0] == "F"), abs=1e-7)


def test_what_regulates_another_bus_holds_the_stored_voltage_of_its_own(tmp_path: Path) -> None:
    """Of a FACTS device and of a unit, where the stored voltages are no solution."""
    facts = [SVC.format(name="A", most=9999.0, regulates=2)]
    text = raw_grid(33, extra={"FACTS": facts, "load": HEAVY})
    imported = of_text(tmp_path, text.replace("99,-99,1.02,0,150", "99,-99,1.07,3,150"))
    flow = solve_powerflow(imported.case)
    assert (abs(flow.voltage(1)), abs(flow.voltage(3))) == pytest.approx((1.02, 1.02), abs=1e-9)
    own = "that regulates another bus: holds the stored voltage of its own"
    assert imported.report.assumed[f"unit {own}"] == imported.report.assumed[f"FACTS device {own}"] == 1


def test_a_series_facts_device_brings_its_scheduled_power(tmp_path: Path) -> None:
    facts = ["'UPFC',2,3,1,30.0,5.0,1.0,50,0,0.9,1.1,1.0,0,0.05,100,1"]
    rows = {q.bus: q for q in static(tmp_path, FACTS=facts).loads if q.letter == "F"}
    assert (rows[3].p, rows[3].q, rows[2].p, rows[2].q_free) == (-30.0, -5.0, 30.0, True)
    with pytest.raises(
        CaseError, match=r"grid\.raw:\d+: FACTS record: MODE \(field 4\) = 5, allowed: 0, 1 or 2"
    ):
        static(tmp_path, FACTS=[facts[0].replace(",1,30.0", ",5,30.0")])


MOTOR = "3,'M1',1,1,1,1,1,1,1,1,20.0,110.0,{code},{power},0.5,1,1,1,1,0.01,0.1,3.0,0.02,0.12,999,999,0"


@pytest.mark.parametrize(("code", "power"), [(2, 10.0), (1, 10.0), (2, -2.0)])
def test_a_motor_draws_what_its_circuit_says(tmp_path: Path, code: int, power: float) -> None:
    grid = static(tmp_path, induction_machine=[MOTOR.format(code=code, power=power)])
    load = next(q for q in grid.loads if q.letter == "M")
    s = complex(load.p, load.q) / 20.0
    current = np.conj(s / 1.02)
    behind = 1.02 - (0.01 + 0.1j) * current  # at the magnetising reactance
    rotor = current - behind / 3.0j
    z = behind / rotor
    assert z.imag == pytest.approx(0.12, abs=1e-9)  # what is left is R/s + j X1 of the rotor
    slip = 0.02 / z.real
    shaft = abs(rotor) ** 2 * z.real * (1.0 - slip) * 20.0
    assert (load.p if code == 2 else shaft) == pytest.approx(power, rel=1e-9)


def test_a_motor_beyond_its_pull_out_power_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CaseError, match=r"induction machine record: PSET = 500, allowed: at most \d+"):
        static(tmp_path, induction_machine=[MOTOR.format(code=2, power=500)])


def test_switches_and_lines_without_impedance_join_their_ends(tmp_path: Path) -> None:
    """THRSHZ of the file is 2e-4: 1.5e-4 pu joins, 3e-4 does not; the charging stays."""
    text = raw_grid(35, extra={"bus": ["5,'FIVE',110,1,1,1,1,1.02,0", "6,'SIX',110,1,1,1,1,1.02,0"]})
    zeros = ",".join(["0"] * 12)
    line = f"2,5,'J',0,1.5e-4,0.08,'',{zeros},0,0,0,0,1\n"
    switches = f"3,6,'S',0.0001,{zeros},1,1,1,2,'CB'\n1,6,'T',0.0001,{zeros},0,1,1,2,'OPEN'\n"
    joined = text.replace("0 / END OF BRANCH", f"{line}0 / END OF BRANCH")
    joined = joined.replace("0 / END OF SWITCHING", f"{switches}0 / END OF SWITCHING")
    case = of_text(tmp_path, joined).case
    assert [bus.number for bus in case.buses] == [1, 2, 3]
    assert [(s.bus, s.Q_mvar) for s in case.shunts if s.name.startswith("B")] == [(2, 8.0)]
    apart = joined.replace("1.5e-4", "3e-4")
    assert [bus.number for bus in of_text(tmp_path, apart).case.buses] == [1, 2, 3, 5]


#: two buses with a slack of their own, and a third without
ISLAND = {
    "bus": [
        "11,'A',110,3,1,1,1,1.0,0",
        "12,'B',110,1,1,1,1,1.0,0",
        "20,'DEAD',110,1,1,1,1,1.0,0",
    ],
    "branch": ["11,12,'1',0.01,0.1,0,0,0,0,0,0,0,0,1"],
    "generator": ["11,'1',5.0,0,9,-9,1.0,0,50.0,0,0.3,0,0,1,1,100,99,0"],
    "load": ["12,'1',1,1,1,5.0,1.0"],
}


def test_islands_one_is_kept_by_choice(tmp_path: Path) -> None:
    text = raw_grid(33, extra=ISLAND)
    island = of_text(tmp_path, text)
    assert [bus.number for bus in island.case.buses] == [1, 2, 3]
    assert any(
        "island of 2 buses with a slack bus of its own (bus 11)" in what for what in island.report.dropped
    )
    assert [bus.number for bus in of_text(tmp_path, text, island=12).case.buses] == [11, 12]
    with pytest.raises(CaseError, match="island = 77, allowed: the number of a bus in service"):
        of_text(tmp_path, text, island=77)
    with pytest.raises(CaseError, match="island = 'both', allowed: the number of a bus, or all"):
        of_text(tmp_path, text, island="both")


def test_islands_each_with_a_slack_of_its_own_are_kept_together(tmp_path: Path) -> None:
    """Voltages as those of each island alone: nothing connects them."""
    text = raw_grid(33, extra=ISLAND)
    every = of_text(tmp_path, text, island="all")
    assert len(every.case.slacks) == 2 and "slack buses" in every.report.text()
    assert any("without a slack bus" in what for what in every.report.dropped)
    together = solve_powerflow(every.case)
    for bus in (1, 12):
        alone = solve_powerflow(of_text(tmp_path, text, island=bus).case)
        for row in alone.case.buses:
            assert abs(together.voltage(row.number) - alone.voltage(row.number)) < 1e-11
        for name, power in zip((m.name for m in alone.case.machines), alone.generation, strict=True):
            at = [m.name for m in every.case.machines].index(name)
            assert abs(together.generation[at] - power) < 1e-11


def test_a_step_up_transformer_inside_a_unit_gets_a_bus(tmp_path: Path) -> None:
    text = raw_grid(33).replace("150.0,0,0.2,0,0,1.0,1", "150.0,0,0.2,0.003,0.09,1.02,1")
    case, plain = of_text(tmp_path, text).case, of_text(tmp_path, raw_grid(33)).case
    flow, before = solve_powerflow(case), solve_powerflow(plain)
    assert [flow.voltage(k) for k in (1, 2, 3)] == pytest.approx(
        [before.voltage(k) for k in (1, 2, 3)], abs=1e-9
    )
    z = (0.003 + 0.09j) / 1.5
    inner = flow.voltage(case.machines[0].bus)
    into_grid = np.conj((inner - before.voltage(1) / 1.02) / z) * before.voltage(1) / 1.02
    assert into_grid == pytest.approx(complex(before.generation[0]), abs=1e-9)


def test_what_is_out_of_service_is_counted(tmp_path: Path) -> None:
    text = raw_grid(33).replace("3,'1 ',1,1.5,12.0", "3,'1 ',1,1.5,12.0\n3,'2',0,0,50.0\n4,'9',1,0,5.0")
    report = of_text(tmp_path, text).report
    assert report.dropped["shunt out of service"] == 1 and report.dropped["isolated bus (type 4)"] == 1
    assert report.assumed["shunt in service at an isolated bus: treated as out of service"] == 1
    text = report.text()
    assert "read: 4 buses, 1 loads, 1 units, 3 fixed shunts" in text and "(" in text.splitlines()[1]


def test_records_of_sections_that_play_no_part_are_counted(tmp_path: Path) -> None:
    extra = {
        "owner": ["1,'ONE'", "2,'TWO'"],
        "multi-section line": ["2,3,'&1',1,4"],
        "area": ["1,1,0,10,'A'"],
    }
    plain, report = of_text(tmp_path, raw_grid(33)), of_text(tmp_path, raw_grid(33, extra=extra)).report
    counts = {
        what.split(" record")[0]: n for what, n in report.dropped.items() if what.endswith(" record: ignored")
    }
    assert counts == {"area": 1, "multi-section line": 1, "owner": 2}
    assert report.first["owner record: ignored"].endswith("grid.raw:33")
    assert not any(" record: ignored" in what for what in plain.report.dropped)


def test_a_flow_without_solution_names_the_worst_bus_and_the_voltages(tmp_path: Path) -> None:
    text = raw_grid(33).replace("80.0,20.0,5.0", "8000.0,20.0,5.0")
    with pytest.raises(
        PowerFlowError, match=r"largest mismatch .* MVA at bus [123] \(.*grid\.raw:\d+\).* pu at bus"
    ):
        of_text(tmp_path, text)


REFUSED = {
    "multi-terminal dc": (["'M',0,0,0,1,1,0,0"], r"multi-terminal dc record: dc buses without numbers"),
    "GNE": (["'G','MODEL',1,3,0,0,0,1,1,1"], r"GNE record: has no model here"),
    "FACTS": (["'F',77,0,1"], r"bus 77 does not exist"),
    "two-terminal dc": (["'D',1,10,50,0", "2,2", "3,2"], r"VSCHD \(field 5\) = 0, allowed: above 0 kV"),
    "branch": (["2,2,'1',0,0.1,0"], r"branch record: both ends at bus 2"),
    "induction machine": (["3,'1',1,1,1,1,1,1,1,1,20,110,2,10"], r"R1 \(field \d+\) = 900, allowed: above 0"),
}


@pytest.mark.parametrize("section", REFUSED)
def test_what_has_no_counterpart_is_refused_with_record_line_and_reason(tmp_path: Path, section: str) -> None:
    rows, message = REFUSED[section]
    with pytest.raises(CaseError, match=rf"grid\.raw:\d+: .*{message}|grid\.raw:\d+: {message}"):
        of_text(tmp_path, raw_grid(33, extra={section: rows}))
