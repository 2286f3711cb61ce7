"""Dynamic data of a PSS/E DYR file as machine, exciter, stabilizer and governor tables.

How the models map (parameters in the order of the PSS/E model library):

GENROU, GENROE  -> round_rotor; X''q = X''d, Ra from the RAW file; saturation of the subtransient flux.
GENSAL, GENSAE  -> round_rotor without Tq01: one winding on the q axis;
                   saturation of E'q on the d axis, GENSAE: of the subtransient flux on both axes.
GENCLS          -> classical behind ZR + jZX of the RAW file; with H = 0 an infinite bus there.
REGFMA1, REGFMB1, GDFORM -> a converter's voltage behind ZR + jZX of the RAW file.
controls        -> devices of the package, by their `[dyr]` tables (models/devices).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..devices.dyr import CURRENTS, device_for_dyr, dyr_models, fault_of_converter, own_records
from ..devices.language.device import OF_CONVERTER, DyrModel
from ..devices.language.structure import Model
from ..devices.library import NONE, library
from ..errors import CaseError, nearest
from .dyr import KNOWN, DyrFile, DyrRecord, read_dyr
from .load_records import MODELS as LOADS
from .raw.record import Record
from .report import Report

MACHINE = "machine model"
ROUNDED = 5e-4  #: pu by which X''d may stand above X'd in a file: both have so few digits
#: machine models that are converters
_CONVERTERS = "REGCA1 REGCB1 REGCC1 DERA1 GDFORM REGFMA1 REGFMB1 WT1G1 WT2G1 WT3G1 WT3G2 WT4G1 WT4G2 PVGU1"
CONVERTERS = frozenset(_CONVERTERS.split())

CONVERTER = "converter"  #: kind of the devices of these
SOURCE = "source"  #: kind of those that are a voltage behind ZR + jZX of the RAW file, one record each
SVC = "svc"  #: kind of the devices of units that are SVCs
PLANT_CONTROL = "REPCA1"  #: a record that names another bus or a branch

#: why these are not modelled
_LOAD = "a composite load of motors and electronics; the constant load of the RAW represents it"
_OVER = "an over-excitation limiter; without it a field current above the rating is not reduced"
_UNDER = "an under-excitation limiter; without it the reactive power absorbed by a machine is not limited"
_WHY = {
    **dict.fromkeys(("CMLDBLU1", "CMLDBLU2", "ACMTBLU1", "CIM5BL", "CIM6BL", "CLODBL"), _LOAD),
    **dict.fromkeys(("MAXEX1", "OEL1B"), _OVER),
    **dict.fromkeys(("MNLEX1", "MNLEX2", "UEL1", "UEL2"), _UNDER),
}

#: assumed of records of these models, and of a field that is not used
_ASSUMED = {
    "GDFORM": "GridPACK's GDFORM modelled as REGFMA1: E with a lag of 5 ms where it is not integrated",
    "MAXEX2": "MAXEX2 measures the field current, also if its first field selects the field voltage",
    "PFLAG": "PFLAG = 1 with a WTTQA1, which already multiplies by the speed: 0 used",
    "INPUTTYPE": "input of a PSSSIM with INPUTTYPE = 1, which another program supplies: 0 used",
}

#: models that only trip or measure
RELAYS = frozenset(
    {
        *("LDSHBL", "LVSHBL", "LDS3BL", "LVS3BL", "LDST", "UVLSBL", "VTGTPA", "VTGDCA", "FRQTPA", "FRQDCA"),
        *("VTGTPAT", "VTGDCAT", "FRQTPAT", "FRQDCAT", "DISTR1"),
        *("RXR1", "CIROS1", "SLNOS1", "SLYPN1", "SCGAP2", "TIOCR1", "TIOCRS", "DPDTR1", "BUSFREQ"),
    }
)


@dataclass(frozen=True)
class Dynamics:
    """What a DYR file says of the units of a grid.

    rows : name of a machine -> keys to merge into its row. where : name -> file:line of its machine model.
    constant : name of a unit without machine model -> exponent of its injection. converters, svcs : name of a
    unit that is a converter or an SVC -> keys to merge into its row.
    """

    rows: dict[str, dict[str, Any]]
    where: dict[str, str]
    constant: dict[str, float]
    converters: dict[str, dict[str, Any]] = dataclasses.field(default_factory=dict)
    svcs: dict[str, dict[str, Any]] = dataclasses.field(default_factory=dict)

    @property
    def no_machines(self) -> set[str]:
        """Names of the units that are none."""
        return self.constant.keys() | self.converters.keys() | self.svcs.keys()


def read_dynamics(path: Path, own: Mapping[str, Model] = NONE) -> DyrFile:
    """Return the records of a DYR file; own : devices of the user's own, whose names are known too."""
    return read_dyr(path, KNOWN | dyr_models().keys() | own_records(own.values()).keys())


