"""A grid file of any format that is read here, told by its suffix."""

from __future__ import annotations

from pathlib import Path

from ..errors import CaseError
from .imported import Imported
from .matpower import import_matpower
from .psse import import_psse

FORMATS = ".raw (PSS/E version 23 to 36) or .m (MATPOWER), plain, .gz, .xz or .bz2"
_PACKED = (".gz", ".xz", ".bz2")


def import_grid(
    grid: str | Path,
    *,
    dyr: str | Path | None = None,
    frequency_hz: float | None = None,
    P_exponent: float | None = None,
    Q_exponent: float | None = None,
    strict: bool = False,
    island: int | None = None,
    converters: str = "refuse",
    coordinates: str | Path | None = None,
) -> Imported:
    """Return the grid of a file of PSS/E or MATPOWER; the options are those of `import_psse`.

    converters : "refuse", or "current" for constant currents.

    Raises
    ------
    CaseError : no such file, another format, an option that is not allowed, or what the format's own reader
        refuses.
    """
    file = Path(grid)
    if not file.is_file():
        what = "is a folder" if file.is_dir() else "no such file"
        raise CaseError(f"{file}: {what}, allowed: {FORMATS}")
    if converters not in ("refuse", "current"):
        raise CaseError(f"converters = {converters!r}, allowed: refuse, current")
    if frequency_hz is not None and not frequency_hz > 0.0:
        raise CaseError(f"frequency = {frequency_hz:g}, allowed: above 0 Hz")
    for name, exponent in (("P_exponent", P_exponent), ("Q_exponent", Q_exponent)):
        if exponent is not None and not exponent >= 0.0:
            raise CaseError(f"{name} = {exponent:g}, allowed: 0 (constant power) or above")
    suffix = (Path(file.stem) if file.suffix.lower() in _PACKED else file).suffix.lower()
    if suffix == ".m":
        if dyr is not None:
            raise CaseError(f"{dyr}: dynamic data goes with a RAW file, not with MATPOWER")
        return import_matpower(
            file,
            frequency_hz=frequency_hz,
            P_exponent=P_exponent,
            Q_exponent=Q_exponent,
            strict=strict,
            island=island,
            coordinates=coordinates,
        )
    if suffix == ".raw":
        return import_psse(
            file,
            dyr,
            P_exponent=P_exponent,
            Q_exponent=Q_exponent,
            strict=strict,
            island=island,
            converters_as_current=converters == "current",
            coordinates=coordinates,
            frequency_hz=frequency_hz,
        )
    raise CaseError(f"{file}: suffix {suffix!r}, allowed: {FORMATS}")
