"""Where the parameters of a sweep go: values put into the scenario, the case and the controller of one run.

Paths (the first word says where):

    seed                            seeds of all channels, each its own, from one number
    case                            another case by name
    case.tie_flow_mw, case.load_scale, case.out, case.vary      operating point (`operating_variant`)
    case.TABLE.ROW.KEY              any entry of the case, such as case.machines.G1.H
    controller                      another controller by name or file
    controller.gain                 factor on what the controller puts out (before its limit)
    controller.PARAMETER            any parameter of its FMU, such as limit or "A[1,1]"
    channels.NAME.KEY               any entry of a channel; NAME may be *
    concentrators.NAME.KEY          any entry of a concentrator, NAME may be *; signals.K.KEY: of its signal K
    channels.NAME.signal_faults.K.KEY    of fault K of a wrong signal; signals.K.signal_faults.K: likewise
    fmus.NAME.start.VARIABLE        start value of a user-defined FMU
    event.K.KEY                     entry of event K, counted from 1
    stop_s, step_s, master.KEY      the run itself
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from interarea.fmu_build.open.fmu_file import describe
from interarea.models.case.case import Case
from interarea.models.case.document import ROW_TABLES
from interarea.models.case.variants import operating_variant

from ..errors import SweepError, nearest
from ..scenario.channels import derived_seed
from ..scenario.document import scenario_document
from ..scenario.master_table import MasterTable
from ..scenario.scenario import Scenario, load_scenario
from ..scenario.signal_faults import SignalFault
from ..scenario.signal_paths import ChannelTable, ConcentratorTable, SignalTable
from .spec import Path_, Sweep
from .values import Value

OPERATING = ("tie_flow_mw", "load_scale", "out", "vary")
_ROOTS = (
    *("seed", "case", "controller", "channels", "concentrators", "event", "fmus"),
    *("stop_s", "step_s", "master"),
)


@dataclass(frozen=True)
class CaseChange:
    """A case by name, with an operating point and single entries changed; hashable."""

    case: str
    operating: tuple[tuple[str, Value], ...] = ()
    entries: tuple[tuple[Path_, Value], ...] = ()

    def apply(self, base: Case) -> Case:
        """Return the changed case.

        Raises
        ------
        CaseError : an entry that does not exist or a value out of range, in one line.
        """
        case = base
        if self.entries:
            change: dict[str, Any] = {}
            for words, value in self.entries:
                table = change
                for word in words[:-1]:
                    table = table.setdefault(word, {})
                table[words[-1]] = value
            case = case.with_changes(change)
        if self.operating:
            requested: dict[str, Any] = dict(self.operating)
            case = operating_variant(case, **requested)
        return case


@dataclass(frozen=True)
class Point:
    """What one run is: its scenario, its case, and start values for its controller's FMU."""

    scenario: Scenario
    change: CaseChange
    gain: float = 1.0
    controller_start: Mapping[str, float] = field(default_factory=dict)


def point_of(
    sweep: Sweep,
    values: Mapping[str, Value],
    *,
    seed: int | None = None,
    base: bytes | None = None,
) -> Point:
    """Return the point of a sweep where its parameters have `values`.

    seed : sets the seeds of all channels, as a parameter on `seed` does. base : `packed` scenario of
        the sweep, when it is at hand.

    Raises
    ------
    ScenarioError, SweepError : values that make no scenario.
    """
    table = pickle.loads(packed(sweep) if base is None else base)  # a fresh copy, and the fastest
    places = _Places(table)
    for name, value in values.items():
        for words in sweep.paths(name):
            places.put(words, value, name)
    seed = seed if places.seed is None else places.seed
    if seed is not None:
        for channel, row in {**table.get("channels", {}), **table.get("concentrators", {})}.items():
            row["seed"] = derived_seed(seed, channel)
    scenario = load_scenario(table | {"folder": sweep.base.folder})
    return Point(scenario, places.change(), places.gain, places.start)


class _Places:
    """Where values go: the table of a scenario, the changes of its case, the FMU of its controller."""

    def __init__(self, table: dict[str, Any]) -> None:
        self.table = table
        provided = table.pop("operating_point", {})  # of which parameters change entries
        self.operating: dict[str, Value] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in provided.items()
        }
        self.entries: dict[Path_, Value] = {}
        self.gain = 1.0
        self.start: dict[str, float] = {}
        self.seed: int | None = None

    def put(self, words: Path_, value: Value, name: str) -> None:
        """Put the value of parameter `name` where `words` say."""
        match words:
            case ("case",):
                self.table["case"] = str(value)
            case ("case", ("out" | "vary") as key) if isinstance(value, str):
                self.operating[key] = (value,) if value else ()
            case ("case", key):
                self.operating[key] = value
            case ("case", *rest):
                self.entries[tuple(rest)] = value
            case ("controller", "gain"):
                self.gain = _number(value, name)
            case ("controller", variable):
                self.start[variable] = _number(value, name)
            case ("seed", *_):
                self.seed = int(_number(value, name))
            case _:
                _put(self.table, words, value)

    def change(self) -> CaseChange:
        """Return the case and what of it is changed."""
        operating, entries = sorted(self.operating.items()), sorted(self.entries.items())
        return CaseChange(str(self.table["case"]), tuple(operating), tuple(entries))


