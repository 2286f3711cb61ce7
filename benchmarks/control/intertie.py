"""The Pacific intertie of the mini-WECC, modulated by the frequencies of its ends (docs/actuators.md).

    python benchmarks/control/intertie.py [--gain PU] [--out FILE.json]

One controller: the frequency of bus 24 less that of bus 49, rad/s, as PMUs (P class) report it, through a
washout of 10 s and a lag of .05 s, times a gain, on the power of the link. Printed: the damping ratios of
both north-south modes, and of all other modes the one that loses most, from the roots of the loop with exact
delay and the transfer functions of the PMUs. `--out` writes the controller for `interarea run`.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from interarea.cosim.run.artefacts import matrices_of_fmu, plant_fmu
from interarea.design.controllers.controller import Controller
from interarea.design.delay.loop_modes import DelayedPath, LoopFunction
from interarea.design.linear.linearise import bus_frequencies, remove_reference, speeds_in_rad
from interarea.design.linear.matrices import LinearMatrices
from interarea.design.modes.modes import damping_ratio, modes_of
from interarea.fmu_build.write.cache import default_cache
from interarea.models.blocks.pmu import pmu_filter
from interarea.models.case.case import load_case

CASE, ACTUATOR, GAIN = "mini-wecc-dc", "pdci_p_mod", 0.4  #: pu of 3100 MW per rad/s
BUSES = {"north_dw": 24, "south_dw": 49}
WASHOUT_S, LAG_S = 10.0, 0.05
NORTH_SOUTH = ("inter-area 1", "inter-area 2")
#: condition -> latency of what arrives, s, and the signal that is lost
CONDITIONS: dict[str, tuple[float, str | None]] = {
    "at once": (0.0, None),
    "100 ms late": (0.1, None),
    "200 ms late": (0.2, None),
    "north lost": (0.0, "north_dw"),
    "north lost, south 100 ms late": (0.1, "north_dw"),
    "south lost": (0.0, "south_dw"),
    "south lost, north 100 ms late": (0.1, "south_dw"),
}
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


def modulation(gain: float) -> LinearMatrices:
    """Return the controller: states are the slow course of the difference and the output."""
    difference = np.array([[1.0, -1.0]])
    A = np.array([[-1.0 / WASHOUT_S, 0.0], [-gain / LAG_S, -1.0 / LAG_S]])
    B = np.vstack([difference / WASHOUT_S, gain / LAG_S * difference])
    C, D = np.array([[0.0, 1.0]]), np.zeros((1, 2))
    return LinearMatrices(A, B, C, D, ["slow", "order"], list(BUSES), [ACTUATOR])


def rows(gain: float) -> tuple[dict[str, float], dict[str, Row]]:
    """Return the damping ratios without control, and condition -> what the loop has."""
    grid, modes = plant()
    function, measured = LoopFunction(grid, modulation(gain)), pmu_filter("P", 60.0, 60.0)
    result = {}
    for name, (latency_s, lost) in CONDITIONS.items():
        paths = {s: DelayedPath(latency_s, lost=s == lost, measured=measured) for s in BUSES}
        swings = function.modes(paths, modes, left=LEFT)
        assert swings.least is not None
        damping = {mode: damping_ratio(root) for mode, root in swings.named.items()}
        result[name] = Row(damping, damping_ratio(swings.least))
    return {mode: damping_ratio(root) for mode, root in modes.items()}, result


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
    """Print the table; write the controller where that is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--gain", type=float, default=GAIN, help="pu of 3100 MW per rad/s")
    parser.add_argument("--out", type=Path, help="file for the controller")
    options = parser.parse_args()
    if options.out is not None:
        Controller("intertie", modulation(options.gain), limit_pu=0.1).save(options.out)
    print(table(options.gain))


if __name__ == "__main__":
    main()
