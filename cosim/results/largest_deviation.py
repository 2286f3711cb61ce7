"""How far a grid strays after a fault: angles between machines, voltages, frequencies."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from interarea.models.case.case import Case
from interarea.models.case.checks import islands_of
from interarea.models.grid.coupling import voltage_sources

from ..trajectory import Trajectory

Array = npt.NDArray[np.float64]
#: what a plant must show for it (`plant_shown.shown_of`)
SHOWN = ("*_*", "bus*.v")
OUT_OF_STEP_DEG = 180.0  #: between two machines: synchronism is lost


@dataclass(frozen=True)
class LargestDeviation:
    """Extremes of a run.

    angle_deg : largest angle between any two machines, or converters that are voltage sources, that run in
        one part of the network. voltage_pu :
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
        """Whether no two of them came half a turn apart."""
        return self.angle_deg < OUT_OF_STEP_DEG


def largest_deviation_of(
    trajectory: Trajectory, case: Case, from_s: float, events: Iterable[Any] = ()
) -> LargestDeviation:
    """Return the extremes of a run whose last event is at `from_s`, of what no event may trip.

    Raises
    ------
    KeyError : the plant does not show the angles and speeds.
    """
    machines, sources = judged_of(case, events)
    names = (*machines, *sources)
    angles = angles_of(trajectory, names)
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
            float(np.degrees(np.ptp(angles[part], axis=0).max())) for part in parts_of(case, names)
        ),
        voltage_pu=float(lowest[place]),
        voltage_at=seen[place].removesuffix(".v").removesuffix("_vt"),
        nadir_hz=float(case.frequency_hz * (1.0 + slips.min())),
        zenith_hz=float(case.frequency_hz * (1.0 + slips.max())),
    )


def parts_of(case: Case, names: Sequence[str]) -> list[list[int]]:
    """Places of machines and sources in each part of the network: between parts angles mean nothing."""
    if sum(m.slack for m in case.machines) == 1:  # each part has one
        return [list(range(len(names)))]
    at = {m.name: m.bus for m in case.machines} | {c.name: c.bus for c in case.converters}
    islands = [[k for k, name in enumerate(names) if at[name] in part] for part in islands_of(case)]
    return [places for places in islands if places]


def judged_of(case: Case, events: Iterable[Any] = ()) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return whose angles count, those that no event may trip: machines, converters that are voltage sources.

    The plant shows the angle of either as `NAME_delta`.
    """
    events = list(events)
    machines = {e.machine for e in events if e.kind in ("machine_trip", "frequency_trip")}
    devices = {e.device for e in events if e.kind == "device_trip"}
    return (
        tuple(m.name for m in case.machines if m.name not in machines),
        tuple(name for name in voltage_sources(case) if name not in devices),
    )


def with_angles(case: Case) -> tuple[str, ...]:
    """Return the names of all machines and voltage sources."""
    machines, sources = judged_of(case)
    return (*machines, *sources)


def angles_of(trajectory: Trajectory, names: Sequence[str]) -> Array:
    """Return the angles of machines and voltage sources, (names, points), rad."""
    return np.array([trajectory[f"plant.{name}_delta"] for name in names])