def packed(sweep: Sweep) -> bytes:
    """Return the table of the scenario that a sweep varies, to be copied for each run."""
    return pickle.dumps(scenario_document(sweep.base))


def check_paths(sweep: Sweep, case: Case, controller_parameters: set[str]) -> None:
    """Raise SweepError for a path that leads nowhere (with the nearest names) and for contradicting paths."""
    taken: dict[Path_, str] = {}
    for name in sweep.parameters:
        for words in sweep.paths(name):
            where = f"{sweep.name}: parameters.{name}: path {'.'.join(words)!r}"
            _check_path(sweep, case, controller_parameters, words, where)
            for other, owner in taken.items():
                if other == words:
                    raise SweepError(f"{where} is set by parameters.{owner} too, allowed: each place once")
                short, long_ = sorted((other, words), key=len)
                if long_[: len(short)] == short and len(short) > 1:
                    raise SweepError(
                        f"{where} and parameters.{owner} ({'.'.join(other)!r}) overwrite each other"
                    )
                if ("seed",) in (words, other) and words[-1] == other[-1] == "seed":
                    raise SweepError(f"{where} and parameters.{owner} both set the seed of a channel")
            taken[words] = name
    search = sweep.searched
    if search is not None and search[1].seeds > 1 and any(w[0] == "seed" for w in taken):
        raise SweepError(
            f"{sweep.name}: parameters.{search[0]}.bisect.seeds = {search[1].seeds} and a parameter that "
            "sets the seed, allowed: one of them"
        )


def _check_path(sweep: Sweep, case: Case, parameters: set[str], words: Path_, where: str) -> None:
    root, rest = words[0], words[1:]
    if root not in _ROOTS:
        raise SweepError(f"{where}: {root!r} cannot be varied; {nearest(root, _ROOTS)}")
    if root == "controller":
        _check_controller(parameters, rest, where)
    elif root == "case":
        _check_case(case, rest, where)
    elif root in ("seed", "stop_s", "step_s"):
        if rest:
            raise SweepError(f"{where}: {root} has no entries")
    else:
        checks = {
            "channels": _check_channel,
            "concentrators": _check_concentrator,
            "event": _check_event,
            "fmus": _check_fmu,
            "master": _check_master,
        }
        checks[root](sweep.base, rest, where)


def _check_channel(base: Scenario, rest: Path_, where: str) -> None:
    if len(rest) < 2:
        raise SweepError(f"{where}: allowed: channels.NAME.KEY")
    _among(where, rest[0], list(base.channels), "channel")
    _among(where, rest[1], list(ChannelTable.model_fields), "key of a channel")
    if rest[1] == "signal_faults" and len(rest) > 2:
        _check_fault(base.channels[rest[0]].signal_faults, "channels", rest[:2], rest[2:], where)
    elif len(rest) > 2 and rest[1] not in ("loss", "latency"):
        raise SweepError(f"{where}: {rest[1]} has no entries")


def _check_concentrator(base: Scenario, rest: Path_, where: str) -> None:
    if len(rest) < 2:
        raise SweepError(f"{where}: allowed: concentrators.NAME.KEY")
    _among(where, rest[0], list(base.concentrators), "concentrator")
    _among(where, rest[1], list(ConcentratorTable.model_fields), "key of a concentrator")
    if rest[1] == "signals":
        signals = base.concentrators[rest[0]].signals
        if len(rest) < 4 or not rest[2].isdecimal() or not 1 <= int(rest[2]) <= len(signals):
            raise SweepError(
                f"{where}: allowed: concentrators.{rest[0]}.signals.K.KEY with K from 1 to {len(signals)}"
            )
        _among(where, rest[3], list(SignalTable.model_fields), "key of a concentrator's signal")
        if rest[3] == "signal_faults" and len(rest) > 4:
            _check_fault(signals[int(rest[2]) - 1].signal_faults, "concentrators", rest[:4], rest[4:], where)
        elif len(rest) > 4:
            raise SweepError(f"{where}: {rest[3]} has no entries")
    elif len(rest) > 2:
        raise SweepError(f"{where}: {rest[1]} has no entries")


