"""What a run of a sweep leaves: one row of numbers, and its trajectory where that is wanted.

A failed run is a row too: `status` = "failed", `failure` is the kind, `reason` the message, numbers are null.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from ..results.delay_ledger import PACKET_COUNTS
from ..results.largest_deviation import LargestDeviation
from ..results.metrics import SYNCHRONISM, Metrics
from ..results.verdict import NOT_JUDGED, RULE, VERDICTS
from ..trajectory import Trajectory
from .plan import SweepPlan
from .spec import Sweep
from .values import Value

#: kinds of failure: a value that makes no scenario, an FMU's error, an FMU whose equations have no solution
#: (voltages that collapse), NaN, computing too long, a worker lost
FAILURES = ("invalid", "fmu", "no solution", "not finite", "time limit", "worker died", "internal")
PACKETS = {
    "packets_sent": "sent",
    "packets_delivered": "delivered",
    "packets_lost": "dropped",
    "packets_late": "late",
}
COMMUTATION = "commutation_failure"  #: column of sweeps with line-commutated dc links
#: metric -> column, which is the field of `Metrics` too
_COLUMNS = {
    "settling_time": "settling_time_s",
    "peak": "peak_pu",
    "energy": "energy_pu2s",
    "effort": "effort_pu2s",
    "fit_error": "fit_error",
}
Row = dict[str, Any]
#: column of `SYNCHRONISM` -> type, unit, meaning
_DEVIATION = {
    "synchronous": (
        pa.bool_(),
        "",
        "the angle between any two machines or voltage sources stays below 180 deg",
    ),
    "angle_deg": (pa.float64(), "deg", "largest angle between two machines or voltage sources"),
    "voltage_pu": (pa.float64(), "pu", "lowest voltage after the last event"),
    "voltage_at": (pa.string(), "", "where that is"),
    "nadir_hz": (pa.float64(), "Hz", "lowest frequency of a machine"),
    "zenith_hz": (pa.float64(), "Hz", "highest frequency of a machine"),
}


@dataclass(frozen=True)
class Outcome:
    """Row of a run; `trajectory` only where the sweep keeps it; `forked`: started where another run was."""

    row: Row
    trajectory: pa.Table | None = None
    forked: bool = False


def column_of_mode(kind: str, mode: str) -> str:
    """Return the column of a mode's number: damping of "inter-area" -> damping_inter_area."""
    return f"{kind}_{mode.replace('-', '_').replace(' ', '_')}"


def schema_of(plan: SweepPlan) -> pa.Schema:
    """Return the columns of the results; their metadata holds unit and meaning."""
    sweep = plan.sweep
    swings = {name: plan.swing(name) for name in plan.swings}
    signal = " or ".join(dict.fromkeys(s.name for s in swings.values())) or "speed difference"
    fields = [_field("run", pa.int64(), "", "number of the run", nullable=False)]
    search = sweep.searched
    for name, p in sweep.parameters.items():
        where = " and ".join(".".join(w) for w in sweep.paths(name))
        kind = pa.float64() if p.bisect is not None else _type_of(p.probes())
        fields.append(_field(name, kind, p.unit, p.label or where, nullable=p.bisect is not None))
    fields += [
        _field("status", pa.string(), "", "ok or failed", nullable=False),
        _field("failure", pa.string(), "", f"kind of failure: {', '.join(FAILURES)}"),
        _field("reason", pa.string(), "", "what went wrong"),
    ]
    if search is not None:
        fields += [
            _field(
                f"{search[0]}_unstable",
                pa.float64(),
                "",
                "least value found unstable; null: none up to `high`",
            ),
            _field("evaluations", pa.int64(), "", "runs the search took"),
        ]
    fields += _measured_fields(plan, signal)
    notes = {"specification": plan.hash, "version": plan.version, "title": sweep.title or sweep.name}
    notes["swing"] = "; ".join(f"{name}: {swing.name}, {swing.text}" for name, swing in swings.items())
    return pa.schema(fields, metadata=notes)


