"""Time records of other programs against the plant: PSS/E, PowerWorld, OpenIPSL, as far as their models go.

    python benchmarks/records/read_traces.py MANIFEST.toml [--only ID ...] [--psse-steps] [--late-limits]

MANIFEST lists records: RAW, DYR, event, CSV with the columns time_s, NAME_unit (formats as in the folders of
PowerSimulationsDynamics.jl and PowerDynamics.jl). Of every column that the plant has (bus voltage, rotor
angle, speed, power, field voltage, mechanical power) the largest difference is printed as a share of the
column's range; behind a slash what of it lies beyond half a unit of the last digit printed in the record.
With --psse-steps the same equations are integrated as PSS/E does it, at the record's step (psse_steps.py);
those of PowerWorld's record by Heun's rule. With --late-limits the field voltage stays on a limit as long as
the record's solver left it there (EXST1 of OpenIPSL).
Three records of PSS/E were not made with the data kept beside them, each by one number, and PowerWorld's has
another governor than PSS/E's of that name; --as-given leaves number and governor as they are. docs/book.md
has the tables. Exit code 1 when a column is off by more than 1e-3 of its range.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

sys.path.extend(str(Path(__file__).resolve().parent / name) for name in (".", ".."))
from fmpy.fmi1 import FMICallException
from fmu_run import PlantSlave
from psse_steps import held_field_steps, heun_steps, psse_steps, without_short_transducers

from interarea.models.case.case import Case
from interarea.models.case.events import events_of
from interarea.models.errors import CaseError
from interarea.models.grid.equilibrium import operating_point
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.psse import import_psse
from interarea.models.importers.raw.text import read_lines

WITHIN = 1e-3
# Records whose solver leaves a limit late: field voltage and what it is but for the limit.
LATE = {"EXST1": ("EXST1_EFD_pu", "EXST1_Vm1_y_pu")}
# The one number in which a run of PSS/E differed from the files kept beside its record. With the files of
# GENROE and GAST the rate of decay alone is off, by one amount all along.
CHANGES: dict[str, dict[str, Any]] = {
    "STAB1": {"frequency_hz": 60.0},  # RAW: 50
    "GENROE": {"machines": {"G102": {"D": 0.0}}},  # DYR: 0.05
    "GAST": {"machines": {"G102": {"governor": {"Dturb": 0.1}}}},  # DYR: 0
}
Array = npt.NDArray[np.float64]
_COLUMN = {
    "V": ("bus{bus}.v", 1.0),
    "Vt": ("bus{bus}.v", 1.0),
    "delta": ("{machine}.delta", 1.0),
    "dw": ("{machine}_dw", 1.0),
    "w": ("{machine}_dw", 1.0),
    "omega": ("{machine}_dw", 1.0),
    "P": ("{machine}_pe", 1.0),
    "EFD": ("{machine}.Efd", 1.0),
    "PMECH": ("{machine}.Pm", 1.0),
}


def case_of_trace(
    trace: dict[str, Any], folder: Path, exponents: tuple[float, float], *, unmodified: bool = False
) -> Case:
    """Return the grid of a record; a control of which only the constants are given takes its place."""
    raw, dyr = folder / trace["raw"], folder / trace["dyr"]
    case = import_psse(raw, dyr, options=ImportOptions(P_exponent=exponents[0], Q_exponent=exponents[1])).case
    if trace.get("tool") == "PSS/E" and not unmodified:
        case = case.with_changes(CHANGES.get(trace["id"], {}))
    change: dict[str, Any] = {}
    for place, constants in trace.get("constants", {}).items():
        model, bus = re.fullmatch(r"(\w+) at (\d+)-\w+", place).groups()  # type: ignore[union-attr]
        machine = next((m for m in case.machines if m.bus == int(bus)), None)
        if machine is None:
            raise CaseError(f"{place}: {model} is not modelled")
        if model == "DEGOV":
            undelayed = {name: value for name, value in constants.items() if name != "TD"}  # 0: no delay
            change[machine.name] = {
                "governor": {"kind": "degov" if unmodified else "degov_fed_back"} | undelayed
            }
    devices = [] if unmodified else [Path(__file__).parent / "degov_fed_back.toml"]
    return case.with_changes({"devices": devices, "machines": change}) if change else case


def events_of_trace(event: dict[str, Any], case: Case) -> list[Any]:
    """Return the disturbance of a record as events of `case`."""
    if event["kind"] == "branch_trip":
        ends = {event["from"], event["to"]}
        branch = next(b for b in case.branches if {b.from_bus, b.to_bus} == ends and b.in_service)
        row = {"kind": "branch_trip", "branch": branch.name, "start_s": event["time_s"]}
    elif event["kind"] == "bus_fault":
        row = {"kind": "bus_fault", "bus": event["bus"], "x_pu": 1e-7, "start_s": event["on_s"]}
        row["end_s"] = event["off_s"]
    else:
        machine = next(m for m in case.machines if m.bus == int(event["machine"].split("-")[0]))
        exciters = operating_point(case).controls.of("exciter")
        rest = next(d.rest for d in exciters if case.machines[d.machine].name == machine.name)
        size = event["value_pu"] - rest.instance.values["vref"]
        row = {"kind": "vref_step", "machine": machine.name, "size_pu": size, "start_s": event["time_s"]}
    return list(events_of([row], where="manifest"))


def with_low_voltage_load(case: Case, events: list[Any], pieces: int = 6) -> list[Any]:
    """Return `events` with ramps of the load during the fault: OpenIPSL's constant current below 0.5 pu.

    There it draws I kI(v), kI = a b v^(b - 1) exp(-a v^b), where the plant goes over to constant impedance,
    I v/0.5; the voltage of the load at the ends of the pieces of the fault decides.
    """
    load, fault = case.loads[0], events[0]
    ends = np.linspace(fault.start_s, fault.end_s, pieces + 1)
    times = np.clip(ends, fault.start_s + 1e-4, fault.end_s - 1e-4)
    shares = np.zeros(pieces + 1)
    for _ in range(4):
        rows = [
            {"kind": "load_step", "load": load.name, "p_pu": change * load.P_mw / case.base_mva, "q_pu": 0.0}
            | {"start_s": start, "rise_s": rise, "end_s": fault.end_s}
            for change, start, rise in zip(
                np.diff(shares, prepend=0.0).tolist(),
                [ends[0], *ends[:-1]],
                [0.0, *np.diff(ends)],
                strict=True,
            )
        ]
        result = [fault, *events_of(rows, where="load")]
        plant = PlantSlave(case, result, 0.001)
        v = plant.record([0.0, *times], [f"bus{load.bus}.v"])[1:, 0]
        plant.close()
        a, b = 1.502, 1.769
        shares = np.where(v < 0.5, a * b * v ** (b - 1.0) * np.exp(-a * v**b) / (v / 0.5) - 1.0, 0.0)
    return result


def columns(names: Iterable[str], case: Case) -> dict[str, tuple[str, Callable[[Array], Array]]]:
    """Return for each column that the plant has its variable and how it becomes the column's unit."""
    result = {}
    for name in names:
        word, _, unit = name.rpartition("_")
        first, _, second = word.rpartition("_")
        quantity, bus = (first, int(second)) if second.isdigit() else (second, case.machines[0].bus)
        machine = next((m for m in case.machines if m.bus == bus), None)
        if (
            name.count("_") > 2
            or quantity not in _COLUMN
            or (machine is None and quantity not in ("V", "Vt"))
        ):
            continue
        variable = _COLUMN[quantity][0].format(bus=bus, machine=machine.name if machine else "")
        factor = 180.0 / np.pi if unit == "deg" else 1.0
        offset = 1.0 if quantity == "w" and re.match(r"w_\d", name) else 0.0
        result[name] = variable, lambda values, f=factor, o=offset: o + f * values
    return result