def replaced(file: DyrFile, leave_out: Collection[str], models: Mapping[str, str], report: Report) -> DyrFile:
    """Return the file without the records of some models, and with records of others read as another model's.

    A record with more fields than the other model has is cut, which is said.

    Raises
    ------
    CaseError : a model that the file does not have.
    """
    gone = {name.strip().upper() for name in leave_out}
    other = {old.strip().upper(): new.strip().upper() for old, new in models.items()}
    present = {record.model for record in file.records}
    for option, names in (("leave_out", gone), ("replace", other)):
        for name in sorted(set(names) - present):
            allowed = ", ".join(sorted(present))
            raise CaseError(f"{file.path}: {option} {name!r}: no record of that model, allowed: {allowed}")
    if gone & other.keys():
        raise CaseError(
            f"{file.path}: {sorted(gone & other.keys())[0]} is left out and replaced, allowed: one"
        )
    records = []
    for record in file.records:
        if record.model in gone:
            report.assume(f"{record.model} left out as requested", record.where)
        elif record.model in other:
            records.append(_as(record, other[record.model], report))
        else:
            records.append(record)
    return dataclasses.replace(file, records=tuple(records))


def _as(record: DyrRecord, model: str, report: Report) -> DyrRecord:
    """A record read as that of another model."""
    count = len(MACHINES[model][0]) if model in MACHINES else None
    if model in dyr_models():
        count = len(dyr_models()[model][1].fields)
    more = len(record.fields) - count if count is not None else 0
    cut = f", its last {more} field(s) {' '.join(record.fields[count:])} left out" if more > 0 else ""
    report.assume(f"{record.model} read as {model} as requested{cut}", record.where)
    return dataclasses.replace(record, model=model, fields=record.fields[:count])


def machine_dynamics(
    file: DyrFile,
    machine_of: Mapping[tuple[int, str], str],
    out: Collection[tuple[int, str]],
    report: Report,
    *,
    converters_as_current: bool = False,
    own: Mapping[str, Model] = NONE,
) -> Dynamics:
    """Return the dynamic data of a DYR file.

    machine_of : (bus, id) -> name of a unit in service. out : units out of service, whose records are
    counted and passed over. A unit without a machine model is constant P and Q and a converter what its
    records say, or, if `converters_as_current`, both are constant currents. own : user-defined devices, whose
    records come before those of the package's.

    Raises
    ------
    CaseError : a model that is not supported, a record that is cut off or too long, a second model of one
        kind for one machine; each with file and line.
    """
    records = dyr_models() | own_records(own.values())
    for note in file.notes:
        place, _, what = note.partition(": ")
        report.assume(what, place)
    report.read["DYR lines of comment"] = file.comments
    units = _Units(file.path, machine_of, report)
    if converters_as_current:
        units.take_converters(file.records)
    for record in file.records:
        if record.model in LOADS:
            continue
        name = units.concerned(record, out, records)
        if name is not None:
            units.take(name, record, *_row(record, own, records, report))
    units.check_converters()
    units.check_svcs()
    units.take_the_rest(1.0 if converters_as_current else 0.0)
    converters = {
        n: {"control": row[kind]} for n, row in units.rows.items() for kind in OF_CONVERTER if kind in row
    }
    svcs = {n: {"control": row[SVC], **units.regulated(n)} for n, row in units.rows.items() if SVC in row}
    machines = units.rows.keys() - units.constant.keys() - converters.keys() - svcs.keys()
    rows = {name: row for name, row in units.rows.items() if name in machines}
    report.lines += _without_controls(rows)
    return Dynamics(rows, units.where, units.constant, converters, svcs)


