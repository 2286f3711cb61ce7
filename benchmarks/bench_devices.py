"""A device evaluated, ns: generated from its file against written by hand, as three were (plain_devices.c).

    python benchmarks/bench_devices.py [--machines 4 16 100]

Both give the same to 1e-12. Generated code is timed one device at a time and as the plant runs it: as many
together as the processor does in one operation. Ratios of neighbouring runs, their median.
"""

from __future__ import annotations

import argparse
import ctypes
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent / "plain"))
from plain_loop import compiled

from interarea.models.blocks.plant import plant_sources

LIMIT = 1.0  #: generated over by hand
ROUNDS_NS = 2e7  #: one timing
PAIRS = 21


@dataclass(frozen=True)
class Device:
    """Parameters in the order of the file, states near rest, which optional parts are there."""

    name: str
    parameters: tuple[float, ...]
    states: tuple[float, ...]
    has: int


DEVICES = (
    # KA TA TR TC TB KE TE KF TF Aex Bex VRmin VRmax MBASE vref
    Device(
        "dc1",
        (20, 0.055, 0.01, 1, 2, 1, 0.36, 0.125, 1.8, 0.0056, 1.075, -5, 5, 900, 1.11),
        (1.02, 0.09, 1.9, 1.85, 1.85),
        0xF,
    ),
    # KA TA TR TC TB VRmin VRmax KC MBASE vref
    Device("st1a", (200, 0.02, 0.01, 1, 10, -5.4, 6.4, 0.05, 900, 1.03), (1.02, 0.01, 1.9), 0x7),
    # R T1 T2 T3 Dt Vmin Vmax MBASE pref
    Device("tgov1", (0.05, 0.5, 2.1, 7, 0.1, 0.1, 1, 900, 0.78), (0.77, 0.77), 0x3),
)


class Pair:
    """One device at `machines` machines, both ways."""

    def __init__(self, which: int, machines: int) -> None:
        needed = tuple(c for c in plant_sources() if c.name in ("devices.h", "tile_4.c", "tile_8.c"))
        self._c = compiled(needed, "plain_devices.c", fmi=False)
        self._c.devices_open.restype = ctypes.c_void_p
        self._c.devices_ns.restype = ctypes.c_double
        device, self.machines = DEVICES[which], machines
        parameters, states = (np.array(v, dtype=float) for v in (device.parameters, device.states))
        sizes = [ctypes.c_size_t(n) for n in (which, machines, len(parameters), len(states))]
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (parameters, states)]
        self._pair = ctypes.c_void_p(self._c.devices_open(*sizes, ctypes.c_uint64(device.has), *pointers))
        self._rates = np.empty(machines * (1 + len(states)))

    def ns(self, rounds: int, *, hand: bool, together: bool = False) -> float:
        """Return the CPU time of one device, ns; afterwards `rates` are what it gave."""
        target = self._rates.ctypes.data_as(ctypes.c_void_p)
        return float(self._c.devices_ns(self._pair, int(hand), int(together), ctypes.c_long(rounds), target))

    def rates(self, *, hand: bool, together: bool = False) -> np.ndarray:
        """Return outputs and rates of every device after one evaluation."""
        self.ns(1, hand=hand, together=together)
        return self._rates.copy()


def measure(which: int, machines: int) -> tuple[float, float, float]:
    """Return ns by hand and the ratios of generated code to it, alone and together."""
    pair = Pair(which, machines)
    rounds = max(1, round(ROUNDS_NS / (machines * pair.ns(1000, hand=True))))
    hand, alone, together = np.array(
        [
            (
                pair.ns(rounds, hand=True),
                pair.ns(rounds, hand=False),
                pair.ns(rounds, hand=False, together=True),
            )
            for _ in range(PAIRS)
        ]
    ).T
    return float(np.median(hand)), float(np.median(alone / hand)), float(np.median(together / hand))


def main() -> int:
    """Print one line for each device and number of machines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, nargs="+", default=[4, 16, 100])
    options = parser.parse_args()
    reached = True
    for which, device in enumerate(DEVICES):
        for machines in options.machines:
            hand, alone, together = measure(which, machines)
            reached &= bool(together <= LIMIT)
            print(
                f"{device.name:6} {machines:4} machines: by hand {hand:5.1f} ns, generated {alone:.2f} of it "
                f"one at a time, {together:.2f} as the plant runs it (wanted {LIMIT:g})"
            )
    return 0 if reached else 1


if __name__ == "__main__":
    sys.exit(main())
