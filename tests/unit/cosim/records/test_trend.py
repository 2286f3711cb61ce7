"""Long records in parts: the same numbers as of each part alone, swings followed, bounded memory."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import invoke

import interarea as ia
from interarea.cosim.records.files import read as reading
from interarea.cosim.records.files.read import read_pieces
from interarea.cosim.records.forced import FORCED, MODAL, UNDECIDED
from interarea.cosim.records.meter import Swing
from interarea.cosim.records.record import Record, RecordError
from interarea.cosim.records.trend import _follow, trend

EVERY_S, RATE_HZ = 40.0, 20
F, Z = 0.5, 0.04  # of the mode that rings down in each part


def day(parts: int, sine_in: tuple[int, ...] = (), sine_hz: float = 0.9) -> pd.DataFrame:
    """Return a ring-down in each part, at four places; in some a sine stands in its place."""
    time = np.arange(round(EVERY_S * RATE_HZ)) / RATE_HZ
    rng = np.random.default_rng(1)
    frames = []
    for part in range(parts):
        decay = np.exp(-Z * 2 * np.pi * F * time) * np.cos(2 * np.pi * F * np.sqrt(1 - Z**2) * time)
        values = 0.02 * np.outer(decay, [1.0, 0.5, -0.6, -0.9])
        if part in sine_in:
            values = 0.02 * np.outer(np.sin(2 * np.pi * sine_hz * time), [1.0, -0.2, 0.1, -0.9])
        values = 60.0 + values + 1e-5 * rng.standard_normal(values.shape)
        frame = pd.DataFrame(values, columns=[f"PMU {k} F [Hz]" for k in range(1, 5)])
        frame.insert(0, "Time", np.round(part * EVERY_S + time, 3))
        frames.append(frame)
    return pd.concat(frames, ignore_index=True)


def as_csv(frame: pd.DataFrame, folder: Path) -> Path:
    frame.to_csv(folder / "day.csv", index=False)
    return folder / "day.csv"


def as_parquet(frame: pd.DataFrame, folder: Path) -> Path:
    pq.write_table(
        pa.Table.from_pandas(frame, preserve_index=False), folder / "day.parquet", row_group_size=999
    )
    return folder / "day.parquet"


@pytest.mark.slow
@pytest.mark.parametrize("write", [as_csv, as_parquet])
@pytest.mark.parametrize("rows", [7, 333, 10**6])
def test_parts_are_those_of_the_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: object, rows: int
) -> None:
    monkeypatch.setattr(reading, "PIECE_ROWS", rows)
    path = write(day(3), tmp_path)  # type: ignore[operator]
    whole = ia.read_record(path)
    pieces = list(read_pieces(path, EVERY_S))
    assert [piece.start_s for piece in pieces] == [0.0, EVERY_S, 2 * EVERY_S]
    for piece in pieces:
        assert isinstance(piece.record, Record)
        assert piece.record.channels == whole.channels
        same = whole.between(piece.start_s, piece.start_s + EVERY_S - 0.5 / RATE_HZ)
        np.testing.assert_array_equal(piece.record.values, same.values)


@pytest.mark.slow
def test_swings_are_followed_and_a_sine_is_named_with_its_times(tmp_path: Path) -> None:
    path = as_csv(day(6, sine_in=(3, 4)), tmp_path)
    result = ia.damping_trend(path, every_s=EVERY_S)
    mode, sine = result.tracks
    assert list(mode.swings) == [0, 1, 2, 5]
    assert mode.frequency_hz == pytest.approx(F * np.sqrt(1 - Z**2), rel=1e-4)
    for estimate in mode.estimates.values():
        assert estimate.damping_ratio == pytest.approx(Z, abs=2e-4)
    assert sine.forced == (3, 4)
    assert not sine.estimates
    assert sine.frequency_hz == pytest.approx(0.9, abs=1e-3)
    table = result.table()
    assert table.start_s.tolist() == [0.0, 40.0, 80.0, 120.0, 160.0, 200.0]
    assert table.track.tolist() == [0, 0, 0, 1, 1, 0]
    alone = ia.meter(ia.read_record(path, window_s=(80.0, 119.95)))
    assert table.damping_ratio[2] == pytest.approx(alone.swings[0].estimates[0].damping_ratio, rel=1e-3)


@pytest.mark.slow
def test_the_command_prints_one_row_a_swing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = day(6, sine_in=(3, 4))
    frame["Time"] = (pd.Timestamp("2026-03-01 23:59:00") + pd.to_timedelta(frame["Time"], unit="s")).astype(
        str
    )
    path = str(as_csv(frame, tmp_path))
    code, out, _ = invoke(["meter", path, "--every", "40"], monkeypatch)
    assert code == 0
    assert "6 parts of 40 s" in out
    assert "4 of 6" in out
    assert "2: 02 00:01:00 to 02 00:01:40" in out
    plain = json.loads(invoke(["meter", path, "--every", "40", "--json"], monkeypatch)[1])
    assert [len(t["swings"]) for t in plain["tracks"]] == [4, 2]
    assert plain["start"].startswith("2026-03-01 23:59:00")


def test_a_part_that_says_nothing_does_not_end_the_day(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = day(4)
    frame.loc[frame.Time.between(42.0, 78.0), frame.columns[1:]] = np.nan  # a part with a long gap
    frame = frame[~frame.Time.between(85.0, 165.0)]  # and a part without frames
    result = ia.damping_trend(as_parquet(frame, tmp_path), every_s=EVERY_S)
    assert [part.start_s for part in result.parts if part.meter] == [0.0]
    whys = {part.start_s: part.why for part in result.parts if not part.meter}
    assert set(whys) == {40.0, 80.0}
    assert "no channel is left" in whys[40.0]
    assert "too short" in whys[80.0]
    _, _, err = invoke(["meter", str(tmp_path / "day.parquet"), "--every", "40"], monkeypatch)
    assert "0:00:40: " in err


def test_a_mode_of_a_case_is_one_track_whatever_its_frequency_does() -> None:
    tracks: list[dict[int, Swing]] = []
    for part, f in enumerate((0.50, 0.60, 0.72)):
        shape = {"G1": 1.0 + 0j, "G2": 0.2j * part - 0.5, "G3": -0.4 + 0j}
        _follow(tracks, part, [Swing(f, MODAL, 1.0, (), shape, "", mode="inter-area")])
    assert [list(t) for t in tracks] == [[0, 1, 2]]
    _follow(tracks, 3, [Swing(0.73, MODAL, 1.0, (), {"G1": 1.0 + 0j, "G2": 1.0 + 0j, "G3": -1.0 + 0j}, "")])
    assert len(tracks) == 2  # near in frequency, of another shape
    shape = {"G1": 1.0 + 0j, "G2": 1.0 + 0j, "G3": -1.0 + 0j}
    _follow(tracks, 4, [Swing(0.73, FORCED, 1.0, (), shape, "")])
    assert [list(t) for t in tracks] == [[0, 1, 2], [3], [4]]
    _follow(tracks, 5, [Swing(0.73, UNDECIDED, 1.0, (), shape, "")])
    _follow(tracks, 6, [Swing(0.74, MODAL, 1.0, (), shape, "")])
    assert [list(t) for t in tracks] == [[0, 1, 2], [3, 5, 6], [4]]


@pytest.mark.parametrize("every", ["0", "-5", "nan"])
def test_a_length_that_is_none_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, every: str
) -> None:
    code, _, err = invoke(["meter", str(as_csv(day(1), tmp_path)), "--every", every], monkeypatch)
    assert code == 2
    assert "allowed: above 0" in err or "allowed: a finite number" in err


def test_nothing_to_meter_is_refused_with_the_first_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    still = day(2)
    still.iloc[:, 1:] = 60.0
    with pytest.raises(RecordError, match="no channel varies"):
        ia.damping_trend(as_csv(still, tmp_path), every_s=EVERY_S)
    with pytest.raises(RecordError, match="no part of the file lies in the window"):
        trend(iter(()))
    code, _, err = invoke(
        ["meter", str(tmp_path / "day.csv"), "--every", "40", "--beside", str(tmp_path / "day.csv")],
        monkeypatch,
    )
    assert code == 2
    assert "allowed: one of them" in err


def test_memory_is_that_of_a_part_not_of_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "PIECE_ROWS", 500)
    most = []
    for parts in (4, 16):
        path = as_parquet(day(parts), tmp_path)
        tracemalloc.start()
        for _ in read_pieces(path, EVERY_S):
            pass
        most.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert most[1] < 1.3 * most[0]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"window_s": (60.0, 0.0)}, r"window_s = \(60, 0\), allowed: the first below the second"),
        ({"window_s": (float("nan"), 60.0)}, "window_s = "),
        (
            {"window_s": (900.0, 960.0)},
            "no part of the file lies in the window, allowed: a window that holds",
        ),
        ({"every_s": float("inf")}, "pieces of inf s, allowed: above 0"),
        ({"quantity": "voltage", "channels": ["PMU 1 F"]}, "channels of frequency, wanted: of voltage"),
    ],
)
def test_choices_that_leave_nothing_are_refused(options: dict[str, object], says: str) -> None:
    with pytest.raises(RecordError, match=says):
        ia.damping_trend(day(2), **{"every_s": EVERY_S, **options})
