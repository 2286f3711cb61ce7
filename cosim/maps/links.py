"""From a map to a run: which address of the sweep's explorer opens the run that a cell stands for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import pandas as pd

from ..explorer.address import address_of
from ..explorer.page import write_where_held
from ..explorer.subject import Subject
from ..scenario.scenario import OperatingPointTable
from ..sweep.plan import SweepPlan
from ..sweep.point import point_of
from .page_data import worst_runs

_MOST = 400  #: cells of a map with a link; more are too small to hit

Cell = tuple[float, float]  #: values of a map's two parameters


@dataclass
class Explorer:
    """The page beside the maps, in which runs of the sweep open.

    file : its name; "" where there is none, and `why`.
    """

    plan: SweepPlan
    subject: Subject | None = None
    file: str = ""
    why: str = ""
    _known: dict[int, str | None] = field(default_factory=dict)

    def run(self, number: int) -> str | None:
        """Return the address of a run, relative to the maps; None where no state of the page is that run."""
        if self.subject is None:
            return None
        if number not in self._known:
            self._known[number] = _address(self.plan, self.subject, number)
        address = self._known[number]
        return None if address is None else self.file + address

    def known(self, number: int) -> str | None:
        """Return the address of a run that was asked for before."""
        address = self._known.get(number)
        return None if address is None else self.file + address

    def cells(self, rows: pd.DataFrame, x: str, y: str) -> dict[Cell, str]:
        """Return the address of the worst run of each cell that the page can open."""
        links: dict[Cell, str] = {}
        groups = rows.groupby([x, y])
        if self.subject is None or groups.ngroups > _MOST:
            return links
        for at, group in groups:
            a, b = cast("tuple[float, float]", at)
            number = next(iter(worst_runs(group, 1)), int(group.run.iloc[0]))
            address = self.run(number)
            if address is not None:
                links[float(a), float(b)] = address
        return links


def write_runs(plan: SweepPlan, path: Path, cache: Path) -> Explorer:
    """Write the explorer of a sweep's scenario to `path`; where no page holds it there is none, and why."""
    if plan.sweep.searched is not None:
        return Explorer(plan)
    subject, why = write_where_held(lambda: plan.sweep.base, path, cache)
    return Explorer(plan, subject, "" if subject is None else path.name, why)


def _address(plan: SweepPlan, subject: Subject, number: int) -> str | None:
    point = point_of(plan.sweep, plan.sweep.values(number))
    limits: Mapping[str, Any] = point.controller_start
    if point.change.entries or point.change.case != subject.scenario.case or set(limits) - {"limit"}:
        return None
    changes: dict[str, Any] = {
        "operating_point": OperatingPointTable.model_validate(dict(point.change.operating)),
        "controller_gain": point.gain * point.scenario.controller_gain,
    }
    if "limit" in limits:
        changes["controller_limit_pu"] = limits["limit"]
    return address_of(subject, point.scenario.model_copy(update=changes))
