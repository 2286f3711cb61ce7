"""Sensitivity of the first swing to each actuator, by pulses in runs without control, cached.

Input of `design.robust.swing_penalty`: for every operating point, exciter ceiling and fault the first peak of
the angle between the two machines that move furthest apart, its change by a pulse of each actuator in each
time slot, and the inputs of the controller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import Field

from interarea.design.robust.swing_penalty import SwingCase, SwingPenalty
from interarea.fmu_build.write.cache import artefact, code_hash, content_hash, file_hash
from interarea.models.case.case import Case
from interarea.models.table import Table

from ..errors import ScenarioError
from ..results.largest_deviation import angles_of, with_angles
from ..run.artefacts import plant_fmu
from ..trajectory import Trajectory
from .acceptance import with_ceilings
from .design_tables import AcceptanceTable, FaultPlace, require_points
from .fault_runs import FaultRun, FaultRuns
from .first_swing import Positive, after_clearing

Array = npt.NDArray[np.float64]

#: length and size of a pulse, s and pu; steps of the samples, s
SLOT_S, PULSE_PU, STEP_S = 0.1, 0.02, 0.02
#: how long after the fault's start a first peak is looked for, s
LONGEST_S = 2.5


class FirstSwingTable(Table):
    """The first swing in the design: the largest contribution of the controller, to first order."""

    #: degrees allowed of every case, step by step: the search goes from one to the next
    margins_deg: tuple[float, ...] = Field((20.0, 14.0, 10.0, 7.0, 5.0), min_length=1)
    points: tuple[str, ...] = ()  #: operating points; none: all of the design
    #: (least, most) field voltage of every exciter with limits, pu, in addition to the case's own; none:
    #: those of the acceptance
    ceilings: tuple[tuple[float, float], ...] = ()
    latency_s: Annotated[float, Field(ge=0.0)] = 0.1  #: of every signal
    limit_pu: Positive | None = None  #: of the outputs in this calculation; none: the design's

    def check(self, points: Sequence[str], acceptance: AcceptanceTable | None) -> None:
        """Raise ValueError if it names no point of the design, or if there is no fault."""
        if acceptance is None:
            raise ValueError("first_swing needs [acceptance]: it uses the faults named there")
        require_points("first_swing.points", self.points, points)


@dataclass(frozen=True)
class FirstSwing:
    """The first swing of one fault without control: up to its peak, samples of `STEP_S` from the fault on."""

    peak_deg: float
    speeds: Mapping[str, Array]  #: machine -> (t,) pu
    sensitivity: Mapping[str, Array]  #: actuator -> (t,) degrees of the peak per pu and second; 0 after it


def swing_penalty(
    cases: Mapping[str, Case],
    table: FirstSwingTable,
    acceptance: AcceptanceTable,
    signals: Sequence[str],
    actuators: Sequence[str],
    losses: Sequence[Sequence[str]],
    limit_pu: float,
    cache: Path,
) -> SwingPenalty:
    """Return the penalty over all cases whose first swing has a peak, each with every loss.

    losses : signals lost from the acceptance's `lost_s` on; (): none.

    Raises
    ------
    ScenarioError : an actuator that is not a set-point, or no fault that the grid without control survives.
    """
    swing_cases: list[SwingCase] = []
    for point in table.points or tuple(cases):
        for ceiling in (None, *(table.ceilings or acceptance.ceilings)):
            case = cases[point] if ceiling is None else with_ceilings(cases[point], *ceiling)
            for fault in acceptance.fault:
                swing = first_swing(case, fault, acceptance, actuators, cache)
                if swing is None:
                    continue
                name = f"{point}, {'no ceilings' if ceiling is None else ceiling}, fault at {fault}"
                sensitivity = np.column_stack([swing.sensitivity[a] for a in actuators])
                swing_cases += [
                    SwingCase(
                        f"{name}, {' and '.join(lost) or 'nothing'} lost",
                        _seen(swing, signals, lost, table.latency_s, acceptance, case.omega_b),
                        sensitivity,
                    )
                    for lost in losses
                ]
    if not swing_cases:
        raise ScenarioError(
            "first_swing: no fault of the acceptance has a first peak without control; shorten it "
            "(acceptance.clear_cycles) or name other points"
        )
    return SwingPenalty(swing_cases, STEP_S, table.limit_pu or limit_pu, table.margins_deg[0])


def _seen(
    swing: FirstSwing,
    signals: Sequence[str],
    lost: Sequence[str],
    latency_s: float,
    acceptance: AcceptanceTable,
    omega_b: float,
) -> Array:
    """Return the signals (t, p) as they arrive, rad/s: late, and zero from the loss on."""
    columns = []
    for signal in signals:
        speed = omega_b * swing.speeds[signal.removesuffix("_dw")]
        time = STEP_S * np.arange(speed.size)
        column = np.interp(time - latency_s, time, speed, left=0.0)
        after_loss = acceptance.start_s + time >= acceptance.lost_s
        columns.append(np.where(after_loss & (signal in lost), 0.0, column))
    return np.column_stack(columns)


def first_swing(
    case: Case, fault: FaultPlace, acceptance: AcceptanceTable, actuators: Sequence[str], cache: Path
) -> FirstSwing | None:
    """Return the first swing of a fault, stored in `cache`; None if it has no peak."""
    machines = [name.removesuffix("_vs") for name in actuators]
    unknown = [a for a in actuators if not a.endswith("_vs")]
    if unknown:
        raise ScenarioError(
            f"first_swing: {', '.join(unknown)} is not a voltage set-point, allowed: names that end in _vs"
        )
    timing = acceptance.model_dump(mode="json", include={"start_s", "clear_cycles", "x_pu"})
    key = content_hash(
        file_hash(plant_fmu(case, cache)), fault.model_dump(), timing, list(actuators), code_hash(__name__)
    )

    def make(path: Path) -> None:
        with FaultRuns(case, cache) as runs:
            arrays = _pulsed(runs, fault, acceptance, machines)
        with path.open("wb") as out:
            np.savez(out, **arrays)

    with np.load(artefact(cache, "first-swing", key, ".npz", make)) as z:
        if "peak_deg" not in z.files:
            return None
        return FirstSwing(
            float(z["peak_deg"]),
            {m.name: z[f"speed_{m.name}"] for m in case.machines},
            {a: z[f"to_{m}"] for a, m in zip(actuators, machines, strict=True)},
        )


def _pulsed(
    runs: FaultRuns, fault: FaultPlace, acceptance: AcceptanceTable, machines: Sequence[str]
) -> dict[str, Any]:
    """Run the fault alone, then with a pulse up and down in each slot before the peak."""
    t = acceptance
    clear_s = t.start_s + t.clear_cycles / runs.case.frequency_hz
    events = after_clearing(runs.case, fault.bus, fault.trip, t.start_s, clear_s, x_pu=t.x_pu)
    stop_s = t.start_s + LONGEST_S
    alone = next(iter(runs.run([FaultRun(events, stop_s)])))
    peak = _first_peak(runs.case, alone, clear_s)
    if peak is None:
        return {"none": np.array(0.0)}
    peak_s, pair, peak_deg = peak
    even = np.arange(t.start_s, stop_s, STEP_S)
    slots = np.arange(t.start_s, peak_s, SLOT_S)
    pulses = [(m, start, sign) for m in machines for start in slots for sign in (1.0, -1.0)]
    outcomes = runs.run(
        [
            FaultRun(
                [
                    *events,
                    {
                        "kind": "vref_pulse",
                        "machine": m,
                        "size_pu": sign * PULSE_PU,
                        "start_s": round(float(start), 6),
                        "end_s": round(float(start) + SLOT_S, 6),
                    },
                ],
                round(float(peak_s) + 0.05, 6),
            )
            for m, start, sign in pulses
        ]
    )
    arrays: dict[str, Any] = {"peak_deg": np.array(peak_deg)}
    for each in runs.case.machines:
        arrays[f"speed_{each.name}"] = np.interp(even, alone.time_s, alone[f"plant.{each.name}_dw"])
    arrays |= {f"to_{m}": np.zeros(even.size) for m in machines}
    for (name, start, sign), data in zip(pulses, outcomes, strict=True):
        # of first order in the pulse the peak moves as the angle at its instant does
        angle = float(np.degrees(np.interp(peak_s, data.time_s, _apart(data, pair))))
        inside = (even >= start - 1e-9) & (even < start + SLOT_S - 1e-9)
        arrays[f"to_{name}"][inside] += sign * angle / (2.0 * PULSE_PU * SLOT_S)
    return arrays


def _first_peak(case: Case, data: Trajectory, clear_s: float) -> tuple[float, tuple[str, str], float] | None:
    """Return when the largest angle first turns after the fault, whose angle it is, and degrees."""
    time, names = data.time_s, with_angles(case)
    angles = angles_of(data, names)
    apart = np.ptp(angles, axis=0)
    after = np.flatnonzero(time > clear_s)[1:-1]
    turns = after[(apart[after] >= apart[after - 1]) & (apart[after] > apart[after + 1])]
    if turns.size == 0 or not apart[turns[0]] < np.pi:
        return None
    top = int(turns[0])
    pair = (names[int(np.argmax(angles[:, top]))], names[int(np.argmin(angles[:, top]))])
    return float(time[top]), pair, float(np.degrees(apart[top]))


def _apart(data: Trajectory, pair: tuple[str, str]) -> Array:
    return np.asarray(data[f"plant.{pair[0]}_delta"] - data[f"plant.{pair[1]}_delta"])
