"""Laws of what is read off a run: known modes come back, scales do not matter, decay is told from growth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from judged import judged

from interarea.cosim.results import metrics as m
from interarea.cosim.results.ringdown import fit_window, ring_down_of
from interarea.cosim.scenario.scenario import load_scenario
from interarea.cosim.trajectory import Trajectory
from interarea.fmu_build.open.ports import Port
from interarea.models.case.case import Case

T = 0.05 * np.arange(300)
SHAPES = {
    "inter-area": np.array([1.0, 0.9, -0.8, -1.1]),
    "local area 1": np.array([1.0, -1.0, 0.02, -0.02]),
    "local area 2": np.array([0.02, -0.02, 1.0, -1.0]),
}


def ring(zeta: float, frequency_hz: float, phase: float) -> np.ndarray:
    """A free oscillation; `frequency_hz` is the damped one."""
    w = 2.0 * np.pi * frequency_hz
    return np.asarray(np.exp(-zeta / np.sqrt(1.0 - zeta**2) * w * T) * np.cos(w * T + phase))


modes = st.tuples(st.floats(-0.01, 0.15), st.floats(0.0, 6.0), st.floats(0.3, 1.0))


@st.composite
def swings(draw: st.DrawFn) -> dict[str, tuple[float, float, float, float]]:
    """Mode -> damping ratio, frequency, phase, amplitude; frequencies apart."""
    frequencies = (draw(st.floats(0.3, 0.8)), draw(st.floats(1.0, 1.3)), draw(st.floats(1.5, 2.0)))
    return {
        name: (z, f, phase, size)
        for name, f, (z, phase, size) in zip(SHAPES, frequencies, [draw(modes) for _ in SHAPES], strict=True)
    }


def speeds(swing: dict[str, tuple[float, float, float, float]]) -> np.ndarray:
    parts = [a * np.outer(ring(z, f, p), SHAPES[n]) for n, (z, f, p, a) in swing.items()]
    return np.asarray(sum(parts))


def records(values: np.ndarray) -> Trajectory:
    columns = [f"plant.G{k}_dw" for k in range(1, 5)]
    return Trajectory.of_records(T, values, columns, [Port(c) for c in columns])


@settings(max_examples=25)
@given(swings(), st.floats(1e-6, 1e3))
def test_modes_come_back_by_name_whatever_their_size(two_area: Case, swing: Any, scale: float) -> None:
    named, fit = ring_down_of(records(scale * 1e-3 * speeds(swing)), two_area, (0.0, float(T[-1])), 0.05)
    assert set(named) == set(swing)
    for name, (zeta, frequency, _, _) in swing.items():
        # the fit leaves out what is below 1e-4 of the strongest, which moves poles by that much
        assert named[name].damping_ratio == pytest.approx(zeta, abs=2e-3)
        assert named[name].frequency_hz == pytest.approx(frequency, rel=2e-3)
    assert fit.error < 1e-2


@pytest.mark.slow
@settings(max_examples=25)
@given(swings(), st.permutations(range(4)), st.lists(st.floats(0.01, 100.0), min_size=4, max_size=4))
def test_the_poles_do_not_depend_on_order_and_units_of_the_signals(
    swing: Any, order: list[int], units: list[float]
) -> None:
    values = speeds(swing)
    one = m.ring_down(T, values, rank_tolerance=1e-9)
    other = m.ring_down(T, (values * units)[:, order], rank_tolerance=1e-9)
    expected = sorted((f, z) for z, f, _, _ in swing.values())
    for fit in (one, other):
        np.testing.assert_allclose(
            sorted((x.frequency_hz, x.damping_ratio) for x in fit.modes[:3]), expected, rtol=1e-5, atol=1e-6
        )
    assert one.error < 1e-7 and other.error < 1e-7


@settings(max_examples=60)
@given(st.floats(-0.05, 0.3), st.floats(0.3, 1.5), st.floats(0.0, 6.0), st.floats(1e-6, 1e3))
def test_decay_is_stable_and_growth_is_not(zeta: float, frequency: float, phase: float, scale: float) -> None:
    rate = zeta * 2.0 * np.pi * frequency  # 1/s; a window is 5 s
    assume(abs(rate) > 0.02)
    signal = scale * ring(zeta, frequency, phase)
    assert judged(T, signal).stable is (zeta > 0.0)
    assert judged(T, -signal).stable is (zeta > 0.0)


@settings(max_examples=60)
@given(st.floats(0.2, 3.0), st.floats(0.3, 1.5), st.floats(0.0, 6.0), st.floats(0.05, 0.6))
def test_what_settles_on_an_oscillation_is_not_stable(
    start: float, frequency: float, phase: float, seconds_: float
) -> None:
    envelope = 1.0 + (start - 1.0) * np.exp(-T / seconds_)
    assert judged(T, envelope * np.sin(2.0 * np.pi * frequency * T + phase)).stable is False


@settings(max_examples=60)
@given(st.floats(0.1, 3.0), st.floats(1e-3, 0.3), st.floats(1e-6, 1e3))
def test_settling_and_energy_scale_as_they_must(rate: float, band: float, scale: float) -> None:
    signal = np.exp(-rate * T)
    settled = m.settling_time_s(T, scale * signal, 0.0, band=band)
    exact = -np.log(band) / rate
    if exact > T[-1]:
        assert settled is None
    else:  # a line between two samples instead of the exponential
        assert settled == pytest.approx(exact, abs=0.05 * (1.0 - np.exp(-rate * 0.05)))
    assert m.energy(T, scale * signal) == pytest.approx(scale**2 * m.energy(T, signal), rel=1e-12)


def test_a_well_damped_mode_has_died_out_where_the_fit_begins(two_area: Case) -> None:
    """An exciter's mode of 2.5 Hz swings three times as far as the machines at first, and like them: after
    0.25 s a seventh is left, so that the mode named is the machines'."""
    pulse = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 0.5, "end_s": 1.0}
    table = {"case": "two-area-thesis", "controller": "none", "stop_s": float(T[-1]), "event": [pulse]}
    machines = speeds({"inter-area": (0.08, 0.62, 1.0, 1.0), "local area 1": (0.1, 1.2, 0.0, 1.0)})
    exciter = speeds({"local area 1": (0.6, 2.5, 0.0, 3.0)})
    after = round(1.0 / 0.05)  # samples before the pulse ends, in which nothing moves
    values = np.zeros_like(machines)
    values[after:] = 1e-3 * (machines + exciter)[:-after]
    window = fit_window(load_scenario(table))
    named, _ = ring_down_of(records(values), two_area, window, 0.05)
    assert named["local area 1"].damping_ratio == pytest.approx(0.1, abs=1e-6)
    assert named["inter-area"].damping_ratio == pytest.approx(0.08, abs=1e-6)
    early, _ = ring_down_of(records(values), two_area, (1.0, window[1]), 0.05)
    assert early["local area 1"].damping_ratio == pytest.approx(0.6, abs=1e-6)
