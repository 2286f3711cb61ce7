"""The Pacific intertie of the mini-WECC, modulated by the frequencies of its ends (docs/actuators.md).

    python benchmarks/control/intertie.py [--gain PU] [--trip] [--out FILE.json]

The controller is the frequency of the north less that of the south, rad/s, as PMUs (P class) report it,
through a washout of 10 s and a lag of .05 s, times a gain, on the power of the link. Each end has two PMUs at
neighbouring buses; a bank has a controller for each pair and uses the first whose signals arrive. Printed:
the damping ratios of both north-south modes, and of all other modes the one that loses most, from the roots
of the loop with exact delay and the transfer functions of the PMUs; for each pair, and for the rivals: the
frequency at one end of the link, not late. `--trip`: what each orders after the loss of a unit. `--out`
writes the bank for `interarea run`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from interarea.cosim.run.artefacts import matrices_of_fmu, plant_fmu
from interarea.cosim.run.run import run_scenario
from interarea.design.controllers.bank import ControllerBank
from interarea.design.controllers.controller import Controller
from interarea.design.delay.loop_modes import DelayedPath, LoopFunction
from interarea.design.linear.linearise import bus_frequencies, remove_reference, speeds_in_rad
from interarea.design.linear.matrices import LinearMatrices
from interarea.design.modes.modes import damping_ratio, modes_of
from interarea.fmu_build.write.cache import default_cache
from interarea.models.blocks.pmu import pmu_filter
from interarea.models.case.case import load_case

CASE, ACTUATOR, GAIN = "mini-wecc-dc", "pdci_p_mod", 0.4  #: pu of 3100 MW per rad/s
RATING_MW, LIMIT = 3100.0, 0.1  #: of the link; of the modulation, pu of it
UNIT = "G7"  #: the largest unit, 3592 MW
BUSES = {"north_dw": 24, "south_dw": 49, "north2_dw": 23, "south2_dw": 48}
WASHOUT_S, LAG_S = 10.0, 0.05
NORTH_SOUTH = ("inter-area 1", "inter-area 2")
#: which signal is lost -> the signals of the member of the bank that acts, with their signs
PAIRS = {
    "all arrive": {"north_dw": 1.0, "south_dw": -1.0},
    "north lost": {"north2_dw": 1.0, "south_dw": -1.0},
    "south lost": {"north_dw": 1.0, "south2_dw": -1.0},
    "one of each end lost": {"north2_dw": 1.0, "south2_dw": -1.0},
}
#: an end alone -> its signal, and the gain relative to that of the difference: of steps of .1, the one with
#: the most damping of the slow mode where no other mode loses .5 points; beyond 2 the north gains nothing
ONE_END = {"south alone": ({"south_dw": -1.0}, 1.4), "north alone": ({"north_dw": 1.0}, 2.0)}
#: 1/s: every root right of this is listed, and so counted; the north-south modes are
LEFT = -0.9


@dataclass(frozen=True)
class Row:
    """Damping ratios under a condition, by mode; least : of every root, mode of the open loop or not."""

    damping: dict[str, float]
    least: float


def plant() -> tuple[LinearMatrices, dict[str, complex]]:
    """Return the grid with the frequencies of both ends, rad/s, as outputs, and its modes, 1/s."""
    case, cache = load_case(CASE), default_cache()
    voltages = [f"bus{bus}.{part}" for bus in BUSES.values() for part in ("re", "im")]
    linear = matrices_of_fmu(plant_fmu(case, cache, show=("*_dw", *voltages)), cache)
    start = linear.output_start
    assert start is not None
    at_rest = {name.replace("_re", ".re").replace("_im", ".im"): v for name, v in _pairs(linear, start)}
    relative = remove_reference(bus_frequencies(linear, at_rest, BUSES, case.omega_b))
    modes = {name: mode.eigenvalue for name, mode in modes_of(relative, case.areas).items()}
    return speeds_in_rad(relative, case.omega_b), modes


def _pairs(linear: LinearMatrices, start: np.ndarray) -> list[tuple[str, float]]:
    return list(zip(linear.output_labels, map(float, start), strict=True))


def modulation(gain: float, signs: Mapping[str, float]) -> LinearMatrices:
    """Return the controller of the signals with `signs`: states are the slow course and the output."""
    difference = np.array([list(signs.values())])
    A = np.array([[-1.0 / WASHOUT_S, 0.0], [-gain / LAG_S, -1.0 / LAG_S]])
    B = np.vstack([difference / WASHOUT_S, gain / LAG_S * difference])
    C, D = np.array([[0.0, 1.0]]), np.zeros((1, len(signs)))
    return LinearMatrices(A, B, C, D, ["slow", "order"], list(signs), [ACTUATOR])


def bank(gain: float) -> ControllerBank:
    """Return the bank: the first pair of signals that arrive, one of each end."""
    members = [
        Controller("_".join(signal.removesuffix("_dw") for signal in signs), modulation(gain, signs), LIMIT)
        for signs in PAIRS.values()
    ]
    return ControllerBank("intertie", tuple(members), LIMIT)


def one_end(gain: float) -> dict[str, Controller]:
    """Return the modulations by the frequency of one end, where the difference has `gain`."""
    return {
        what: Controller(what.replace(" ", "_"), modulation(relative * gain, signs), LIMIT)
        for what, (signs, relative) in ONE_END.items()
    }


def _cases(gain: float) -> Iterator[tuple[str, Controller, float]]:
    """Yield name, controller and latency (s) of each row of the table."""
    for what, member in zip(PAIRS, bank(gain).members, strict=True):
        yield what, member, 0.0
        for latency_s in (0.1, 0.2) if what == "all arrive" else (0.1,):
            yield f"{what}, {1e3 * latency_s:g} ms late", member, latency_s
    for what, alone in one_end(gain).items():
        yield what, alone, 0.0


def rows(gain: float) -> tuple[dict[str, float], dict[str, Row]]:
    """Return the damping ratios without control, and condition -> what the loop has."""
    grid, modes = plant()
    result, measured = {}, pmu_filter("P", 60.0, 60.0)
    for name, controller, latency_s in _cases(gain):
        paths = {signal: DelayedPath(latency_s, measured=measured) for signal in controller.inputs}
        swings = LoopFunction(grid, controller.matrices).modes(paths, modes, left=LEFT)
        assert swings.least is not None
        damping = {mode: damping_ratio(root) for mode, root in swings.named.items()}
        result[name] = Row(damping, damping_ratio(swings.least))
    return {mode: damping_ratio(root) for mode, root in modes.items()}, result


def common_rise(gain: float) -> Iterator[str]:
    """Yield what each modulation orders after the trip of `UNIT`: mean of 4 to 14 s after it, and largest."""
    for what, controller in {"difference": bank(gain), **one_end(gain)}.items():
        channels = {
            name.removesuffix("_dw"): {"signal": name, "latency_s": 0.1, "pmu": {"bus": BUSES[name]}}
            for name in controller.inputs
        }
        trip = [{"kind": "machine_trip", "machine": UNIT, "start_s": 1.0}]
        table = {"case": CASE, "stop_s": 16.0, "channels": channels, "event": trip}
        run = run_scenario(table, controller=controller)
        t, order = run.trajectory["time_s"], run.trajectory[f"controller.{ACTUATOR}"]
        mean, most = np.mean(order[(t > 5.0) & (t < 15.0)]), np.max(np.abs(order))
        yield f"{what:12s} mean {RATING_MW * mean:+6.0f} MW, largest {RATING_MW * most:5.0f} MW"


def most_lost(without: dict[str, float], row: Row) -> tuple[str, float]:
    """Return the mode that loses most, and by how much its damping ratio changes."""
    change = {mode: row.damping[mode] - before for mode, before in without.items()}
    worst = min(change, key=lambda mode: change[mode])
    return worst, change[worst]


def table(gain: float) -> str:
    """Return the rows as a table of a page."""
    without, reached = rows(gain)
    lines = [
        "| signals | .21 Hz | .38 Hz | least of all modes | most lost by any mode |",
        "|---|---|---|---|---|",
    ]
    slow, fast = (without[mode] for mode in NORTH_SOUTH)
    lines.append(f"| no control | {slow:.3f} | {fast:.3f} | {min(without.values()):.3f} | |")
    for name, row in reached.items():
        slow, fast = (row.damping[mode] for mode in NORTH_SOUTH)
        mode, change = most_lost(without, row)
        lines.append(f"| {name} | {slow:.3f} | {fast:.3f} | {row.least:.3f} | {-change:.4f}, {mode} |")
    return "\n".join(lines)


def main() -> None:
    """Print the table; write the bank where that is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--gain", type=float, default=GAIN, help="pu of 3100 MW per rad/s")
    parser.add_argument("--trip", action="store_true", help="also the orders after the loss of a unit")
    parser.add_argument("--out", type=Path, help="file for the bank")
    options = parser.parse_args()
    if options.out is not None:
        bank(options.gain).save(options.out)
    print(table(options.gain))
    for line in common_rise(options.gain) if options.trip else ():
        print(line)


if __name__ == "__main__":
    main()
