"""A day of 50 PMUs, 30 frames a second, metered in parts of ten minutes: time, memory, and what is right.

    python benchmarks/records/day_of_pmus.py --out FOLDER
    python benchmarks/records/day_of_pmus.py --out FOLDER --kind csv --hours 2

The record is that of the linear plant of `nets-nyps`, noise at every rotor, frequencies of 50 places that are
mixtures of its machines, 1 mHz of noise, one frame of a thousand lost at each. For the third quarter of the
day the noise stays and a sine of 0.4 Hz comes in at one machine. The file is written part by part, then
`interarea meter FILE --every 600` runs in a process of its own. Printed: its time, its largest memory, and
of each mode how the tracked damping ratio compares with the exact one, and in which parts a sine is seen.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import ambient_coverage
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

import interarea as ia

CASE, PLACES, RATE_HZ, PART_S = "nets-nyps", 50, 30, 600
SINE_HZ, SINE_HZ_RMS = 0.4, 0.05
NOISE_HZ, LOST = 1e-3, 1e-3
MOTION_HZ = 0.02  # rms of what swings by itself, of the place that moves most


def parts(hours: float) -> Iterator[pd.DataFrame]:
    """Yield ten minutes after ten minutes of frequencies, Hz, with the time of each frame."""
    ambient_coverage.STEP_S = 1.0 / RATE_HZ
    plant = ambient_coverage.LinearRecords(ia.linearise(CASE))
    rng = np.random.default_rng(0)
    many = round(hours * 3600 / PART_S)
    first = plant.record(0, PART_S)
    mix = rng.dirichlet(np.full(first.values.shape[1], 0.3), PLACES).T
    size = (
        MOTION_HZ / (first.values @ mix - (first.values @ mix).mean(axis=1, keepdims=True)).std(axis=0).max()
    )
    names = [f"PMU {k + 1} F [Hz]" for k in range(PLACES)]
    for part in range(many):
        record = plant.record(part, PART_S)
        values = size * record.values
        if 0.5 * many <= part < 0.75 * many:
            values = values + np.sqrt(2.0) * SINE_HZ_RMS * np.outer(
                np.sin(2.0 * np.pi * SINE_HZ * record.time_s), np.eye(values.shape[1])[0]
            )
        values = 60.0 + values @ mix + NOISE_HZ * rng.standard_normal((len(values), PLACES))
        values[rng.random(values.shape) < LOST] = np.nan
        frame = pd.DataFrame(values.round(6), columns=names)
        frame.insert(0, "Time", np.round(part * PART_S + record.time_s, 4))
        yield frame


def write(path: Path, hours: float) -> None:
    """Write the record, part by part."""
    if path.suffix == ".csv":
        with path.open("w", encoding="utf-8") as file:
            for k, frame in enumerate(parts(hours)):
                frame.to_csv(file, index=False, header=k == 0)
        return
    writer = None
    for frame in parts(hours):
        table = pa.Table.from_pandas(frame, preserve_index=False)
        writer = writer or pq.ParquetWriter(path, table.schema)
        writer.write_table(table)
    if writer:
        writer.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--kind", choices=["parquet", "csv"], default="parquet")
    parser.add_argument("--hours", type=float, default=24.0)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / f"day.{options.kind}"
    if not path.exists():
        write(path, options.hours)
    command = [
        sys.executable,
        "-m",
        "interarea",
        "meter",
        str(path),
        "--every",
        str(PART_S),
        "--json",
        "--quiet",
    ]
    began = time.perf_counter()
    with (options.out / "trend.json").open("wb") as out:
        child = subprocess.Popen(command, stdout=out)
        _, status, used = os.wait4(child.pid, 0)
    wall = time.perf_counter() - began
    print(
        f"{path.name}: {path.stat().st_size / 1e6:.0f} MB; exit code {os.waitstatus_to_exitcode(status)}, "
        f"{wall:.0f} s, {used.ru_utime + used.ru_stime:.0f} s of processor, "
        f"{used.ru_maxrss / 1e3:.0f} MB at most"
    )
    trend = json.loads((options.out / "trend.json").read_text(encoding="utf-8"))
    report(trend)


def report(trend: dict) -> None:
    """Print of each mode what was tracked, and when the sine was seen."""
    exact = [m for m in ia.modes(CASE).values() if 0.1 <= m.frequency_hz <= 2.5]
    for track in trend["tracks"]:
        if not len(track["swings"]) >= 0.05 * trend["parts"]:
            continue
        ratios = np.array([s["damping_ratio"] for s in track["swings"] if "damping_ratio" in s])
        forced = [s["start_s"] for s in track["swings"] if s["kind"] == "forced"]
        near = min(exact, key=lambda m: abs(m.frequency_hz - track["frequency_hz"]))
        spread = [f"{x:.4f}" for x in np.quantile(ratios, [0.5, 0.05, 0.95])] if len(ratios) else ["-"] * 3
        when = f", from {forced[0]:g} to {forced[-1] + PART_S:g} s" if forced else ""
        print(
            f"{track['frequency_hz']:.3f} Hz: {len(track['swings'])} of {trend['parts']} parts, "
            f"damping {spread[0]} in the median, 5 to 95 % {spread[1]} to {spread[2]}; "
            f"nearest mode {near.frequency_hz:.3f} Hz {near.damping_ratio:.4f}; forced in {len(forced)}{when}"
        )


if __name__ == "__main__":
    main()
