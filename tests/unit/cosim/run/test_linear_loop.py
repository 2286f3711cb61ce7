"""One loop, one number: run, certificate and sweep on the same loop, and what is told where they cannot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.cosim.results.ringdown import fit_window
from interarea.cosim.results.run import Run
from interarea.cosim.run.artefacts import linear_plant
from interarea.cosim.run.controllers import controller_of
from interarea.cosim.run.run import run_scenario, system_of
from interarea.cosim.scenario.scenario import load_scenario
from interarea.cosim.study.delay import least_damping
from interarea.cosim.sweep.front import run_sweep
from interarea.cosim.sweep.parts import read_rows
from interarea.design.controllers.controller import Controller
from interarea.design.delay.loop_modes import LoopModes
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.design.modes.modes import damping_ratio
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case

PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}
TRIP = {"kind": "branch_trip", "branch": "8-9 a", "start_s": 1.0}


def document(latency_s: float, **changes: Any) -> dict[str, Any]:
    channels = {
        n: {"signal": s, "latency_s": latency_s} for n, s in (("remote", "G2_dw"), ("local", "G4_dw"))
    }
    return {
        "case": "two-area-thesis",
        "controller": "robust",
        "stop_s": 14.0,
        "channels": channels,
        "event": [PULSE],
    } | changes


@pytest.fixture(scope="module")
def late() -> Run:
    return run_scenario(document(0.2, controller="wdc"))


def test_a_run_tells_what_is_damped_least_and_not_what_its_ring_down_shows_best(
    late: Run, tmp_path: Path
) -> None:
    """0.063 is the study's row for 200 ms on both signals, by other code; a sweep has the same bits."""
    case = load_case("two-area-thesis")
    plant = speeds_in_rad(remove_reference(linear_plant(case, default_cache())), case.omega_b)
    K = controller_of("wdc", case, default_cache())
    assert isinstance(K, Controller)
    expected = least_damping(plant, K.system, dict.fromkeys(K.inputs, 0.2))
    assert expected == pytest.approx(0.063, abs=5e-4)
    m = late.metrics
    assert m.least_damping_ratio == pytest.approx(expected, abs=1e-6)
    assert late.damping_ratio("least") == m.least_damping_ratio and m.least_mode == "local area 2"
    assert m.least_frequency_hz == pytest.approx(1.403, abs=1e-3)
    assert "least damping 0.063 at 1.40 Hz (local area 2)" in late.summary
    run_sweep({"scenario": document(0.2, controller="wdc")}, tmp_path / "sweep", workers=1)
    row = read_rows(tmp_path / "sweep").iloc[0]
    assert (row.damping_least, row.frequency_least) == (m.least_damping_ratio, m.least_frequency_hz)
    assert row.damping_inter_area == late.damping_ratio("inter-area")


def test_the_ring_down_agrees_with_the_roots_where_its_fit_is_good(late: Run) -> None:
    m = late.metrics
    assert m.fit_error is not None and m.fit_error <= 0.02
    assert m.ring_down
    for name, ratio in m.ring_down.items():
        assert ratio == pytest.approx(m.damping_ratio[name], abs=0.02), name


@pytest.mark.parametrize("latency_s", [0.0, 0.1])
def test_the_default_controller_shows_its_inter_area_mode(latency_s: float) -> None:
    run = run_scenario(document(latency_s))
    assert run.damping_ratio("inter-area") > 0.25


def swings(**changes: Any) -> LoopModes | str:
    return system_of(load_scenario(document(0.1, stop_s=20.0) | changes)).linear_swings()


@pytest.mark.slow
def test_packets_and_losses_count_in_the_mean() -> None:
    smooth = swings()
    packets = {"reporting_interval_s": 0.02, "on_loss": "hold"}
    lossy = {
        n: {"signal": s, "latency_s": 0.09, **packets, "loss": {"kind": "bernoulli", "rate": 0.0}}
        for n, s in (("remote", "G2_dw"), ("local", "G4_dw"))
    }
    held = swings(channels=lossy)
    assert isinstance(smooth, LoopModes) and isinstance(held, LoopModes)
    for name, root in smooth.named.items():  # 90 ms and packets that are 10 ms old on average
        assert damping_ratio(held.named[name]) == pytest.approx(damping_ratio(root), abs=1e-3)
    lossy["remote"]["loss"] = lossy["local"]["loss"] = {"kind": "bernoulli", "rate": 0.8}
    worse = swings(channels=lossy)
    assert isinstance(worse, LoopModes) and worse.least is not None and held.least is not None
    assert damping_ratio(worse.least) < damping_ratio(held.least) - 0.02


@pytest.mark.slow
def test_a_signal_that_is_lost_in_the_window_counts_as_lost() -> None:
    channels = document(0.1)["channels"]
    channels["remote"]["outages_s"] = [[1.5, 20.0]]
    result, whole = swings(channels=channels), swings()
    assert isinstance(result, LoopModes) and isinstance(whole, LoopModes)
    assert result.named["inter-area"] != pytest.approx(whole.named["inter-area"], abs=1e-3)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"event": [PULSE, TRIP]}, "the grid is changed by the branch_trip at 1 s"),
        ({"plant": {"G1.exciter.KA": 30.0}}, "plant.G1.exciter.KA was changed"),
    ],
)
def test_where_there_is_no_linear_loop_the_reason_is_told(changes: dict[str, Any], reason: str) -> None:
    assert swings(**changes) == reason


def test_what_has_ended_before_the_window_changes_no_loop() -> None:
    assert isinstance(swings(event=[TRIP | {"end_s": 1.1}]), LoopModes)


def test_without_a_linear_loop_the_ring_down_is_told_and_harmonics_are_no_modes() -> None:
    """After the trip the inter-area mode has 0.50 Hz; the square of the large swing has 1.00 Hz."""
    run = run_scenario("fault")
    m = run.metrics
    assert m.least_mode == "inter-area" and m.least_frequency_hz == pytest.approx(0.49, abs=0.02)
    assert "branch_trip" in m.methods["damping_ratio"] and m.ring_down == m.damping_ratio


def test_a_poor_fit_names_no_mode(late: Run) -> None:
    rng = np.random.default_rng(2)
    columns = {c: late.trajectory[c].copy() for c in late.trajectory.units}
    after = late.trajectory.time_s > fit_window(late.scenario)[0]
    for name in columns:
        if name.endswith("_dw"):
            size = 0.2 * np.max(np.abs(columns[name]))
            columns[name][after] += size * rng.standard_normal(int(after.sum()))
    noisy = type(late.trajectory)(columns, late.trajectory.units, late.trajectory.descriptions)
    with pytest.raises(ValueError, match=r"fitted within \d+\.\d% only, wanted 2%"):
        replace(late, trajectory=noisy).damping_ratio(start_s=1.5)
