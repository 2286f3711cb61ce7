"""Networks that trips cut in parts: each goes on as if it were alone, what has no machine is taken out."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest
from plant_shim import BlockShim

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import Case, case_of, load_case
from interarea.models.case.events import events_of
from interarea.models.grid.powerflow import solve_powerflow

CASE, FORMS = "two-area-thesis", ("dense", "sparse")
FAULT = {"kind": "bus_fault", "bus": 8, "start_s": 0.05, "end_s": 0.1}
SHOW = ["G*_*"]


def rows(table: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in table.items() if isinstance(v, dict)}


def twice(name: str) -> Case:
    """A grid and its image, bus to bus the same voltage, over a branch that carries nothing."""
    case = load_case(name)
    document = case.document()
    slack = next(m for m in case.machines if m.slack)
    power = case.base_mva * solve_powerflow(case).generation[case.machines.index(slack)].real
    copied: dict[str, dict[str, Any]] = {}
    for table in ("buses", "branches", "shunts", "loads", "machines"):
        own = rows(document[table])
        image = {}
        for key, row in own.items():
            there = {k: v + 100 if k in ("bus", "from", "to") else v for k, v in row.items()}
            image[str(int(key) + 100) if table == "buses" else f"{key}x"] = there
        copied[table] = own | image
    copied["machines"][f"{slack.name}x"] |= {"slack": False, "P_mw": float(power), "angle_deg": 0.0}
    link = dict(next(iter(rows(document["branches"]).values())))
    copied["branches"]["link"] = link | {"from": 7, "to": 107}
    return case_of(document | copied | {"name": "twice"}, where="twice")


def started(case: Case, *events: dict[str, Any], form: str = "dense", show: Any = None) -> BlockShim:
    values = event_parameters(case, events_of(events, where="test"))
    return BlockShim(plant_block(case, show=show, network=form), values)


def outputs(plant: BlockShim, stop_s: float) -> dict[str, np.ndarray]:
    _, _, result = plant.run(stop_s, 0.002)
    return dict(zip(plant.output_names, result.T, strict=True))


@pytest.mark.parametrize("form", FORMS)
def test_each_of_two_parts_is_its_own_case_alone(form: str) -> None:
    """Angles about its own centre of inertia, speeds, powers and voltages."""
    case = twice(CASE)
    trip = {"kind": "branch_trip", "branch": "link", "start_s": 0.02}
    plant = started(case, trip, FAULT, form=form, show=SHOW)
    both, steady = outputs(plant, 0.3), outputs(started(load_case(CASE), form=form, show=SHOW), 0.3)
    alone = outputs(started(load_case(CASE), FAULT, form=form, show=SHOW), 0.3)
    at = [len(curve) for curve in (both["G1_dw"], alone["G1_dw"], steady["G1_dw"])]
    assert np.abs(alone["G1_dw"]).max() > 1e-3  # something happened
    for name, curve in alone.items():
        assert both[name][-1] == pytest.approx(curve[-1], rel=1e-9, abs=1e-9), (name, at)
        machine, _, what = name.partition("_")
        assert both[f"{machine}x_{what}"][-1] == pytest.approx(steady[name][-1], rel=1e-8, abs=1e-8), name


@pytest.mark.parametrize("form", FORMS)
def test_a_bus_without_a_machine_is_taken_out(form: str) -> None:
    """Bus 1 hangs on one transformer: without its machine that carries nothing."""
    case = load_case(CASE)
    lost = {"kind": "machine_trip", "machine": "G1", "start_s": 0.0}
    opened = {"kind": "branch_trip", "branch": "1-5", "start_s": 0.0}
    whole, cut = (started(case, *e, form=form, show=["*_*", "bus*.v"]) for e in ((lost,), (lost, opened)))
    x = whole.x + 1e-3 * np.random.default_rng(3).standard_normal(len(whole.x))
    (dx, y), (dx_cut, y_cut) = whole.derivatives(x), cut.derivatives(x)
    np.testing.assert_allclose(dx_cut, dx, rtol=1e-9, atol=1e-9)
    names = whole.output_names
    rest = [k for k, name in enumerate(names) if name not in ("bus1.v", "G1_vt", "G1_delta")]
    np.testing.assert_allclose(y_cut[rest], y[rest], rtol=1e-9, atol=1e-9)
    assert y[names.index("bus1.v")] > 0.5 and y_cut[names.index("bus1.v")] == 0.0


@pytest.mark.parametrize("form", FORMS)
def test_loads_that_iterate_draw_nothing_where_no_machine_is(form: str) -> None:
    """Constant power at 7 and both sides of it opened: its voltage is zero and the rest finds its own."""
    mix = {"P_exponent": 0.0, "Q_exponent": 0.0}
    case = load_case(CASE).with_changes({"loads": {"L7": mix, "L9": mix}})
    around = [b.name for b in case.branches if 7 in (b.from_bus, b.to_bus)]
    trips = [{"kind": "branch_trip", "branch": name, "start_s": 0.01} for name in around]
    plant = started(case, *trips, form=form, show=["bus*.v", "G*_pe"])
    _, states, result = plant.run(0.05, 0.005)
    last = dict(zip(plant.output_names, result[-1], strict=True))
    assert np.all(np.isfinite(states))
    assert last["bus7.v"] == pytest.approx(0.0, abs=1e-9) and last["bus9.v"] > 0.5


@pytest.mark.parametrize("form", FORMS)
def test_the_remark_names_what_is_cut_off_once(form: str) -> None:
    case = load_case(CASE)
    trips = [
        {"kind": "branch_trip", "branch": b.name, "start_s": 0.01, "end_s": 0.03}
        for b in case.branches
        if 7 in (b.from_bus, b.to_bus)
    ]
    pulse = {"kind": "pm_pulse", "machine": "G1", "size_pu": 0.01, "start_s": 0.02, "end_s": 0.025}
    plant = started(case, *trips, pulse, form=form)
    said = []
    for time in (0.01, 0.02, 0.03):
        ctypes.memset(plant.message, 0, 256)
        plant.event(time, plant.x)
        said.append(plant.message.value.decode())
    assert said[0] == (
        "network: bus 7 removed, no running machine is connected to it; "
        "2 islands remain, each with its own centre of inertia"
    )
    assert said[1:] == ["", "network: all buses are connected again"]
