"""What the master needs of anything it steps: an FMU, or a model written in Python."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from interarea.fmu_build.open.ports import Description


class Participant(Protocol):
    """One instance in a run. Numbers pass through the buffers `u`, `du`, `y`, `dy`.

    u[i] : value of bound input i; du[3 i + k - 1] : its k-th derivative (k = 1..3).
    y[j] : value of output j in the order of the description; dy[m] : slope of the m-th bound slope.
    Integers and Booleans travel as floats.
    """

    name: str
    description: Description
    u: Any
    du: Any
    y: Any
    dy: Any

    def bind(self, inputs: Sequence[str], slopes: Sequence[str]) -> None:
        """Fix which inputs will be sent and of which outputs slopes will be asked; makes the buffers."""

    def begin(self, start_s: float, stop_s: float) -> None:
        """Instantiate or reset, set start values, enter initialisation."""

    def ready(self) -> None:
        """Leave initialisation."""

    def send(self, order: int) -> None:
        """Set the bound inputs from `u`, and their derivatives up to `order` from `du`."""

    def advance(self, time_s: float, length_s: float) -> None:
        """Do one step; raises StepError."""

    def receive(self, slopes: bool) -> None:
        """Fill `y`, and `dy` if `slopes`."""

    def save(self) -> Any:
        """Return a copy of the state."""

    def restore(self, state: Any) -> None:
        """Go back to a saved state."""

    def release(self, state: Any) -> None:
        """Free a saved state."""

    def last_log(self) -> str:
        """Return the last line the instance logged, or an empty string."""

    def close(self) -> None:
        """End the instance and free what it holds."""
