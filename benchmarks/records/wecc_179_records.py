"""Nine public records of forced oscillations on 179 buses of WECC, two that the energy flow cannot locate.

    python benchmarks/records/wecc_179_records.py WECC_179.m RECORD.mat ...

From github.com/Plutoteris/DTL-Location (`Create_Sample/pf/WECC_179.m`, `More Samples`, `DEF_Invalid_Case`; no
licence is named, so they are read where they lie). The records are runs of PSAT: 29 machines at 30 samples a
second, noise at every load. There the machine that is the source has a field circuit and an exciter, which
nobody knows beforehand: the model here has all machines classical, loads of constant power. Speeds of the
last 18 s are taken; the voltages show the exciter that the model lacks. Printed: the machine that is the
source, its rank among the machines and that of its bus among all, and what `locate --case` says.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from interarea.cosim.records.model_source import source_by_model
from interarea.cosim.records.record import Channel, Record
from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case

STEP_S, FROM_S = 1.0 / 30.0, 12.0
DAMPING = 4.0  # Syn.con(:,19) of the file


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("records", type=Path, nargs="+")
    options = parser.parse_args()
    text = options.model.read_text(encoding="utf-8")
    plants, first, wrong = {}, 0, 0
    for path in options.records:
        number, scale, frequency = of_name(path.name)
        if scale not in plants:
            case = case_of(text, scale)
            plants[scale] = case, sparse_linear_plant(case, default_cache())
        case, plant = plants[scale]
        speeds = loadmat(path)["data"][0, 0]["w"][round(FROM_S / STEP_S) :, : len(case.machines)]
        names = [m.name for m in case.machines]
        channels = tuple(Channel(f"{name} speed", "speed", "pu", name) for name in names)
        record = Record(path.name, np.arange(len(speeds)) * STEP_S, speeds, channels)
        answer = source_by_model(record, case, plant, frequency_hz=frequency, most=400)
        truth = case.machines[number - 1]
        one = [c for c in answer.candidates if len(c.places) == 1]
        of_bus = list(dict.fromkeys(c.at[0] for c in one))
        of_machines = [c.places[0] for c in one if c.kinds[0] == "mechanical power"]
        first += of_machines[0] == truth.name
        wrong += answer.source is not None and f"bus{truth.bus}" not in answer.source.at
        print(
            f"{path.name}: {truth.name} at {frequency:g} Hz; bus {of_bus.index(f'bus{truth.bus}') + 1} of "
            f"{len(of_bus)}, machine {of_machines.index(truth.name) + 1} of {len(names)}; {answer.why}"
        )
    print(f"first of the machines {first} of {len(options.records)}, named but wrong {wrong}")


def of_name(name):
    """Return number of the machine, factor on the loads and frequency, Hz."""
    number = int(re.match(r"V?(\d+)", name)[1])
    scale = re.search(r"PQ_([\d.]+)Pf", name)
    return (
        number,
        float(scale[1]) if scale else 1.0,
        float(re.search(r"(?:Pf|f)_([\d.]+?)(?:_|\.mat)", name)[1]),
    )


def table(text, name):
    """Return a matrix of a PSAT file."""
    body = re.search(re.escape(name) + r"\s*=\s*\[(?:\s*\.\.\.)?(.*?)\];", text, re.DOTALL)[1]
    rows = [row.split("%")[0].split() for row in re.split(r"[;\n]", body)]
    return np.array([[float(x) for x in row] for row in rows if row and row[0][0] in "0123456789"])


def case_of(text, scale):
    """Return the grid of the file with all loads times `scale`, all machines classical."""
    inertia = re.search(r"M = 2\*\[ \.\.\.(.*?)\];", text, re.DOTALL)[1].replace(";", " ").split()
    slack = table(text, "SW.con")[0]
    regulated = {int(row[0]): (row[3] * row[1], row[4]) for row in table(text, "PV.con")}
    lines = ['name = "wecc-179-psat"', 'title = "WECC 179"', 'source = "WECC_179.m"', "frequency_hz = 60.0"]
    machines = table(text, "Syn.con")
    lines += ["base_mva = 100.0", f'swing = ["G{int(machines[0][0])}", "G{int(machines[-1][0])}"]', "[buses]"]
    lines += [f"{int(row[0])} = {{ kv = {row[1]} }}" for row in table(text, "Bus.con")]
    lines.append("[branches]")
    for k, row in enumerate(table(text, "Line.con")):
        a, b = int(row[0]), int(row[1])
        tap = f', kind = "transformer", tap = {row[10] or 1.0}, shift_deg = {row[11]}'
        changes = row[6] > 0.0 or row[10] > 0.0 or row[11] != 0.0
        more = tap if changes else ""
        lines.append(
            f'"{a}-{b} {k}" = {{ from = {a}, to = {b}, r = {row[7]}, x = {row[8]}, b = {row[9]}{more} }}'
        )
    lines.append("[shunts]")
    for k, row in enumerate(table(text, "Shunt.con")):
        lines.append(f"S{k} = {{ bus = {int(row[0])}, P_mw = {100 * row[4]}, Q_mvar = {100 * row[5]} }}")
    lines.append("[loads]")
    for row in table(text, "PQ.con"):
        power = f"P_mw = {100 * scale * row[3]}, Q_mvar = {100 * scale * row[4]}"
        lines.append(
            f"L{int(row[0])} = {{ bus = {int(row[0])}, {power}, P_exponent = 0.0, Q_exponent = 0.0 }}"
        )
    lines.append("[machines]")
    for row, H in zip(machines, inertia, strict=True):
        bus = int(row[0])
        P, V = regulated.get(bus, (slack[9] * slack[1], slack[3]))
        more = ", slack = true" if bus == int(slack[0]) else ""
        lines.append(
            f'G{bus} = {{ bus = {bus}, base_mva = {row[1]}, model = "classical", H = {H}, D = {DAMPING}, '
            f"Xd1 = {row[8]}, P_mw = {P}, V_pu = {V}{more} }}"
        )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "wecc-179-psat.toml"
        path.write_text("\n".join(lines), encoding="utf-8")
        return load_case(str(path))


if __name__ == "__main__":
    main()