def _check_fault(faults: Sequence[SignalFault], root: str, owner: Path_, rest: Path_, where: str) -> None:
    if len(rest) != 2 or not rest[0].isdecimal() or not 1 <= int(rest[0]) <= len(faults):
        place = ".".join((root, *owner))
        raise SweepError(
            f"{where}: allowed: {place}.K.KEY with K from 1 to {len(faults)}"
            if faults
            else f"{where}: the scenario has no fault there; write one with its kind, then vary its keys"
        )
    fault = faults[int(rest[0]) - 1]
    _among(where, rest[1], [k for k in type(fault).model_fields if k != "kind"], f"key of {fault.kind}")


def _check_event(base: Scenario, rest: Path_, where: str) -> None:
    count = len(base.event)
    if len(rest) != 2 or not rest[0].isdecimal() or not 1 <= int(rest[0]) <= count:
        raise SweepError(f"{where}: allowed: event.K.KEY with K from 1 to {count}")
    _among(where, rest[1], list(type(base.event[int(rest[0]) - 1]).model_fields), "key of this event")


def _check_fmu(base: Scenario, rest: Path_, where: str) -> None:
    if rest:
        _among(where, rest[0], list(base.fmus), "FMU of the scenario")
    if len(rest) != 3 or rest[1] != "start":
        raise SweepError(f"{where}: allowed: fmus.NAME.start.VARIABLE")
    variables = describe(base.folder / base.fmus[rest[0]].file).variables
    _among(where, rest[2], [v.name for v in variables], f"variable of {base.fmus[rest[0]].file}")


def _check_master(_: Scenario, rest: Path_, where: str) -> None:
    if len(rest) != 1:
        raise SweepError(f"{where}: allowed: master.KEY")
    _among(where, rest[0], list(MasterTable.model_fields), "key of the master")


def _check_controller(parameters: set[str], rest: Path_, where: str) -> None:
    if not rest:
        return
    if len(rest) > 1:
        raise SweepError(f"{where}: allowed: controller, controller.gain, controller.PARAMETER")
    if not parameters:
        raise SweepError(f"{where}: the scenario has no controller")
    _among(where, rest[0], ["gain", *sorted(parameters)], "parameter of the controller")


def _check_case(case: Case, rest: Path_, where: str) -> None:
    if len(rest) == 1:
        _among(where, rest[0], [*OPERATING, *ROW_TABLES], "part of a case")
        if rest[0] in ROW_TABLES:
            raise SweepError(f"{where}: allowed: case.{rest[0]}.ROW.KEY")
    elif rest:
        _check_case_path(case, rest, where)


def _check_case_path(case: Case, rest: Path_, where: str) -> None:
    document: Any = case.document()
    _among(where, rest[0], ROW_TABLES, "table of the case")
    rows = {k: v for k, v in document[rest[0]].items() if isinstance(v, Mapping)}
    _among(where, rest[1], [*rows, "defaults"], f"row of {rest[0]}")
    if len(rest) < 3:
        raise SweepError(f"{where}: allowed: case.{rest[0]}.{rest[1]}.KEY")
    row = next(iter(getattr(case, rest[0])))
    keys = {f.alias or k for k, f in type(row).model_fields.items()}
    _among(where, rest[2], sorted(keys), f"key of {rest[0]}")


def _among(where: str, word: str, known: Any, what: str) -> None:
    if word not in known:
        raise SweepError(f"{where}: {word!r} is no {what}; {nearest(word, known)}")


def check_values(sweep: Sweep, case: Case) -> None:
    """Try every listed value, and the ends of what is drawn, each with the first values of the others.

    Raises
    ------
    SweepError : a value that makes no scenario or no case; names the parameter.
    """
    first = sweep.values(0) if sweep.size else {}
    search = sweep.searched
    if search is not None:
        first[search[0]] = search[1].low
    for name, parameter in sweep.parameters.items():
        for value in parameter.probes():
            try:
                point = point_of(sweep, {**first, name: value})
                if point.change.case == case.name:
                    point.change.apply(case)
            except SweepError:
                raise
            except (ValueError, TypeError, AttributeError) as error:
                text = " ".join(str(error).split())
                raise SweepError(
                    f"{sweep.name}: parameters.{name}: the value {value!r} does not fit: {text}"
                ) from None


def _put(table: dict[str, Any], words: Path_, value: Value) -> None:
    """Set an entry of a scenario's table; events and signals are counted from 1."""
    plain: Any = list(value) if isinstance(value, tuple) else value
    place: Any = table
    for word in words[:-1]:
        place = place[int(word) - 1] if isinstance(place, list) else place.setdefault(word, {})
    if words[-2:] == ("loss", "rate") and "kind" not in place:
        place["kind"] = "bernoulli"
    place[words[-1]] = plain


def _number(value: Value, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise SweepError(f"parameters.{name} = {value!r}, allowed: a number")
    return value
