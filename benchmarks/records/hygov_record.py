"""OpenIPSL's record of HYGOV, block by block: each block fed with what the record says of its input.

    python benchmarks/records/hygov_record.py MANIFEST.toml

The largest difference from the record's own output of the block, as a share of its range. A block that is off
there is off in the record, whatever the rest of the model does: the integrator of the gate, beside its limit.
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

Array = npt.NDArray[np.float64]


def between(time: Array, values: Array) -> Callable[[float], float]:
    """Return a curve through samples, smooth but where two rows are at one time."""
    ends = np.flatnonzero(np.diff(time) <= 1e-9)
    parts = np.split(np.arange(len(time)), ends + 1)
    starts = np.array([time[part[0]] for part in parts])
    curves = [
        CubicSpline(time[part], values[part])
        if len(part) > 3
        else (lambda t, p=part: np.interp(t, time[p], values[p]))
        for part in parts
    ]
    return lambda t: float(curves[max(0, int(np.searchsorted(starts, t, side="right")) - 1)](t))


def state(rate: Callable[[float, float], float], start: float, time: Array) -> Array:
    """Return the state of dx/dt = rate(t, x) at `time`, by Heun's rule in parts of 0.5 ms at most."""
    x, values = start, [start]
    for a, b in pairwise(time.tolist()):
        parts = max(1, int(np.ceil((b - a) / 5e-4)))
        h = (b - a) / parts
        for k in range(parts if b > a else 0):
            t = a + k * h
            first = rate(t, x)
            x += 0.5 * h * (first + rate(t + h * (1.0 - 1e-9), x + h * first))
        values.append(x)
    return np.array(values)


def main() -> int:
    """Print a line a block; return the exit code."""
    manifest = Path(sys.argv[1])
    trace = next(
        t for t in tomllib.loads(manifest.read_text(encoding="utf-8"))["trace"] if t["id"] == "HYGOV"
    )
    lines = (manifest.parent / trace["csv"]).read_text(encoding="utf-8").split()
    data = np.array([[float(v or "nan") for v in row.split(",")] for row in lines[1:]])
    record = dict(zip(lines[0].split(","), data.T, strict=True))
    words = (manifest.parent / trace["dyr"]).read_text(encoding="utf-8")
    R, r, Tr, Tf, Tg, VELM, GMAX, GMIN, Tw, At, Dturb, qNL = map(
        float, re.search(r"'HYGOV'\s+\S+\s+([^/]*)/", words).group(1).split()  # type: ignore[union-attr]
    )  # fmt: skip
    time, w = record["time_s"], record["GENSAL_w_pu"]
    names = ("SimpleLag1_y", "Position_Limiter_y", "g_y", "q_y", "PMECH")
    e, c, g, q, power = (record[f"HYGOV_{name}_pu"] for name in names)
    slip_of, e_of, c_of, g_of = (between(time, values) for values in (w, e, c, g))
    pref = R * c[0]

    def opening(t: float, x: float) -> float:
        u = pref - slip_of(t) - R * x
        speed = np.clip(e_of(t) / (r * Tr) + (u - e_of(t)) / (Tf * r), -VELM, VELM)
        return float(0.0 if (x >= GMAX and speed > 0.0) or (x <= GMIN and speed < 0.0) else speed)

    blocks = {
        "filter, from speed and gate asked for": (
            e, state(lambda t, x: (pref - slip_of(t) - R * c_of(t) - x) / Tf, e[0], time),
        ),
        "gate asked for, from speed and filter": (c, np.clip(state(opening, c[0], time), GMIN, GMAX)),
        "gate, from the gate asked for": (g, state(lambda t, x: (c_of(t) - x) / Tg, g[0], time)),
        "flow, from the gate": (q, state(lambda t, x: (1.0 - (x / g_of(t)) ** 2) / Tw, q[0], time)),
        "power, from gate, flow and speed": (power, At * (q / g) ** 2 * (q - qNL) - Dturb * w * g),
    }  # fmt: skip
    for name, (recorded, values) in blocks.items():
        print(f"{name:40} {np.abs(values - recorded).max() / np.ptp(recorded):.1e}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