class _Units:
    """The units of a grid, and what the records that were read say of each."""

    def __init__(self, path: Path, machine_of: Mapping[tuple[int, str], str], report: Report) -> None:
        self.path, self.machine_of, self.report = path, machine_of, report
        self.rows: dict[str, dict[str, Any]] = {name: {} for name in machine_of.values()}
        self.seen: dict[tuple[str, str], str] = {}  #: name of a unit and kind of a model -> file:line
        self.where: dict[str, str] = {}
        self.constant: dict[str, float] = {}
        self.records: dict[str, DyrRecord] = {}  #: of SVCs

    def take_converters(self, records: Iterable[DyrRecord]) -> None:
        """Make the converters among the units constant currents."""
        for record in records:
            at = (record.bus, record.identity)
            if record.model in CONVERTERS and at in self.machine_of:
                self.constant[self.machine_of[at]] = 1.0
                self.report.assume("converter modelled as a constant current", record.where)

    def concerned(
        self, record: DyrRecord, out: Collection[tuple[int, str]], records: Collection[str]
    ) -> str | None:
        """Return the name of the unit that `record` tells of; None, and a line of the report, if of none."""
        at = (record.bus, record.identity)
        if at in out:
            self.report.drop("DYR record of a unit out of service", record.where)
            return None
        if record.model in RELAYS:
            self.report.drop("relay or meter", record.where)
            return None
        if at not in self.machine_of:
            if record.model not in MACHINES and record.model not in records:
                raise CaseError(f"{record.where}: {_unknown(record, records)}")
            self.report.assume("DYR record of a unit that is not in the grid: ignored", record.where)
            return None
        if self.machine_of[at] in self.constant:
            self.report.drop("further DYR record of a constant current", record.where)
            return None
        return self.machine_of[at]

    def take(self, name: str, record: DyrRecord, kind: str, row: Mapping[str, Any]) -> None:
        """Give the unit `name` the keys that its record makes."""
        what = record.model if kind == CONVERTER else kind  # which several records make up
        if (name, what) in self.seen:
            first = self.seen[name, what]
            raise CaseError(f"{record.where}: second {what} of {name}, the first is at {first}")
        self.seen[name, what] = record.where
        if kind == CONVERTER:
            source = {"source": f"{self.path.name}, converter records"}
            self.rows[name][kind] = self.rows[name].get(kind, source) | row
            if record.model in CONVERTERS:
                self.where[name] = record.where
        elif kind == MACHINE:
            self.where[name] = record.where
            self.rows[name] |= row
        else:
            self.rows[name][kind] = {"source": f"{self.path.name}, {record.model}", **row}
            if kind in (SOURCE, SVC):
                self.where[name] = record.where
            if kind == SVC:
                self.records[name] = record
        self.report.read[record.model] += 1

    def check_converters(self) -> None:
        """Check that each converter has what sets its currents, and nothing that belongs to a machine."""
        for name, row in self.rows.items():
            kind = next((kind for kind in OF_CONVERTER if kind in row), None)
            if kind is None:
                continue
            place = next(at for (unit, _), at in self.seen.items() if unit == name)
            if kind == CONVERTER:
                fault = fault_of_converter([model for unit, model in self.seen if unit == name])
                if fault:
                    raise CaseError(f"{place}: {name} {fault}")
                if row[kind].get("WT3") == row[kind].get("PFLAG") == 1.0:
                    self.report.assume(_ASSUMED["PFLAG"], self.seen[name, "WTTQA1"])
                    row[kind]["PFLAG"] = 0.0
            others = row.keys() - {kind}
            if others:
                what = f"{sorted(others)[0]!r} beside a converter"
                raise CaseError(f"{place}: {name} has {what}, allowed: records of one of both")

    def check_svcs(self) -> None:
        """Check that no SVC has a record that belongs to a machine."""
        for name, record in self.records.items():
            if len(self.rows[name]) > 1:
                what = next(at for (unit, model), at in self.seen.items() if unit == name and model != SVC)
                raise CaseError(
                    f"{record.where}: {name} is an SVC and at {what} a machine, allowed: one of both"
                )

    def regulated(self, name: str) -> dict[str, int]:
        """Return the bus that an SVC regulates where it is not its own: the first field of its record."""
        record = self.records[name]
        bus = Record(record.model, record.fields, record.where, {"IB": 0}).whole("IB")
        return {"regulates": bus} if bus not in (0, record.bus) else {}

    def take_the_rest(self, exponent: float) -> None:
        """Make the units without any record constant P and Q (exponent 0) or currents (1)."""
        taken = (
            f"unit without DYR record modelled as {'a constant current' if exponent else 'constant P and Q'}"
        )
        for (bus, identity), name in self.machine_of.items():
            if name in self.where or name in self.constant:
                continue
            other = next((place for (n, _), place in self.seen.items() if n == name), None)
            if other is not None:
                raise CaseError(
                    f"{other}: machine {name} has controls but no machine model in {self.path.name}"
                )
            self.constant[name] = exponent
            self.report.assume(taken, f"{self.path}: bus {bus}, {identity!r}")


