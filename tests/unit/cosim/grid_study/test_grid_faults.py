"""Faults of a design made from a grid: which output limit is taken, and what a want of time leaves open."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from interarea.cosim.designs.acceptance import Acceptance, ClearingRow
from interarea.cosim.designs.design_file import load_design
from interarea.cosim.designs.design_tables import AcceptanceTable
from interarea.cosim.grid_study import faults
from interarea.cosim.grid_study.clock import Clock
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.controllers.controller import Controller
from interarea.models.case.case import Case

POINTS = [point.name for point in load_design("robust").point]


class Grid:
    """Loses faults above a limit that each point has, in the place of runs; counts what is run."""

    def __init__(self, holds_to: Mapping[str, float]) -> None:
        self.holds_to, self.ran = holds_to, []

    def judge(
        self,
        controller: Controller,
        cases: Mapping[str, Case],
        table: AcceptanceTable,
        cache: Path,
        *,
        clearing: bool,
    ) -> Acceptance:
        (point,) = cases
        self.ran.append((controller.limit_pu, point))
        holds = controller.limit_pu <= self.holds_to.get(point, 1.0)
        return Acceptance(6, () if holds else (f"{point}, fault",), (), 60.0, (), loops=6, longest_s=10.0)

    def clearing(
        self, controller: Controller, point: str, case: Case, table: AcceptanceTable, cache: Path
    ) -> tuple[ClearingRow, ...]:
        return (ClearingRow(point, "of the case", "bus 8", 10.0, 11.0),)


def _judged(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, holds_to: Mapping[str, float], clock: Clock
) -> tuple[Controller, list[tuple[float, str]]]:
    grid = Grid(holds_to)
    monkeypatch.setattr(faults, "judge_acceptance", grid.judge)
    monkeypatch.setattr(faults, "clearing_times", grid.clearing)
    weakest = {POINTS[-1]: 0.01}
    judged = faults.judged_with_faults(
        load_design("robust"), shipped_controller("robust"), tmp_path, clock, weakest=weakest
    )
    return judged, grid.ran


def _acceptance(controller: Controller) -> dict[str, Any]:
    return dict((controller.certificate or {})["acceptance"])


def test_the_largest_limit_that_loses_no_fault_is_taken(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    judged, ran = _judged(monkeypatch, tmp_path, {POINTS[0]: 0.02}, Clock(1e3))
    assert ran[:3] == [(0.05, POINTS[-1]), (0.05, POINTS[0]), (0.02, POINTS[-1])]  # the weakest point first
    assert judged.limit_pu == 0.02
    assert judged.design["specification"]["limit_pu"] == 0.02
    assert _acceptance(judged)["lost"] == () and (judged.certificate or {})["passed"]
    assert _acceptance(judged)["cases"] == 6 * len(POINTS)
    assert [row["point"] for row in _acceptance(judged)["clearing"]] == [POINTS[-1], *POINTS[:-1]]
    assert _acceptance(judged)["clearing_mean_change_cycles"] == 1.0


def test_where_every_limit_loses_faults_the_best_is_run_everywhere_and_does_not_pass(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    judged, ran = _judged(monkeypatch, tmp_path, {POINTS[-1]: 0.02, POINTS[1]: 0.001}, Clock(1e3))
    assert judged.limit_pu == 0.02  # .05 is lost at the first point already; .01 is no better
    assert {point for limit, point in ran if limit == 0.02} == set(POINTS)
    assert _acceptance(judged)["lost"] == (f"{POINTS[1]}, fault",)
    assert not (judged.certificate or {})["passed"]


def test_points_that_there_was_no_time_for_are_not_passed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    clock = Clock(0.0)
    judged, ran = _judged(monkeypatch, tmp_path, {}, clock)
    assert ran == [(0.05, POINTS[-1])]
    certificate = judged.certificate or {}
    assert certificate["violations"][0] == (
        f"non-linear faults at {POINTS[0]}: not judged, time limit reached"
    )
    assert not certificate["passed"] and POINTS[0] in certificate["not_covered"]
    assert clock.left_out == [
        f"clearing times of robust at {POINTS[-1]}",
        f"faults of robust at {', '.join(POINTS[:-1])}",
    ]


def test_what_was_run_is_found_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    first, _ = _judged(monkeypatch, tmp_path, {}, Clock(1e3))
    again, ran = _judged(monkeypatch, tmp_path, {}, Clock(1e3))
    assert ran == []
    assert again.as_dict() == first.as_dict()
