"""What a controller should read for a lost packet (docs/controllers.md): zero, the last value, or both.

python benchmarks/control/packet_rules.py [CONTROLLER ...]

Two areas: a fault of 4 cycles at bus 8 at the base point and at a tie flow of +100 MW, packets every 20 ms,
the signal of G2 100 ms late. 10, 30 and 60 % of the packets of each signal lost, each by itself, or 40 % in
bursts with a mean length of .4 s; `SEEDS` runs each, the same packets lost under each rule. Printed: the
root mean square of the swing between G2 and G4 in the last 4 s of 20, mHz: mean and largest of the runs.
"""

import sys
from typing import Any

import numpy as np

import interarea as ia

RULES: dict[str, dict[str, Any]] = {
    "zero": {"on_loss": "zero"},
    "hold": {"on_loss": "hold"},
    "held .2 s": {"on_loss": "hold_then_zero", "hold_s": 0.2},
    "held 1 s": {"on_loss": "hold_then_zero", "hold_s": 1.0},
}
LOSSES: dict[str, Any] = {
    "10 %": 0.1,
    "30 %": 0.3,
    "60 %": 0.6,
    "bursts": {"kind": "gilbert_elliott", "good_to_bad": 0.0333, "bad_to_good": 0.05},
}
TIES_MW: tuple[float | None, ...] = (None, 100.0)
SEEDS, STOP_S, LAST_S, RATED_HZ = 8, 20.0, 4.0, 60.0


def swing_mhz(controller: str, tie_mw: float | None, line: dict[str, Any], seed: int) -> float:
    """Return the rms of dw24 at the end of a run, mHz."""
    keys: dict[str, Any] = {
        "case": "two-area-thesis",
        "controller": controller,
        "stop_s": STOP_S,
        "step_s": 0.01,
        "event": [{"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": "start + 4 cycles"}],
    }
    if controller != "none":
        keys["channels"] = {
            "remote": {
                "signal": "G2_dw",
                "latency_s": 0.1,
                "reporting_interval_s": 0.02,
                "seed": 2 * seed,
                **line,
            },
            "local": {"signal": "G4_dw", "reporting_interval_s": 0.02, "seed": 2 * seed + 1, **line},
        }
    if tie_mw is not None:
        keys["operating_point"] = {"tie_flow_mw": tie_mw}
    curves = ia.simulate(keys).trajectory
    swing = (curves["plant.G2_dw"] - curves["plant.G4_dw"])[curves.time_s >= STOP_S - LAST_S]
    return float(1e3 * RATED_HZ * np.sqrt(np.mean(swing**2)))


def main(controllers: list[str]) -> None:
    """Print a line for each operating point, controller, loss and rule."""
    for tie_mw in TIES_MW:
        where = "base" if tie_mw is None else f"tie {tie_mw:+g} MW"
        print(f"{where:12} no control {swing_mhz('none', tie_mw, {}, 0):8.3f}", flush=True)
        for controller in controllers:
            print(
                f"{where:12} {controller:14} nothing lost {swing_mhz(controller, tie_mw, {}, 0):8.3f}",
                flush=True,
            )
            for name, loss in LOSSES.items():
                for rule, keys in RULES.items():
                    values = [
                        swing_mhz(controller, tie_mw, {"loss": loss, **keys}, seed) for seed in range(SEEDS)
                    ]
                    print(
                        f"{where:12} {controller:14} {name:8} {rule:10} mean {np.mean(values):8.3f} "
                        f"largest {max(values):8.3f}",
                        flush=True,
                    )


if __name__ == "__main__":
    main(sys.argv[1:] or ["robust", "robust_latency", "wide_area"])
