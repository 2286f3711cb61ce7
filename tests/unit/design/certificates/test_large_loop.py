"""Verdicts on sparse blocks against those on dense matrices, on a grid where both can be had."""

from __future__ import annotations

from dataclasses import replace
from functools import cache as once
from pathlib import Path

import control
import numpy as np
import pytest

from interarea.cosim.designs.design_file import load_design
from interarea.cosim.designs.family import FamilyPlant, family_plants
from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.design.certificates import large_loop
from interarea.design.certificates.closed_loop import closed_loop_matrix
from interarea.design.certificates.large_loop import LargePlant
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.delay.signal_conditions import condition_of_many
from interarea.design.errors import UncertifiedDesign
from interarea.design.linear.resolvent import OpenLoop
from interarea.design.modes.mode_count import SLOWEST, all_that_grows, count_modes
from interarea.design.robust.operating_points import judge_family
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case

TABLE, K = load_design("new_england"), shipped_controller("new_england").system
#: none late, all late, one lost; the last asks for a delay that is none of the design's
CODES = ("N", "s150", "L:G10_dw", "s130+L:G6_dw")


@once
def base() -> tuple[FamilyPlant, LargePlant]:
    point = family_plants(TABLE.model_copy(update={"point": TABLE.point[:1]}), default_cache())["base"]
    return point, LargePlant(point.blocks, point.case.areas, point.case.omega_b)


def scaled(gain: float) -> control.StateSpace:
    names = {"inputs": list(K.input_labels), "outputs": list(K.output_labels)}
    return control.ss(K.A, K.B, gain * K.C, gain * K.D, **names)


@pytest.mark.slow
def test_every_verdict_is_that_of_the_dense_plant() -> None:
    point, large = base()
    conditions = [condition_of_many(code, TABLE.signals) for code in CODES]
    dense = judge_family({"base": point.judged}, K, conditions, bands_hz={"base": (0.3, 0.75)})
    sparse = judge_family({"base": large}, K, conditions)
    for one, other in zip(sparse.rows, dense.rows, strict=True):
        assert one.stable
        assert other.stable
        assert one.worst_swing == pytest.approx(other.worst_swing, abs=1e-7)
        # one inter-area mode, alone in its band: the least damped root there is the one that was followed
        assert one.inter_area == pytest.approx(other.inter_area, abs=1e-7)
    assert sparse.effort == pytest.approx(dense.effort, rel=1e-6)
    assert sparse.loss_criterion == pytest.approx(dense.loss_criterion, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("gain", [-1.0, -4.0, 12.0])
def test_what_grows_is_counted_as_dense_eigenvalues_count_it(gain: float) -> None:
    point, large = base()
    turned, normal = scaled(gain), condition_of_many("N", TABLE.signals)
    values = np.linalg.eigvals(closed_loop_matrix(point.judged, turned))
    assert (values.real > SLOWEST).any()
    loop = large.late(turned, normal)
    assert count_modes(loop, all_that_grows(loop), ()).modes == np.sum(values.real > SLOWEST)
    assert not judge_family({"base": large}, turned, [normal]).passed


def test_a_grid_that_grows_without_control_is_counted_too() -> None:
    case = load_case("nets-nyps-no-pss")
    blocks = sparse_linear_plant(case, default_cache())
    values = np.linalg.eigvals(blocks.state_matrix())
    loop = OpenLoop(blocks)
    assert count_modes(loop, all_that_grows(loop), ()).modes == np.sum(values.real > SLOWEST) > 0


def test_no_control_leaves_every_mode_where_it_is() -> None:
    _, large = base()
    ends = large.followed(scaled(1e-9), condition_of_many("s200", TABLE.signals))
    assert ends == pytest.approx({mode.name: mode.eigenvalue for mode in large.inter_area}, rel=1e-6)


def test_two_names_for_one_mode_are_no_certificate() -> None:
    _, large = base()
    twice = LargePlant(large.plant, large.areas, large.omega_b)
    mode = large.inter_area[0]
    twice.__dict__["inter_area"] = (mode, replace(mode, name="inter-area 2"))
    with pytest.raises(UncertifiedDesign, match=r"'inter-area' and 'inter-area 2' are both tracked to"):
        twice.followed(K, condition_of_many("N", TABLE.signals))


@pytest.mark.slow
def test_a_mode_is_not_followed_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    large = base()[1]
    (mode,) = large.inter_area
    assert large.follow(K, condition_of_many("s150", TABLE.signals), mode).real < 0.0
    monkeypatch.setattr(large_loop, "_MOST_STEPS", 2)
    with pytest.raises(UncertifiedDesign, match="could not be tracked beyond"):
        large.follow(K, condition_of_many("s150", TABLE.signals), mode)


@pytest.mark.slow
def test_a_model_of_a_large_grid_answers_as_the_grid_does(cache: Path) -> None:
    """The response of what a search is made on, at frequencies between those where its error was measured."""
    case, signals, actuators = load_case("wecc-240"), ("G2030_G_dw", "G2630_dw"), ("G2030_G_vs", "G5032_C_vs")
    point = FamilyPlant(case, signals, actuators, sparse_linear_plant(case, cache), None)
    assert isinstance(point.judged, LargePlant)
    assert point.modes is not None
    assert sorted(point.modes) == ["inter-area 1", "inter-area 2"]
    exact = point.judged.response(actuators, signals)
    peak = max(np.linalg.norm(exact(1j * w)) for w in np.linspace(1.0, 9.0, 40))
    for omega in (1.234, 3.456, 5.678, 9.012):
        model = case.omega_b * point.searched(1j * omega)
        assert np.linalg.norm(model - exact(1j * omega)) <= 1e-5 * peak
