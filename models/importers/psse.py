"""Read a grid from PSS/E: network from a RAW file of version 33, dynamic data from a DYR file.

What has no counterpart here is refused with its file and line, never dropped silently. Left aside because
it plays no part in these models: ratings, reactive limits, owners, zones, interchange, line grouping,
regulated taps and switched shunts (taps stay, switched shunts are fixed at BINIT).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..case.case import Case, CaseError, case_of
from .psse_branches import read_branches
from .psse_dyr import machine_dynamics
from .psse_records import Record, read_raw

_REFUSED = ("two-terminal dc", "vsc dc", "multi-terminal dc", "FACTS", "GNE", "induction machine")


def import_psse(
    raw: str | Path,
    dyr: str | Path | None = None,
    *,
    name: str | None = None,
    P_exponent: float = 2.0,
    Q_exponent: float = 2.0,
) -> Case:
    """Return the grid of a PSS/E RAW (version 33) and DYR file.

    Without `dyr` the machines have no dynamic data (model power_flow). A RAW file does not tell how loads
    follow the voltage: all get the two exponents. Generators out of service are left out and counted in the
    source of their table.

    Raises
    ------
    CaseError : another version, a truncated or malformed record, equipment or a model that is not supported
        (each with file and line), or a value that the case refuses.
    """
    path = Path(raw)
    header, sections = read_raw(path)
    reader = _Raw(path, header, sections, {"P_exponent": float(P_exponent), "Q_exponent": float(Q_exponent)})
    document = reader.document(name or path.stem)
    if dyr is not None:
        dynamics = machine_dynamics(Path(dyr), reader.machine_of, reader.machine_lines, reader.out)
        for key, rows in dynamics.items():
            document["machines"][key] |= rows
        document["source"] += f" and {Path(dyr).name}"
    try:
        return case_of(document, where=str(path))
    except CaseError as error:
        machine = re.search(r"machines\.(\w+)", str(error))
        where = reader.machine_lines.get(machine.group(1)) if machine else None
        raise CaseError(f"{error} (given at {where})" if where else str(error)) from None


class _Raw:
    """The sections of one RAW file on their way to the document of a case."""

    def __init__(
        self, path: Path, header: Record, sections: Mapping[str, list[Record]], exponents: dict[str, float]
    ) -> None:
        self.path, self.sections, self.exponents = path, sections, exponents
        self.base_mva = header.number(1, "SBASE", 100.0)
        self.frequency_hz = header.number(5, "BASFRQ", 60.0)
        self.kv: dict[int, float] = {}
        self.kind: dict[int, int] = {}
        self.area: dict[int, int] = {}
        self.angle: dict[int, float] = {}
        self.machine_of: dict[tuple[int, str], str] = {}  #: (bus, id) -> name
        self.machine_lines: dict[str, str] = {}  #: name -> file:line
        self.out: set[tuple[int, str]] = set()  #: machines out of service

    def document(self, name: str) -> dict[str, Any]:
        for section in _REFUSED:
            for record in self.sections[section][:1]:
                raise CaseError(
                    f"{record.where}: {section} data has no counterpart here; take it out or replace it"
                )
        buses = self._buses()
        shunts = self._shunts()
        machines = self._machines()
        loads = self._loads(shunts)
        branches = read_branches(
            self.sections["branch"], self.sections["transformer"], self.kind, self.kv, self.base_mva, shunts
        )
        for key, rows in (
            ("shunts", shunts),
            ("loads", loads),
            ("machines", machines),
            ("branches", branches),
        ):
            left_out = f"; {len(self.out)} out of service left out" if self.out and key == "machines" else ""
            rows["source"] = self.path.name + left_out
        return {
            "name": re.sub(r"[^A-Za-z0-9_.-]+", "-", name),
            "source": f"imported from {self.path.name} (PSS/E)",
            "frequency_hz": self.frequency_hz,
            "base_mva": self.base_mva,
            "buses": buses,
            "branches": branches,
            "shunts": shunts,
            "loads": loads,
            "machines": machines,
        }

    def _buses(self) -> dict[str, Any]:
        buses: dict[str, Any] = {}
        for record in self.sections["bus"]:
            number = record.whole(0, "bus number")
            if number in self.kind:
                raise CaseError(f"{record.where}: bus {number} is given twice, allowed: once")
            self.kind[number] = record.whole(3, "IDE", 1)
            self.kv[number] = record.number(2, "BASKV", 0.0)
            self.area[number] = max(record.whole(4, "AREA", 1), 1)
            self.angle[number] = record.number(8, "VA", 0.0)
            if self.kind[number] == 4:
                continue
            row: dict[str, Any] = {"area": self.area[number]}
            if record.text(1, "NAME"):
                row["name"] = record.fields[1]
            if self.kv[number] > 0.0:
                row["kv"] = self.kv[number]
            buses[str(number)] = row
        return buses

    def _bus(self, record: Record, k: int, what: str, *, active: bool = True) -> int:
        return record.bus(k, what, self.kind, active=active)

    def _names(self, records: list[Record], letter: str) -> Callable[[Record], str]:
        count = Counter(record.whole(0, "bus") for record in records)
        first: dict[tuple[int, str], str] = {}

        def name_of(record: Record) -> str:
            bus = record.whole(0, "bus")
            where = first.setdefault((bus, record.text(1, "ID")), record.where)
            if where != record.where:
                raise CaseError(
                    f"{record.where}: ID {record.fields[1]!r} at bus {bus} is given twice, first at {where}"
                )
            if count[bus] == 1:
                return f"{letter}{bus}"
            identity = re.sub(r"[^A-Za-z0-9_]", "_", record.text(1, "ID"))
            return f"{letter}{bus}_{identity}"

        return name_of

    def _loads(self, shunts: dict[str, Any]) -> dict[str, Any]:
        loads: dict[str, Any] = {}
        name_of = self._names(self.sections["load"], "L")
        for record in self.sections["load"]:
            on = record.whole(2, "STATUS", 1) == 1
            bus = self._bus(record, 0, "bus", active=on)
            if self.kind[bus] == 4:
                continue
            p, q, ip, iq, yp, yq = (
                record.number(k, key, 0.0)
                for k, key in enumerate(("PL", "QL", "IP", "IQ", "YP", "YQ"), start=5)
            )
            if ip or iq:
                raise CaseError(
                    f"{record.where}: IP = {ip:g}, IQ = {iq:g}: a constant-current part in the power flow, "
                    "allowed: PL, QL and YP, YQ"
                )
            name = name_of(record)
            if yp or yq:
                shunts[f"{name}_Y"] = {"bus": bus, "P_mw": yp, "Q_mvar": yq, "in_service": on}
            loads[name] = {"bus": bus, "P_mw": p, "Q_mvar": q, "in_service": on, **self.exponents}
        return loads

    def _shunts(self) -> dict[str, Any]:
        shunts: dict[str, Any] = {}
        name_of = self._names(self.sections["fixed shunt"], "C")
        for record in self.sections["fixed shunt"]:
            on = record.whole(2, "STATUS", 1) == 1
            bus = self._bus(record, 0, "bus", active=on)
            if self.kind[bus] != 4:
                shunts[name_of(record)] = {
                    "bus": bus,
                    "P_mw": record.number(3, "GL", 0.0),
                    "Q_mvar": record.number(4, "BL", 0.0),
                    "in_service": on,
                }
        for record in self.sections["switched shunt"]:
            on = record.whole(3, "STAT", 1) == 1
            bus = self._bus(record, 0, "bus", active=on)
            if f"S{bus}" in shunts:
                raise CaseError(f"{record.where}: second switched shunt at bus {bus}, allowed: one")
            if self.kind[bus] != 4:
                shunts[f"S{bus}"] = {"bus": bus, "Q_mvar": record.number(9, "BINIT", 0.0), "in_service": on}
        return shunts

    def _machines(self) -> dict[str, Any]:
        machines: dict[str, Any] = {}
        name_of = self._names(self.sections["generator"], "G")
        swing_done: set[int] = set()
        for record in self.sections["generator"]:
            on = record.whole(14, "STAT", 1) == 1
            bus = self._bus(record, 0, "bus", active=on)
            identity = record.text(1, "ID")
            if not on:
                self.out.add((bus, identity))
                continue
            if self.kind[bus] not in (2, 3):
                raise CaseError(
                    f"{record.where}: generator in service at a bus of IDE = {self.kind[bus]}, allowed: 2, 3"
                )
            regulated = record.whole(7, "IREG", 0)
            if regulated not in (0, bus):
                raise CaseError(
                    f"{record.where}: IREG = {regulated}: remote regulation, allowed: 0 or the own bus"
                )
            if record.number(11, "RT", 0.0) or record.number(12, "XT", 0.0):
                raise CaseError(
                    f"{record.where}: RT, XT: step-up transformer inside the generator, allowed: 0"
                )
            name = name_of(record)
            machines[name] = {
                "bus": bus,
                "area": self.area[bus],
                "model": "power_flow",
                "base_mva": record.number(8, "MBASE", self.base_mva),
                "Ra": record.number(9, "ZR", 0.0),
                "Xd1": record.number(10, "ZX", 1.0),
                "P_mw": record.number(2, "PG", 0.0),
                "V_pu": record.number(6, "VS", 1.0),
            }
            if self.kind[bus] == 3 and bus not in swing_done:
                swing_done.add(bus)
                machines[name] |= {"slack": True, "angle_deg": self.angle[bus]}
            self.machine_of[bus, identity] = name
            self.machine_lines[name] = record.where
        return machines
