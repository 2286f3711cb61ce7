"""What `meter --beside` measures of the damping that a controller adds, against the poles of the loop.

Run `python benchmarks/records/damping_gained.py [--pairs 24] [--minutes 10]`: records of the linear loop of
two areas with shares of the gain of `wide_area`, and as many without a controller, noise at every rotor. A
row for each share: the difference of the poles; the pairs that show the mode, and of these the mean and
deviation of the measured difference, half of the median interval, and how many intervals contain the poles'
difference (points).
"""

from __future__ import annotations

import argparse
from functools import cache

import control
import numpy as np
from ambient_coverage import LinearRecords
from threadpoolctl import threadpool_limits

import interarea as ia
from interarea.cosim.records.brought import brought
from interarea.cosim.records.record import RecordError
from interarea.design.certificates.closed_loop import closed_loop_matrix, swing_poles
from interarea.design.modes.modes import damping_ratio

CASE, CONTROLLER = "two-area-thesis", "wide_area"
MODE, MODE_HZ, NEAR = "inter-area", 0.62, 0.1  # without control, and how far from it a difference may be
SHARES = (0.0, 0.1, 0.3, 1.0)  #: of the controller's gain


def parts(share: float) -> tuple[control.StateSpace, control.StateSpace]:
    """Return the linear plant, speeds in rad/s, and the controller with a share of its gain."""
    return ia.linearise(CASE, speeds="rad/s"), ia.load_controller(CONTROLLER).scaled(share).system


@cache
def loop(share: float) -> control.StateSpace:
    """Return the plant with a share of the controller's gain, its outputs those of the plant."""
    plant, K = parts(share)
    A, n = closed_loop_matrix(plant, K), K.nstates
    return control.ss(
        A, np.zeros((len(A), 1)), np.hstack([plant.C, np.zeros((plant.noutputs, n))]), 0.0,
        states=[*plant.state_labels, *(f"controller.{k}" for k in range(n))], outputs=plant.output_labels,
    )  # fmt: skip


def damping(share: float) -> float:
    """Return the damping ratio of the mode's pole, followed from the open loop."""
    return damping_ratio(swing_poles(*parts(share), ia.modes(CASE))[MODE])


def row(share: float, pairs: int, minutes: float) -> str:
    """Return the row of a share."""
    with_it, without = LinearRecords(loop(share)), LinearRecords(loop(0.0))
    truth = damping(share) - damping(0.0)
    measured, halves, inside = [], [], 0
    for seed in range(pairs):
        try:
            result = brought(
                with_it.record(seed, 60.0 * minutes), without.record(pairs + seed, 60.0 * minutes)
            )
        except RecordError:
            continue
        near = [d for d in result.differences if abs(d.frequency_hz - MODE_HZ) <= NEAR]
        if not near:
            continue
        first = min(near, key=lambda d: abs(d.frequency_hz - MODE_HZ))
        low, high = first.interval
        measured.append(100.0 * first.difference)
        halves.append(50.0 * (high - low))
        inside += low <= truth <= high
    if len(measured) < 2:
        return f"| {share:g} | {100.0 * truth:.1f} | {len(measured)} of {pairs} | | | |"
    return (
        f"| {share:g} | {100.0 * truth:.1f} | {len(measured)} of {pairs} | {np.mean(measured):.1f}, "
        f"{np.std(measured, ddof=1):.1f} | {np.median(halves):.1f} | {inside} |"
    )


def main() -> None:
    """Print the table of the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=24)
    parser.add_argument("--minutes", type=float, default=10.0)
    options = parser.parse_args()
    print("| share of the gain | difference of the poles | pairs | measured: mean, deviation ", end="")
    print("| half of the interval, median | intervals that contain it |\n|---|---|---|---|---|---|")
    with threadpool_limits(1):
        for share in SHARES:
            print(row(share, options.pairs, options.minutes), flush=True)


if __name__ == "__main__":
    main()
