"""What a wrong signal does to each controller: the table of docs/wrong_signals.md.

python benchmarks/control/wrong_signals.py [CONTROLLER ...]

Two areas, a fault of 8 cycles at bus 8 at 1 s, packets every 20 ms, the remote signal 100 ms late; one signal
is wrong from 1.5 s on, its flag up. Verdicts are of 20 s (docs/verdicts.md).
"""

import argparse
import itertools
from typing import Any

import interarea as ia

RATED_HZ = 60.0
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
TIE_MW = (0.0, 100.0)


def verdict(controller: str, wrong: str, fault: dict[str, Any] | None, tie_mw: float) -> str:
    """Return the first words of the verdict of one run."""
    channels: dict[str, dict[str, Any]] = {}
    for name, (signal, latency_s) in SIGNALS.items():
        channels[name] = {"signal": signal, "latency_s": latency_s, "reporting_interval_s": 0.02}
        if name == wrong and fault is not None:
            channels[name]["signal_faults"] = [{**fault, "start_s": 1.5}]
    run = ia.simulate(
        {
            "case": "two-area-thesis",
            "controller": controller,
            "stop_s": 20.0,
            "channels": channels,
            "operating_point": {"tie_flow_mw": tie_mw},
            "event": [{"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": "start + 8 cycles"}],
        }
    )
    return str(run.metrics.verdict).partition(":")[0]


def main(controllers: list[str]) -> None:
    """Print the table; the two verdicts of a cell are those of the case and of 100 MW more on the tie."""
    columns = list(itertools.product(controllers, SIGNALS))
    print("| the signal | " + " | ".join(f"`{c}`, {s}" for c, s in columns) + " |")
    print("|---|" + "---|" * len(columns))
    for name, fault in FAULTS.items():
        cells = []
        for controller, signal in columns:
            verdicts = [verdict(controller, signal, fault, tie_mw) for tie_mw in TIE_MW]
            cells.append(" / ".join(dict.fromkeys(verdicts)))
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("controllers", nargs="*", default=["robust", "active", "ftc"])
    main(parser.parse_args().controllers)
