"""What `interarea run` leaves in its folder: trajectory as CSV and Parquet, ledgers and metrics, a plot."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from .plots import DASHES, SERIES, new_figure, save_figure
from .result import Result
from .ringdown import swing_signal
from .run import Run


def write_result(result: Result, folder: Path) -> list[Path]:
    """Write trajectory.csv, trajectory.parquet and ledger.json, for a `Run` also metrics.json and run.svg.

    Returns the files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / name for name in ("trajectory.csv", "trajectory.parquet", "ledger.json")]
    result.trajectory.write_csv(files[0])
    result.trajectory.write_parquet(files[1])
    ledgers = {
        "step_s": result.ledger.step_s,
        "inputs": result.ledger.inputs,
        "delays": result.ledger.as_rows(),
        "packets": {name: dict(row) for name, row in result.packets.rows.items()},
    }
    _write_json(ledgers, files[2])
    if isinstance(result, Run):
        files += [folder / "metrics.json", folder / "run.svg"]
        _write_json(result.metrics.as_dict(), files[3])
        save_figure(run_plot(result), files[4])
    return files


def _write_json(value: object, path: Path) -> None:
    path.write_text(json.dumps(value, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def run_plot(run: Run) -> Figure:
    """Draw a run: the speed difference it is judged by, speeds of the machines, controls if there are any."""
    curves = run.trajectory
    name, swing = swing_signal(curves, run.case)
    controls = curves.reals_of("controller")
    rows = 3 if controls else 2
    figure, axes = new_figure(rows, 1, height=1.4 * rows + 0.5, sharex=True)
    axes[0].plot(curves.time_s, 1e3 * swing, color=SERIES[0])
    axes[0].set_ylabel(f"{name}\n(10⁻³ pu)")
    for k, machine in enumerate(run.case.machines):
        speed = 1e3 * np.asarray(curves[f"plant.{machine.name}_dw"])
        colour, dash = SERIES[k % len(SERIES)], DASHES[(k // len(SERIES)) % len(DASHES)]
        axes[1].plot(curves.time_s, speed, color=colour, linestyle=dash, linewidth=1.0, label=machine.name)
    axes[1].set_ylabel("speed deviation\n(10⁻³ pu)")
    axes[1].legend(loc="upper right", ncols=min(8, len(run.case.machines)), fontsize=7)
    for k, control in enumerate(controls):
        colour = SERIES[k % len(SERIES)]
        axes[2].plot(curves.time_s, curves[control], color=colour, label=control.split(".", 1)[1])
    if controls:
        axes[2].set_ylabel("control (pu)")
        axes[2].legend(loc="upper right", fontsize=7)
    axes[-1].set_xlabel("time (s)")
    axes[-1].set_xlim(float(curves.time_s[0]), float(curves.time_s[-1]))
    title = run.scenario.title or run.scenario.name
    axes[0].set_title(title)
    return figure
