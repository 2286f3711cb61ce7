"""Files by which a receiver checks that an FMU runs in his tool as it ran here: the FMI cross-check's layout.

``extra/NAME_in.csv`` inputs over time, straight lines between the rows; ``extra/NAME_ref.csv`` the outputs;
``extra/NAME_ref.opt`` times and step. The outputs come from the FMU's own binary, stepped with the inputs'
values and slopes, so they are the same to the bit wherever the files are made.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from ctypes import c_double, c_int
from pathlib import Path

import numpy as np
import numpy.typing as npt

from interarea.models.files import write_whole

from ..errors import BuildError
from ..write.cache import artefact, code_hash, content_hash, file_hash
from ..write.package import archive_bytes
from .description import ScalarVariable
from .fmi2 import CallFailed, Library, references
from .fmu_file import FmuFile, host_folders

Array = npt.NDArray[np.float64]
_MOST_STEPS = 2000
_MOST_OUTPUTS = 20
_AMPLITUDE = 0.01  # of an input, in its unit and relative to its nominal value


def add_cross_check(fmu: Path, path: Path) -> Path:
    """Write a copy of `fmu` with the three cross-check files in ``extra/`` to `path`; return that path.

    The run: from the default start over at most 2000 of the default steps. Input k rises
    from its start value by a hundredth of its nominal value between k T/20 and (k + 1) T/20,
    T the stop time, and goes back after T/2. Of many outputs the first 20 are written.

    Raises
    ------
    FmuFileError : no binary for this platform. BuildError : the FMU refuses to run; with its message.
    """
    file = FmuFile(fmu)
    try:
        step_s, stop_s = (file.model.experiment_s(k, d) for k, d in (("stepSize", 0.01), ("stopTime", 1.0)))
        count = max(1, min(_MOST_STEPS, round(stop_s / step_s)))
        variables = file.model.variables
        inputs = [v for v in variables if v.causality == "input" and v.type == "Real"]
        outputs = [v for v in variables if v.causality == "output" and v.type != "String"][:_MOST_OUTPUTS]
        knots, values = _excitation(inputs, count * step_s)
        rows = _run(file, inputs, outputs, knots, values, step_s, count)
    except (CallFailed, OSError) as error:
        raise BuildError(f"{fmu.name}: the cross-check run failed: {error}") from error
    finally:
        file.close()
    options = (("StartTime", 0.0), ("StopTime", count * step_s), ("StepSize", step_s), ("RelTol", 1e-4))
    name = file.model.name
    extra = {f"extra/{name}_ref.opt": "".join(f"{k}, {v!r}\n" for k, v in options)}
    extra[f"extra/{name}_ref.csv"] = _csv([v.name for v in outputs], rows)
    if inputs:
        extra[f"extra/{name}_in.csv"] = _csv([v.name for v in inputs], np.column_stack([knots, values]))
    with zipfile.ZipFile(fmu) as archive:
        entries = {n: archive.read(n) for n in archive.namelist()}
    entries |= {n: text.encode("utf-8") for n, text in extra.items()}
    return write_whole(path, archive_bytes(entries, first="modelDescription.xml"))


def complete_fmu(fmu: Path, cache: Path) -> Path:
    """Return a copy of one of our FMUs with cross-check files, or the FMU itself if it cannot run here."""
    with zipfile.ZipFile(fmu) as archive:
        local = tuple(f"binaries/{folder}/" for folder in host_folders())
        if not any(name.startswith(local) for name in archive.namelist()):
            return fmu
    key = content_hash(file_hash(fmu), code_hash(add_cross_check.__module__))
    return artefact(cache, "complete", f"{fmu.stem}-{key}", ".fmu", lambda p: add_cross_check(fmu, p))


def _excitation(inputs: Sequence[ScalarVariable], stop_s: float) -> tuple[Array, Array]:
    """Knots (s) and values (knots, inputs) of the straight lines that the inputs follow."""
    starts = [v.number("start") or 0.0 for v in inputs]
    sizes = [_AMPLITUDE * (v.number("nominal") or 1.0) for v in inputs]
    times = {0.0, stop_s / 2.0, 0.55 * stop_s, stop_s}
    times |= {(k + j) * stop_s / 20.0 for k in range(1, min(len(inputs), 8) + 1) for j in (0, 1)}
    knots = np.array(sorted(times))
    columns = []
    for k, (start, size) in enumerate(zip(starts, sizes, strict=True)):
        rise = (k % 8 + 1) * stop_s / 20.0
        at = [0.0, rise, rise + stop_s / 20.0, stop_s / 2.0, 0.55 * stop_s, stop_s]
        columns.append(np.interp(knots, at, [start, start, start + size, start + size, start, start]))
    return knots, np.array(columns).T.reshape(len(knots), len(inputs))


def _run(
    file: FmuFile,
    inputs: Sequence[ScalarVariable],
    outputs: Sequence[ScalarVariable],
    knots: Array,
    values: Array,
    step_s: float,
    count: int,
) -> Array:
    """Time and outputs at every communication point, (count + 1, 1 + outputs)."""
    library = Library(file.model, file.interface, file.folder, file.binary)
    n, known = len(inputs), references(inputs)
    orders = (c_int * n)(*[1] * n)
    fmu = library.fresh()
    try:
        fmu.initialise()
        rows = [[0.0, *fmu.get(outputs)]]
        for k in range(count):
            t, end = k * step_s, (k + 1) * step_s
            if inputs:
                now = [float(np.interp(t, knots, c)) for c in values.T]
                then = [float(np.interp(end, knots, c)) for c in values.T]
                slopes = [(b - a) / step_s for a, b in zip(now, then, strict=True)]
                fmu.do("SetReal", known, n, (c_double * n)(*now))
                fmu.do("SetRealInputDerivatives", known, n, orders, (c_double * n)(*slopes))
            fmu.step(t, step_s)
            rows.append([end, *fmu.get(outputs)])
        fmu.do("Terminate")
    finally:
        fmu.free()
        library.close()
    return np.array(rows, dtype=float)


def _csv(names: Sequence[str], rows: Array) -> str:
    head = ",".join(f'"{name}"' for name in ("time", *names))
    return "\n".join([head, *(",".join(f"{x:.12g}" for x in row) for row in rows)]) + "\n"
