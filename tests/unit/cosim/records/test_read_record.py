"""Records as the files of different makers have them; each format is written here and read back."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import interarea as ia
from interarea.cosim.records.files.read import read_record
from interarea.cosim.records.record import RecordError
from interarea.cosim.trajectory import Trajectory

RATE = 30.0
TIME = np.arange(300) / RATE
ANGLE = 170.0 + 40.0 * TIME + np.sin(2 * np.pi * 0.5 * TIME)  # degrees, wraps
COLUMNS = {
    "F": ("HZ", 60.0 + 0.1 * np.sin(TIME)),
    "VM": ("KV", 200.0 + np.sin(TIME)),
    "VA": ("DEG", (ANGLE + 180.0) % 360.0 - 180.0),
    "IM": ("AMP", 300.0 + 10 * np.sin(TIME)),
    "IA": ("DEG", (ANGLE - 20.0 + 180.0) % 360.0 - 180.0),
}


def ieee_csv(path: Path, *, time: np.ndarray = TIME, columns: dict = COLUMNS, places=("Sub:1:Ln:1",)) -> Path:
    """Write a csv of the IEEE form, with stamps rounded to 1 ms as real ones are."""
    kinds = list(columns)
    rows = [
        ["Time", *(p for p in places for _ in kinds)],
        ["T", *(k for _ in places for k in kinds)],
        ["sec", *(columns[k][0] for _ in places for k in kinds)],
        ["", *(p.rpartition(":")[2] for p in places for _ in kinds)],
    ]
    for k, t in enumerate(time):
        cells = ["" if np.isnan(v := columns[c][1][k]) else f"{v:.6f}" for _ in places for c in kinds]
        rows.append([f"{t:.3f}", *cells])
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")
    return path


def test_the_ieee_form_keeps_rate_terminals_units_and_unwraps_angles(tmp_path: Path) -> None:
    record = read_record(ieee_csv(tmp_path / "pmu.csv", places=("Sub:1:Ln:1", "Sub:2:Ln:7")))
    assert 1.0 / record.step_s == pytest.approx(RATE, rel=1e-5)  # stamps of 0.033, 0.067 are rounded ones
    assert list(record.terminals) == ["Sub:1:Ln:1", "Sub:2:Ln:7"]
    assert set(record.table()["unit"]) == {"Hz", "kV", "rad", "A"}
    np.testing.assert_allclose(record.of("Sub:2:Ln:7", "voltage angle"), np.deg2rad(ANGLE), atol=1e-7)
    with pytest.raises(ValueError, match="read-only"):
        record.values[0, 0] = 1.0


def test_missing_frames_and_samples_are_interpolated_and_said(tmp_path: Path) -> None:
    columns = {k: (u, v.copy()) for k, (u, v) in COLUMNS.items()}
    columns["VA"][1][50:54] = np.nan
    keep = np.delete(np.arange(300), [100, 101, 200])
    columns = {k: (u, v[keep]) for k, (u, v) in columns.items()}
    record = read_record(ieee_csv(tmp_path / "pmu.csv", time=TIME[keep], columns=columns))
    assert len(record.time_s) == 300
    np.testing.assert_allclose(record["Sub:1:Ln:1 VA"], np.deg2rad(ANGLE), atol=2e-3)  # 4 samples of 0.5 Hz
    assert "3 frames are missing: interpolated" in record.notes
    assert any("interpolated: Sub:1:Ln:1 VA (4)" in n for n in record.notes)


def test_a_long_gap_cuts_the_record_and_a_channel_with_one_is_left_out(tmp_path: Path) -> None:
    keep = np.delete(np.arange(300), np.arange(40, 80))
    cut = {k: (u, v[keep]) for k, (u, v) in COLUMNS.items()}
    record = read_record(ieee_csv(tmp_path / "cut.csv", time=TIME[keep], columns=cut))
    assert record.length_s == pytest.approx(219 / RATE)
    assert any("2.67 to 9.967 s is taken" in n or "only 2.66" in n for n in record.notes)
    holed = {k: (u, v.copy()) for k, (u, v) in COLUMNS.items()}
    holed["IM"][1][100:140] = np.nan
    record = read_record(ieee_csv(tmp_path / "holed.csv", columns=holed))
    assert "Sub:1:Ln:1 IM" not in [c.name for c in record.channels]
    assert any("IM: a gap of 1.37 s: left out" in n for n in record.notes)


def test_what_a_stat_word_calls_wrong_is_left_out(tmp_path: Path) -> None:
    status = np.zeros(300)
    status[60:65] = 0x8000
    spoiled = COLUMNS["VM"][1].copy()
    spoiled[60:65] = 0.0
    columns = {**COLUMNS, "VM": ("KV", spoiled), "STAT": ("", status)}
    record = read_record(ieee_csv(tmp_path / "pmu.csv", columns=columns))
    np.testing.assert_allclose(record["Sub:1:Ln:1 VM"], COLUMNS["VM"][1], atol=5e-3)
    assert any("5 samples are flagged as wrong" in n for n in record.notes)


def comtrade(folder: Path, kind: str, revision: str = "2013") -> Path:
    """Write a COMTRADE pair of two analog and 17 status channels, by the words of the standard."""
    a, b = (0.01, 200.0) if kind in ("ASCII", "BINARY") else (1e-6 if kind == "BINARY32" else 1.0, 0.0)
    volts, degrees = COLUMNS["VM"][1], COLUMNS["VA"][1]
    lines = [f"North,PMU 7,{revision}", "19,2A,17D"]
    lines += [f"1,VM,,L1,kV,{a},{b},0,-99999,99998,1,1,P", f"2,VA,,L1,deg,{a},{b},0,-99999,99998,1,1,P"]
    lines += [f"{k},D{k},,,0" for k in range(1, 18)]
    lines += [
        "60",
        "1",
        f"{RATE:g},300",
        "28/04/2025,12:32:57.000000",
        "28/04/2025,12:32:58.000000",
        kind,
        "1",
    ]
    (folder / "r.cfg").write_text("\r\n".join(lines) + "\r\n")
    packed = b""
    for k, (v, d) in enumerate(zip(volts, degrees, strict=True)):
        stamp, flags = round(k * 1e6 / RATE), [int(j == 16 and k > 100) for j in range(17)]
        raw = [(v - b) / a, (d - b) / a]
        if kind != "FLOAT32":
            raw = [round(x) for x in raw]
        if kind == "ASCII":
            packed += (",".join(map(str, [k + 1, stamp, *raw, *flags])) + "\r\n").encode()
            continue
        letter = {"BINARY": "h", "BINARY32": "i", "FLOAT32": "f"}[kind]
        words = [sum(bit << j for j, bit in enumerate(flags[:16])), flags[16]]
        packed += struct.pack(f"<II{letter}{letter}HH", k + 1, stamp, *raw, *words)
    (folder / "r.dat").write_bytes(packed)
    return folder / "r.cfg"


@pytest.mark.parametrize("kind", ["ASCII", "BINARY32", "FLOAT32"])
def test_comtrade_of_each_kind_reads_the_same(kind: str, tmp_path: Path) -> None:
    record = read_record(comtrade(tmp_path, kind))
    if kind != "ASCII":
        np.testing.assert_allclose(record["VA"], np.deg2rad(ANGLE), atol=1e-6)
    np.testing.assert_allclose(record["VM"], COLUMNS["VM"][1], atol=0.0051 if kind == "ASCII" else 2e-5)
    assert record.start == "28/04/2025 12:32:57.000000"
    assert list(record.terminals) == ["L1"]


def test_sixteen_bits_of_a_binary_file_with_a_missing_sample(tmp_path: Path) -> None:
    path = comtrade(tmp_path, "ASCII")
    lines = path.read_text().replace("ASCII", "BINARY").replace(",0.01,200.0,", ",0.005,210.0,")
    path.write_text(lines)
    numbers = np.round((COLUMNS["VM"][1] - 210.0) / 0.005).astype("<i2")
    numbers[77] = -32768
    rows = (struct.pack("<IIhhHH", k + 1, 0, n, int(k % 7), 0, 0) for k, n in enumerate(numbers))
    (tmp_path / "r.dat").write_bytes(b"".join(rows))
    record = read_record(path)
    np.testing.assert_allclose(record["VM"], COLUMNS["VM"][1], atol=0.0026)
    assert any("VM (1)" in n for n in record.notes)


@pytest.mark.parametrize("kind", ["ASCII", "FLOAT32"])
def test_samples_that_a_comtrade_file_has_not_are_missing(kind: str, tmp_path: Path) -> None:
    path = comtrade(tmp_path, kind)
    whole, data = read_record(path), (tmp_path / "r.dat").read_bytes()
    size = len(data) // 300
    rows = (
        data.splitlines(keepends=True) if kind == "ASCII" else [data[k * size :][:size] for k in range(300)]
    )
    (tmp_path / "r.dat").write_bytes(b"".join(rows[:100] + rows[110:]))
    record = read_record(path)
    np.testing.assert_allclose(record.values[110:], whole.values[110:], atol=1e-9)
    assert record.length_s == pytest.approx(whole.length_s)
    assert "10 frames are missing: interpolated" in record.notes


def test_secondary_values_of_comtrade_are_taken_to_the_primary_side(tmp_path: Path) -> None:
    path = comtrade(tmp_path, "FLOAT32")
    primary = read_record(path)["VM"]
    path.write_text(path.read_text().replace("99998,1,1,P", "99998,4.0,0.5,S", 1))
    record = read_record(path)
    np.testing.assert_allclose(record["VM"], 8.0 * primary, rtol=1e-12)
    assert "secondary values, taken times the ratio of their transformer: VM" in record.notes
    path.write_text(path.read_text().replace("99998,4.0,0.5,S", "99998,4.0,0,S", 1))
    with pytest.raises(
        RecordError, match=r"line 3 is '4.0,0', wanted: a primary and a secondary ratio above 0"
    ):
        read_record(path)


@pytest.mark.parametrize("kind", ["ASCII", "BINARY32", "FLOAT32"])
def test_the_comtrade_package_reads_the_same_numbers(kind: str, tmp_path: Path) -> None:
    other = pytest.importorskip("comtrade")
    path = comtrade(tmp_path, kind)
    theirs = other.load(str(path), str(tmp_path / "r.dat"))
    record = read_record(path)
    np.testing.assert_allclose(record["VM"], theirs.analog[0], rtol=1e-6)
    assert record.start[:10] == theirs.start_timestamp.strftime("%d/%m/%Y")


def test_a_comtrade_file_of_both_parts(tmp_path: Path) -> None:
    cfg = comtrade(tmp_path, "FLOAT32")
    both = b"--- file type: CFG ---\r\n" + cfg.read_bytes()
    data = (tmp_path / "r.dat").read_bytes()
    (tmp_path / "r.cff").write_bytes(both + b"--- file type: DAT BINARY: %d ---\r\n" % len(data) + data)
    np.testing.assert_array_equal(read_record(tmp_path / "r.cff").values, read_record(cfg).values)


def test_channels_of_psse(tmp_path: Path) -> None:
    names = [
        "Time(s)",
        "POWR   101[NUC-A       21.600]1",
        "VOLT   151[NUCPANT    500.00]",
        "FREQ   151[NUCPANT    500.00]",
        "POWR 151 TO 152 CKT '1 '",
        "ANGL   101[NUC-A       21.600]1",
        "SPD    101[NUC-A       21.600]1",
    ]
    frame = pd.DataFrame({"t": TIME, "p": 7.5 + np.sin(TIME), "v": 1.01 + 0.01 * np.sin(TIME)})
    frame = frame.assign(
        f=1e-3 * np.sin(TIME), flow=400 + np.sin(TIME), d=30 + np.sin(TIME), w=1e-3 * np.sin(TIME)
    )
    path = tmp_path / "channels.csv"
    rows = frame.to_csv(index=False, header=False, float_format="%.8f")
    path.write_text(
        "PSS(R)E SAMPLE CASE\nALL DATA ARE FICTITIOUS\n" + ",".join(f'"{n}"' for n in names) + "\n" + rows
    )
    record = read_record(path, frequency_hz=50.0)
    assert [(c.quantity, c.unit, c.terminal) for c in record.channels] == [
        ("active power", "pu", "101 1"),
        ("voltage", "pu", "bus151"),
        ("frequency", "Hz", "bus151"),
        ("active power", "MW", "151-152 1"),
        ("rotor angle", "rad", "101 1"),
        ("speed", "pu", "101 1"),
    ]
    np.testing.assert_allclose(record.of("bus151", "frequency"), 50.0 + 0.05 * np.sin(TIME), atol=1e-6)


@pytest.mark.slow
def test_a_run_is_read_back(tmp_path: Path) -> None:
    run = ia.simulate("ring-down")
    run.save(tmp_path)
    for name in ("trajectory.parquet", "trajectory.csv"):
        record = ia.read_record(tmp_path / name)
        assert {c.unit for c in record.channels if c.quantity == "rotor angle"} == {"rad"}
        assert record.terminals["G2"] == {
            "speed": "plant.G2_dw",
            "rotor angle": "plant.G2_delta",
            "active power": "plant.G2_pe",
            "voltage": "plant.G2_vt",
        }
        np.testing.assert_allclose(record["plant.tie_p"], run["plant.tie_p"], rtol=0, atol=1e-12)


def test_a_frame_keeps_what_it_is(tmp_path: Path) -> None:
    record = read_record(ieee_csv(tmp_path / "pmu.csv"))
    again = read_record(record.to_frame())
    np.testing.assert_allclose(again.values, record.values)
    assert again.channels == record.channels
    dated = record.to_frame().set_index(
        pd.Timestamp("2025-04-28 12:32") + pd.to_timedelta(record.time_s, unit="s")
    )
    assert read_record(dated).start.startswith("2025-04-28 12:32")


def test_resampling_takes_out_what_would_alias(tmp_path: Path) -> None:
    low, high = np.sin(2 * np.pi * 0.7 * TIME), np.sin(2 * np.pi * 12.3 * TIME)
    record = read_record(ieee_csv(tmp_path / "a.csv", columns={"F": ("HZ", 60 + low + high)}), rate_hz=10.0)
    assert 1.0 / record.step_s == pytest.approx(10.0, rel=1e-4)
    inner = slice(10, -10)
    expected = 60 + np.sin(2 * np.pi * 0.7 * record.time_s)
    np.testing.assert_allclose(record.values[inner, 0], expected[inner], atol=0.03)  # of an alias of size 1
    assert any("resampled from 30" in n for n in record.notes)


SWING = 60.0 + 0.02 * np.sin(2 * np.pi * 0.5 * TIME)


def table_csv(path: Path, head: str, *columns: np.ndarray, separator: str = ";", decimal: str = ",") -> Path:
    """Write a csv as a spreadsheet does; `head` names the columns with commas between."""
    rows = [separator.join(head.split(",")) + "\n"]
    for row in zip(*columns, strict=True):
        rows.append(separator.join(f"{v:.6f}".replace(".", decimal) for v in row) + "\n")
    path.write_text("".join(rows), encoding="utf-8-sig")
    return path


@pytest.mark.parametrize(("separator", "title"), [(";", ""), ("\t", ""), (";", "Recorder 7, bay 3\n")])
def test_numbers_with_a_decimal_comma_are_read(separator: str, title: str, tmp_path: Path) -> None:
    path = table_csv(tmp_path / "r.csv", "Zeit,F [Hz],P [MW]", TIME, SWING, 10 * SWING, separator=separator)
    path.write_text(title + path.read_text(encoding="utf-8-sig"))
    record = read_record(path)
    assert 1.0 / record.step_s == pytest.approx(RATE, rel=1e-5)
    np.testing.assert_allclose(record.values, np.column_stack([SWING, 10 * SWING]), atol=1e-6)


@pytest.mark.parametrize(("head", "factor"), [("Time [ms]", 1e3), ("Time_ms", 1e3), ("Time (min)", 1 / 60)])
def test_the_unit_of_a_column_of_times_counts(head: str, factor: float, tmp_path: Path) -> None:
    record = read_record(table_csv(tmp_path / "r.csv", f"{head},F [Hz]", factor * TIME, SWING))
    assert 1.0 / record.step_s == pytest.approx(RATE, rel=1e-3)
    frame = pd.DataFrame({head: factor * TIME, "F [Hz]": SWING})
    assert 1.0 / read_record(frame).step_s == pytest.approx(RATE, rel=1e-9)


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, 31.0, float("nan"), float("inf")])
def test_a_rate_that_the_record_has_not_is_refused(rate_hz: float, tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"rate_hz = .*, allowed: above 0 up to the record's own 30"):
        read_record(ieee_csv(tmp_path / "r.csv"), rate_hz=rate_hz)


def test_a_frequency_that_no_grid_has_is_a_lost_sample(tmp_path: Path) -> None:
    dropped = SWING.copy()
    dropped[100:104] = 0.0
    record = read_record(table_csv(tmp_path / "r.csv", "Time,F [Hz]", TIME, dropped))
    np.testing.assert_allclose(record.values[:, 0], SWING, atol=1e-3)
    assert "F: 4 samples are outside 40 to 70 Hz: left out" in record.notes


def test_a_magnitude_below_0_is_a_lost_sample(tmp_path: Path) -> None:
    dropped = SWING.copy()
    dropped[100:104] = -99.0
    record = read_record(table_csv(tmp_path / "r.csv", "Time,Bus 7 VM [kV]", TIME, dropped))
    np.testing.assert_allclose(record.values[:, 0], SWING, atol=1e-3)
    assert "Bus 7 VM: 4 samples are outside 0 to 2000 kV: left out" in record.notes


@pytest.mark.parametrize(
    ("head", "says"),
    [
        ("P [MW]", "P: 4 samples are outside -1e+06 to 1e+06 MW: left out"),
        ("VM [kV]", "VM: 4 samples are outside 0 to 2000 kV: left out"),
    ],
)
def test_a_value_that_no_grid_has_is_a_lost_sample(head: str, says: str, tmp_path: Path) -> None:
    dropped = SWING.copy()
    dropped[100:104] = 3.1e8
    record = read_record(table_csv(tmp_path / "r.csv", f"Time,{head}", TIME, dropped))
    np.testing.assert_allclose(record.values[:, 0], SWING, atol=1e-3)
    assert says in record.notes


@pytest.mark.parametrize(("code", "unit"), [(-9999, "MW"), (9999.99, "Mvar"), (-999, "deg"), (1e20, "kW")])
def test_a_code_for_a_missing_value_is_no_value(code: float, unit: str, tmp_path: Path) -> None:
    values = 100.0 * (SWING - 60.0)
    coded = values.copy()
    coded[100:104] = code
    record = read_record(table_csv(tmp_path / "r.csv", f"Time,X [{unit}]", TIME, coded))
    whole = read_record(table_csv(tmp_path / "whole.csv", f"Time,X [{unit}]", TIME, values))
    np.testing.assert_allclose(record.values, whole.values, atol=0.06 * np.ptp(whole.values))
    assert f"X: 4 samples are {code:.6g}: taken as missing" in record.notes
    power = 999.0 + np.round(200.0 * (SWING - 60.0))
    assert (power == 999.0).any()
    assert read_record(table_csv(tmp_path / "p.csv", "Time,P [MW]", TIME, power)).notes == ()


def test_round_brackets_hold_units_where_one_of_them_does(tmp_path: Path) -> None:
    head = "Time,Bus 7 VM (kV),P (horses),Q (L1)"
    record = read_record(table_csv(tmp_path / "r.csv", head, TIME, SWING, SWING, SWING))
    assert [c.name for c in record.channels] == ["Bus 7 VM", "Q (L1)"]
    assert record.notes[0].startswith("P: active power in horses, allowed: MW, pu: left out")
    frame = pd.DataFrame({"Time": TIME, "Bus 7 VM (kV)": SWING, "P (horses)": SWING})
    assert [c.name for c in read_record(frame).channels] == ["Bus 7 VM"]


def test_every_column_of_a_name_that_occurs_twice_is_read() -> None:
    frame = pd.DataFrame(np.column_stack([TIME, SWING, 2.0 * SWING]), columns=["Time", "P [MW]", "P [MW]"])
    record = read_record(frame)
    assert [c.name for c in record.channels] == ["P", "P (2)"]
    np.testing.assert_array_equal(record["P (2)"], 2.0 * SWING)


@pytest.mark.parametrize("end", [b"\n", b"\r", b"\r\r\n", b"\n\r", b"\r\r\r\n"])
@pytest.mark.parametrize("form", ["comtrade", "csv"])
def test_the_ends_of_lines_change_nothing(form: str, end: bytes, tmp_path: Path) -> None:
    path = comtrade(tmp_path, "ASCII") if form == "comtrade" else ieee_csv(tmp_path / "r.csv")
    before = read_record(path)
    for file in tmp_path.iterdir():
        file.write_bytes(end.join(file.read_bytes().splitlines()) + end)
    after = read_record(path)
    np.testing.assert_array_equal(after.values, before.values)
    assert (after.channels, after.notes, after.start) == (before.channels, before.notes, before.start)


def test_a_sample_between_two_moments_takes_the_place_of_none(tmp_path: Path) -> None:
    """As where a run has an event between two of its steps: it would move the jump by one step."""
    values = np.where(TIME > 5.005, 1.0, 0.0) + 0.1 * SWING / np.abs(SWING).max()
    even = read_record(table_csv(tmp_path / "a.csv", "Time [s],P [MW]", TIME, values))
    k = int(np.flatnonzero(TIME > 5.005)[0])
    for late in (0.2, 0.4):
        time = np.insert(TIME, k, TIME[k - 1] + late / RATE)
        path = table_csv(tmp_path / "b.csv", "Time [s],P [MW]", time, np.insert(values, k, values[k]))
        record = read_record(path)
        assert "1 samples lie between those of the even spacing: left out" in record.notes
        assert not any("twice" in note or "moved" in note for note in record.notes)
        np.testing.assert_array_equal(record.values, even.values)


@pytest.mark.parametrize("as_index", [True, False])
def test_durations_are_times(as_index: bool) -> None:
    frame = pd.DataFrame({"Time": pd.to_timedelta(TIME, unit="s"), "P [MW]": SWING})
    record = read_record(frame.set_index("Time").rename_axis(None) if as_index else frame)
    assert record.step_s == pytest.approx(1.0 / RATE, rel=1e-6)


def test_comtrade_data_with_a_word_or_a_second_start_are_refused(tmp_path: Path) -> None:
    path = comtrade(tmp_path, "ASCII")
    rows = (tmp_path / "r.dat").read_text().splitlines()
    (tmp_path / "r.dat").write_text("\n".join([*rows[:7], rows[7].replace(",", ",x", 1), *rows[8:]]))
    with pytest.raises(RecordError, match=r"data line 8 has 'x\d+', wanted: a number"):
        read_record(path)
    (tmp_path / "r.dat").write_text("\n".join([*rows[:200], *rows[150:]]))
    with pytest.raises(RecordError, match=r"decreases from 6.63333 to 5 s at sample 201, .* split the file"):
        read_record(path)


@pytest.mark.parametrize("kind", ["ASCII", "FLOAT32"])
def test_a_comtrade_file_that_ends_early_is_said(kind: str, tmp_path: Path) -> None:
    path = comtrade(tmp_path, kind)
    assert not any("last sample" in note for note in read_record(path).notes)
    data = (tmp_path / "r.dat").read_bytes()
    rows = data.splitlines(keepends=True) if kind == "ASCII" else [data[: len(data) // 300 * 200]]
    (tmp_path / "r.dat").write_bytes(b"".join(rows[:200]))
    record = read_record(path)
    assert len(record.time_s) == 200
    assert "its last sample is number 200, by its configuration 300" in record.notes


def test_a_comtrade_file_whose_rates_contradict_its_stamps_says_so(tmp_path: Path) -> None:
    path = comtrade(tmp_path, "FLOAT32")
    assert read_record(path).notes[0].endswith("time by its sampling rates")
    path.write_text(path.read_text().replace("30,300", "60,300"))
    said = "time by its sampling rates, 4.98333 s; its time stamps have 9.96667 s"
    assert read_record(path).notes[0].endswith(said)


def test_of_a_date_with_points_the_day_comes_first(tmp_path: Path) -> None:
    stamps = pd.Timestamp("2025-04-12 23:59:58") + pd.to_timedelta(TIME, unit="s")
    rows = [f"{stamp:%d.%m.%Y %H:%M:%S.%f},{v:.6f}" for stamp, v in zip(stamps, SWING, strict=True)]
    (tmp_path / "r.csv").write_text("\n".join(["Time,F [Hz]", *rows]))
    record = read_record(tmp_path / "r.csv")
    assert record.start.startswith("2025-04-12 23:59:58")
    assert record.length_s == pytest.approx(TIME[-1], abs=1e-3)


@pytest.mark.parametrize(
    ("head", "separator"),
    [
        ("Date,Time,F [Hz]", ","),
        ("Datum;Uhrzeit;F [Hz]", ";"),
        ("UTC;F [Hz]", ";"),
        ("Zeitstempel;F [Hz]", ";"),
    ],
)
def test_a_day_may_stand_beside_its_time(head: str, separator: str, tmp_path: Path) -> None:
    """Over midnight, with decimal commas between semicolons; as a frame too."""
    stamps = pd.Timestamp("2025-04-28 23:59:58") + pd.to_timedelta(TIME, unit="s")
    between = separator if head.count(separator) == 2 else " "
    rows = [
        f"{s:%Y-%m-%d}{between}{s:%H:%M:%S.%f}{separator}{v:.6f}" for s, v in zip(stamps, SWING, strict=True)
    ]
    text = "\n".join([head, *rows])
    (tmp_path / "r.csv").write_text(text.replace(".", ",") if separator == ";" else text)
    record = read_record(tmp_path / "r.csv")
    assert record.start.startswith("2025-04-28 23:59:58")
    assert record.length_s == pytest.approx(TIME[-1], abs=1e-5)
    assert [c.quantity for c in record.channels] == ["frequency"]
    np.testing.assert_allclose(record.values[:, 0], SWING, atol=2e-6)
    if between == separator:
        frame = pd.read_csv(tmp_path / "r.csv", sep=separator, decimal="," if separator == ";" else ".")
        frame = frame.rename(columns={"Datum": "Date", "Uhrzeit": "Time"})
        assert read_record(frame).length_s == pytest.approx(TIME[-1], abs=1e-5)


@pytest.mark.parametrize("count", [1e6, 2.0**24, 1.0])
def test_a_second_of_the_century_may_stand_beside_its_fraction(count: float, tmp_path: Path) -> None:
    """FRACSEC of C37.118 counts parts of a second: 1e6, or all of its 24 bits."""
    whole, part = np.divmod(TIME + 0.4, 1.0)
    parts = np.round(count * part) if count > 1.0 else np.round(part, 6)
    rows = [f"{1745836390 + a:.0f},{b:.6f},{v:.6f}" for a, b, v in zip(whole, parts, SWING, strict=True)]
    (tmp_path / "r.csv").write_text("\n".join(["SOC,FRACSEC,F [Hz]", *rows]))
    record = read_record(tmp_path / "r.csv")
    assert len(record.time_s) == len(TIME)
    assert record.length_s == pytest.approx(TIME[-1], abs=1e-5)
    np.testing.assert_allclose(record.values[:, 0], SWING, atol=2e-6)


def test_a_title_with_a_date_names_no_columns(tmp_path: Path) -> None:
    path = table_csv(tmp_path / "r.csv", "Time,F [Hz]", TIME, SWING, separator=",", decimal=".")
    path.write_text("Date: 28.04.2025, Recorder 7\n" + path.read_text(encoding="utf-8-sig"))
    np.testing.assert_allclose(read_record(path).values[:, 0], SWING, atol=1e-6)


def test_a_word_of_a_name_can_be_the_unit(tmp_path: Path) -> None:
    degrees = np.rad2deg(0.2 * np.sin(TIME))
    columns = (TIME, degrees, 1e3 * (SWING - 60.0), degrees)
    record = read_record(table_csv(tmp_path / "r.csv", "Time,VA_deg_bus1,f_mHz,G1 VA", *columns))
    np.testing.assert_allclose(record.values[:, 0], 0.2 * np.sin(TIME), atol=1e-6)
    np.testing.assert_allclose(record.values[:, 1], SWING - 60.0, atol=1e-6)
    assert "angles without a unit in the file are taken as rad: G1 VA" in record.notes


def _text(content: str):
    return lambda path: path.with_suffix(".csv").write_text(content)


def _with_time(change) -> object:
    time = TIME.copy()
    change(time)
    return lambda path: ieee_csv(path, time=time)


WRONG = {
    "prose": (_text("Dear Sir,\nplease find enclosed\n"), "no row begins with Time"),
    "toml": (_text('title = "x"\n[[event]]\nkind = "bus_fault"\n'), "no row begins with Time"),
    "empty": (_text(""), "is empty, wanted: a PMU csv"),
    "header alone": (_text("Time,F\n"), "no samples follow the header, wanted"),
    "time of day": (
        _text("Time,F\n01:59:50.0,60\n"),
        r"header: row 2 is '01:59:50.0,60', wanted: rows of a time \(s, or date and time\)",
    ),
    "commas for all": (
        _text("Time,F\n" + "".join(f"0,{k:02d},60,01\n" for k in range(20))),
        "row 2 has 4 cells and the header 2, .* decimal comma need ; between",
    ),
    "binary": (lambda path: path.write_bytes(bytes(range(256)) * 9), "is binary, wanted"),
    "short": (_text("Time,F [Hz]\n0,60\n0.1,60.1\n"), "2 samples, wanted: at least 8"),
    "units cut off": (
        lambda path: path.write_text(ieee_csv(path).read_text().replace(",AMP,DEG\n", "\n", 1)),
        "6 columns, but quantities or units for 4 of them, wanted: the rows below their names",
    ),
    "watts": (
        lambda path: ieee_csv(path, columns={"P": ("MW", 1e8 * TIME)}),
        r"P is 4\.\d+e\+08 MW, allowed: up to 1e\+06 MW; .*--unit 'P=W'",
    ),
    "millivolts": (
        lambda path: ieee_csv(path, columns={"VM": ("KV", 1e3 * COLUMNS["VM"][1])}),
        r"VM is 2\.\d+e\+05 kV, allowed: up to 2000 kV; .*--unit 'VM=V'",
    ),
    "radians": (
        lambda path: ieee_csv(path, columns={"VA": ("DEG", (2 * TIME + np.pi) % (2 * np.pi) - np.pi)}),
        r"VA is degrees that jump by 6\.283, allowed: jumps by 360; .*'rad'",
    ),
    "degrees": (
        lambda path: ieee_csv(path, columns={"VA": ("RAD", COLUMNS["VA"][1])}),
        r"VA is radians that jump by 360, .*'deg'",
    ),
    "millihertz": (
        lambda path: ieee_csv(path, columns={"F": ("HZ", 1e3 * COLUMNS["F"][1])}),
        "F is 6.003e.04 Hz, allowed: 40 to 70 Hz",
    ),
    "back": (
        _with_time(lambda t: t.__setitem__(slice(100, None), t[100:] - 2.0)),
        "the time decreases from 3.3",
    ),
    "jump": (
        _with_time(lambda t: t.__iadd__(50.0 * (np.arange(300) // 100))),
        "time stamps jump, by 50 s at 3.3",
    ),
    "uneven": (_with_time(lambda t: t.__ipow__(1.5)), "do not fit an even spacing"),
    "still": (
        lambda path: ieee_csv(path, columns={"F": ("HZ", np.full(300, 60.0))}),
        "no channel varies in 9.96",
    ),
    "time without end": (
        _text("Time,F\n" + "\n".join(f"{k},60" if k != 9 else "1e400,60" for k in range(20))),
        "row 11 has 'inf' for its time",
    ),
    "year of no calendar": (
        _text(
            "Time,F\n" + "".join(f"{7 if k == 9 else 2025:04d}-04-28 12:32:{k:02d},60\n" for k in range(20))
        ),
        "row 11 has '0007-04-28",
    ),
    "no time": (
        _text("Time,F\n" + "\n".join(f"{k},60" if k != 9 else "x,60" for k in range(20))),
        "row 11 has 'x'",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_refused_in_one_line_that_says_what_would_do(name: str, tmp_path: Path) -> None:
    write, says = WRONG[name]
    write(tmp_path / "r.csv")
    with pytest.raises(RecordError, match=says) as raised:
        read_record(tmp_path / "r.csv")
    assert len(raised.value.args) == 1
    assert "r.csv" in str(raised.value)


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda c, d: d.unlink(), "its data are missing, wanted: r.dat beside it"),
        (
            lambda c, d: d.write_bytes(d.read_bytes()[:-3]),
            "bytes, allowed: a multiple of the 20 of a FLOAT32",
        ),
        (
            lambda c, d: c.write_text(c.read_text().replace("19,2A,17D", "many")),
            "line 2 is 'many', wanted: number of",
        ),
        (lambda c, d: c.write_text(c.read_text()[:60]), "line|ends at"),
        (
            lambda c, d: c.write_text(c.read_text().replace("30,300", "30,inf")),
            "line 24 is 'inf', wanted: sampling rate, last sample",
        ),
        (
            lambda c, d: c.write_text(c.read_text().replace("FLOAT32", "FLOAT99")),
            "'FLOAT99', wanted: ASCII, BINARY",
        ),
    ],
)
def test_a_damaged_comtrade_names_the_line(damage, says: str, tmp_path: Path) -> None:
    path = comtrade(tmp_path, "FLOAT32")
    damage(path, tmp_path / "r.dat")
    with pytest.raises(RecordError, match=says):
        read_record(path)


def test_units_named_by_the_caller_are_taken_or_refused(tmp_path: Path) -> None:
    path = ieee_csv(tmp_path / "r.csv", columns={"VM": ("KV", 1e3 * COLUMNS["VM"][1])})
    np.testing.assert_allclose(read_record(path, units={"VM": "V"}).values[:, 0], COLUMNS["VM"][1], rtol=1e-6)
    with pytest.raises(
        RecordError, match="units names 'VX', which is not a channel or quantity; did you mean"
    ):
        read_record(path, units={"VX": "V"})
    with pytest.raises(RecordError, match="unit 'furlong' of Sub:1:Ln:1 VM, allowed: a, amp"):
        read_record(path, units={"VM": "furlong"})
    with pytest.raises(RecordError, match=r"unit 'MW' of .* VM, allowed: one of its quantity, voltage"):
        read_record(path, units={"VM": "MW"})


@pytest.mark.parametrize("wrong", [-1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("option", ["fill_s", "frequency_hz"])
def test_an_option_that_is_no_time_and_no_frequency_is_refused(
    option: str, wrong: float, tmp_path: Path
) -> None:
    with pytest.raises(RecordError, match=rf"r.csv: {option} = {wrong:g}"):
        read_record(ieee_csv(tmp_path / "r.csv"), **{option: wrong})


def test_what_its_unit_does_not_fit_is_left_out_and_a_frequency_in_pu_is_converted(tmp_path: Path) -> None:
    head = "Time,Line 1 P [GW],F_pu_bus7,G1 speed [rpm],F slope [Hz/s],Line 2 P"
    path = table_csv(tmp_path / "r.csv", head, TIME, SWING, SWING / 60.0, SWING, SWING, SWING)
    record = read_record(path, frequency_hz=50.0)
    assert [(c.name, c.unit) for c in record.channels] == [
        ("Line 1 P", "MW"),
        ("F_pu_bus7", "Hz"),
        ("Line 2 P", "1"),
    ]
    np.testing.assert_allclose(record["Line 1 P"], 1e3 * SWING, rtol=1e-6)
    np.testing.assert_allclose(record["F_pu_bus7"], SWING * 50.0 / 60.0, rtol=1e-6)
    assert any(n.startswith("G1 speed: speed in rpm, allowed: pu: left out") for n in record.notes)
    assert any(n.startswith("F slope: frequency in Hz/s, allowed: Hz: left out") for n in record.notes)
    assert "without a known unit in the file, used as they are: Line 2 P" in record.notes


def test_a_word_for_the_unit_is_no_part_of_the_terminal(tmp_path: Path) -> None:
    head = "Time,VA_deg_bus7,VM_kV_bus7,Bus 7 F [Hz],bus7_P_MW,I_ang_bus7,bus7.angle,G1 rotor angle [deg]"
    path = table_csv(tmp_path / "r.csv", head, TIME, *[SWING] * 7)
    assert [(c.quantity, c.terminal) for c in read_record(path).channels] == [
        ("voltage angle", "bus7"),
        ("voltage", "bus7"),
        ("frequency", "Bus 7"),
        ("active power", "bus7"),
        ("current angle", "bus7"),
        ("voltage angle", "bus7"),
        ("rotor angle", "G1"),
    ]


def test_the_clocks_may_change_within_a_record(tmp_path: Path) -> None:
    rows = ["Timestamp,F [Hz]"]
    for k, value in enumerate(SWING):
        zone = "01:59:5" if k < 50 else "03:00:0"  # 5 a second
        rows.append(f"2025-03-30T{zone}{(k % 50) / 5:.1f}+0{1 if k < 50 else 2}:00,{value:.6f}")
    path = tmp_path / "r.csv"
    path.write_text("\n".join(rows[:101]))
    record = read_record(path)
    assert record.step_s == pytest.approx(0.2)
    assert record.length_s == pytest.approx(99 * 0.2)


def frame() -> pd.DataFrame:
    return pd.DataFrame({"Time": TIME, "VM [kV]": COLUMNS["VM"][1], "VA [deg]": COLUMNS["VA"][1]})


@pytest.mark.parametrize(
    ("key", "words", "says"),
    [
        ("units", "kV", r"attrs\['units'\] is kV, wanted: a text for each column"),
        ("unit", {"VM [kV]": None}, r"attrs\['unit'\] is .* wanted: a text for each column"),
        ("quantity", {"VM [kV]": "volts"}, r"attrs\['quantity'\] has 'volts', allowed: frequency, speed"),
        ("terminal", 7, r"attrs\['terminal'\] is 7, wanted"),
    ],
)
def test_wrong_words_on_the_columns_of_a_frame_are_refused(key: str, words: object, says: str) -> None:
    table = frame()
    table.attrs[key] = words
    with pytest.raises(RecordError, match=says):
        read_record(table)


def test_a_frame_without_rows_or_with_phasors_is_refused_and_one_time_of_two_is_used(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="the table: no samples, wanted"):
        read_record(frame().iloc[:0])
    frame().iloc[:0].to_parquet(tmp_path / "empty.parquet")
    with pytest.raises(RecordError, match=r"empty\.parquet: no samples, wanted"):
        read_record(tmp_path / "empty.parquet")
    with pytest.raises(RecordError, match=r"'VM \[kV\]' has complex numbers, wanted: real ones, as"):
        read_record(frame().astype({"VM [kV]": complex}))
    twice = frame().set_axis(["Time", "VM [kV]", "Time"], axis=1)
    np.testing.assert_array_equal(read_record(twice)["VM"], COLUMNS["VM"][1])


def test_a_parquet_file_with_any_byte_changed_is_refused_or_read_as_it_was(tmp_path: Path) -> None:
    """Pages of a run have checksums; the notes of pandas at the end of a file are a text that can break."""
    path, rng = tmp_path / "trajectory.parquet", np.random.default_rng(1)
    columns, units = (
        {"time_s": TIME, "plant.G1_dw": 1e-3 * np.sin(TIME)},
        {"time_s": "s", "plant.G1_dw": "pu"},
    )
    Trajectory(columns, units).write_parquet(path)
    theirs = tmp_path / "pandas.parquet"
    frame().to_parquet(theirs)
    text = theirs.read_bytes()
    theirs.write_bytes(text.replace(b'"pandas_type"', b'"pandas_typo"'))
    with pytest.raises(RecordError, match=r"pandas\.parquet: is damaged"):
        read_record(theirs)
    good, right = path.read_bytes(), read_record(path)["plant.G1_dw"]
    refused = 0
    for at in rng.integers(4, len(good), 200):
        path.write_bytes(good[:at] + bytes([good[at] ^ 0x10]) + good[at + 1 :])
        try:
            record = read_record(path)
        except RecordError as error:
            refused += 1
            assert "\n" not in str(error)
            continue
        if "plant.G1_dw" in [c.name for c in record.channels]:
            np.testing.assert_array_equal(record["plant.G1_dw"], right)
    assert refused > 100
