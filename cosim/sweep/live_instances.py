"""FMUs and instances of a sweep that stay alive from run to run."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.models.case.case import Case

from ..errors import ScenarioError
from ..master.instances import FmuParticipant
from ..master.instances import Value as Start
from ..run.run import Loop
from .point import Point
from .shared_start import Beginning


class TimeUpError(RuntimeError):
    """A run computes longer than the sweep allows."""


def watch_of(limit_s: float) -> Callable[[float, float], None]:
    """Return what ends a run that computes longer than `limit_s` from now."""
    end = time.monotonic() + limit_s

    def watch(now_s: float, stop_s: float) -> None:
        if time.monotonic() > end:
            raise TimeUpError(f"more than {limit_s:g} s of computing, at t = {now_s:g} of {stop_s:g} s")

    return watch


@dataclass
class Plant:
    """A case of the sweep as an FMU; `own` files go when it is no longer needed."""

    case: Case
    file: FmuFile
    own: bool

    def close(self) -> None:
        self.file.close()
        if self.own:
            self.file.path.unlink(missing_ok=True)


@dataclass
class Kept:
    """Live instances for one structure (case, controller, channels), and the loop made of them last.

    beginnings : states that runs to come start from, earliest first.
    """

    participants: dict[str, FmuParticipant] = field(default_factory=dict)
    key: Any = None
    loop: Loop = field(init=False)
    beginnings: list[Beginning] = field(default_factory=list)

    def release(self, after_s: float = -math.inf) -> None:
        """Free the beginnings that reach beyond `after_s`."""
        while self.beginnings and self.beginnings[-1].until_s > after_s:
            self.loop.master.release(self.beginnings.pop().fork.saved)

    def close(self) -> None:
        self.release()
        for p in self.participants.values():
            p.close()


def controller_start(file: FmuFile, point: Point) -> dict[str, Start]:
    """Return the start values that a point asks of its controller's FMU.

    Raises
    ------
    ScenarioError : a gain for a controller without matrices.
    """
    start: dict[str, Start] = {}
    if point.gain != 1.0:
        for v in file.model.variables:
            if v.causality == "parameter" and v.name[:2] in ("C[", "D[") and file.start_of(v.name) != 0.0:
                start[v.name] = point.gain * file.start_of(v.name)
        if not start:
            raise ScenarioError(
                f"controller.gain = {point.gain:g}: {file.path.name} has no matrices among its parameters; "
                "allowed for a single linear controller"
            )
    return start | dict(point.controller_start)
