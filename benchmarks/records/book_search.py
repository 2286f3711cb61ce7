"""Which constants of exciter and stabilizer would give the stabilized row of Kundur's Example 12.6?

    python benchmarks/records/book_search.py [--constants 2]

For every choice of that many constants the fit to the three printed modes by least squares, from
several starts, the others as printed. The number before a choice is the largest distance left of the
six printed numbers, in half units of their last digits: 1 would give the row. Three constants take minutes.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

sys.path.insert(0, str(Path(__file__).parent))
from book_readings import HALF, printed, stabilizer_needed

from interarea.cosim.run.artefacts import linear_plant
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case

#: constants as printed; TA, TC/TB: lag and gain reduction of the exciter, TS: a lag more in the stabilizer
PRINTED = {"KA": 200.0, "TR": 0.01, "TA": 0.0, "TC": 0.0, "TB": 0.0, "K": 20.0, "Tw": 10.0}
PRINTED |= {"T1": 0.05, "T2": 0.02, "T3": 3.0, "T4": 5.4, "TS": 0.0}
STEP = 1e-4  #: of the derivative along s, 1/s
#: where a constant that is 0 starts its search
START = {"TA": 0.01, "TC": 0.1, "TB": 0.1, "TS": 0.01}


class Row:
    """Three poles (the printed ones unless given) and the machines' responses to their fields there."""

    def __init__(self, poles: Sequence[complex] | None = None) -> None:
        """Undo the exciters of `kundur-thyristor`: P = G (KA (1 - F Gv))^-1 with F = 1/(1 + s TR)."""
        system = linear_plant(load_case("kundur-thyristor"), default_cache())
        self.poles = np.array(printed("kundur-pss") if poles is None else poles)
        names = system.output_labels
        outputs = {end: [k for k, name in enumerate(names) if name.endswith(end)] for end in ("_dw", "_vt")}
        self.responses, slope = [], []
        for s in self.poles:
            inner = np.linalg.solve(s * np.eye(system.nstates) - system.A, system.B)
            Gw, Gv = (np.asarray(system.C[rows] @ inner + system.D[rows]) for rows in outputs.values())
            undo = np.linalg.inv(PRINTED["KA"] * (np.eye(len(Gv)) - Gv / (1 + PRINTED["TR"] * s)))
            self.responses.append((Gw @ undo, Gv @ undo))
            shifted = [self.stabilizer(s + step, PRINTED) for step in (-STEP, STEP)]
            needed = [stabilizer_needed(system, s + step, shifted[0]) for step in (-STEP, STEP)]
            slope.append(np.log(shifted[1] / needed[1] / (shifted[0] / needed[0])) / (2 * STEP))
        self.slope = np.array(
            slope
        )  #: of log(given/needed) along s: turns a misfit of H into one of the pole

    @staticmethod
    def stabilizer(s: complex, c: dict[str, float]) -> complex:
        """The stabilizer's transfer function at s."""
        lead = (1 + s * c["T1"]) / (1 + s * c["T2"]) * (1 + s * c["T3"]) / (1 + s * c["T4"])
        return c["K"] * s * c["Tw"] / (1 + s * c["Tw"]) * lead / (1 + s * c["TS"])

    def misfit(self, c: dict[str, float]) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Distance of each pole from the printed one, to first order, half units: real parts, imaginary."""
        left = []
        for s, (Pw, Pv) in zip(self.poles, self.responses, strict=True):
            E = c["KA"] * (1 + s * c["TC"]) / (1 + s * c["TB"]) / (1 + s * c["TA"])
            G = Pw @ np.linalg.inv(np.eye(len(Pv)) + E / (1 + s * c["TR"]) * Pv) * E
            transfer = self.stabilizer(s, c)
            needed = 1.0 / np.linalg.eigvals(G)
            left.append(np.log(transfer / needed[np.argmin(abs(needed / transfer - 1))]))
        moved = np.array(left) / self.slope
        return np.concatenate([moved.real / HALF[0], moved.imag / HALF[1]])

    def fit(self, free: tuple[str, ...], starts: int = 5) -> tuple[float, dict[str, float]]:
        """Return the largest part of the least misfit (2-norm) over the constants `free`, and them."""
        best = (np.inf, dict.fromkeys(free, np.nan))
        start = np.log([PRINTED[name] or START[name] for name in free])
        for k in range(starts):
            guess = start + np.random.default_rng(k).normal(0.0, 0.7 if k else 0.0, len(free))
            solution = least_squares(
                lambda x: self.misfit(PRINTED | dict(zip(free, np.exp(x), strict=True))), guess, max_nfev=60
            )
            largest = float(abs(solution.fun).max())
            if largest < best[0]:
                best = (largest, dict(zip(free, map(float, np.exp(solution.x)), strict=True)))
        return best


def main() -> int:
    """Print the nearest choices for 1 .. --constants constants."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--constants", type=int, default=2, help="largest number changed at once")
    options = parser.parse_args()
    row = Row()
    print(f"as printed {abs(row.misfit(PRINTED)).max():6.1f}")
    for count in range(1, options.constants + 1):
        solution = sorted(
            (row.fit(free) for free in itertools.combinations(PRINTED, count)), key=lambda f: f[0]
        )
        print(f"{count} changed, the nearest of {len(solution)} choices")
        for largest, constants in solution[:8]:
            print(
                f"  {largest:8.1f}  ", ", ".join(f"{name} = {value:.4g}" for name, value in constants.items())
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
