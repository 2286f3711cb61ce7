"""Screening: extremes of a run in closed form, against single runs, resumed, on its page."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from interarea.cosim.errors import SweepError
from interarea.cosim.results.largest_deviation import largest_deviation_of
from interarea.cosim.run.run import run_scenario
from interarea.cosim.screen import screening as module
from interarea.cosim.screen.page import Explorer, write_grid, write_screening
from interarea.cosim.screen.screening import START_S, Screened, Screening, run_screening, worst_first
from interarea.cosim.trajectory import Trajectory
from interarea.models.case.case import load_case
from interarea.models.case.events import event_of

CASE = "two-area-thesis"


def sample_curves(case, *, buses: bool = True) -> Trajectory:
    """Angles, speeds and voltages that are known."""
    time = np.array([0.0, 0.5, 0.5, 1.0, 2.0])
    columns = {"time_s": time}
    for k, machine in enumerate(case.machines):
        columns[f"plant.{machine.name}_delta"] = k * np.array([0.1, 0.2, 0.2, 0.9, 0.3])
        columns[f"plant.{machine.name}_dw"] = (k - 1) * np.array([0.0, 0.0, 0.0, 0.01, 0.02])
        columns[f"plant.{machine.name}_vt"] = np.array([1.0, 0.1, 0.6, 0.95, 0.9 - 0.01 * k])
    for k, bus in enumerate(case.buses if buses else ()):
        columns[f"plant.bus{bus.number}.v"] = np.array([1.0, 0.0, 0.0, 0.8 - 0.01 * k, 0.9])
    return Trajectory(columns, {})


def test_extremes_of_a_run_are_those_of_its_curves() -> None:
    case = load_case(CASE)
    result = largest_deviation_of(sample_curves(case), case, 0.5)
    assert result.angle_deg == pytest.approx(np.degrees(3 * 0.9)) and result.synchronous
    last = case.buses[-1]
    assert result.voltage_pu == pytest.approx(0.8 - 0.01 * (len(case.buses) - 1))
    assert result.voltage_at == f"bus{last.number}"
    assert result.nadir_hz == pytest.approx(case.frequency_hz * 0.98)
    assert result.zenith_hz == pytest.approx(case.frequency_hz * 1.04)
    without = largest_deviation_of(sample_curves(case, buses=False), case, 0.5)
    assert (without.voltage_pu, without.voltage_at) == (pytest.approx(0.87), case.machines[-1].name)


def test_a_tripped_machine_does_not_count() -> None:
    case = load_case(CASE)
    table = {"kind": "machine_trip", "machine": case.machines[-1].name, "start_s": 0.5}
    result = largest_deviation_of(sample_curves(case), case, 0.5, [event_of(table, where="event 1")])
    assert result.angle_deg == pytest.approx(np.degrees(1.8))


def test_half_a_turn_is_out_of_step() -> None:
    case = load_case(CASE)
    curves = sample_curves(case)
    curves._columns[f"plant.{case.machines[-1].name}_delta"] = np.array([0.0, 0.0, 0.0, np.pi, 0.0])
    assert not largest_deviation_of(curves, case, 0.5).synchronous


SCREENING = Screening(CASE, buses=(8, 5), clearing_s=0.1, stop_s=3.0, step_s=0.02, longest_s=0.8)


@pytest.fixture(scope="module")
def screening(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> tuple[list[Screened], Path]:
    folder = tmp_path_factory.mktemp("screen")
    return run_screening(SCREENING, folder, clearing=True, workers=1, cache=cache), folder


def alone(bus: int, clearing_s: float, cache: Path) -> float:
    """The largest angle of a single run, deg."""
    end = round(START_S + clearing_s, 9)
    event = {"kind": "bus_fault", "bus": bus, "start_s": START_S, "end_s": end}
    run = run_scenario({"case": CASE, "stop_s": 3.0, "step_s": 0.02, "event": [event]}, cache=cache)
    angles = [run.trajectory[f"plant.{m.name}_delta"] for m in run.case.machines]
    return float(np.degrees(np.ptp(np.array(angles), axis=0).max()))


@pytest.mark.slow
def test_a_screening_is_its_single_runs(screening: tuple[list[Screened], Path], cache: Path) -> None:
    assert sorted(one.place for one in screening[0]) == ["5", "8"]
    for one in screening[0]:
        assert one.verdict == "kept"
        assert one.angle_deg == pytest.approx(alone(int(one.place), 0.1, cache), rel=1e-9)


def test_beyond_the_critical_clearing_time_synchronism_goes(
    screening: tuple[list[Screened], Path], cache: Path
) -> None:
    worst = screening[0][0]
    assert worst.critical_s is not None and 0.1 < worst.critical_s < 0.8
    assert alone(int(worst.place), worst.critical_s, cache) < 180.0
    assert alone(int(worst.place), worst.critical_s + SCREENING.tolerance_s, cache) >= 180.0


def test_worst_comes_first_and_nothing_runs_twice(
    screening: tuple[list[Screened], Path], cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, folder = screening
    assert rows[0].critical_s <= rows[1].critical_s
    monkeypatch.setattr("interarea.cosim.sweep.front.local_outcomes", None)  # nothing is left to do
    assert run_screening(SCREENING, folder, clearing=True, workers=1, cache=cache) == rows


def test_page_and_files_hold_what_was_found(screening: tuple[list[Screened], Path]) -> None:
    rows, folder = screening
    page = write_screening(SCREENING, rows, folder).read_text(encoding="utf-8")
    table = page[page.index("worst first") :]
    first, second = (table.index(f'<td class="t">{one.place}</td>') for one in rows)
    assert first < second
    assert f"{1e3 * rows[0].critical_s:.4g}" in table and "<svg" in page
    document = json.loads((folder / "screen.json").read_text())
    assert [row["critical_s"] for row in document["rows"]] == [one.critical_s for one in rows]
    lines = list(csv.DictReader((folder / "screen.csv").open()))
    assert [float(line["angle_deg"]) for line in lines] == [one.angle_deg for one in rows]


def test_order_lost_failed_kept(screening: tuple[list[Screened], Path]) -> None:
    pd = pytest.importorskip("pandas")
    row = {"status": "ok", "failure": None, "reason": None, "voltage_at": "bus1"}
    row |= dict.fromkeys(("voltage_pu", "nadir_hz", "zenith_hz"), 1.0)
    none = dict.fromkeys(("synchronous", "angle_deg", "voltage_pu", "voltage_at", "nadir_hz", "zenith_hz"))
    rows = pd.DataFrame(
        [
            {"bus": 1, "controller": "robust", "synchronous": False, "angle_deg": 500.0, **row},
            {"bus": 1, "controller": "none", "synchronous": True, "angle_deg": 50.0, **row},
            {"bus": 2, "controller": "none", "synchronous": True, "angle_deg": 60.0, **row},
            {"bus": 3, "controller": "none", **none, "status": "failed", "failure": "invalid",
             "reason": "why"},
            {"bus": 4, "controller": "none", **none, "status": "failed", "failure": "no solution",
             "reason": "network: bus 4"},
            {"bus": 5, "controller": "none", "synchronous": False, "angle_deg": 200.0, **row},
        ]
    )  # fmt: skip
    order = worst_first(rows, SCREENING, {})
    assert [(one.place, one.controller, one.verdict) for one in order] == [
        ("5", "none", "lost"), ("4", "none", "lost"), ("3", "none", "failed"), ("2", "none", "kept"),
        ("1", "none", "kept"), ("1", "robust", "lost"),
    ]  # fmt: skip


def test_trips_outages_and_controllers_become_axes() -> None:
    sweep = Screening(CASE, kind="trip", outages=("8-9 a",), controllers=("robust",)).sweep()
    case = load_case(CASE)
    assert sweep.size == 2 * 2 * len(case.branches)
    assert sweep.base.event[0].kind == "branch_trip"
    assert {v["controller"] for v in map(sweep.values, range(sweep.size))} == {"none", "robust"}
    assert {v["outage"] for v in map(sweep.values, range(sweep.size))} == {"", "8-9 a"}


@pytest.mark.parametrize(
    "screening, why",
    [
        (Screening(CASE, buses=(80,)), r"no bus 80; did you mean '8'"),
        (Screening(CASE, kind="trip", branches=("7-8",)), r"no branch 7-8; did you mean '7-8 "),
        (Screening(CASE, clearing_s=20.0), r"the run ends at 10 s, allowed: after the fault"),
    ],
)
def test_what_does_not_exist_is_refused(screening: Screening, why: str) -> None:
    with pytest.raises(SweepError, match=why):
        screening.sweep()


def test_trips_have_no_clearing_times(tmp_path: Path) -> None:
    with pytest.raises(SweepError, match="clearing times need faults"):
        module.run_screening(Screening(CASE, kind="trip"), tmp_path, clearing=True)


@pytest.mark.slow
def test_a_place_opens_its_disturbance_in_the_explorer(cache: Path, tmp_path: Path) -> None:
    result = [
        Screened("8", outage, "none", "kept", 30.0, 0.9, "bus8", 59.0, 61.0, "") for outage in ("", "8-9 a")
    ]
    screening = Screening(CASE, buses=(8,), clearing_s=0.15, outages=("8-9 a",))
    page = write_screening(screening, result, tmp_path, write_grid(screening, tmp_path, cache)).read_text()
    link = "explorer.html#v=1&k=none&ev=fault&fault=8&tc=150&br="
    assert page.count(f'href="{link.replace("&", "&amp;")}"') == 1  # not the one with a branch out
    assert Explorer("e").address(Screening(CASE, clearing_s=0.7), "8", "") == ""  # beyond the page's slider
    assert (
        Explorer("e").address(Screening(CASE, kind="trip"), "8-9 a", "") == "e#v=1&k=none&ev=trip&trip=8-9+a"
    )
    nothing = write_grid(Screening("no-such-grid"), tmp_path, cache)
    assert not nothing.file and "no-such-grid" in nothing.why
