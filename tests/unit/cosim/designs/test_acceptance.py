"""Acceptance by the non-linear fault: the harm that a guard takes away, and the edge of clearing times."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from interarea.cosim.designs.acceptance import (
    AcceptanceTable,
    Setting,
    Trial,
    judge_acceptance,
    with_ceilings,
)
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.controllers.controller import Controller
from interarea.models.case.case import load_case
from interarea.models.case.variants import operating_variant

TABLE = AcceptanceTable(fault=({"bus": 8, "trip": "8-9 a"},), ceilings=((-5.0, 5.0),))  # type: ignore[arg-type]
CASES = {"tie +100": operating_variant(load_case("two-area-thesis"), tie_flow_mw=100.0)}


def _bare() -> Controller:
    return replace(shipped_controller("robust"), guard=None)


def test_ceilings_reach_every_exciter_that_has_limits() -> None:
    case = with_ceilings(load_case("two-area-thesis"), -5.0, 5.0)
    assert {(m.exciter.Efd_min, m.exciter.Efd_max) for m in case.machines} == {(-5.0, 5.0)}
    untouched = load_case("two-area-thesis").machine("G1").exciter
    assert untouched.Efd_max != 5.0


@pytest.mark.slow
def test_without_a_guard_the_grid_is_lost_where_it_holds_alone(cache: Path) -> None:
    """The local channel answers the common speed rise with the harmful sign; the guard takes that side."""
    bare = judge_acceptance(_bare(), CASES, TABLE, cache, clearing=False)
    assert bare.cases == 6
    assert [s for s in bare.lost if "ceilings" in s and "G4_dw lost" not in s] == list(bare.lost)
    assert len(bare.lost) == 2
    guarded = judge_acceptance(shipped_controller("robust"), CASES, TABLE, cache, clearing=False)
    assert guarded.lost == ()
    assert guarded.largest_angle_deg < 100.0


@pytest.mark.slow
def test_the_clearing_time_is_the_edge_of_synchronism(cache: Path) -> None:
    setting = Setting("tie +100", None, TABLE.fault[0])
    with Trial(CASES, _bare(), TABLE, cache) as trial:
        edge = trial.clearing_cycles(setting, control=False)
        assert edge is not None
        assert trial.kept(setting, control=False, cycles=edge)
        assert not trial.kept(setting, control=False, cycles=edge + TABLE.resolution_cycles)
        assert trial.angle(setting, control=False, cycles=8.0) < np.pi
