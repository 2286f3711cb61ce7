"""Separate targets for signals there, late and lost: what the search trades, what is asked of whom."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest

from interarea.cosim.designs.design_file import design_of, load_design
from interarea.cosim.designs.design_tables import PointTable
from interarea.cosim.designs.family import FamilyPlant, at_point
from interarea.cosim.errors import ScenarioError
from interarea.design.delay.signal_conditions import Condition, condition_of_many
from interarea.design.linear.linearise import select
from interarea.design.robust.design import design_robust
from interarea.design.robust.design_models import build_objective
from interarea.design.robust.operating_points import judge_family
from interarea.design.robust.smoothed_objective import BandOffsets
from interarea.design.robust.spec import RobustSpec
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case
from interarea.synthesis import design_controller

NOW, LOST = Condition("N"), Condition("L", ("B_dw",))


def _grid() -> control.StateSpace:
    """Two modes of the same machine: A shows both, B the slow one alone and the better."""
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1.0
    A[1, :2], A[3, 2:] = (-16.0, -0.4), (-49.0, -0.6)
    C = np.array([[0.0, 0.3, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0]])
    return control.ss(A, [[0.0], [1.0], [0.0], [1.0]], C, 0.0, inputs=["A_vs"], outputs=["A_dw", "B_dw"])


@pytest.mark.slow
def test_less_asked_where_a_signal_is_lost_leaves_more_where_it_is_there() -> None:
    flat = BandOffsets((0.0, 50.0), (0.0, 0.0))
    spec = RobustSpec(
        ("A_dw", "B_dw"),
        ("A_vs",),
        (NOW, LOST),
        order=3,
        starts=1,
        evaluations=300,
        polishes=3,
        plant_order=4,
        effort_cap=((0.05, 1.0), (300.0, 1.0)),
        offsets=flat,
        rho=200.0,
    )
    less = BandOffsets((0.0, 50.0), (-0.25, -0.25))
    reached = {}
    for name, variant in (("same", spec), ("less", replace(spec, more_under={"lost": less}))):
        design = design_robust({"base": _grid()}, variant, 1.0)
        judged = judge_family({"base": _grid()}, design.system, (NOW, LOST))
        reached[name] = [row.worst_swing for row in judged.rows]
    assert reached["less"][0] > reached["same"][0] + 0.01
    assert reached["less"][1] < reached["same"][1]


def test_each_kind_of_condition_is_asked_for_its_own_target() -> None:
    """A speed fed back with gain g adds g / 8 to the damping .05 of this mode."""
    K = control.ss([], [], [], [[0.0, -0.8]], inputs=["A_dw", "B_dw"], outputs=["A_vs"])
    plant = {"base": control.ss(_grid().A[:2, :2], [[0.0], [1.0]], [[0.0, 0.3], [0.0, 1.0]], 0.0)}
    plant["base"] = control.ss(
        *(plant["base"].A, plant["base"].B, plant["base"].C, plant["base"].D),
        inputs=["A_vs"],
        outputs=["A_dw", "B_dw"],
    )
    certificate = judge_family(plant, K, (NOW, LOST), worst_swing=0.1, inter_area=0.1)
    assert [v.split(" is ")[0] for v in certificate.violations] == [
        "worst swing damping",
        "inter-area damping",
    ]
    certificate = judge_family(
        plant, K, (NOW, LOST), worst_swing=0.1, inter_area=0.1, targets={"lost": (0.04, 0.04)}
    )
    assert certificate.violations == ()
    certificate = judge_family(plant, K, (NOW, LOST), targets={"all": (0.1, 0.2), "lost": (0.04, 0.06)})
    assert [v.partition(":")[0] for v in certificate.violations] == [
        "inter-area damping with signals all is 0.15, required >= 0.2",
        "inter-area damping with signals lost is 0.05, required >= 0.06",
    ]
    # a point that is asked for less, whatever the conditions: .05 where it is lost; one asked for more
    two = {"base": plant["base"], "out": plant["base"]}
    targets = {"worst_swing": 0.1, "inter_area": 0.1, "targets": {"lost": (0.04, 0.04)}}
    certificate = judge_family(two, K, (NOW, LOST), at={"out": (0.04, 0.04)}, **targets)  # type: ignore[arg-type]
    assert certificate.violations == ()
    certificate = judge_family(two, K, (NOW, LOST), at={"out": (0.04, 0.06)}, **targets)  # type: ignore[arg-type]
    (missed,) = certificate.violations
    assert missed.startswith(
        "out: inter-area damping is 0.05, required >= 0.06: violated in 1 of 2 conditions"
    )


def test_a_scaled_signal_is_judged_and_asked_for_by_name() -> None:
    """Gain g of a speed adds g / 8 to the damping .05: -1.6 gives .25, with the wrong polarity -.05."""
    codes = ("N", "x2:B_dw", "x-1:B_dw")
    conditions = [condition_of_many(code, ("A_dw", "B_dw")) for code in codes]
    K = control.ss([], [], [], [[0.0, -0.8]], inputs=["A_dw", "B_dw"], outputs=["A_vs"])
    slow = select(_grid(), ["A_vs"], ["A_dw", "B_dw"])
    plant = {"base": control.ss(*_first_two_states(slow), inputs=["A_vs"], outputs=["A_dw", "B_dw"])}
    certificate = judge_family(
        plant, K, conditions, targets={"scaled": (0.24, 0.0), "x-1:B_dw": (-0.04, -0.06)}, worst_swing=0.16
    )
    assert [row.worst_swing for row in certificate.rows] == pytest.approx([0.15, 0.25, -0.05])
    assert [v.partition(":")[0] for v in certificate.violations] == [
        "base, x-1",
        "worst swing damping is 0.15, required >= 0.16",
        "worst swing damping under x-1",
    ]


def _first_two_states(G: control.StateSpace) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    return G.A[:2, :2], G.B[:2], G.C[:, :2], G.D


def test_the_search_sees_a_scaled_signal_as_so_much_more_gain() -> None:
    """Late and at once: as a controller whose gain from that signal is so much larger."""
    codes = ("x-3:B_dw", "s100+x-3:B_dw")
    scaled = tuple(condition_of_many(code, ("A_dw", "B_dw")) for code in codes)
    plain = tuple(replace(condition, scale_of={}) for condition in scaled)
    spec = RobustSpec(("A_dw", "B_dw"), ("A_vs",), scaled, order=2, plant_order=4)
    seen, unscaled = (
        build_objective({"base": _grid()}, replace(spec, conditions=conditions), 1.0)
        for conditions in (scaled, plain)
    )
    A, C = np.array([[-1.0, 2.0], [-2.0, -1.0]]), np.array([[0.4, 0.2]])
    B = np.array([[0.2, 0.1], [0.0, -0.1]])
    result = seen.worst(seen.pack(A, B, C))
    assert result == pytest.approx(unscaled.worst(unscaled.pack(A, B * [1.0, -3.0], C)))
    assert result != pytest.approx(unscaled.worst(unscaled.pack(A, B, C)))
    efforts = [
        float(np.abs(grid.response[:, 1] / other.response[:, 1] + 3.0).max())
        for grid, other in zip(seen.efforts, unscaled.efforts, strict=True)
    ]
    assert efforts == pytest.approx([0.0, 0.0], abs=1e-9)


def test_a_target_under_what_is_no_condition_is_refused() -> None:
    keys = load_design("robust").model_dump(exclude_unset=True)
    with pytest.raises(ScenarioError, match=r"target.under = 'x2:G2_dw', allowed: all, late"):
        design_of(keys | {"target": [{"under": "x2:G2_dw"}]})


def test_targets_of_a_design_file_reach_the_search() -> None:
    keys = load_design("robust").model_dump(exclude_unset=True)
    table = design_of(keys | {"target": [{"under": "lost", "more": [[0.0, -0.04], [9.0, 0.0]]}]})
    assert table.spec().more_under == {"lost": BandOffsets((0.0, 9.0), (-0.04, 0.0))}
    with pytest.raises(Exception, match="under"):
        design_of(keys | {"target": [{"under": "gone"}]})


@pytest.mark.slow
def test_a_gain_is_changed_after_the_search() -> None:
    """The same search, one input of what it finds lowered; a name that is no signal is refused."""
    keys = {
        "name": "quick",
        "case": "two-area-thesis",
        "remote": "G2_dw",
        "local": "G4_dw",
        "actuator": "G4_vs",
        "order": 2,
        "conditions": ["N"],
        "point": [{"name": "base"}],
        "starts": 1,
        "evaluations": 60,
        "polishes": 0,
    }
    plain, lowered = (design_controller(keys | more).system for more in ({}, {"gain_of": {"G2_dw": 0.25}}))
    np.testing.assert_allclose(lowered.B, plain.B * [0.25, 1.0], rtol=1e-12)
    np.testing.assert_allclose(lowered.D, plain.D * [0.25, 1.0], rtol=1e-12)
    with pytest.raises(ScenarioError, match=r"gain_of names \['G9_dw'\], allowed: G2_dw, G4_dw"):
        design_of(keys | {"gain_of": {"G9_dw": 0.5}})


def test_states_below_rounding_leave_no_pole_of_their_own_in_a_design_model() -> None:
    """Two areas without 7-8 a, 40 states asked: with all of them a pole at -.062 or -.022 1/s comes up."""
    case = at_point(load_case("two-area-thesis"), PointTable(name="7-8 a out", out=("7-8 a",)))
    plant = FamilyPlant.of(case, ("G2_dw", "G4_dw"), ("G4_vs",), default_cache()).searched
    band = BandOffsets((0.0, 50.0), (0.0, 0.0))
    spec = RobustSpec(("G2_dw", "G4_dw"), ("G4_vs",), (NOW,), plant_order=40, offsets=band, washout_s=0.0)
    (model,) = build_objective({"out": plant}, spec, case.omega_b).models
    full = np.linalg.eigvals(plant.A)
    slow = [e for e in np.linalg.eigvals(model.A) if e.real > -0.3 and abs(e) > 1e-3]
    assert len(slow) >= 4
    assert max(np.abs(full - e).min() / abs(e) for e in slow) < 0.01


@pytest.mark.parametrize("excess", [1e-6, 1e-9])
def test_a_swing_that_does_not_decay_is_unstable_however_slowly_it_grows(excess: float) -> None:
    """A speed fed back with the mode's own damping .4 and a little more: its roots are excess / 2 +- 4j."""
    A, B, C = _grid().A[:2, :2], [[0.0], [1.0]], [[0.0, 0.3], [0.0, 1.0]]
    plant = control.ss(A, B, C, 0.0, inputs=["A_vs"], outputs=["A_dw", "B_dw"])
    K = control.ss([], [], [], [[0.0, 0.4 + excess]], inputs=["A_dw", "B_dw"], outputs=["A_vs"])
    certificate = judge_family({"base": plant}, K, (NOW,), worst_swing=-1.0, inter_area=-1.0)
    assert certificate.rows[0].rightmost == pytest.approx(0.5 * excess, rel=0.01, abs=1e-12)
    assert certificate.violations[0] == "base, N: unstable"
