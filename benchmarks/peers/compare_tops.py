"""Power flow and swing modes of the plant FMU against tops on the same data.

    python benchmarks/peers/compare_tops.py [--tops-python PYTHON] [--json FILE]

tops, the dynamic simulator of H. Haugdal [Haugdal2024], comes with the extra `bench`; it may live in another
environment, whose interpreter `--tops-python` names. Each grid is run twice there: with tops's machine and
with the sixth-order machine of this project in its place (20 lines in tops_run.py). What is left in column
"same machine" comes from network, loads, power flow, controls and linearisation; the column "tops machine"
tells what tops's machine itself changes:

- its subtransient circuits do not act back on the transient ones (no leakage reactance);
- its mechanical input is a power, the torque is power over speed: a damping torque of Pm per pu speed;
- no armature resistance (set to 0 here too).

Exit code 1 when a bus voltage or, with the machine replaced, a swing mode differs by more than allowed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from compare_andes import PSS, TGOV1, impedance_loads
from tops_rows import LEAKAGE, case_from, tables_of

from interarea.cosim.run.artefacts import linear_plant
from interarea.design.modes.modes import modes_of
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import Case, load_case
from interarea.models.grid.powerflow import solve_powerflow

SEXS = {"kind": "static", "KA": 200.0, "TA": 0.02, "TR": 0.0, "Efd_min": -5.0, "Efd_max": 5.0}
SEXS_TGR = SEXS | {"kind": "static_tgr", "TC": 1.0, "TB": 10.0}
MANUAL = {"kind": "constant"}
#: name -> (case, controls of all machines; None: the case's own)
CASES: dict[str, tuple[str, Mapping[str, Any] | None]] = {
    "two-area, constant Efd": ("kundur-thyristor-z", {"exciter": MANUAL}),
    "two-area, static + PSS": ("kundur-thyristor-z", {"exciter": SEXS, "stabilizer": PSS}),
    "two-area, gain reduction + TGOV1": ("kundur-thyristor-z", {"exciter": SEXS_TGR, "governor": TGOV1}),
    "new-england, constant Efd": ("new-england", {"exciter": MANUAL}),
    "nets-nyps, static exciters": ("nets-nyps-no-pss", None),
    "nets-nyps, static + PSS": ("nets-nyps", None),
}
#: grids that come with tops, their machines at constant field voltage
GRIDS = ("k2a", "ieee39", "n44")
ALLOWED_VOLTAGE_PU = 1e-8
ALLOWED_EIGENVALUE = 1e-5  #: 1/s, swing modes, with the same machine


def without_resistance(case: Case, controls: Mapping[str, Any] | None) -> Case:
    """The case with loads as impedances, no armature resistance and these controls on every machine."""
    change = {m.name: {"Ra": 0.0} | dict(controls or {}) for m in case.machines}
    return impedance_loads(case).with_changes({"machines": change})


def ask(python: str, problem: Mapping[str, Any]) -> dict[str, Any]:
    """Run tops in the interpreter `python` and return what it found; RuntimeError with its words."""
    script = str(Path(__file__).with_name("tops_run.py"))
    problem = {"leakage": LEAKAGE} | dict(problem)
    done = subprocess.run(
        [python, script], input=json.dumps(problem), capture_output=True, text=True, check=False
    )
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no message"]
        raise RuntimeError(f"tops in {python}: {last[0]} (pip install tops there, name it by --tops-python)")
    return dict(json.loads(done.stdout))


def swing_modes(case: Case) -> list[complex]:
    """The swing modes of the plant FMU (1 < Im < 15 rad/s, Re > -3.2 1/s), by frequency."""
    poles = np.linalg.eigvals(linear_plant(case, default_cache()).A)
    return sorted((complex(z) for z in poles if 1.0 < z.imag < 15.0 and z.real > -3.2), key=lambda z: z.imag)


def differences(case: Case, result: Mapping[str, Any]) -> tuple[float, float]:
    """Largest differences of a complex bus voltage (pu, equal slack angles) and of a swing mode (1/s)."""
    flow = solve_powerflow(case)
    ours = np.array([flow.voltage(bus.number) for bus in case.buses])
    theirs = np.array([complex(*z) for z in result["v"]])
    slack = next(k for k, b in enumerate(case.buses) if b.number == _slack_bus(case))
    theirs = theirs * (ours[slack] / theirs[slack] / abs(ours[slack] / theirs[slack]))
    poles = np.array([complex(*z) for z in result["eigenvalues"]])
    return float(abs(theirs - ours).max()), float(max(abs(poles - z).min() for z in swing_modes(case)))


def inter_area_modes(case: Case, tables: Mapping[str, Any], bus: str) -> list[float]:
    """Frequencies of the inter-area modes, Hz, the machines at `bus` (tops's name) being the second area."""
    number = [row[0] for row in tables["buses"][1:]].index(bus) + 1
    areas = {m.name: 2 if m.bus == number else 1 for m in case.machines}
    modes = modes_of(linear_plant(case, default_cache()), areas)
    return [mode.frequency_hz for name, mode in modes.items() if name.startswith("inter-area")]


def _slack_bus(case: Case) -> int:
    return next(m.bus for m in case.machines if m.slack)


def main() -> int:
    """Print one line per grid; return 1 when something differs by more than allowed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tops-python", default=sys.executable)
    parser.add_argument("--json", type=Path, help="write the numbers there")
    options = parser.parse_args()
    python, results, worst = options.tops_python, {}, 0
    print(
        f"{'':36} {'machines':>8} {'modes':>6} {'power flow':>11} {'same machine':>13} {'tops machine':>13}"
    )
    runs = [(name, None) for name in CASES] + [(f"{grid} of tops, constant Efd", grid) for grid in GRIDS]
    for name, grid in runs:
        if grid is None:
            case = without_resistance(load_case(CASES[name][0]), CASES[name][1])
            problem: dict[str, Any] = {"tables": tables_of(case)}
        else:
            problem = {"grid": grid}
        same = ask(python, problem | {"machine": "sixth order"})
        own = ask(python, problem | {"machine": "tops"})
        if grid is not None:
            case = case_from(grid, same["tables"])
        volts, mode = differences(case, same)
        row: dict[str, Any] = {
            "machines": len(case.machines),
            "modes": len(swing_modes(case)),
            "power_flow_pu": volts,
            "same_machine": mode,
            "tops_machine": differences(case, own)[1],
            "rest": same["rest"],
        }
        if grid == "ieee39":
            row["inter_area_hz"] = inter_area_modes(case, same["tables"], "39")
        row["passed"] = volts <= ALLOWED_VOLTAGE_PU and mode <= ALLOWED_EIGENVALUE
        worst |= not row["passed"]
        results[name] = row
        print(
            f"{name:36} {row['machines']:8d} {row['modes']:6d} {volts:11.1e} {mode:13.1e} "
            f"{row['tops_machine']:13.1e} {'' if row['passed'] else 'DIFFERS'}",
            flush=True,
        )
    result = ", ".join(f"{f:.3f} Hz" for f in results["ieee39 of tops, constant Efd"]["inter_area_hz"])
    print(f"inter-area modes of ieee39 of tops, bus 39 against the rest: {result}")
    if options.json:
        options.json.write_text(json.dumps({"tops": same["version"], "runs": results}, indent=1))
    return int(worst)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except RuntimeError as error:
        sys.exit(f"compare_tops: {error}")
