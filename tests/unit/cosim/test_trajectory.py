"""Trajectories: units and numbers survive the way through files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from interarea.cosim.results.trajectory_files import TrajectoryFiles
from interarea.cosim.trajectory import Trajectory
from interarea.fmu_build.open.ports import Port
from interarea.fmu_build.open.units import UnitOf


@pytest.fixture
def trajectory() -> Trajectory:
    times = np.array([0.0, 0.1, 0.2])
    records = np.array([[1 / 3, 1.0, 0.0], [2 / 3, 2.0, 1.0], [np.pi, 3.0, 1.0]])
    ports = [
        Port("v", unit=UnitOf("pu"), description="Voltage"),
        Port("n", type="Integer"),
        Port("ok", type="Boolean"),
    ]
    return Trajectory.of_records(times, records, ["a.v", "a.n", "a.ok"], ports)


def test_columns_units_and_types(trajectory: Trajectory) -> None:
    assert list(trajectory.data) == ["time_s", "a.v", "a.n", "a.ok"]
    assert trajectory.units == {"time_s": "s", "a.v": "pu", "a.n": "1", "a.ok": "1"}
    assert trajectory.data.attrs["units"] == trajectory.units
    assert trajectory.data["a.ok"].dtype == np.bool_
    assert trajectory.data["a.n"].dtype == np.int64


def test_parquet_keeps_bits_units_and_descriptions(trajectory: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    trajectory.write_parquet(path)
    again = Trajectory.read_parquet(path)
    pd.testing.assert_frame_equal(again.data, trajectory.data, check_exact=True)
    assert again.units == trajectory.units
    assert pq.read_schema(path).field("a.v").metadata == {b"unit": b"pu", b"description": b"Voltage"}


def test_csv_keeps_bits(trajectory: Trajectory, tmp_path: Path) -> None:
    with TrajectoryFiles(tmp_path) as files:
        files.add(trajectory)
    again = pd.read_csv(files.files[0])
    assert (again["a.v"] == trajectory.data["a.v"]).all()


def test_files_are_those_that_pandas_writes(trajectory: Trajectory, tmp_path: Path) -> None:
    """Nothing of pandas is loaded for them: its own writers are the independent path."""
    columns = {name: trajectory[name].copy() for name in ("time_s", "a.v", "a.n", "a.ok")}
    columns["a.v"][1], columns['odd "name", here'] = np.nan, np.array([np.inf, -0.0, 1e-300])
    odd = Trajectory(columns, dict.fromkeys(columns, "1"))
    with TrajectoryFiles(tmp_path, every=2) as files:
        files.add(odd)
    expected = odd.data.iloc[::2]
    assert files.files[0].read_text() == expected.to_csv(index=False, float_format="%.17g")
    own, theirs = odd.table(), pa.Table.from_pandas(pd.DataFrame(columns), preserve_index=False)
    assert own.equals(theirs) and own["a.v"].null_count == 1
    with TrajectoryFiles(tmp_path) as files:
        files.add(odd)
    assert files.files[0].read_text() == odd.data.to_csv(index=False, float_format="%.17g")


def test_an_unknown_column_names_those_there_are(trajectory: Trajectory) -> None:
    with pytest.raises(KeyError, match=r"a\.v"):
        trajectory["a.w"]
