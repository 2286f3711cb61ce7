"""A case written as PSS/E RAW and DYR and as MATPOWER, for the tests of the import and of malformed files."""

from __future__ import annotations

import re
from pathlib import Path

from interarea.models.case.case import Case, load_case


def pair_with(folder: Path, record: str) -> tuple[Path, Path]:
    """Write `kundur-pss` as RAW and DYR, with `record` in place of the unit at bus 4; return both files."""
    case = load_case("kundur-pss")
    lines = re.split(r"(?<=/)\s*\n", dyr_text(case))
    rest = [line for line in lines if not line.strip().startswith("4 ")]
    (folder / "grid.dyr").write_text("\n".join(rest) + "\n" + record)
    (folder / "grid.raw").write_text(raw_text(case))
    return folder / "grid.raw", folder / "grid.dyr"


def raw_text(case: Case) -> str:
    """Write the network of `case` as a RAW file: transformers with the ratio split over both windings."""
    machines = {m.bus: m for m in case.machines}
    ide = {bus: 3 if m.slack else 2 for bus, m in machines.items()}
    lines = [f"0, {case.base_mva}, 33, 0, 1, {case.frequency_hz} / made by a test", "one", "two"]
    for bus in case.buses:
        angle = case.slack.angle_deg if ide.get(bus.number) == 3 else 0.0
        lines.append(
            f"{bus.number},'a/b, {bus.number}',0.0,{ide.get(bus.number, 1)},{bus.area},1,1,1.0,{angle}"
        )
    lines.append("0 / END OF BUS DATA")
    lines += [f"{q.bus},'1 ',1,1,1,{q.P_mw},{q.Q_mvar},0,0,0,0,1,1" for q in case.loads]
    lines.append("0 / END OF LOAD DATA")
    lines += [f"{s.bus},'1 ',1,{s.P_mw},{s.Q_mvar}" for s in case.shunts]
    lines.append("0 / END OF FIXED SHUNT DATA")
    for m in case.machines:
        lines.append(
            f"{m.bus},'1 ',{m.P_mw},0,99,-99,{m.V_pu},0,{m.base_mva},{m.Ra},{m.Xd1},0,0,1,1,100,999,0"
        )
    lines.append("0 / END OF GENERATOR DATA")
    circuits = {b.name: f"{k}" for k, b in enumerate(case.branches)}
    for b in case.branches:
        if b.kind == "line":
            zeros = "0,0,0,0,0,0,0"
            row = f"{b.from_bus},{-b.to_bus},'{circuits[b.name]}',{b.r!r},{b.x!r},{b.b!r},{zeros}"
            lines.append(f"{row},{int(b.in_service)},1,0")
    lines.append("0 / END OF BRANCH DATA")
    turns = 1.25
    for b in case.branches:
        if b.kind == "transformer":
            head = f"{b.from_bus},{b.to_bus},0,'{circuits[b.name]}',1,2,1,0,0,1,'T',1"
            scale = 5.0 / turns**2  # own base of 500 MVA, ratio of the second winding 1.25
            lines += [head, f"{b.r * scale!r},{b.x * scale!r},{5.0 * case.base_mva}"]
            lines += [f"{b.tap * turns!r},0.0,{b.shift_deg}", f"{turns},0.0"]
    lines += ["0 / END OF TRANSFORMER DATA", "0", "0", "Q"]
    return "\n".join(lines) + "\n"


def dyr_text(case: Case) -> str:
    """Write machines, static exciters and stabilizers of `case` as a DYR file."""
    lines = ["// made by a test"]
    for m in case.machines:
        lines.append(f"{m.bus} 'GENROU' 1 {m.Td01} {m.Td02} {m.Tq01} {m.Tq02} {m.H} {m.D} {m.Xd}")
        lines.append(f"   {m.Xq} {m.Xd1} {m.Xq1} {m.Xd2} {m.Xl} 0.0 0.0 /")
        e = m.exciter
        if e.kind == "static":
            lines.append(f"{m.bus} 'EXST1' 1 {e.TR} 9 -9 0 0 {e.KA} {e.TA} 5 -5 0 0 1 /")
        s = m.stabilizer
        if s is not None:
            stages = f"{s.T1} {s.T2} {s.T3} {s.T4} {s.Tw} {s.Tw} {s.K}"
            lines.append(f"{m.bus} 'IEEEST' 1 1 0 0 0 0 0 0 0 {stages} {s.Vs_max} {s.Vs_min} 0 0 /")
    return "\n".join(lines) + "\n"


def matpower_text(case: Case) -> str:
    """Write the network of `case` as a MATPOWER case."""
    machines = {m.bus: m for m in case.machines}
    loads, shunts = {q.bus: q for q in case.loads}, {s.bus: s for s in case.shunts}
    lines = [
        "function mpc = grid",
        "mpc.version = '2'; % text",
        f"mpc.baseMVA = {case.base_mva};",
        "mpc.bus = [",
    ]
    for bus in case.buses:
        k = bus.number
        kind = 1 if k not in machines else 3 if machines[k].slack else 2
        load, shunt = loads.get(k), shunts.get(k)
        p, q = (load.P_mw, load.Q_mvar) if load else (0, 0)
        b = shunt.Q_mvar if shunt else 0
        angle = case.slack.angle_deg if kind == 3 else 0
        lines.append(f"\t{k} {kind} {p} {q} 0 {b} {bus.area} 1 {angle} 230 1 1.1 0.9;")
    lines += ["];", "mpc.gen = ["]
    lines += [f"\t{m.bus}, {m.P_mw}, 0, 99, -99, {m.V_pu}, {m.base_mva}, 1, 999, 0;" for m in case.machines]
    lines += ["];", "mpc.branch = ["]
    for b in case.branches:
        tap = b.tap if b.kind == "transformer" else 0
        lines.append(
            f"\t{b.from_bus} {b.to_bus} {b.r!r} {b.x!r} {b.b!r} 0 0 0 {tap!r} {b.shift_deg} 1 -360 360;"
        )
    return "\n".join([*lines, "];"]) + "\n"
