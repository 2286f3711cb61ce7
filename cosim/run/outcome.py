"""What a master leaves behind, as the fields of a `Result`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from interarea.models.blocks.pmu import PmuFilter

from ..errors import StepError
from ..master.master import Master
from ..results.accumulators import Accumulators
from ..results.delay_ledger import delay_ledger, explain, packet_ledger
from ..scenario.channels import ChannelLine, Delays
from ..scenario.concentrators import ConcentratorLine
from ..trajectory import Trajectory


def fields_of_result(
    master: Master,
    trajectory: Trajectory,
    accumulators: Accumulators,
    *,
    pmus: Mapping[str, PmuFilter],
    channels: Mapping[str, ChannelLine | ConcentratorLine],
    rounded: Sequence[str],
    warnings: Sequence[str],
    failed: StepError | None = None,
) -> dict[str, Any]:
    """Return the fields of a `Result` by name; `failed` is what ended the run before its time."""
    delays = {name: Delays(p.delay_s, 0.0, measuring_s=p.delay_s) for name, p in pmus.items()}
    delays |= {name: line.delays(master.clock) for name, line in channels.items()}
    ledger = delay_ledger(master, delays, rounded)
    of_fmus = [line for log in master.fmu_logs if (line := log.warning())]
    ended = [] if failed is None else [f"the run ended early: {failed}"]
    return {
        "trajectory": trajectory,
        "ledger": ledger,
        "packets": packet_ledger(trajectory, accumulators),
        "explanation": explain(master, ledger),
        "warnings": (*warnings, *of_fmus, *ended),
        "fmu_log": tuple(line for log in master.fmu_logs for line in log.as_text()),
    }