def _measured_fields(plan: SweepPlan, signal: str) -> list[pa.Field]:
    """Return the columns of what is measured; `signal` names the speed difference."""
    requested, fields = plan.sweep.metrics, []
    if "least" in requested:
        text = "the least damped mode"
        fields += [
            _field("damping_least", pa.float64(), "1", f"damping ratio {text}"),
            _field("frequency_least", pa.float64(), "Hz", f"frequency {text}"),
        ]
    if "stable" in requested:
        fields += [
            _field(
                "stable",
                pa.bool_(),
                "",
                "synchronism is kept and the swing decays: the first two verdicts",
            ),
            _field("verdict", pa.string(), "", f"{', '.join(VERDICTS)} or {NOT_JUDGED}; {RULE}"),
        ]
    for kind, unit in (("damping", "1"), ("frequency", "Hz")):
        if kind in requested:
            text = (
                f"{kind} of the mode: its root in the loop, else in the ring-down; null: it is not identified"
            )
            fields += [_field(column_of_mode(kind, mode), pa.float64(), unit, text) for mode in plan.modes]
    for name, column, unit, text in (
        (
            "settling_time",
            "settling_time_s",
            "s",
            "from the last event to within 2 % of the peak; null: it does not",
        ),
        ("peak", "peak_pu", "pu", f"largest |{signal}|"),
        ("energy", "energy_pu2s", "pu2 s", f"integral of {signal}^2"),
        ("effort", "effort_pu2s", "pu2 s", "integral of the square of the control signals"),
        ("fit_error", "fit_error", "1", "largest misfit of the ring-down over the largest signal"),
    ):
        if name in requested:
            fields.append(_field(column, pa.float64(), unit, text))
    if SYNCHRONISM in requested:
        fields += [_field(c, *rest) for c, rest in _DEVIATION.items()]
    if plan.has_dc_links:
        text = "dc links that fail to commutate; null: none; the model continues without a failure"
        fields.append(_field(COMMUTATION, pa.string(), "", text))
    if "packets" in requested:
        fields += [_field(c, pa.int64(), "", f"packets {w}, all channels") for c, w in PACKETS.items()]
    return fields


def start_row(run: int, values: Mapping[str, Value]) -> Row:
    """Return the row of a run before it has run: its number and parameters."""
    plain = {k: str(list(v)) if isinstance(v, tuple) else v for k, v in values.items()}
    return {"run": run, **plain, "status": "ok", "failure": None, "reason": None}


def failed_row(sweep: Sweep, run: int, failure: str, reason: str) -> Row:
    """Return the row of a run that failed."""
    row = start_row(run, sweep.values(run))
    return row | {"status": "failed", "failure": failure, "reason": " ".join(reason.split())[:500]}


def measured(
    metrics: Metrics,
    metric_names: Collection[str],
    modes: Sequence[str],
    packets: Iterable[Mapping[str, float]],
) -> Row:
    """Return the columns of `metric_names`; packets : what each channel counted (`packet_counts`)."""
    row: Row = {}
    if "least" in metric_names:
        row |= {"damping_least": metrics.least_damping_ratio, "frequency_least": metrics.least_frequency_hz}
    if "stable" in metric_names:
        row |= {"stable": metrics.stable, "verdict": None if (v := metrics.verdict) is None else v.name}
    for name, result in (("damping", metrics.damping_ratio), ("frequency", metrics.frequency_hz)):
        if name in metric_names:
            row |= {column_of_mode(name, mode): result.get(mode) for mode in modes}
    for name, column in _COLUMNS.items():
        if name in metric_names:
            row[column] = getattr(metrics, column)
    if "packets" in metric_names:
        counts = list(packets)
        row |= {column: int(sum(c.get(name, 0.0) for c in counts)) for column, name in PACKETS.items()}
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}


def deviation_row(largest_deviation: LargestDeviation) -> Row:
    """Return the columns of `SYNCHRONISM`."""
    return {column: getattr(largest_deviation, column) for column in _DEVIATION}


def packet_counts(participant: Any) -> dict[str, float]:
    """Return what a channel counted; empty for an instance that counts nothing."""
    known = participant.file.variables
    return {name: participant.value_of(name) for name in (*PACKET_COUNTS, "age") if name in known}


def trajectory_table(sweep: Sweep, run: int, curves: Trajectory) -> pa.Table:
    """Return a trajectory as a table with the run's number in front."""
    data = curves.data
    requested = sweep.trajectories.columns
    chosen = [c for c in map(str, data) if c == "time_s" or not requested or c in requested]
    every = slice(None, None, sweep.trajectories.every)
    arrays = {c: pa.array(data[c].to_numpy()[every]) for c in chosen}
    return pa.table({"run": pa.array([run] * len(arrays["time_s"]), pa.int64()), **arrays})


def _type_of(values: Sequence[Value]) -> pa.DataType:
    if values and all(isinstance(v, bool) for v in values):
        return pa.bool_()
    if any(isinstance(v, str | tuple | bool) for v in values):
        return pa.string()
    return pa.int64() if values and all(isinstance(v, int) for v in values) else pa.float64()


def _field(name: str, kind: pa.DataType, unit: str, text: str, *, nullable: bool = True) -> pa.Field:
    notes = {k: v for k, v in {"unit": unit, "description": text}.items() if v}
    return pa.field(name, kind, nullable=nullable, metadata=notes)
