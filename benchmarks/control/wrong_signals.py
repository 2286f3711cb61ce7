"""What a wrong signal does to each controller, with and without a detector (docs/wrong_signals.md).

python benchmarks/control/wrong_signals.py [CONTROLLER ...]
python benchmarks/control/wrong_signals.py --detector [CONTROLLER ...]
python benchmarks/control/wrong_signals.py --genuine [CONTROLLER ...]

with --design FILE: of `design_detector`, made where it is not there yet.

Two areas, packets every 20 ms, the remote signal 100 ms late. A fault of 8 cycles at bus 8 at 1 s; one signal
is wrong from 1.5 s on, its flag up. Verdicts are of 20 s (docs/verdicts.md). With a detector two more speeds
travel as witnesses, 50 ms late. --genuine: disturbances of the grid with right signals, which must not alarm.
"""

import argparse
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import interarea as ia
from interarea.cosim.screen.detector_design import design_detector

RATED_HZ = 60.0
WRONG_S = 1.5
FAULTS: dict[str, dict[str, Any] | None] = {
    "none": None,
    "stuck": {"kind": "stuck"},
    "zero": {"kind": "scale", "factor": 0.0},
    "times 3": {"kind": "scale", "factor": 3.0},
    "times 10": {"kind": "scale", "factor": 10.0},
    "polarity": {"kind": "polarity"},
    "bias of 100 mHz": {"kind": "bias", "size": 0.1 / RATED_HZ},
    "ramp of 50 mHz/s": {"kind": "ramp", "rate_per_s": 0.05 / RATED_HZ},
    "drift to 100 mHz": {"kind": "drift", "size": 0.1 / RATED_HZ, "time_s": 2.0},
    "replay of 1.5 s": {"kind": "replay", "length_s": 1.5},
    "spikes of 500 mHz, 5 %": {"kind": "spike", "size": 0.5 / RATED_HZ, "probability": 0.05},
    "noise of 10 mHz": {"kind": "noise", "rms": 0.01 / RATED_HZ},
    "stamp 0.3 s wrong": {"kind": "time_error", "offset_s": 0.3},
    "stamp 0.8 s wrong": {"kind": "time_error", "offset_s": 0.8},
    "sine of 50 mHz, 0.6 Hz": {"kind": "oscillating", "amplitude": 0.05 / RATED_HZ, "frequency_hz": 0.6},
}
SIGNALS = {"remote": ("G2_dw", 0.1), "local": ("G4_dw", 0.0)}
WITNESSES = {"witness 1": ("G1_dw", 0.05), "witness 3": ("G3_dw", 0.05)}
TIE_MW = (0.0, 100.0)
DETECTOR: dict[str, Any] = {}  #: keys of the scenario's detector
FAULT = {"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": "start + 8 cycles"}


def scenario(
    controller: str,
    tie_mw: float,
    *,
    detector: bool,
    wrong: str = "",
    fault: dict[str, Any] | None = None,
    event: tuple[dict[str, Any], ...] = (FAULT,),
) -> dict[str, Any]:
    """Return a run in which the signal of one channel is wrong."""
    channels: dict[str, dict[str, Any]] = {}
    for name, (signal, latency_s) in {**SIGNALS, **(WITNESSES if detector else {})}.items():
        channel: dict[str, Any] = {"signal": signal, "latency_s": latency_s, "reporting_interval_s": 0.02}
        if name == wrong and fault is not None:
            channel["signal_faults"] = [{**fault, "start_s": WRONG_S}]
        channels[name.replace(" ", "_")] = channel
    table = {
        "case": "two-area-thesis",
        "controller": controller,
        "stop_s": 20.0,
        "channels": channels,
        "operating_point": {"tie_flow_mw": tie_mw},
        "event": list(event),
    }
    return {**table, "detector": dict(DETECTOR)} if detector else table


def isolations(run: Any) -> dict[str, float]:
    """Return when each signal was isolated first, s."""
    found = {}
    for signal, _ in (*SIGNALS.values(), *WITNESSES.values()):
        reason = run.data[f"detector.{signal}_reason"]
        if reason.any():
            found[signal] = float(run.data["time_s"][reason.to_numpy().argmax()])
    return found


