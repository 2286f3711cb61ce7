"""What a controller should read for a lost signal (docs/controllers.md): zero, the last value, or both.

python benchmarks/control/packet_rules.py [--faults] [CONTROLLER ...]

Two areas: a fault of 4 cycles at bus 8 at the base point and at a tie flow of +100 MW, packets every 20 ms,
the signal of G2 100 ms late. 10, 30 and 60 % of the packets of each signal lost, each by itself, or 40 % in
bursts with a mean length of .4 s; `SEEDS` runs each, the same packets lost under each rule. Printed: the
root mean square of the swing between G2 and G4 in the last 4 s of 20, mHz: mean and largest of the runs.

With `--faults` the faults of the design's acceptance at its operating points, each signal lost for good .5 s
after the fault begins: how many of 8 cycles lose and gain synchronism against no control, and the longest
that keep it, cycles (searched to .3), at the largest latency.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import interarea as ia
from interarea.cosim.designs.acceptance import Setting, settings_of
from interarea.cosim.designs.design_file import load_design
from interarea.cosim.designs.design_tables import AcceptanceTable
from interarea.cosim.designs.family import family_cases
from interarea.cosim.designs.fault_loops import ControllerOrBank
from interarea.cosim.designs.fault_runs import FaultRun, FaultRuns, longest_stable
from interarea.cosim.designs.first_swing import after_clearing
from interarea.design.controllers.bundled import shipped_bank, shipped_banks, shipped_controller
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import Case

RULES: dict[str, dict[str, Any]] = {
    "zero": {"on_loss": "zero"},
    "hold": {"on_loss": "hold"},
    "held .2 s": {"on_loss": "hold_then_zero", "hold_s": 0.2},
    "held .5 s": {"on_loss": "hold_then_zero", "hold_s": 0.5},
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
LONGEST_CYCLES, RESOLUTION_CYCLES = 30.0, 0.3


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


def packets(controllers: list[str]) -> None:
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


@dataclass(frozen=True)
class RuledRun(FaultRun):
    """A fault whose lost signals are what `rule` of `RULES` makes of them."""

    rule: str = "zero"

    def document(self) -> dict[str, Any]:
        """Return it as a scenario."""
        document = super().document()
        for channel in document.get("channels", {}).values():
            channel.update(RULES[self.rule])
        return document


class Point:
    """The faults of an acceptance at one operating point; ceilings and loads of the case."""

    def __init__(self, K: ControllerOrBank, table: AcceptanceTable, point: str, case: Case) -> None:
        self.K, self.table, self.case = K, table, case
        groups = list(settings_of(table, point, None, K.inputs))
        self.alone = {s: alone for alone, settings in groups for s in settings if s.lost}
        self.latest = [s for s in self.alone if s.latency_s == max(table.latency_s)]

    def survives(
        self, runs: FaultRuns, rule: str, cycles: Mapping[Setting, float], *, controlled: bool = True
    ) -> dict[Setting, bool]:
        """Return which faults keep synchronism."""
        t = self.table
        rows = [
            RuledRun(
                after_clearing(
                    self.case,
                    s.fault.bus,
                    s.fault.trip,
                    t.start_s,
                    t.start_s + n / self.case.frequency_hz,
                    x_pu=t.x_pu,
                ),
                t.stop_s,
                self.K if controlled else None,
                s.latency_s,
                dict.fromkeys(s.lost, t.lost_s),
                rule,
            )
            for s, n in cycles.items()
        ]
        angles = runs.largest_angles(rows)
        return {s: angle < np.pi for s, angle in zip(cycles, angles, strict=True)}

    def clearing_cycles(self, runs: FaultRuns, rule: str) -> list[float]:
        """Return the longest faults that keep synchronism."""
        longest = longest_stable(
            self.latest,
            lambda cycles: self.survives(runs, rule, cycles),
            1.0,
            LONGEST_CYCLES,
            RESOLUTION_CYCLES,
        )
        return [longest[s] for s in self.latest]


def faults(controllers: list[str]) -> None:
    """Print a line for each controller and rule: faults lost and gained, clearing times against zero."""
    for name in controllers:
        table = load_design(name)
        K = shipped_bank(name) if name in shipped_banks() else shipped_controller(name)
        if table.acceptance is None:
            raise SystemExit(f"{name}: its design names no faults")
        counts = {rule: np.zeros(3, dtype=int) for rule in RULES}
        cycles: dict[str, list[float]] = {rule: [] for rule in RULES}
        for label, case in family_cases(table).items():
            point = Point(K, table.acceptance, label, case)
            with FaultRuns(case, default_cache()) as runs:
                fault = dict.fromkeys(point.alone.values(), table.acceptance.clear_cycles)
                without = point.survives(runs, "zero", fault, controlled=False)
                for rule in RULES:
                    stable = point.survives(
                        runs, rule, dict.fromkeys(point.alone, table.acceptance.clear_cycles)
                    )
                    for s, keeps in stable.items():
                        alone = without[point.alone[s]]
                        counts[rule] += (1, alone and not keeps, keeps and not alone)
                    cycles[rule] += point.clearing_cycles(runs, rule)
        for rule, (count, lost, gained) in counts.items():
            change = np.subtract(cycles[rule], cycles["zero"])
            print(
                f"{name:14} {rule:10} {count} faults, {lost} lost, {gained} gained; clearing against zero: "
                f"mean {change.mean():+.2f}, least {change.min():+.2f}, most {change.max():+.2f} cycles "
                f"({change.size} faults)",
                flush=True,
            )


def main(arguments: list[str]) -> None:
    """Measure packets lost at random, or with `--faults` signals lost for good."""
    names = [name for name in arguments if name != "--faults"]
    if "--faults" in arguments:
        faults(names or ["robust", "robust_latency", "wide_area", "active"])
    else:
        packets(names or ["robust", "robust_latency", "wide_area"])


if __name__ == "__main__":
    main(sys.argv[1:])
