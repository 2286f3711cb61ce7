"""A wide-area loop for what local stabilizers leave: the grid it is for, and when there is one."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.cosim.designs.design_tables import AskTable
from interarea.cosim.grid_study import automatic, faults, local_stabilizers
from interarea.cosim.grid_study.automatic import design_grid
from interarea.cosim.grid_study.beside_local import (
    beside_local,
    installable,
    leaves_something,
    with_stabilizers,
)
from interarea.cosim.grid_study.choices import Choices
from interarea.cosim.grid_study.clock import Clock
from interarea.cosim.grid_study.local_stabilizers import Stabilizer, as_controller
from interarea.cosim.grid_study.operating_points import (
    chosen_points,
    keeping_what_is_there,
    tried_points,
)
from interarea.cosim.grid_study.page import headline
from interarea.cosim.grid_study.study import STABILIZED, study_grid
from interarea.cosim.grid_study.weak_modes import WeakModes, modes_of_grid, weak_modes
from interarea.cosim.run.artefacts import linear_plant
from interarea.design.certificates.closed_loop import closed_loop_matrix
from interarea.design.controllers.controller import Controller
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.design.robust.smoothed_objective import BandOffsets
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case

UNITS = (
    Stabilizer("G2", "inter-area", 8.0, 0.2, 0.05, 1),
    Stabilizer("G4", "inter-area", 5.0, 0.3, 0.1, 3),
)


@pytest.fixture(scope="module")
def weak(cache: Path) -> WeakModes:
    return weak_modes(modes_of_grid(load_case("two-area-thesis"), cache))


def test_stabilizers_in_the_grid_are_the_controller_beside_it(cache: Path) -> None:
    case = load_case("two-area-thesis")
    stabilized = with_stabilizers(case, [asdict(one) for one in UNITS], 0.05)
    inside = np.linalg.eigvals(remove_reference(linear_plant(stabilized, cache)).A)
    plant = speeds_in_rad(remove_reference(linear_plant(case, cache)), case.omega_b)
    K = as_controller(UNITS, case.omega_b, "local", 0.05)
    beside = np.linalg.eigvals(closed_loop_matrix(plant, K.system))
    assert len(inside) == len(beside)
    for root in beside:
        assert np.abs(inside - root).min() < 1e-6 * (1.0 + abs(root))
    device = next(m for m in stabilized.machines if m.name == "G2").stabilizer
    assert device is not None
    assert (device.Vs_min, device.Vs_max) == (-0.05, 0.05)


def test_a_machine_with_a_stabilizer_gets_no_second_one() -> None:
    rows = [asdict(replace(UNITS[0], machine=name)) for name in ("G1", "G2", "G3", "G4")]
    assert [one["machine"] for one in installable(load_case("two-area-thesis"), rows)] == ["G2", "G4"]
    assert not installable(load_case("kundur-pss"), rows)


def test_a_grid_with_stabilizers_at_every_machine_has_no_such_design(weak: WeakModes, cache: Path) -> None:
    units = [replace(UNITS[0], machine=name) for name in ("G1", "G3")]
    assert beside_local(weak, as_controller(units, 377.0, "local", 0.05), cache) is None


def _row(inter_area: float, condition: str = "N", *, stable: bool = True) -> dict[str, Any]:
    return {"condition": condition, "inter_area": inter_area, "stable": stable}


@pytest.mark.parametrize(
    ("rows", "leaves"),
    [
        ([_row(0.1), _row(0.2)], False),
        ([_row(0.2), _row(0.09)], True),
        ([_row(float("nan"))], True),
        ([_row(0.2), _row(0.09, "L:G2_dw")], False),  # one of them out: no gap that a loop is asked to fill
        ([_row(0.09), _row(0.05, "L:G2_dw", stable=False)], False),  # nothing to build on
    ],
)
def test_a_loop_is_for_inter_area_modes_that_stable_stabilizers_leave_weak(
    rows: list[dict[str, Any]], leaves: bool
) -> None:
    requested = AskTable(inter_area=0.1, worst_swing=0.03, given_away=0.005)
    local = replace(as_controller(UNITS, 377.0, "local", 0.05), certificate={"rows": rows})
    assert leaves_something(local, requested) is leaves


def test_as_much_is_asked_as_without_and_each_stabilizer_may_be_out(weak: WeakModes, cache: Path) -> None:
    local = as_controller(UNITS, weak.case.omega_b, "local", 0.05)
    there = beside_local(weak, local, cache)
    assert there is not None
    assert there.required_damping == weak.required_damping == 0.1
    assert there.weakest.damping_ratio > weak.weakest.damping_ratio
    assert there.stabilized == ("G2", "G4")
    rows = tried_points(there, cache, Clock(0.0))
    without = {row.point.name: row for row in rows if row.point.vary}
    assert set(without) == {"no stabilizer at G2", "no stabilizer at G4"}
    alone = modes_of_grid(with_stabilizers(weak.case, [asdict(UNITS[1])], 0.05), cache)
    least = min(mode.damping_ratio for mode in alone.inter_area)
    assert without["no stabilizer at G2"].least == pytest.approx(least, abs=1e-9)
    assert set(without) <= {point.name for point in chosen_points(rows)}


def test_a_loop_is_asked_for_what_the_stabilizers_give_at_each_point(weak: WeakModes, cache: Path) -> None:
    local = as_controller(UNITS, weak.case.omega_b, "local", 0.05)
    there = beside_local(weak, local, cache)
    assert there is not None
    rows = tried_points(there, cache, Clock(0.0))
    points = chosen_points(rows)
    targets = {p.name: p for p in keeping_what_is_there(there, points, rows, 0.03)}
    assert list(targets) == [point.name for point in points]
    least = {row.point.name: row.least for row in rows} | {"base": there.weakest.damping_ratio}
    for name, point in targets.items():
        expected = least[name] - there.choices.given_away
        if not expected > there.required_damping:
            assert point.ask is None and not point.more
            continue
        assert point.ask == (0.03, pytest.approx(expected, abs=1e-4))
        in_band = 2.0 * np.pi * there.weakest.frequency_hz
        extra = BandOffsets(*zip(*point.more, strict=True))(np.array([0.0, in_band, 15.0]))[0]
        assert extra == pytest.approx([0.0, expected - there.required_damping, 0.0], abs=2e-4)
    assert targets["base"].ask is not None and any(point.ask is None for point in targets.values())
    assert keeping_what_is_there(weak, points, rows, 0.03) == points  # no stabilizers to keep


@pytest.mark.slow
@pytest.mark.timeout(1200)  # beyond five minutes from an empty cache beside others
def test_both_are_designed_where_local_stabilizers_miss_what_is_asked(
    interarea: Any, few_points: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """One local stabilizer, one actuator, two signals, one fault, four points; more take minutes."""
    monkeypatch.setattr(faults, "LIMITS_PU", (0.05,))
    monkeypatch.setattr(local_stabilizers, "MOST", 1)
    case = load_case("two-area-thesis")
    choices = Choices(
        grid="two-area-thesis",
        minutes=60.0,
        inter_area=0.14,
        most_actuators=1,
        signals=2,
        latencies_ms=(150,),
        faults=1,
    )
    study = study_grid(case, tmp_path, default_cache(), named="two-area-thesis", choices=choices)
    assert study["problem"] is None
    local = study["local"]
    assert local["installed"] and local["certificate"]["inter_area"] < 0.14
    (machine,) = (one["machine"] for one in local["stabilizers"])
    certificate = study["certificate"]
    assert certificate["inter_area"] > local["certificate"]["inter_area"]
    assert f"no stabilizer at {machine}" in {row["point"] for row in certificate["rows"]}
    assert study["worth"]["open_loop"]["inter_area"] > study["modes"]["modes"][0]["damping_ratio"]
    assert "both" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert any(line.startswith("With the local stabilizers and the controller") for line in headline(study))
    assert load_case(tmp_path / STABILIZED).machine(machine).stabilizer is not None
    _, out, _ = interarea("certify", tmp_path / "controller.json", "--json")
    assert json.loads(out)["inter_area"] == pytest.approx(certificate["inter_area"], abs=1e-9)
    again = design_grid(  # of which all parts are in the cache
        case, default_cache(), Clock(60.0), choices=choices, named=case.name, named_stabilized=STABILIZED
    )
    assert again.certificate == certificate
    monkeypatch.setattr(automatic, "design_grid", lambda *_, **named: names.update(named) or again)
    names: dict[str, Any] = {}
    code, out, _ = interarea("design", "two-area-thesis", "--out", tmp_path / "k.json")
    files = [tmp_path / f"k.{end}" for end in ("json", "local.json", "design.toml", "stabilizers.toml")]
    assert out.splitlines()[-len(files) :] == [str(file) for file in files]
    assert code == (0 if again.passed else 1)
    assert names["named_stabilized"] == files[-1].name
    assert load_case(files[-1]).machine(machine).stabilizer is not None
    local_there = Controller.load(files[1])
    assert local_there.outputs == (f"{machine}_vs",)