def cell(controller: str, wrong: str, fault: dict[str, Any] | None, *, detector: bool) -> str:
    """Return the first words of the verdicts of both cases, and when the detector named which signal."""
    verdicts, named = [], []
    for tie_mw in TIE_MW:
        run = ia.simulate(scenario(controller, tie_mw, detector=detector, wrong=wrong, fault=fault))
        verdicts.append(str(run.metrics.verdict).partition(":")[0])
        if detector and fault is not None:
            found = isolations(run)
            right = found.pop(SIGNALS[wrong][0], None)
            words = [
                "not seen" if right is None else f"{right - WRONG_S:.2f} s",
                *(f"and {s}" for s in found),
            ]
            named.append(" ".join(words))
    words = [" / ".join(dict.fromkeys(verdicts)), " / ".join(dict.fromkeys(named))]
    return "; ".join(w for w in words if w)


def table(controllers: list[str], *, detector: bool) -> None:
    """Print the table; the two verdicts of a cell are those of the case and of 100 MW more on the tie."""
    columns = list(itertools.product(controllers, SIGNALS))
    print("| the signal | " + " | ".join(f"`{c}`, {s}" for c, s in columns) + " |")
    print("|---|" + "---|" * len(columns))
    for name, fault in FAULTS.items():
        cells = [cell(controller, signal, fault, detector=detector) for controller, signal in columns]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


def disturbances() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield disturbances of the grid."""
    for bus, cycles in itertools.product(range(5, 12), (4, 6, 8)):
        yield "fault", {"kind": "bus_fault", "bus": bus, "start_s": 1.0, "end_s": f"start + {cycles} cycles"}
    for machine in ("G1", "G2", "G3", "G4"):
        for kind in ("vref_pulse", "pm_pulse"):
            yield "pulse", {"kind": kind, "machine": machine, "size_pu": 0.05, "start_s": 1.0, "end_s": 1.3}
        for size in (-0.05, 0.05):
            yield "step", {"kind": "pm_step", "machine": machine, "size_pu": size, "start_s": 1.0}
    for bus, size in itertools.product((7, 9), (-0.5, 0.5)):
        yield "step", {"kind": "load_step", "bus": bus, "p_pu": size, "q_pu": 0.1, "start_s": 1.0}
    yield "trip", {"kind": "branch_trip", "branch": "8-9 a", "start_s": 1.0}


def genuine(controllers: list[str]) -> None:
    """Print how many disturbances with right signals made the detector isolate one."""
    print("| controller | runs | with an isolation |")
    print("|---|---|---|")
    for controller in controllers:
        runs, alarms = 0, []
        for tie_mw, (_, event) in itertools.product((-100.0, 0.0, 100.0), disturbances()):
            run = ia.simulate(scenario(controller, tie_mw, detector=True, event=(event,)))
            runs += 1
            if isolations(run):
                alarms.append(f"{event} at {tie_mw:+g} MW: {isolations(run)}, {run.metrics.verdict}")
        print(f"| `{controller}` | {runs} | {len(alarms)} |", flush=True)
        for line in alarms:
            print(f"  {line}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("controllers", nargs="*", default=["robust", "active", "ftc"])
    parser.add_argument("--detector", action="store_true", help="with a detector and two witnesses")
    parser.add_argument("--genuine", action="store_true", help="disturbances with right signals")
    parser.add_argument("--design", type=Path, help="file of the detector's patterns, for robust")
    asked = parser.parse_args()
    if asked.design is not None:
        signals = [signal for signal, _ in (*SIGNALS.values(), *WITNESSES.values())]
        if not asked.design.exists():
            design_detector("two-area-thesis", "robust", signals).save(asked.design)
        DETECTOR["file"] = str(asked.design.absolute())
    if asked.genuine:
        genuine(asked.controllers)
    else:
        table(asked.controllers, detector=asked.detector)
