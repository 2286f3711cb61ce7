"""A grid file of any format that is read here, told by its suffix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..case.schema import LARGEST_EXPONENT
from ..case.tables import RATED_HZ
from ..errors import CaseError
from ..grid.powerflow import solve_powerflow
from ..grid.start import release_limits as release_limits_of
from ..grid.start import start_of
from .imported import Imported
from .matpower import import_matpower
from .psse import import_psse
from .published import FORMATS, PUBLISHED, not_alone, published, require_grid

_GRIDS = (".raw", ".rawx", ".m")
_PACKED = (".gz", ".xz", ".bz2")


@np.errstate(all="ignore")  # of numbers such as 1e300; what comes of them is checked
def import_grid(
    grid: str | Path,
    *,
    dyr: str | Path | None = None,
    frequency_hz: float | None = None,
    P_exponent: float | None = None,
    Q_exponent: float | None = None,
    strict: bool = False,
    island: int | str | None = None,
    converters: str = "model",
    dc_lines: str = "model",
    coordinates: str | Path | None = None,
    release_limits: bool = False,
    devices: Sequence[str | Path] = (),
    leave_out: Sequence[str] = (),
    replace_models: Mapping[str, str] = MappingProxyType({}),
) -> Imported:
    """Return the grid of a file of PSS/E or MATPOWER, or of a name in `PUBLISHED`; options as `import_psse`.

    converters : "model", what their records say, or "current" for constant currents. dc_lines : "model", dc
    links where two-terminal lines can be that, or "power" for constant powers. release_limits : widen
    the limits that keep controls from resting where their machines start. leave_out, replace_models : models
    of DYR records to pass over, and to read as another.

    Raises
    ------
    CaseError : no such file, another format, an option that is not allowed, or what the format's own reader
        refuses.
    """
    _check_choices(converters, dc_lines)
    _check_numbers(frequency_hz, P_exponent=P_exponent, Q_exponent=Q_exponent)
    how: dict[str, Any] = {
        "frequency_hz": frequency_hz,
        "P_exponent": P_exponent,
        "Q_exponent": Q_exponent,
        "strict": strict,
        "island": island,
        "coordinates": coordinates,
    }
    models: dict[str, Any] = {"devices": devices, "leave_out": leave_out}
    file = Path(grid)
    if str(grid) in PUBLISHED and not file.exists():
        how |= {"converters": converters, "release_limits": release_limits, "replace_models": replace_models}
        how |= models | {"dc_lines": dc_lines}
        return _import_published(str(grid), dyr, how)
    require_grid(str(grid))
    suffix = (Path(file.stem) if file.suffix.lower() in _PACKED else file).suffix.lower()
    if suffix in _GRIDS and dyr is not None and Path(dyr).suffix.lower() in _GRIDS:
        raise CaseError(f"dyr = {dyr}: is a grid by its suffix, wanted: the dynamic data of {file.name}")
    if suffix == ".m":
        if dyr is not None:
            raise CaseError(f"{dyr}: dynamic data need a RAW file, MATPOWER has none")
        if devices:
            raise CaseError(f"{devices[0]}: a device needs a DYR file, MATPOWER has none")
        if leave_out or replace_models:
            raise CaseError(f"{file}: no DYR file, so no model can be left out or replaced")
        return import_matpower(file, **how)
    if suffix in (".raw", ".rawx"):
        models |= {"converters_as_current": converters == "current", "dc_lines_as_power": dc_lines == "power"}
        imported = import_psse(file, dyr, replace=replace_models, **how, **models)
        return imported if dyr is None else _started(imported, release=release_limits)
    raise CaseError(f"{file}: suffix {suffix!r}, allowed: {FORMATS}{not_alone(file)}")


def _import_published(name: str, dyr: str | Path | None, how: dict[str, Any]) -> Imported:
    """The grid `name` of `PUBLISHED`, from the files that its authors give, with its source."""
    if dyr is not None:
        raise CaseError(f"{dyr}: {name} has its own dynamic data, allowed: no --dyr")
    with published(name) as (raw, own):
        imported = import_grid(raw, dyr=own, **how)
    source = PUBLISHED[name].source
    imported.report.lines.append(source)
    return replace(imported, case=imported.case.model_copy(update={"source": source}))


def _check_choices(converters: str, dc_lines: str) -> None:
    if converters not in ("model", "current"):
        raise CaseError(f"converters = {converters!r}, allowed: model, current")
    if dc_lines not in ("model", "power"):
        raise CaseError(f"dc_lines = {dc_lines!r}, allowed: model, power")


def _check_numbers(frequency_hz: float | None, **exponents: float | None) -> None:
    low, high = RATED_HZ
    if frequency_hz is not None and not low <= frequency_hz <= high:
        raise CaseError(f"frequency = {frequency_hz:g}, allowed: {low:g} to {high:g} Hz")
    for name, exponent in exponents.items():
        if exponent is not None and not 0.0 <= exponent <= LARGEST_EXPONENT:
            raise CaseError(f"{name} = {exponent:g}, allowed: 0 (constant power) to {LARGEST_EXPONENT:g}")


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