def printed_half(texts: list[str]) -> Array:
    """Return half a unit of the last digit printed, for each of a column's numbers."""
    digits = max(len(re.sub(r"[eE].*|[-+.]", "", text).lstrip("0")) for text in texts)
    size = np.abs(np.array([float(text or "nan") for text in texts]))
    return 0.5 * 10.0 ** (np.floor(np.log10(np.maximum(size, 1e-30))) - digits + 1)


def compare(
    trace: dict[str, Any],
    folder: Path,
    whole: dict[str, Any],
    *,
    two_steps: bool,
    unmodified: bool = False,
    late_limits: bool = False,
) -> dict[str, tuple[float, float]]:
    """Return the largest difference of each column, and that beyond its digits, as shares of its range."""
    exponents = (1.0, 2.0) if "constant current" in whole.get("load_model", "") else (2.0, 2.0)
    if "constant current" in trace.get("load_model", "") or "constant-current" in str(trace["models"]):
        exponents = (1.0, 1.0)
    case = case_of_trace(trace, folder, exponents, unmodified=unmodified)
    h = trace.get("nominal_step_s", 0.0)
    if two_steps and h:
        case = without_short_transducers(case, h)
    events = events_of_trace(trace.get("event", whole.get("event")), case)
    if "kI(v)" in whole.get("load_model", ""):
        events = with_low_voltage_load(case, events)
    lines = list(read_lines(folder / trace["csv"]))
    names = lines[0].strip().split(",")
    texts = [row.strip().split(",") for row in lines[1:] if row.strip()]
    data = np.array([[float(v or "nan") for v in row] for row in texts])
    columns_of_record = columns(names[1:], case)
    time = np.round(data[:, 0] / h) * h if h else data[:, 0]
    if events[0].kind == "branch_trip" and "DEGOV" in trace["id"]:
        time = data[:, 0]
    starts = [t for e in events for t in (e.start_s, getattr(e, "end_s", None)) if t is not None]
    apart = 2.0 * h if h else 1e-4
    last = np.append(np.diff(time) > 0.0, True)  # of two rows at a time the first is that before a jump
    clear = last & (time >= 0.0) & np.all([np.abs(time - t) > apart for t in starts], axis=0)
    settled = None
    if late_limits and trace["id"] in LATE:
        field, free = (data[:, names.index(name)] for name in LATE[trace["id"]])
        late = np.flatnonzero(field > free + 1e-3)[[0, -1]]
        settled = time[late], field[late]
        clear &= (time < settled[0][0]) | (time > settled[0][1] + apart)
    times, data = time[clear], data[clear]
    variables = [variable for variable, _ in columns_of_record.values()]
    plant = PlantSlave(case, events, 0.001)
    if settled is not None:
        rows = held_field_steps(plant, case, events, times, variables, settled)
    elif two_steps and h:
        steps = heun_steps if trace.get("tool") == "PowerWorld" else psse_steps
        rows = steps(plant, case, events, float(times[-1]), h, variables)[np.round(times / h).astype(int)]
    else:
        rows = plant.record(times.tolist(), variables)
    plant.close()
    result = {}
    for k, (name, (_, shown)) in enumerate(columns_of_record.items()):
        column = names.index(name)
        record, half = data[:, column], printed_half([row[column] for row in texts])[clear]
        error = np.abs(shown(rows[:, k]) - record)
        beyond = np.maximum(error - half, 0.0)
        result[name] = float(error.max() / np.ptp(record)), float(beyond.max() / np.ptp(record))
    return result


def main() -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("manifest", type=Path)
    parser.add_argument("--only", nargs="+", metavar="ID")
    parser.add_argument("--psse-steps", action="store_true", help="integrate as PSS/E does")
    parser.add_argument("--as-given", action="store_true", help="with the data as kept beside the records")
    parser.add_argument(
        "--late-limits", action="store_true", help="left as late as the record's solver left them"
    )
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    whole = tomllib.loads(options.manifest.read_text(encoding="utf-8"))
    result: dict[str, Any] = {}
    for trace in whole["trace"]:
        if options.only and trace["id"] not in options.only:
            continue
        try:
            result[trace["id"]] = compare(
                trace, options.manifest.parent, whole,
                two_steps=options.psse_steps, unmodified=options.as_given, late_limits=options.late_limits,
            )  # fmt: skip
            text = ", ".join(f"{name} {a:.1e}/{b:.1e}" for name, (a, b) in result[trace["id"]].items())
        except (CaseError, KeyError, FileNotFoundError, FMICallException) as error:
            text = f"refused: {error}"
        print(f"{trace['id']}: {text}", flush=True)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1))
    return int(any(not error <= WITHIN for row in result.values() for error, _ in row.values()))


if __name__ == "__main__":
    sys.exit(main())
