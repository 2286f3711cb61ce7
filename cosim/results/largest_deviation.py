"""How far a grid strays after a fault: angles between machines, voltages, frequencies."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from interarea.models.case.case import Case
from interarea.models.case.checks import islands_of

from ..trajectory import Trajectory

#: what a plant must show for it (`plant_shown.shown_of`)
SHOWN = ("*_*", "bus*.v")
OUT_OF_STEP_DEG = 180.0  #: between two machines: synchronism is lost


@dataclass(frozen=True)
class LargestDeviation:
    """Extremes of a run.

    angle_deg : largest angle between any two machines that run in one part of the network. voltage_pu :
        lowest of all buses (of the machines' terminals where no bus is shown) from the last event on;
        `voltage_at` says where.
    nadir_hz, zenith_hz : lowest and highest frequency of a machine, of its speed.
    """

    angle_deg: float
    voltage_pu: float
    voltage_at: str
    nadir_hz: float
    zenith_hz: float

    @property
    def synchronous(self) -> bool:
        """Whether no two machines came half a turn apart."""
        return self.angle_deg < OUT_OF_STEP_DEG


def largest_deviation_of(
    trajectory: Trajectory, case: Case, from_s: float, machines: Sequence[str] | None = None
) -> LargestDeviation:
    """Return the extremes of a run whose last event is at `from_s`, of `machines` (default: all).

    Raises
    ------
    KeyError : the plant does not show its machines' angles and speeds.
    """
    machines = machines_judged(case, ()) if machines is None else machines
    angles = np.array([trajectory[f"plant.{name}_delta"] for name in machines])
    slips = np.array([trajectory[f"plant.{name}_dw"] for name in machines])
    buses = [f"bus{b.number}.v" for b in case.buses]
    seen = buses if f"plant.{buses[0]}" in trajectory else [f"{name}_vt" for name in machines]
    # an event's instant is recorded twice, before and after: only what follows counts
    after = trajectory.time_s > from_s
    volts = np.array([trajectory[f"plant.{name}"] for name in seen])[:, after]
    lowest = volts.min(axis=1) if volts.shape[1] else np.full(len(seen), np.nan)
    place = int(np.argmin(lowest))
    return LargestDeviation(
        angle_deg=max(
            float(np.degrees(np.ptp(angles[part], axis=0).max())) for part in parts_of(case, machines)
        ),
        voltage_pu=float(lowest[place]),
        voltage_at=seen[place].removesuffix(".v").removesuffix("_vt"),
        nadir_hz=float(case.frequency_hz * (1.0 + slips.min())),
        zenith_hz=float(case.frequency_hz * (1.0 + slips.max())),
    )


def parts_of(case: Case, machines: Sequence[str]) -> list[list[int]]:
    """Places of the machines in each part of the network: between parts angles mean nothing."""
    if sum(m.slack for m in case.machines) == 1:  # each part has one
        return [list(range(len(machines)))]
    at = {m.name: m.bus for m in case.machines}
    islands = [[k for k, name in enumerate(machines) if at[name] in part] for part in islands_of(case)]
    return [places for places in islands if places]


def machines_judged(case: Case, events: Iterable[Any]) -> list[str]:
    """Return the machines whose angles count: those that no event may trip."""
    tripped = {e.machine for e in events if e.kind in ("machine_trip", "frequency_trip")}
    return [m.name for m in case.machines if m.name not in tripped]
