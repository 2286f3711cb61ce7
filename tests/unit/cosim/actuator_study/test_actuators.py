"""The study `actuators`: equal terms in closed form, numbers by other paths, words, refusals."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import control
import numpy as np
import pyarrow.parquet as pq
import pytest
from command_line import invoke

import interarea as ia
from interarea.cosim.actuator_study.cells import ActuatorCells, Cell
from interarea.cosim.actuator_study.installed import FULL_AT, SHARE, Installed, installed, ratings
from interarea.cosim.actuator_study.study import FILES, actuator_rows, study_actuators
from interarea.cosim.actuator_study.words import conclusion
from interarea.cosim.designs.design_tables import FaultPlace, PointTable
from interarea.cosim.designs.family import at_point
from interarea.cosim.grid_study.choices import Choices
from interarea.cosim.grid_study.weak_modes import WeakModes, modes_of_grid, weak_modes
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import Case, load_case
from interarea.models.grid.powerflow import solve_powerflow

GRID = "two-area-actuators"


@pytest.fixture(scope="module")
def case() -> Case:
    return load_case(GRID)


@pytest.fixture(scope="module")
def weak(case: Case) -> WeakModes:
    exciters = tuple(f"{machine.name}_vs" for machine in case.machines)
    grid = modes_of_grid(case, default_cache())
    return weak_modes(grid, Choices(grid=GRID, most_actuators=1, actuators=exciters))


@pytest.fixture(scope="module")
def compared(weak: WeakModes) -> dict[str, Installed]:
    kinds = ("exciter", "lcc", "svc", "statcom", "tcsc", "vsc")
    those, mva = installed(weak, kinds, None, default_cache())
    assert mva == 100.0
    return those


def test_full_outputs_move_the_same_power(case: Case, compared: dict[str, Installed]) -> None:
    share = SHARE * 100.0  # MVA
    assert compared["lcc"].full * case.hvdcs[0].base_mva == pytest.approx(share)
    assert compared["vsc"].full * case.vscs[0].base_mva == pytest.approx(share)
    for kind, row, gain in (("svc", case.svcs[0], "K"), ("statcom", case.svcs[1], "KR")):
        regulator = getattr(row.control, gain)
        assert compared[kind].full * regulator * row.base_mva == pytest.approx(share)
    flow = solve_powerflow(case)
    line = case.branch(case.tcscs[0].branch)
    drop = flow.voltage(line.from_bus) - flow.voltage(line.to_bus)
    # the current behind half of the line's charging, twice that at rest is what the capacitor is rated for
    series = abs(drop / complex(line.r, line.x - case.tcscs[0].x0_pu))
    assert compared["tcsc"].full * (2.0 * series) ** 2 * case.base_mva == pytest.approx(share, rel=0.02)
    assert ratings(case)["tcsc"]["tcsc1"] >= 100.0
    assert compared["exciter"].terms("remote", 1).effort == pytest.approx(0.05 / FULL_AT)


def test_a_speed_of_the_mode_may_give_full_output_through_either_signal(
    case: Case, weak: WeakModes, compared: dict[str, Installed]
) -> None:
    # tie power by a rad/s of the speeds' difference: from the mode's shape in the grid's whole linear model
    plant = ia.linearise(case, speeds="rad/s")
    values, right = np.linalg.eig(plant.A)
    shape = right[:, np.argmin(np.abs(values - weak.weakest.eigenvalue))]
    shown = dict(zip(plant.output_labels, plant.C @ shape, strict=True))
    for kind in ("lcc", "vsc", "svc", "statcom", "tcsc"):
        one = compared[kind]
        a, b = one.sees["remote"]
        size = abs(shown[one.sees["own"][0]]) / abs(shown[a] - shown[b])
        caps = [one.terms(signals, 1).effort or 0.0 for signals in ("own", "remote")]
        assert caps[0] * size == pytest.approx(caps[1]) == pytest.approx(one.full / FULL_AT)


def _cell(kind: str, signals: str, ms: int, least: float, **others: Any) -> Cell:
    keys: dict[str, Any] = {
        "actuator": "a",
        "sees": ("x",),
        "there": least,
        "late": least,
        "lost": None,
        "lost_stable": True,
        "worst_lost": "x",
        "worst_swing": least,
        "effort": 0.1,
        "effort_share": 1.0,
        "delay_margin_ms": None,
        "faults": 12,
        "survived": 12,
        "survived_lost": 12,
        "clearing_cycles": None,
        "controller": {},
    }
    return Cell(kind=kind, signals=signals, latency_ms=ms, **{**keys, **others})


def test_conclusions_follow_from_the_numbers() -> None:
    cells = [
        _cell("svc", "own", 0, 0.08),
        _cell("svc", "remote", 0, 0.12),
        _cell("svc", "remote", 300, 0.09, lost_stable=False, survived=10),
        _cell("lcc", "own", 0, 0.30, survived=11),
        _cell("lcc", "remote", 0, 0.31),
        _cell("tcsc", "own", 0, 0.14),
        _cell("tcsc", "remote", 0, 0.27, lost=0.11),
        _cell("tcsc", "remote", 300, 0.17, lost=0.13),
    ]
    assert conclusion(cells, 12) == [
        "with own signals the inter-area damping ratios are LCC dc link 0.300, TCSC 0.140, SVC 0.080",
        "with remote signals delayed by 0 ms the inter-area damping ratios are LCC dc link 0.310, "
        "TCSC 0.270, SVC 0.120",
        "with remote signals delayed by 300 ms the inter-area damping ratios are TCSC 0.170, SVC 0.090",
        "SVC: own signal 0.080, remote signals 0.120 at most; the link pays at 0 ms, not at 300 ms; "
        "unstable when x is lost; 2 fewer faults are stable at 300 ms",
        "LCC dc link: own signal 0.300, remote signals 0.310 at most; the own signal performs as well: do "
        "not build this link; with the own signal 1 fewer faults are stable than without control",
        "TCSC: own signal 0.140, remote signals 0.270 at most; the link pays at 0, 300 ms; with x lost "
        "0.110 at 0 ms, less than with the own signal",
    ]


def test_a_rival_is_no_worse_than_remote_controllers_with_the_link_masked(
    compared: dict[str, Installed], monkeypatch: pytest.MonkeyPatch
) -> None:
    nothing = control.ss([], [], [], [[0.0]], inputs=["G4_dw"], outputs=["G4_vs"])
    known = {"controller": Controller("link", nothing).as_dict()}
    own, remote = (_cell("exciter", name, 0, 0.2, **known) for name in ("own", "remote"))
    cells = ActuatorCells.__new__(ActuatorCells)
    masked = SimpleNamespace(best_own=lambda sees, tried: tried[1], effort=lambda K: 0.0)
    monkeypatch.setattr(cells, "designs", masked, raising=False)
    for least, taken in ((0.3, 0.3), (0.1, 0.2)):
        monkeypatch.setattr(cells, "_judged", lambda *_, least=least: _cell("exciter", "own", 0, least))
        assert cells.own_again(compared["exciter"], own, [remote]).least == taken
    # a device's own signal is none of its remote ones: nothing to mask
    assert cells.own_again(compared["lcc"], own, [remote]) is own


@pytest.mark.parametrize(("pole", "survived"), [(-0.3, 1), (0.03, 0)])
def test_a_fault_is_not_survived_where_the_loop_grows_later_than_the_run_shows(
    case: Case, monkeypatch: pytest.MonkeyPatch, pole: float, survived: int
) -> None:
    # the signal hardly moves this state, and it hardly moves the device: nothing is seen of it in 15 s
    hidden = control.ss([[pole]], [[1e-6]], [[1e-3]], [[0.0]], inputs=["G4_dw"], outputs=["svc1_v_mod"])
    cells = ActuatorCells.__new__(ActuatorCells)
    monkeypatch.setattr(cells, "case", case, raising=False)
    monkeypatch.setattr(cells, "cache", default_cache(), raising=False)
    monkeypatch.setattr(cells, "family", ((FaultPlace(bus=8), 200),), raising=False)
    assert cells._survived(Controller("hidden", hidden), {"G4_dw": 0.1}, ("",)) == [survived]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["actuators", "--mva", "0"], "--mva MVA: got 0, allowed: above 0, in MVA"),
        (["actuators", "--mva", "500"], "--mva 500: hvdc1 (LCC dc link) of two-area-actuators has 100 MVA"),
        (
            ["actuators", "--actuator", "flywheel"],
            "--actuator flywheel: not a kind of actuator; there are: exciter",
        ),
        (["actuators", "--grid", "two-area-thesis"], "two-area-thesis: no LCC dc link in this grid"),
        (["actuators", "--grid", "kundur-pss"], "kundur-pss: no weak inter-area mode"),
        (["actuators", "--grid", "nowhere"], "--grid nowhere: not a grid"),
        (["thesis", "--mva", "3"], "--mva: belongs to the study actuators"),
        (["worth", "--actuator", "svc"], "--actuator svc: belongs to the study actuators"),
    ],
)
def test_bad_input_is_refused_in_a_line(
    words: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, _, err = invoke(["study", *words, "--out", str(tmp_path / "out")], monkeypatch)
    assert code == 2 and message in err and len(err.splitlines()) == 1, err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_cells_hold_numbers_that_other_paths_give(case: Case, tmp_path: Path) -> None:
    kinds, latencies = ("vsc",), (0, 100)
    study = study_actuators(
        case, tmp_path, default_cache(), kinds=kinds, latencies_ms=latencies, places=1, minutes=30.0
    )
    assert [(row["signals"], row["latency_ms"]) for row in study["cells"]] == [
        ("own", 0),
        ("remote", 0),
        ("remote", 100),
    ]
    first, second = study["cells"][1:]
    assert first["there"] >= second["there"] - 1e-9  # a controller made for 100 ms may be used at 0
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(FILES)
    assert pq.read_table(tmp_path / "actuators.parquet").num_rows == len(actuator_rows(study)) == 3
    points = [case if name == "base" else at_point(case, _point(name)) for name in study["points"]]
    plants = [ia.linearise(point, speeds="rad/s") for point in points]
    stored = json.loads((tmp_path / "controllers.json").read_text(encoding="utf-8"))["controllers"]
    band = 2.0 * np.pi * np.array([0.3, 0.9])
    for row, entry in zip(study["cells"], stored, strict=True):
        K = Controller.from_dict(entry["controller"]).system
        late = row["latency_ms"] * 1e-3 if row["signals"] == "remote" else 0.0
        for key, latency_s in (("there", 0.0), ("late", late)):
            roots = np.concatenate([ia.delayed_poles(_open(p, K), latency_s, right_of=-2.5) for p in plants])
            swings = roots[(np.abs(roots.imag) > band[0]) & (np.abs(roots.imag) < band[1])]
            damping = float((-swings.real / np.abs(swings)).min())
            assert min(damping, 1.0) == pytest.approx(row[key], abs=1e-6)
        assert 0.0 < row["effort_share"] <= 1.0 + 1e-6
        margins = [float(ia.delay_margin(_open(p, K)).margin_s) for p in plants]
        assert 1e3 * min(margins) == pytest.approx(row["delay_margin_ms"], rel=1e-4)
        assert row["faults"] == 6 and 0 <= row["survived"] <= 6


def _point(name: str) -> PointTable:
    """Return an operating point by its name, "8-9 a out", "load +5 %" or "tie +100 MW"."""
    if name.startswith("load "):
        return PointTable(name=name, load_scale=1.0 + 0.01 * float(name.split()[1]))
    if name.startswith("tie "):
        return PointTable(name=name, tie_flow_mw=float(name.split()[1]))
    return PointTable(name=name, out=(name.removesuffix(" out"),))


def _open(plant: control.StateSpace, K: control.StateSpace) -> control.StateSpace:
    """Return the loop cut at the controller's inputs; positive feedback is -K's with the usual sign."""
    outputs = [plant.output_labels.index(name) for name in K.input_labels]
    inputs = [plant.input_labels.index(name) for name in K.output_labels]
    G = control.ss(plant.A, plant.B[:, inputs], plant.C[outputs], 0.0)
    return -G * control.ss(K.A, K.B, K.C, K.D)
