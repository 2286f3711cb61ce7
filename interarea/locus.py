"""Loci of eigenvalues over a parameter of a case or of its controller, as tables, drawings and matrices."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .cosim.errors import DestinationError
from .models.errors import UserError, nearest

if TYPE_CHECKING:
    from .design.controllers.controller import Controller
    from .design.modes.locus import Locus
    from .models.case.case import Case

CONTROLLER_KEYS = ("controller.gain", "controller.latency_s")
MOST_POINTS = 1000
POINTS = 21
_EXPECTED = "KEY=FROM:TO or KEY=FROM:TO:POINTS, such as machines.G1.exciter.KA=50:300 or controller.gain=0:2"


class LocusError(UserError):
    """An unknown parameter, or values that do not form a locus."""


def along_of(text: str) -> tuple[str, list[float]]:
    """Return the key and the values of `KEY=FROM:TO[:POINTS]`.

    Raises
    ------
    LocusError : another form, equal ends, fewer than 2 or more than 1000 points.
    """
    key, sign, ends = text.rpartition("=")
    parts = ends.split(":")
    try:
        low, high = (float(part) for part in parts[:2])
        points = int(parts[2]) if len(parts) == 3 else POINTS
    except ValueError:
        raise LocusError(f"--along {text!r}, wanted {_EXPECTED}") from None
    if not sign or not key or len(parts) > 3:
        raise LocusError(f"--along {text!r}, wanted {_EXPECTED}")
    if not (np.isfinite([low, high]).all() and low != high and 2 <= points <= MOST_POINTS):
        raise LocusError(f"--along {text!r}: allowed: two different numbers, 2 to {MOST_POINTS} points")
    return key, [float(value) for value in np.linspace(low, high, points)]


def locus_of(
    case: Case,
    key: str,
    values: list[float],
    region: tuple[tuple[float, float], float],
    *,
    controller: Controller | None = None,
    latency_s: float = 0.0,
) -> Locus:
    """Return the modes in a band (Hz) below a damping ratio, over `values` of a parameter.

    Each value has its own operating point, its exact linear model and, with a controller with late
    signals, exact delays; the modes of each are counted independently. key : a path of the case
    (`machines.G1.exciter.KA`, `redispatch.G1:G2`), `controller.gain` (a factor on the designed gain) or
    `controller.latency_s`.

    Raises
    ------
    LocusError : a key of the controller without a controller, or an unknown key.
    CaseError : a path that is not a number of the case, or a value that the case rejects.
    """
    from .cosim.run.artefacts import sparse_linear_plant
    from .design.delay.late_plant import LatePlant
    from .design.modes.all_modes import all_modes
    from .design.modes.locus import follow
    from .fmu_build.write.cache import default_cache
    from .models.case.parameter_path import parameter_value, with_parameter

    band_hz, below = region
    of_controller = key.startswith("controller.")
    if of_controller:
        _check_controller_key(key, controller)
    else:
        parameter_value(case, key)
    base_plant = sparse_linear_plant(case, default_cache()) if of_controller else None

    def spectrum(value: float) -> Mapping[str, complex]:
        varied = case if of_controller else with_parameter(case, key, value)
        plant = base_plant or sparse_linear_plant(varied, default_cache())
        loop = None
        if controller is not None and not (key == "controller.gain" and value == 0.0):
            system = controller.system * (value if key == "controller.gain" else 1.0)
            latency = value if key == "controller.latency_s" else latency_s
            system.set_inputs(list(controller.inputs))
            system.set_outputs(list(controller.outputs))
            late = dict.fromkeys(controller.inputs, latency)
            loop = LatePlant(plant, system, late, omega_b=case.omega_b, high_hz=band_hz[1])
        result = all_modes(plant, case.areas, band_hz=band_hz, below=below, loop=loop)
        return {mode.name: mode.eigenvalue for mode in result.modes}

    return follow(spectrum, values, key=key)


def _check_controller_key(key: str, controller: Controller | None) -> None:
    if key not in CONTROLLER_KEYS:
        raise LocusError(f"--along {key}: no such key of a controller; {nearest(key, CONTROLLER_KEYS)}")
    if controller is None:
        raise LocusError(f"--along {key}: name the controller with --controller")


def save_locus(locus: Locus, case: Case, folder: Path) -> list[Path]:
    """Write locus.csv, locus.parquet and the plant's A, B, C, D of every value; return the files.

    matrices-K.npz holds A, B, C, D, states, inputs, outputs and value; for a key of the controller, which
    leaves the plant as it is, there is one.

    Raises
    ------
    DestinationError : a folder that cannot be written.
    UserError : a plant with too many states for dense matrices.
    """
    import csv
    import io

    import pyarrow as pa
    import pyarrow.parquet as pq

    from .cosim.run.artefacts import linear_matrices
    from .fmu_build.write.cache import default_cache
    from .models.case.parameter_path import with_parameter
    from .models.files import together, write_whole

    of_controller = locus.key.startswith("controller.")
    rows = locus.rows()
    table, text = io.BytesIO(), io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]) if rows else ["parameter", "mode"])
    writer.writeheader()
    writer.writerows(rows)
    pq.write_table(pa.Table.from_pylist(rows), table)
    contents = {"locus.csv": text.getvalue().encode(), "locus.parquet": table.getvalue()}
    for k, value in enumerate(locus.values[:1] if of_controller else locus.values):
        varied = case if of_controller else with_parameter(case, locus.key, float(value))
        m = linear_matrices(varied, default_cache())
        arrays = {name: getattr(m, name) for name in "ABCD"}
        arrays |= {"states": m.state_labels, "inputs": m.input_labels, "outputs": m.output_labels}
        packed = io.BytesIO()
        np.savez(packed, value=float(value), **arrays)
        contents[f"matrices-{k:03d}.npz"] = packed.getvalue()
    try:
        with together():
            return [write_whole(folder / name, content) for name, content in contents.items()]
    except OSError as error:
        where = Path(error.filename or folder)
        raise DestinationError(f"--save {where}: cannot be written: {error.strerror}") from None


def locus_table(locus: Locus) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return titles and rows of a locus as texts."""
    titles: tuple[str, ...] = (locus.key, "mode", "frequency (Hz)", "damping ratio", "eigenvalue (1/s)")
    rows: list[tuple[str, ...]] = [
        (
            f"{row['parameter']:.6g}",
            str(row["mode"]),
            f"{row['frequency_hz']:.4f}",
            f"{row['damping_ratio']:.4f}",
            f"{row['real_per_s']:.4f} ± {row['imag_per_s']:.4f}j",
        )
        for row in locus.rows()
    ]
    return titles, rows


def draw_locus(locus: Locus, folder: Path) -> Path:
    """Draw the eigenvalues in the complex plane, each mode from its ring to its dot; return locus.svg."""
    from .cosim.plots.curves import SERIES, new_figure, save_figure

    figure, axes = new_figure(height=3.4)
    for k, (name, track) in enumerate(locus.modes.items()):
        there = track[np.isfinite(track)]
        colour = SERIES[k % len(SERIES)]
        axes.plot(there.real, there.imag / (2.0 * np.pi), color=colour, label=name)
        axes.plot(there.real[:1], there.imag[:1] / (2.0 * np.pi), "o", mfc="none", color=colour)
        axes.plot(there.real[-1:], there.imag[-1:] / (2.0 * np.pi), "o", color=colour)
    axes.axvline(0.0, color="0.4", linewidth=0.7)
    axes.set_xlabel("real part (1/s)")
    axes.set_ylabel("frequency (Hz)")
    axes.set_title(f"{locus.key} from {locus.values[0]:g} (ring) to {locus.values[-1]:g} (dot)")
    if locus.modes:
        axes.legend(fontsize=7)
    folder.mkdir(parents=True, exist_ok=True)
    return save_figure(figure, folder / "locus.svg")
