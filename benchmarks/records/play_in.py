"""Six parameters of a machine with exciter, stabilizer and governor of common types, fitted to its record.

    python benchmarks/records/play_in.py --controls ESST1A --record steps
    python benchmarks/records/play_in.py --controls EXST1 --record fault --seeds 3

G1 of two areas is a round-rotor machine (six windings) with the controls named. The record is what a run of
the whole grid shows of it, 100 points a second, with white noise of `--noise` of what P and Q move:
``steps`` has 12 s with three disturbances elsewhere, ``fault`` 30 s with a fault of six cycles in the other
area. The start values are 20 to 30 % off. Printed of each seed and parameter: how far off the fitted value
is, its standard deviation, and their ratio; then the largest of all.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

import interarea as ia
from interarea.cosim.records.play_in import with_value
from interarea.cosim.records.record import Record

CASE, MACHINE = "two-area-thesis", "G1"
PLACES = ["bus1.re", "bus1.im", "branch[1-5].p", "branch[1-5].q"]
ESST1A = {
    "exciter": {
        "kind": "esst1a", "TR": 0.02, "VIMIN": -0.2, "VIMAX": 0.2, "TC": 1.0, "TB": 5.0, "KA": 200.0,
        "TA": 0.02, "VAMIN": -6.0, "VAMAX": 7.0, "VRMIN": -6.0, "VRMAX": 7.0, "KC": 0.04,
    },
    "stabilizer": {
        "kind": "pss2b", "ICS1": 1, "ICS2": 3, "M": 5, "N": 1, "TW1": 5.0, "TW2": 5.0, "TW3": 5.0, "T7": 5.0,
        "KS2": 0.39, "KS3": 1.0, "T8": 0.5, "T9": 0.1, "KS1": 15.0, "T1": 0.18, "T2": 0.03, "T3": 0.18,
        "T4": 0.03, "T10": 0.0, "T11": 0.0, "TW4": 0.0, "T6": 0.0, "VS1MIN": -99.0, "VS1MAX": 99.0,
        "VS2MIN": -99.0, "VS2MAX": 99.0, "VSTMIN": -0.1, "VSTMAX": 0.1,
    },
    "governor": {
        "kind": "ggov1", "Rselect": 1, "Flag": 0, "R": 0.04, "Tpelec": 1.0, "maxerr": 0.05, "minerr": -0.05,
        "Kpgov": 10.0, "Kigov": 2.0, "Kdgov": 0.0, "Tdgov": 1.0, "Vmax": 1.0, "Vmin": 0.15, "Tact": 0.5,
        "Kturb": 1.5, "Wfnl": 0.2, "Tb": 0.1, "Tc": 0.0, "Teng": 0.0, "Tfload": 3.0, "Kpload": 2.0,
        "Kiload": 0.67, "Ldref": 1.2, "Dm": 0.0, "Ropen": 0.1, "Rclose": -0.1, "Kimw": 0.0, "Aset": 0.1,
        "Ka": 0.0, "Ta": 0.1, "Trate": 0.0, "db": 0.0, "Tsa": 4.0, "Tsb": 5.0, "Rup": 99.0, "Rdown": -99.0,
    },
}  # fmt: skip
EXST1 = {
    "exciter": {
        "kind": "exst1", "TR": 0.02, "VIMIN": -0.2, "VIMAX": 0.2, "TC": 1.0, "TB": 5.0, "KA": 200.0,
        "TA": 0.02, "VRMIN": -5.0, "VRMAX": 6.0, "KC": 0.05, "KF": 0.0, "TF": 1.0,
    },
    "stabilizer": {
        "kind": "ieeest", "ICS": 1, "A1": 0.061, "A2": 0.0017, "T1": 0.25, "T2": 0.03, "T3": 0.15, "T4": 0.02,
        "T5": 10.0, "T6": 10.0, "KS": 12.0, "LSMIN": -0.1, "LSMAX": 0.1,
    },
    "governor": {
        "kind": "tgov1", "R": 0.05, "T1": 0.5, "T2": 3.0, "T3": 10.0, "Dt": 0.0, "Vmin": 0.0, "Vmax": 1.2,
    },
}  # fmt: skip
CONTROLS = {"ESST1A": ESST1A, "EXST1": EXST1}
#: share of the true value that each of the six starts at
START = {
    "ESST1A": {"H": 1.25, "Xd1": 1.2, "exciter.KA": 0.7, "stabilizer.KS1": 1.3, "stabilizer.T1": 0.8,
               "governor.Kpgov": 0.75},
    "EXST1": {"H": 1.25, "Xd1": 1.2, "exciter.KA": 0.7, "stabilizer.KS": 1.3, "stabilizer.T1": 0.8,
              "governor.R": 0.75},
}  # fmt: skip
EVENTS = {
    "steps": [
        {"kind": "vref_pulse", "machine": "G2", "size_pu": 0.05, "start_s": 1.0, "end_s": 3.0},
        {"kind": "pm_pulse", "machine": "G3", "size_pu": 0.1, "start_s": 4.0, "end_s": 6.0},
        {"kind": "vref_pulse", "machine": "G3", "size_pu": -0.05, "start_s": 7.0, "end_s": 8.0},
    ],
    "fault": [{"kind": "bus_fault", "bus": 9, "start_s": 1.0, "end_s": 1.1, "x_pu": 0.01}],
}
STOP_S = {"steps": 12.0, "fault": 30.0}  # a governor shows itself slowly


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--controls", choices=CONTROLS, default="ESST1A")
    parser.add_argument("--record", choices=EVENTS, default="steps")
    parser.add_argument("--noise", type=float, default=0.05, help="of what P and Q move")
    parser.add_argument("--seeds", type=int, default=1)
    options = parser.parse_args()
    case = with_controls(options.controls)
    shares = START[options.controls]
    truth = {name: value_of(case, name) for name in shares}
    off = case
    for name, share in shares.items():
        off = with_value(off, MACHINE, name, truth[name] * share)
    run = recorded(case, options.record)
    errors, ratios = [], []
    for seed in range(1, options.seeds + 1):
        began = time.process_time()
        fit = ia.fit(noisy(run, options.noise, seed), off, MACHINE, list(truth), rest_s=0.9)
        took = time.process_time() - began
        for p in fit.parameters:
            error, deviation = p.value / truth[p.name] - 1.0, p.deviation / truth[p.name]
            errors.append(abs(error))
            ratios.append(abs(error) / deviation)
            print(
                f"seed {seed} {p.name}: {p.start:.4g} -> {p.value:.5g}, true {truth[p.name]:.5g}, off "
                f"{error:+.2%}, deviation {deviation:.2%}, ratio {ratios[-1]:.2f}"
            )
        for name, why in fit.kept_as_is.items():
            print(f"seed {seed} {name}: {why}")
        misfit = (
            f"misfit {fit.misfit[0]:.3f}, {fit.misfit[1]:.3f} -> {fit.fitted[0]:.3f}, {fit.fitted[1]:.3f}"
        )
        print(f"seed {seed}: {misfit}; {took:.0f} s of processor; {'; '.join(fit.notes)}", flush=True)
    print(
        f"{options.controls}, {options.record}: {len(errors)} values, off by {max(errors):.2%} at most, "
        f"{np.mean(np.array(ratios) < 1.0):.0%} within one deviation, {np.mean(np.array(ratios) < 1.96):.0%} "
        "within their interval"
    )


def with_controls(name):
    """Return the case with G1's controls of other types."""
    change = dict.fromkeys(CONTROLS[name], "none")
    case = ia.load_case(CASE).with_changes({"machines": {MACHINE: change}})
    return case.with_changes({"machines": {MACHINE: CONTROLS[name]}})


def value_of(case, path):
    value = next(m for m in case.machines if m.name == MACHINE)
    for field in path.split("."):
        value = getattr(value, field)
    return value


def recorded(case, kind):
    """Return what a run of the whole grid shows of the machine."""
    scenario = {"stop_s": STOP_S[kind], "controller": "none", "show": PLACES, "case": CASE}
    scenario["event"] = EVENTS[kind]
    result = ia.simulate(scenario, case=case)
    with tempfile.TemporaryDirectory() as folder:
        result.save(folder)
        return ia.read_record(Path(folder) / "trajectory.parquet")


def noisy(record, share, seed):
    """Return the record with noise on P and Q, a share of what they move."""
    rng, values = np.random.default_rng(seed), np.array(record.values)
    for k, c in enumerate(record.channels):
        if c.quantity in ("active power", "reactive power"):
            values[:, k] += share * values[:, k].std() * rng.standard_normal(len(values))
    return Record("noisy", record.time_s.copy(), values, record.channels)


if __name__ == "__main__":
    main()
