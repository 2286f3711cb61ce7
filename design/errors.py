"""What a design can fail with."""

from __future__ import annotations

from typing import Any

from interarea.models.errors import InterareaError


class InfeasibleDesign(InterareaError, ValueError):
    """No controller meets the specification; `constraint` names what cannot be met, `relaxed` what can.

    Attributes
    ----------
    constraint : the specification at fault, e.g. "damping_ratio".
    asked : its value.
    reachable : the nearest value found feasible, None if none is.
    """

    def __init__(self, message: str, *, constraint: str, asked: Any = None, reachable: Any = None) -> None:
        super().__init__(message)
        self.constraint = constraint
        self.asked = asked
        self.reachable = reachable


class UncertifiedDesign(InterareaError, RuntimeError):
    """A controller was computed, but a check of the closed loop contradicts what was asked."""


class SolverError(InterareaError, RuntimeError):
    """An LMI engine stopped without an answer."""
