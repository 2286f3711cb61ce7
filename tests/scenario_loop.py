"""A scenario's system with the master that steps it, for tests that look at both."""

from __future__ import annotations

from typing import Any

from interarea.cosim.results.latency_test import SelfTest
from interarea.cosim.results.run import Run
from interarea.cosim.run.run import system_of
from interarea.cosim.scenario.scenario import Scenario


class Loop:
    """Context manager; options as of `system_of`."""

    def __init__(self, scenario: Scenario, **options: Any) -> None:
        self.system = system_of(scenario, **options)
        self.master = self.system.master()

    def __enter__(self) -> Loop:
        return self

    def __exit__(self, *_: object) -> None:
        self.master.close()

    def result(self) -> Run:
        """Return the run so far."""
        return self.system.result(self.master)

    def self_test(self) -> SelfTest:
        """Measure every connection's latency."""
        return self.system.self_test(self.master)
