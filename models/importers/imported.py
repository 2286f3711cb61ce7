"""How a grid is to be read, and what an import gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..case.case import Case
from ..case.schema import LARGEST_EXPONENT
from ..case.tables import RATED_HZ
from ..errors import CaseError
from .report import Report
from .stored import Solution


@dataclass(frozen=True)
class ImportOptions:
    """How the files of a grid are read.

    frequency_hz : for a file that has none; 60 Hz when not given.
    P_exponent, Q_exponent : of loads against voltage; constant impedance (2) when not given.
    strict : an assumption is an error.
    island : a bus of the island to keep, or "all" with a slack bus; the largest of these when not given.
    converters : "model", what their records say, or "current" for constant currents.
    dc_lines : "model", dc links where two-terminal and VSC lines can be that, or "power" for constant powers.
    coordinates : CSV with bus, latitude, longitude.
    release_limits : widen the limits that keep controls from resting where their machines start.
    devices : files of user-defined devices, which records of their names (USRMDL or not) become.
    leave_out : models whose DYR records are passed over. replace : model -> the one that its records are read
    as, by the order of their fields.

    Raises
    ------
    CaseError : a value that is not allowed.
    """

    frequency_hz: float | None = None
    P_exponent: float | None = None
    Q_exponent: float | None = None
    strict: bool = False
    island: int | str | None = None
    converters: str = "model"
    dc_lines: str = "model"
    coordinates: str | Path | None = None
    release_limits: bool = False
    devices: Sequence[str | Path] = ()
    leave_out: Sequence[str] = ()
    replace: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.converters not in ("model", "current"):
            raise CaseError(f"converters = {self.converters!r}, allowed: model, current")
        if self.dc_lines not in ("model", "power"):
            raise CaseError(f"dc_lines = {self.dc_lines!r}, allowed: model, power")
        for name in ("devices", "leave_out"):
            if isinstance(value := getattr(self, name), str | Path):
                raise CaseError(f"{name} = {str(value)!r}, allowed: a list, [{str(value)!r}]")
        if not isinstance(self.replace, Mapping):
            raise CaseError(f"replace = {self.replace!r}, allowed: a dict such as {{'USEXST': 'EXST1'}}")
        low, high = RATED_HZ
        if self.frequency_hz is not None and not low <= self.frequency_hz <= high:
            raise CaseError(f"frequency = {self.frequency_hz:g}, allowed: {low:g} to {high:g} Hz")
        for name in ("P_exponent", "Q_exponent"):
            exponent = getattr(self, name)
            if exponent is not None and not 0.0 <= exponent <= LARGEST_EXPONENT:
                raise CaseError(f"{name} = {exponent:g}, allowed: 0 (constant power) to {LARGEST_EXPONENT:g}")


AS_FILED = ImportOptions()  #: everything as the files have it


@dataclass(frozen=True)
class Imported:
    """An imported grid: the case, what was read, assumed and dropped, and its stored solution."""

    case: Case
    report: Report
    solution: Solution
    unrest: tuple[str, ...] = ()  #: why controls cannot rest where their machines start, a line each
