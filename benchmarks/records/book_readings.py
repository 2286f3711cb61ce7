"""Other readings of Kundur's Example 12.6 beside its printed swing modes; the stabilizer those need.

    python benchmarks/records/book_readings.py [--andes-python PYTHON]

Reads book_readings.toml. The first column of numbers tells how far the farthest of the six printed
numbers is, in half units of its last digit: 1 or less reaches the digits. Exit code 1 when a mode
is not the one recorded there. With --andes-python, ANDES 2.0 gives two readings more, without saturation
of the machines: the stabilizers on the machines' speed and on the frequency of their buses.
"""

from __future__ import annotations

import argparse
import sys
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import control
import numpy as np

sys.path.extend(str(Path(__file__).resolve().parent / name) for name in ("..", "../peers"))
from andes_rows import load_mix, rows_of
from compare_andes import ask, unsaturated

from interarea.cosim.run.artefacts import linear_plant
from interarea.design.modes.modes import modes_of
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import Case, load_case

FOLDER = Path(__file__).resolve().parent
PRINTED = FOLDER.parents[1] / "tests" / "published" / "swing_kundur.toml"
NAMES = ("inter-area", "local area 1", "local area 2")
#: half units of the last digit of (real, imaginary) part in the printed rows
HALF = (5e-4, 5e-3)
RECORDED = 1.01e-4  #: 1/s, two units of the last digit written in the file


def readings() -> Iterator[tuple[str, str, dict[str, Any], tuple[complex, ...], bool]]:
    """Yield (case, what, change, recorded modes, whether all digits are said to be reached)."""
    for row in tomllib.loads((FOLDER / "book_readings.toml").read_text(encoding="utf-8"))["case"]:
        first = {"what": "as the case stands", "gives": row["gives"]}
        for reading in [first, *row["reading"]]:
            modes = tuple(map(complex, reading["gives"]))
            yield row["name"], reading["what"], reading.get("change", {}), modes, reading.get("digits", False)


def printed(name: str) -> tuple[complex, ...]:
    """Return the printed swing modes of the case, in the order of NAMES."""
    rows = tomllib.loads(PRINTED.read_text(encoding="utf-8"))["row"]
    eigenvalues = {r["mode"]: complex(float(r["real"]), float(r["imag"])) for r in rows if r["case"] == name}
    return tuple(eigenvalues[mode] for mode in NAMES)


def computed_modes(case: Case) -> tuple[complex, ...]:
    """Return the swing modes of the case's plant FMU, in the order of NAMES."""
    modes = modes_of(linear_plant(case, default_cache()), case.areas)
    return tuple(modes[name].eigenvalue for name in NAMES)


def half_units(ours: Sequence[complex], printed: Sequence[complex]) -> float:
    """Return the largest distance of a printed number, in half units of its last digit."""
    differences = [z - w for z, w in zip(ours, printed, strict=True)]
    return max(max(abs(d.real) / HALF[0], abs(d.imag) / HALF[1]) for d in differences)


def stabilizer_needed(system: control.StateSpace, at: complex, near: complex) -> complex:
    """Return the transfer from speed (pu) to `vs` (pu), equal on all machines, that puts a pole at `at`.

    With G the transfer matrix from the stabilizers' summing points to the speeds, H G must have the
    eigenvalue 1 at the pole: H = 1/eig G(at). Of the N solutions the one next to `near` is meant.
    """
    A, B, C, D = (np.asarray(matrix) for matrix in (system.A, system.B, system.C, system.D))
    speeds = [k for k, name in enumerate(system.output_labels) if name.endswith("_dw")]
    G = C[speeds] @ np.linalg.solve(at * np.eye(len(A)) - A, B) + D[speeds]
    eigenvalues = 1.0 / np.linalg.eigvals(G)
    return complex(eigenvalues[np.argmin(abs(eigenvalues - near))])


def stabilizer_of_the_book(s: complex) -> complex:
    """Return 20 . 10s/(1+10s) . (1+.05s)/(1+.02s) . (1+3s)/(1+5.4s)."""
    return 20 * 10 * s / (1 + 10 * s) * (1 + 0.05 * s) / (1 + 0.02 * s) * (1 + 3 * s) / (1 + 5.4 * s)


def on_bus_frequency(rows: list[tuple[str, dict[str, Any]]]) -> list[tuple[str, dict[str, Any]]]:
    """Return ANDES's rows with every stabilizer on the frequency of its machine's bus, filtered by 1 ms."""
    bus_of = {row["gen"]: row["bus"] for model, row in rows if model == "GENROU"}
    meters = [
        ("BusFreq", {"idx": f"{name} frequency", "bus": bus, "Tf": 1e-3, "Tw": 1e-3, "fn": 60.0})
        for name, bus in bus_of.items()
    ]
    changed = [
        (model, row | {"MODE": 2, "busf": row["idx"].replace("stabilizer", "frequency")})
        if model == "IEEEST"
        else (model, row)
        for model, row in rows
    ]
    network = [pair for pair in changed if pair[0] != "IEEEST"]
    return network + meters + [pair for pair in changed if pair[0] == "IEEEST"]


def modes_in_andes(python: str) -> None:
    """Print the swing modes of the stabilized example in ANDES, by speed and by bus frequency."""
    case = unsaturated(load_case("kundur-pss"))
    problem = {"loads": load_mix(case), "frequency_hz": case.frequency_hz, "base_mva": case.base_mva}
    print(f"\n{case.name} in ANDES")
    for what, rows in (("speed", rows_of(case)), ("bus frequency", on_bus_frequency(rows_of(case)))):
        eigenvalues = [complex(*pair) for pair in ask(python, problem | {"rows": rows})["eigenvalues"]]
        swing = sorted(
            (z for z in eigenvalues if 2.5 < z.imag < 10.0 and z.real > -3.2), key=lambda z: z.imag
        )
        print(f"  stabilizers on {what:71}", *(f"{z.real:8.4f}{z.imag:+8.4f}j" for z in swing))


def main() -> int:
    """Print the tables; return 1 when a recorded mode does not come out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--andes-python", help="interpreter that has ANDES 2.0")
    options = parser.parse_args()
    differs, last = 0, ""
    for name, what, change, recorded, _ in readings():
        printed_modes = printed(name)
        if name != last:
            print(f"\n{name}\n  {'printed':86}", *(f"{z.real:8.3f}{z.imag:+6.2f}j  " for z in printed_modes))
            last = name
        case = load_case(name)
        ours = computed_modes(case.with_changes(change) if change else case)
        same = len(recorded) == 3 and max(abs(np.subtract(ours, recorded))) <= RECORDED
        differs |= not same
        print(
            f"  {what:80} {half_units(ours, printed_modes):5.1f}",
            *(f"{z.real:8.4f}{z.imag:+8.4f}j" for z in ours),
            "" if same else "NOT AS RECORDED",
        )
    print("\nThe stabilizer that the printed modes need, beside the printed constants' (gain, degrees)")
    system = linear_plant(load_case("kundur-thyristor"), default_cache())
    for pole in printed("kundur-pss"):
        stabilizer = stabilizer_of_the_book(pole)
        needed = stabilizer_needed(system, pole, stabilizer)
        numbers = (f"{abs(z):7.3f} {np.degrees(np.angle(z)):6.2f}" for z in (needed, stabilizer))
        print(f"  {pole:+.3f}   ", "     ".join(numbers))
    if options.andes_python:
        modes_in_andes(options.andes_python)
    return int(differs)


if __name__ == "__main__":
    sys.exit(main())
