"""How a wrong device is reported: one class, one line, with file, line and remedy."""

from __future__ import annotations

from ..errors import CaseError


class DeviceError(CaseError):
    """A device file, or a record that fills it, is wrong: one line with place, value and what is allowed."""


class BeyondLimit(DeviceError):
    """A signal that would rest beyond a limit of its device.

    signal, value : what would rest where. limit : the limit as the diagram has it. above : whether it is an
    upper one.
    """

    def __init__(self, text: str, *, signal: str, value: float, limit: str, above: bool) -> None:
        super().__init__(text)
        self.signal, self.value, self.limit, self.above = signal, value, limit, above
