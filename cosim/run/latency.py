"""The latency test of a system: its channels with nothing random, lost or rounded."""

from __future__ import annotations

from collections.abc import Mapping

from interarea.fmu_build.open.fmu_file import FmuFile

from ..master.instances import FmuParticipant
from ..master.master import Master
from ..participant import Participant
from ..results.latency_test import SelfTest, self_test
from ..scenario.channels import ChannelLine, hold_packets, points_of
from ..scenario.concentrators import ConcentratorLine


def self_test_of(
    master: Master,
    channels: Mapping[str, ChannelLine | ConcentratorLine],
    files: Mapping[str, FmuFile],
    arrivals: str,
) -> SelfTest:
    """Return the latency of every connection of a master, measured; files : of the channels."""
    lines = {name: line.steady for name, line in channels.items()}

    def fresh(name: str) -> Participant:
        line = lines[name]
        return hold_packets(FmuParticipant(name, files[name], line.parameters(name)), line)

    return self_test(
        master,
        {name: fresh(name) for name in lines},
        delays=lambda clock: {name: line.delays(clock) for name, line in lines.items()},
        points=lambda stop_s: points_of(lines.values(), arrivals, 0.0, stop_s),
        interval_s=max([line.reporting_interval_s for line in lines.values()], default=0.0),
    )
