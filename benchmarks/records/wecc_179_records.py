"""Nine public records of forced oscillations on 179 buses of WECC, two that the energy flow cannot locate.

    python benchmarks/records/wecc_179_records.py WECC_179.m RECORD.mat ...

From github.com/Plutoteris/DTL-Location (`Create_Sample/pf/WECC_179.m`, `More Samples`, `DEF_Invalid_Case`; no
licence is named, so they are read where they lie). The records are runs of PSAT: 29 machines at 30 samples a
second, noise at every load. There the machine that is the source has a field circuit and an exciter, which
nobody knows beforehand: the model here has all machines classical, loads of constant power. Speeds of the
last 18 s are taken; the voltages show the exciter that the model lacks. Printed: the machine that is the
source, its rank among the machines and that of its bus among all, and what `locate --case` says.

The file has one rule for the machine where the oscillation comes in: a field circuit and a voltage regulator.
So the kind is asked in a second step, with them at the machine that came first: the torque or the reference,
whichever leaves less; sure where that leaves 4 % at most and the other twice as much.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from interarea.cosim.records.model_source import CLEAR, EXPLAINED, MECHANICAL, REFERENCE, source_by_model
from interarea.cosim.records.record import Channel, Record
from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case

STEP_S, FROM_S = 1.0 / 30.0, 12.0
DAMPING = 4.0  # Syn.con(:,19) of the file
#: the source in the file: order 3 (no damper windings, here ones that do nothing), first-order regulator
FIELD_CIRCUIT = (
    'model = "round_rotor", D = 0.0, Ra = 0.0, Xl = 0.0, Xd = 1.4463, Xd1 = 0.3855, Xd2 = 0.3854, '
    "Xq = 1.4081, Xq1 = 1.408, Xq2 = 1.4079, Td01 = 7.741, Td02 = 0.01, Tq01 = 0.1, Tq02 = 0.01, exciter = "
    '{ kind = "sexs", TA_TB = 1.0, TB = 1.0, K = 300.0, TE = 0.05, EMIN = -10.0, EMAX = 10.0 }'
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("records", type=Path, nargs="+")
    options = parser.parse_args()
    text = options.model.read_text(encoding="utf-8")
    plants, first, wrong, right, sure, sure_and_wrong = {}, 0, 0, 0, 0, 0
    for path in options.records:
        number, scale, frequency = of_name(path.name)
        if scale not in plants:
            case = case_of(text, scale)
            plants[scale] = case, sparse_linear_plant(case, default_cache())
        case, plant = plants[scale]
        names = [m.name for m in case.machines]
        record = record_of(path, names)
        answer = source_by_model(record, case, plant, frequency_hz=frequency, most=400)
        truth = case.machines[number - 1]
        one = [c for c in answer.candidates if len(c.places) == 1]
        of_bus = list(dict.fromkeys(c.at[0] for c in one))
        of_machines = [c.places[0] for c in one if c.kinds[0] == MECHANICAL]
        first += of_machines[0] == truth.name
        wrong += answer.source is not None and f"bus{truth.bus}" not in answer.source.at
        print(
            f"{path.name}: {truth.name} at {frequency:g} Hz; bus {of_bus.index(f'bus{truth.bus}') + 1} of "
            f"{len(of_bus)}, machine {of_machines.index(truth.name) + 1} of {len(names)}; {answer.why}"
        )
        kind, k = REFERENCE if path.name.startswith("V") else MECHANICAL, names.index(of_machines[0])
        if (scale, k) not in plants:
            other = case_of(text, scale, source=k)
            plants[scale, k] = other, sparse_linear_plant(other, default_cache())
        answer = source_by_model(record, *plants[scale, k], frequency_hz=frequency, most=400)
        left = {
            c.kinds[0]: c.unexplained
            for c in answer.candidates
            if len(c.places) == 1 and c.places[0] == names[k] and c.kinds[0] in (MECHANICAL, REFERENCE)
        }
        best, other = sorted(left, key=left.__getitem__)
        is_sure = left[best] <= EXPLAINED and left[other] >= CLEAR * left[best]
        is_right = names[k] == truth.name and best == kind
        right, sure, sure_and_wrong = (
            right + is_right,
            sure + is_sure,
            sure_and_wrong + (is_sure and not is_right),
        )
        print(
            f"  kind: {best} leaves {left[best]:.2%}, {other} {left[other]:.2%}; it is {kind}"
            f"{', sure' if is_sure else ''}",
            flush=True,
        )
    print(f"first of the machines {first} of {len(options.records)}, named but wrong {wrong}")
    print(f"machine and kind right {right}, kind sure {sure}, sure and wrong {sure_and_wrong}")


def record_of(path, names):
    """Return the speeds of a record, pu."""
    speeds = loadmat(path)["data"][0, 0]["w"][round(FROM_S / STEP_S) :, : len(names)]
    channels = tuple(Channel(f"{name} speed", "speed", "pu", name) for name in names)
    return Record(path.name, np.arange(len(speeds)) * STEP_S, speeds, channels)


def of_name(name):
    """Return number of the machine, factor on the loads and frequency, Hz."""
    number, f = re.match(r"V?(\d+)", name), re.search(r"(?:Pf|f)_([\d.]+?)(?:_|\.mat)", name)
    if number is None or f is None:
        raise SystemExit(f"{name}: is no record of DTL-Location, wanted: such as V17_amp_0.1_f_0.6.mat")
    scale = re.search(r"PQ_([\d.]+)Pf", name)
    return int(number[1]), float(scale[1]) if scale else 1.0, float(f[1])


def table(text, name):
    """Return a matrix of a PSAT file."""
    body = re.search(re.escape(name) + r"\s*=\s*\[(?:\s*\.\.\.)?(.*?)\];", text, re.DOTALL)[1]
    rows = [row.split("%")[0].split() for row in re.split(r"[;\n]", body)]
    return np.array([[float(x) for x in row] for row in rows if row and row[0][0] in "0123456789"])


def case_of(text, scale, source=None):
    """Return the grid of the file, its first and last load times `scale`.

    source : number of the machine that has a field circuit and a regulator; the others are classical.
    """
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
    loads = table(text, "PQ.con")
    for row in loads:
        factor = scale if row[0] in (loads[0][0], loads[-1][0]) else 1.0  # PQ.con([1,104],[4,5]) of the file
        power = f"P_mw = {100 * factor * row[3]}, Q_mvar = {100 * factor * row[4]}"
        lines.append(
            f"L{int(row[0])} = {{ bus = {int(row[0])}, {power}, P_exponent = 0.0, Q_exponent = 0.0 }}"
        )
    lines.append("[machines]")
    for k, (row, H) in enumerate(zip(machines, inertia, strict=True)):
        bus = int(row[0])
        P, V = regulated.get(bus, (slack[9] * slack[1], slack[3]))
        more = ", slack = true" if bus == int(slack[0]) else ""
        model = f'model = "classical", D = {DAMPING}, Xd1 = {row[8]}'
        if k == source:
            model = FIELD_CIRCUIT
        lines.append(
            f"G{bus} = {{ bus = {bus}, base_mva = {row[1]}, {model}, H = {H}, P_mw = {P}, V_pu = {V}{more} }}"
        )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "wecc-179-psat.toml"
        path.write_text("\n".join(lines), encoding="utf-8")
        return load_case(str(path))


if __name__ == "__main__":
    main()
