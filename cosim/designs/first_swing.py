"""First swing: whether the areas keep synchronism after a fault with lost signals.

Eigenvalues do not show this. After a loss the local signal contains the common rise of speed; a controller
that responds to it raises the voltage of the importing area, and thereby its load, and drives the areas
apart. The predictor needs no run with the controller: the speeds of the run *without* control are its inputs,
and the mean of its output in the 1.5 s after the loss measures the drive. `after_fault` is the run itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import control
import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator
from scipy.signal import lsim

from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.cache import artefact, code_hash, content_hash, file_hash
from interarea.models.case.case import Case
from interarea.models.case.write_toml import export_toml
from interarea.models.files import temporary_folder
from interarea.models.table import Table

from ..results.largest_deviation import angles_of, with_angles
from ..run.artefacts import plant_fmu
from ..run.run import run_scenario
from ..run.swing_signal import swing_of

Array = npt.NDArray[np.float64]
Positive = Annotated[float, Field(gt=0.0)]

#: mean drive (pu) below which synchronism was kept in every run, and above which it was lost in every run of
#: the two-area system; in between both happened (0.054 lost, 0.059 kept, limits and corners being different)
STABLE_BELOW, LOST_ABOVE = 0.05, 0.1


class FaultTable(Table):
    """The fault of the certificate: a bus fault, then a branch trip, signals late and lost."""

    bus: int  #: number of the faulted bus
    branch: str  #: branch tripped when the fault is cleared
    start_s: Positive = 1.0  #: start of the fault
    clear_s: Positive = 1.1333333  #: clearing time of the fault
    lost_s: Positive = 1.5  #: start of the loss
    latency_s: Annotated[float, Field(ge=0.0)] = 0.1  #: of every signal
    stop_s: Positive = 13.0  #: end of the run
    settle_s: Positive = 10.0  #: latest settling time after the fault's start

    @model_validator(mode="after")
    def _in_order(self) -> FaultTable:
        if not self.start_s < self.clear_s < self.stop_s:
            raise ValueError(
                f"start_s = {self.start_s:g}, clear_s = {self.clear_s:g}, stop_s = {self.stop_s:g}, allowed: "
                "rising"
            )
        if not self.lost_s < self.stop_s:
            raise ValueError(f"lost_s = {self.lost_s:g}, allowed: before stop_s = {self.stop_s:g}")
        return self


@dataclass(frozen=True)
class FaultRow:
    """Result of the fault at one operating point with lost signals."""

    point: str
    lost: tuple[str, ...]
    synchronism: bool
    largest_angle: float  #: between any two machines, rad
    settled_s: float  #: after the fault's start; |speed difference| stays below 2 % of its peak from then on
    passed: bool

    @property
    def missed(self) -> str:
        """The violation of this run."""
        what = f"settled after {self.settled_s:.1f} s" if self.synchronism else "synchronism lost"
        return f"{self.point}, fault with {' and '.join(self.lost) or 'nothing'} lost: {what}"


def fault_scenario(
    case_file: Path, case: Case, fault: FaultTable, controller: str = "none"
) -> dict[str, Any]:
    """Return the scenario of the fault; a branch that is already out is not tripped."""
    events = after_clearing(case, fault.bus, fault.branch, fault.start_s, fault.clear_s)
    return {"case": str(case_file), "event": events, "controller": controller, "stop_s": fault.stop_s}


def after_clearing(
    case: Case,
    bus: int,
    trip: str | None,
    start_s: float,
    clear_s: float,
    *,
    x_pu: float = 1e-4,
) -> list[dict[str, Any]]:
    """Return the events of a fault cleared by a trip; a branch that is already out is not tripped."""
    events: list[dict[str, Any]] = [
        {"kind": "bus_fault", "bus": bus, "start_s": start_s, "end_s": clear_s, "x_pu": x_pu}
    ]
    if trip is not None and case.branch(trip).in_service:
        events.append({"kind": "branch_trip", "branch": trip, "start_s": clear_s})
    return events


def uncontrolled_speeds(case: Case, fault: FaultTable, cache: Path) -> tuple[Array, dict[str, Array]]:
    """Return time (s) and machine -> speed deviation (pu) of the fault without control, stored in `cache`."""
    window = fault.model_copy(update={"stop_s": fault.lost_s + 1.5})
    key = content_hash(file_hash(plant_fmu(case, cache)), window.model_dump(mode="json"), code_hash(__name__))

    def make(path: Path) -> None:
        with temporary_folder() as folder:
            file = folder / "case.toml"
            export_toml(case, file)
            data = run_scenario(fault_scenario(file, case, window), cache=cache).trajectory.data
        retained: dict[str, Any] = {m.name: data[f"plant.{m.name}_dw"].to_numpy() for m in case.machines}
        with path.open("wb") as out:
            np.savez(out, time_s=data["time_s"].to_numpy(), **retained)

    with np.load(artefact(cache, "uncontrolled", key, ".npz", make)) as z:
        return z["time_s"], {name: z[name] for name in z.files if name != "time_s"}


def mean_drive(
    K: control.StateSpace,
    time_s: Array,
    speeds: dict[str, Array],
    lost: Sequence[str],
    fault: FaultTable,
) -> float:
    """Return the largest of `mean_outputs`, pu; positive raises the voltage."""
    return float(mean_outputs(K, time_s, speeds, lost, fault).max())


def mean_outputs(
    K: control.StateSpace,
    time_s: Array,
    speeds: dict[str, Array],
    lost: Sequence[str],
    fault: FaultTable,
) -> Array:
    """Return the mean (pu) of each unlimited output of K in the 1.5 s after the loss.

    K : inputs ``*_dw`` in rad/s, outputs in pu. speeds : machine -> rad/s. lost : signals that are zero.
    """
    # what only a guard looks at, a flow, drives nothing
    driving = np.count_nonzero(np.vstack([K.B, K.D]), axis=0)
    u = np.column_stack(
        [
            speeds[name.removesuffix("_dw")] if drives and name not in lost else np.zeros_like(time_s)
            for name, drives in zip(K.input_labels, list(driving), strict=True)
        ]
    )
    even = np.arange(time_s[0], time_s[-1], 2e-3)
    u = np.column_stack([np.interp(even, time_s, column) for column in u.T])
    _, y, _ = lsim((K.A, K.B, K.C, K.D), u, even)
    y = y.reshape(even.size, -1)
    window = (even >= fault.lost_s) & (even <= fault.lost_s + 1.5)
    return np.asarray(y[window].mean(axis=0))


def predicted_drive(
    controller: Controller,
    cases: Mapping[str, Case],
    fault: FaultTable,
    losses: Sequence[Sequence[str]],
    cache: Path,
) -> tuple[float, str]:
    """Return the largest mean drive (pu) over operating points and losses, and its prediction.

    "kept" and "lost" beyond the thresholds, where all runs agreed; "uncertain" between them.
    """
    worst = -np.inf
    for case in cases.values():
        time_s, speeds = uncontrolled_speeds(case, fault, cache)
        in_rad = {name: case.omega_b * values for name, values in speeds.items()}
        for lost in losses:
            worst = max(worst, mean_drive(controller.system, time_s, in_rad, lost, fault))
    message = "kept" if worst < STABLE_BELOW else "lost" if worst > LOST_ABOVE else "uncertain"
    return worst, message


def after_fault(
    controller: Controller, point: str, case: Case, fault: FaultTable, lost: Sequence[str], cache: Path
) -> FaultRow:
    """Run the fault with every signal of the controller late and the `lost` ones zero from `fault.lost_s` on.

    Synchronism: no two machines more than pi apart. Settled: the swing signal of the case (`swing_of`) below
    2 % of its peak.
    """
    with temporary_folder() as folder:
        export_toml(case, folder / "case.toml")
        file = controller.save(folder / "controller.json")
        document = fault_scenario(folder / "case.toml", case, fault, str(file))
        document["channels"] = {
            f"from_{signal}": {
                "signal": signal,
                "latency_s": fault.latency_s,
                "on_loss": "zero",
                "outages_s": [[fault.lost_s, fault.stop_s]] if signal in lost else [],
            }
            for signal in controller.inputs
        }
        trajectory = run_scenario(document, cache=cache).trajectory
    data = trajectory.data
    spread = float(np.ptp(angles_of(trajectory, with_angles(case)), axis=0).max())
    swing = swing_of(case, cache)
    first = data[f"plant.{swing.ahead}_dw"]
    apart = (first - data[f"plant.{swing.behind}_dw"] if swing.behind else first).abs()
    settled = float(data["time_s"][apart > 0.02 * apart.max()].max()) - fault.start_s
    synchronous = bool(spread < np.pi)
    return FaultRow(
        point, tuple(lost), synchronous, spread, settled, synchronous and settled <= fault.settle_s
    )