def _without_controls(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a line for exciters and governors that some units have a record of and others not."""
    lines = []
    for kind, instead in (("exciter", "field voltage"), ("governor", "mechanical power")):
        concerned = {name: row for name, row in rows.items() if row.get("model") == "round_rotor"}
        missing = [name for name, row in concerned.items() if kind not in row]
        if missing and len(missing) < len(concerned):
            listed = ", ".join(missing[:5]) + (", ..." if len(missing) > 5 else "")
            lines.append(
                f"no {kind} record: {len(missing)} of {len(concerned)} units ({listed}), {instead} constant"
            )
    return lines


def _row(
    record: DyrRecord, own: Mapping[str, Model], records: Mapping[str, tuple[Model, DyrModel]], report: Report
) -> tuple[str, dict[str, Any]]:
    """What a record is, and the keys it gives."""
    if record.model not in MACHINES:
        return _device(record, own, records, report)
    names, convert = MACHINES[record.model]
    count = len(names)
    if record.model == "GENCLS" and len(record.fields) == count + 1:  # a reactance, which the RAW has too
        report.assume("third field of GENCLS ignored: the reactance of the RAW is used", record.where)
        record = dataclasses.replace(record, fields=record.fields[:count])
    if len(record.fields) != count:
        less = len(record.fields) < count
        raise CaseError(
            f"{record.where}: {record.model} has {len(record.fields)} parameters, allowed: {count} "
            f"({'cut off?' if less else 'is the / of the record missing?'})"
        )
    fields = Record(record.model, record.fields, record.where, {name: k for k, name in enumerate(names)})
    row = convert(record.where, {name: fields.number(name) for name in names})
    for transient, subtransient in (("Xd1", "Xd2"), ("Xq1", "Xq2")):
        if 0.0 < row.get(subtransient, 0.0) - row.get(transient, 0.0) <= ROUNDED:
            report.assume(f"{subtransient} above {transient} by rounding: {transient} used", record.where)
            row |= {"Xd2": row[transient], "Xq2": row[transient]}
    return MACHINE, row | {"torque_by_speed": True} if row["model"] == "round_rotor" else row


def _device(
    record: DyrRecord, own: Mapping[str, Model], records: Mapping[str, tuple[Model, DyrModel]], report: Report
) -> tuple[str, dict[str, Any]]:
    """The kind of device that a record is, and its row."""
    if record.model not in records:
        raise CaseError(f"{record.where}: {_unknown(record, records)}")
    if record.model == "WSIEG1" and "WSIEG1" not in own_records(own.values()):
        record = _without_curve(record)
    if len(record.fields) != len(records[record.model][1].fields):
        record = _completed(record, report)
    result = device_for_dyr(record, own.values())
    device = result.model.device
    for name in result.unused:
        report.assume(_ASSUMED.get(name, f"{name} of {record.model} is not 0, and is not used"), record.where)
    if record.model in _ASSUMED and device.key in library():
        report.assume(_ASSUMED[record.model], record.where)
    return device.kind, {"kind": device.key} | dict(result.parameters)


def _without_curve(record: DyrRecord) -> DyrRecord:
    """A WSIEG1 whose deadbands and curve are all 0 as the IEEEG1 with whose fields it begins."""
    count, of_both = (len(dyr_models()[model][1].fields) for model in ("IEEEG1", "WSIEG1"))
    plain = len(record.fields) == of_both and not any(field.strip("0.") for field in record.fields[count:])
    return dataclasses.replace(record, model="IEEEG1", fields=record.fields[:count]) if plain else record


def _completed(record: DyrRecord, report: Report) -> DyrRecord:
    """A WTARA1 with a field before Ka, or a WTDTA1 of one mass without Dshaft, as the published record."""
    fields = record.fields
    if record.model == "WTARA1" and len(fields) == 3:
        report.assume("first of three fields of WTARA1 ignored: Ka and theta0 follow", record.where)
        return dataclasses.replace(record, fields=fields[1:])
    if record.model == "WTDTA1" and len(fields) == 4 and not fields[2].strip("0.-+"):
        report.assume("WTDTA1 without Dshaft, which a single mass does not have", record.where)
        return dataclasses.replace(record, fields=(*fields, "0"))
    return record


def _unknown(record: DyrRecord, records: Collection[str]) -> str:
    model = record.model
    if record.user and model not in _WHY:
        advice = f"; define it as a device named {model} and give its file with --device"
    elif model in CONVERTERS:
        advice = f": {_WHY[model]}{CURRENTS}" if model in _WHY else CURRENTS
    elif model in _WHY:
        advice = f": {_WHY[model]}; --leave-out {model} omits it"
    else:
        near = "" if model in KNOWN else nearest(model, [*MACHINES, *records])
        advice = f"; {near}" if near else ""
        advice += f"; --leave-out {model} omits it, --replace {model}=MODEL reads it as another"
    return f"model {model!r} at bus {record.bus} is not supported{advice}"


def _round_rotor(where: str, p: dict[str, float], **kind: str) -> dict[str, Any]:
    return _saturated(where, p, kind) | {"model": "round_rotor", "Xq2": p["Xd2"]}


def _salient(where: str, p: dict[str, float], **kind: str) -> dict[str, Any]:
    return _saturated(where, p, kind) | {"model": "round_rotor", "Xq1": p["Xq"], "Xq2": p["Xd2"]}  # no Tq01


def _saturated(where: str, p: dict[str, float], kind: dict[str, str]) -> dict[str, Any]:
    """The fields of a record, its saturation as a table; S(1.0) = 0 means none."""
    row: dict[str, Any] = dict(p)
    S10, S12 = row.pop("S10"), row.pop("S12")
    if S10 == 0.0:
        return row
    if not 0.0 < S10 < S12:
        raise CaseError(
            f"{where}: saturation S(1.0) = {S10:g}, S(1.2) = {S12:g}, allowed: both rising, or S(1.0) = 0"
        )
    return row | {"flux_saturation": {"S10": S10, "S12": S12} | kind}


def _gencls(where: str, p: dict[str, float]) -> dict[str, Any]:
    H = p["H"]
    if H == 0.0:
        return {"model": "infinite_bus"}
    if not H > 0.0:
        raise CaseError(f"{where}: GENCLS with H = {H:g}, allowed: 0 (an infinite bus) or above")
    return {"model": "classical", **p}


_ROUND_ROTOR = ("Td01", "Td02", "Tq01", "Tq02", "H", "D", "Xd", "Xq", "Xd1", "Xq1", "Xd2", "Xl", "S10", "S12")
_SALIENT = ("Td01", "Td02", "Tq02", "H", "D", "Xd", "Xq", "Xd1", "Xd2", "Xl", "S10", "S12")
#: record -> its fields in order, and what makes a machine's row of them
MACHINES: dict[str, tuple[tuple[str, ...], Callable[..., dict[str, Any]]]] = {
    "GENROU": (_ROUND_ROTOR, _round_rotor),
    "GENROE": (_ROUND_ROTOR, partial(_round_rotor, shape="exponential")),
    "GENSAL": (_SALIENT, partial(_salient, of="transient_emf", axes="d")),
    "GENSAE": (_SALIENT, partial(_salient, shape="exponential")),
    "GENCLS": (("H", "D"), _gencls),
}
