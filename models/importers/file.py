"""A grid file of any format that is read here, told by its suffix."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import CaseError
from ..grid.powerflow import solve_powerflow
from ..grid.start import release_limits as release_limits_of
from ..grid.start import start_of
from .imported import AS_FILED, Imported, ImportOptions
from .matpower import import_matpower
from .psse import import_psse
from .published import FORMATS, PUBLISHED, not_alone, published, require_grid

_GRIDS = (".raw", ".rawx", ".m")
_PACKED = (".gz", ".xz", ".bz2")


@np.errstate(all="ignore")  # of numbers such as 1e300; what comes of them is checked
def import_grid(
    grid: str | Path, dyr: str | Path | None = None, options: ImportOptions = AS_FILED
) -> Imported:
    """Return the grid of a file of PSS/E or MATPOWER, or of a name in `PUBLISHED`.

    Raises
    ------
    CaseError : no such file, another format, or what the format's own reader
        refuses.
    """
    file = Path(grid)
    if str(grid) in PUBLISHED and not file.exists():
        return _import_published(str(grid), dyr, options)
    require_grid(str(grid))
    suffix = (Path(file.stem) if file.suffix.lower() in _PACKED else file).suffix.lower()
    if suffix in _GRIDS and dyr is not None and Path(dyr).suffix.lower() in _GRIDS:
        raise CaseError(f"dyr = {dyr}: is a grid by its suffix, wanted: the dynamic data of {file.name}")
    if suffix == ".m":
        if dyr is not None:
            raise CaseError(f"{dyr}: dynamic data need a RAW file, MATPOWER has none")
        if options.devices:
            raise CaseError(f"{options.devices[0]}: a device needs a DYR file, MATPOWER has none")
        if options.leave_out or options.replace:
            raise CaseError(f"{file}: no DYR file, so no model can be left out or replaced")
        return import_matpower(file, options)
    if suffix in (".raw", ".rawx"):
        imported = import_psse(file, dyr, options)
        return imported if dyr is None else _started(imported, release=options.release_limits)
    raise CaseError(f"{file}: suffix {suffix!r}, allowed: {FORMATS}{not_alone(file)}")


def _import_published(name: str, dyr: str | Path | None, options: ImportOptions) -> Imported:
    """The grid `name` of `PUBLISHED`, from the files that its authors give, with its source."""
    if dyr is not None:
        raise CaseError(f"{dyr}: {name} has its own dynamic data, allowed: no --dyr")
    with published(name) as (raw, own):
        imported = import_grid(raw, own, options)
    source = PUBLISHED[name].source
    imported.report.lines.append(source)
    return replace(imported, case=imported.case.model_copy(update={"source": source}))


def _started(imported: Imported, *, release: bool) -> Imported:
    """Look at how the controls start, widen limits where that is asked for, and say so."""
    case, lines = imported.case, imported.report.lines
    flow = solve_powerflow(case)
    if release:
        case, changed = release_limits_of(case, flow)
        lines += [f"released: {change}" for change in changed]
    start = start_of(case, flow)
    lines.append(start.text())
    return replace(imported, case=case, unrest=tuple(str(item.error) for item in start.unrest))
