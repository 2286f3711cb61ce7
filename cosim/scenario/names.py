"""Names in a scenario, of what is bundled and of what its case has, and those that name nothing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from interarea.design.controllers.bundled import shipped_banks, shipped_names
from interarea.models.bundled import bundled_elsewhere
from interarea.models.case.document import ROW_TABLES
from interarea.models.documents import require_regular
from interarea.models.errors import Collected, UserError

from ..errors import ScenarioError, nearest

if TYPE_CHECKING:  # the file is checked before what a case takes is loaded
    from interarea.models.case.case import Case

CONTROLLER_NAMES = ("wdc", "cc", "ftc")  #: designed for a case, in the order in which the study tells them
NAMED_CONTROLLERS = ("none", *CONTROLLER_NAMES, *shipped_banks(), *shipped_names())


def beside(folder: Path, name: str) -> str | Path:
    """Return what a file names: something bundled, or a path from its own folder."""
    if "/" in name or "\\" in name or Path(name).suffix:
        return folder / name
    return name


def wrong_names(table: Mapping[str, Any], where: str, folder: Path) -> list[str]:
    """Return a line for each name in a scenario's table that names nothing, whatever else is wrong."""
    lines, named = list(wrong_controller(table.get("controller"), where, folder)), table.get("case")
    lines += [
        f"{where}: {key}: a key of a case file (`interarea new case`), which `case = ` names"
        for key in ("base", "change", *ROW_TABLES)
        if key in table
    ]
    if not isinstance(named, str) or not named:
        return lines
    try:
        case = grid_of(folder, named)
    except (UserError, OSError) as error:
        return [
            *lines,
            *(f"{where}: {line}" for line in (error.args if isinstance(error, UserError) else ())),
        ]
    events = table.get("event")
    if events and isinstance(events, list | tuple):
        lines += wrong_targets(case, events, where)
    return [*lines, *_wrong_rows(case, table, where), *_wrong_signals(case, table, where, folder)]


def grid_of(folder: Path, named: str) -> Any:
    """Return the case that a file names; of a bundled one, in which nothing is wrong, only its `outline`.

    Raises
    ------
    CaseError : as `load_case`.
    """
    from interarea.models.case.document import outline

    place = beside(folder, named)
    if isinstance(place, str) or not place.exists():  # which is reported before models of pydantic are loaded
        return outline(place)
    from interarea.models.case.case import load_case

    return load_case(place)


def wrong_controller(name: Any, where: str, folder: Path) -> Iterator[str]:
    """Yield a line where the controller is neither a name nor a file."""
    if not isinstance(name, str) or not name or name in NAMED_CONTROLLERS:
        return
    if not (folder / name).exists():
        yield f"{where}: {no_controller(name)}"


def require_controller(name: str, folder: Path = Path()) -> None:
    """Require that a controller is one of the names, or a file in `folder`; the file is not read.

    Raises
    ------
    ScenarioError : neither, with the nearest names; a folder, or no regular file.
    """
    path = folder / name
    if name in NAMED_CONTROLLERS or path.is_file():
        return
    if path.is_dir():
        raise ScenarioError(f"controller {path}: is a folder, wanted: a JSON file or an FMU")
    if path.suffix == ".fmu":
        require_regular(path, "the FMU of a controller", ScenarioError)
    raise ScenarioError(no_controller(name))


def no_controller(name: str) -> str:
    """Return the line of a controller that is neither a name nor a file."""
    if (other := bundled_elsewhere(name, "controller")) is not None:
        return f"controller = {name!r} {other}"
    hint = nearest(name, NAMED_CONTROLLERS)
    return f"controller = {name!r} is neither a name nor a file; {hint} (or the path of a controller file)"


def two_machines(names: Sequence[str], machines: Sequence[str]) -> tuple[str, str]:
    """Return the two of `swing`; ScenarioError where one is none of the `machines`, or both are one."""
    for name in names:
        if name not in machines:
            raise ScenarioError(f"swing: machine {name!r} does not exist; {nearest(name, machines)}")
    if names[0] == names[1]:
        raise ScenarioError(f"swing: has {names[0]!r} twice, allowed: two machines")
    return names[0], names[1]


def wrong_targets(case: Case, events: Iterable[Any], where: str) -> list[str]:
    """Return a line for each event, a table or an object, whose target the case does not have."""
    from interarea.models.case.checks import target_index
    from interarea.models.case.events import event_of

    wrong = Collected()
    for k, provided in enumerate(events, start=1):
        try:
            event = event_of(provided, where="") if isinstance(provided, Mapping) else provided
        except UserError:  # told by whoever reads it
            continue
        if not hasattr(event, "kind"):
            continue
        try:
            target_index(case, event)
        except UserError as error:
            wrong.lines += [
                f"{where}: event {k}: {line.removeprefix(f'{case.name}: ')}" for line in error.args
            ]
    return wrong.lines


def _wrong_rows(case: Case, table: Mapping[str, Any], where: str) -> Iterator[str]:
    """Yield a line for each machine of `swing` and each branch that is out that the case does not have."""
    machines, branches = [m.name for m in case.machines], [b.name for b in case.branches]
    swing, point = table.get("swing"), table.get("operating_point")
    out = point.get("out") if isinstance(point, Mapping) else None
    for key, names, known in (("swing", swing, machines), ("operating_point.out", out, branches)):
        for name in names if isinstance(names, list | tuple) else ():
            if isinstance(name, str) and name not in known:
                yield f"{where}: {key} has {name!r}; {nearest(name, known)}"


def _wrong_signals(case: Case, table: Mapping[str, Any], where: str, folder: Path) -> Iterator[str]:
    """Yield a line for each signal that the plant of the case does not put out, and each PMU at no bus."""
    speeds = {f"{m.name}_dw" for m in case.machines}  # told without the plant, which takes numpy
    known: list[str] = []
    for place, row in _signal_rows(table):
        signal, pmu = row.get("signal"), row.get("pmu")
        if isinstance(pmu, Mapping):
            bus, buses = pmu.get("bus"), [str(b.number) for b in case.buses]
            if isinstance(bus, int) and str(bus) not in buses:
                yield f"{where}: {place}.pmu.bus = {bus} does not exist; {nearest(str(bus), buses)}"
        elif isinstance(signal, str) and signal and signal not in speeds:
            from interarea.models.blocks.plant_shown import shown_names
            from interarea.models.case.case import load_case

            known = known or shown_names(load_case(beside(folder, table["case"])))
            if signal not in known:
                hint = nearest(signal, known)
                yield f"{where}: {place}.signal = {signal!r} is not an output of the plant; {hint}"


def _signal_rows(table: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield where signals are named and their tables, whatever else stands there."""
    for kind in ("channels", "concentrators"):
        rows = table.get(kind)
        for name, row in rows.items() if isinstance(rows, Mapping) else ():
            of = row.get("signals", [row]) if isinstance(row, Mapping) else None
            for s in of if isinstance(of, list | tuple) else ():
                if isinstance(s, Mapping):
                    yield f"{kind}.{name}", s
