"""Sets of loops at other operating points: the same mode is found there, and its own ranking holds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.design.modes.all_modes import all_modes
from interarea.design.modes.loop_choice import LoopChoice, choose_loops
from interarea.design.modes.loop_points import LoopPoint
from interarea.design.modes.modes import ModeError
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case
from interarea.models.case.variants import operating_variant


@cache
def point(name: str, load_scale: float = 1.0) -> LoopPoint:
    case = load_case(name)
    if load_scale != 1.0:
        case = operating_variant(case, load_scale=load_scale)
    plant = sparse_linear_plant(case, default_cache())
    return LoopPoint(
        f"load={load_scale:g}", plant, all_modes(plant, case.areas, band_hz=(0.1, 2.5), below=0.4).modes
    )


def chosen(at: LoopPoint, *points: LoopPoint, **options) -> LoopChoice:  # type: ignore[no-untyped-def]
    areas = load_case("nets-nyps").areas
    return choose_loops(
        at.plant, at.modes, areas, kinds=["speed"], together=3, most=9999, points=points, **options
    )


@pytest.mark.slow
def test_what_holds_at_a_point_is_the_score_that_the_point_gives_by_itself() -> None:
    """Each point ranked as if it were the base one; the modes keep their order from one to the other."""
    base, light = point("nets-nyps"), point("nets-nyps", 0.9)
    both, alone = chosen(base, light), {one.actuators: one.score for one in chosen(light).sets}
    assert both.remarks == ()
    assert len(both.sets) > 500
    for one in both.sets:
        if one.actuators in alone:
            assert one.holds == pytest.approx(alone[one.actuators], rel=1e-9)
            assert one.weakest_point == "load=0.9"
    assert any(abs(one.holds - one.score) > 0.01 for one in both.sets)
    ranks = [min(one.score, one.holds) for one in both.sets]
    assert ranks == sorted(ranks, reverse=True)


def test_a_mode_is_most_like_itself_and_of_two_points_the_worst_counts() -> None:
    base, light = point("nets-nyps"), point("nets-nyps", 0.9)
    assert all(base.like(mode) is mode for mode in base.modes)
    swings = [mode for mode in base.modes if mode.name.startswith("inter-area")]
    assert [light.like(mode).name for mode in swings] == [mode.name for mode in swings]  # type: ignore[union-attr]
    sizes = [10.0 ** (3 * (-1) ** k) for k in range(len(light.modes))]  # what an eigenvector does not fix
    pairs = zip(light.modes, sizes, strict=True)
    scaled = LoopPoint(
        "scaled", light.plant, [replace(m, right=m.right * c, left=m.left / c) for m, c in pairs]
    )
    assert [scaled.like(mode).name for mode in swings] == [mode.name for mode in swings]  # type: ignore[union-attr]
    alone = {one.actuators: one.holds for one in chosen(base, light).sets}
    for one in chosen(base, base, light).sets:
        assert one.holds == pytest.approx(min(one.score, alone[one.actuators] or 0.0))


def test_a_target_that_is_no_mode_of_a_point_is_said_and_asks_nothing_there() -> None:
    base, light = point("nets-nyps"), point("nets-nyps", 0.9)
    first = next(mode for mode in base.modes if mode.name == "inter-area 1")
    fewer = LoopPoint("light", light.plant, [m for m in light.modes if m is not light.like(first)])
    only = chosen(base, fewer, targets=["inter-area 1"])
    assert only.remarks == ("at light: no mode with the shape of inter-area 1 below the damping limit",)
    assert all(one.holds == 1.0 for one in only.sets)


def test_a_point_of_another_grid_is_refused() -> None:
    with pytest.raises(ModeError, match=r"point 'load=1' has 56 states, the base one \d+; wanted: the same"):
        chosen(point("nets-nyps"), point("two-area-thesis"))
