"""How a wrong device is reported: one class, one line, with file, line and remedy."""

from __future__ import annotations

from ..errors import CaseError


class DeviceError(CaseError):
    """A device file, or a record that fills it, is wrong: one line with place, value and what is allowed."""
