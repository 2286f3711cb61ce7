"""Oscillations and load noise against closed forms, the linear plant's resolvent and the law of the process.

The electric power of a single constant EMF on constant impedances is constant, so 2 H d(slip)/dt is what its
mechanical power is moved by, exactly.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from plant_shim import BlockFailure, BlockShim

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import Case, case_of, load_case
from interarea.models.case.events import events_of

H, SIZE, STAIR_S = 4.0, 1e-3, 0.02


def grid() -> Case:
    """One machine, one line, two loads."""
    machine = {"bus": 1, "model": "classical", "base_mva": 100.0, "H": H, "Xd1": 0.2, "P_mw": 50.0}
    return case_of(
        {
            "name": "one",
            "source": "of this test",
            "frequency_hz": 60.0,
            "base_mva": 100.0,
            "buses": {"1": {}, "2": {}},
            "branches": {"1-2": {"from": 1, "to": 2, "x": 0.1}},
            "loads": {
                "L1": {"bus": 1, "P_mw": 20.0, "Q_mvar": 0.0},
                "L2": {"bus": 2, "P_mw": 30.0, "Q_mvar": 10.0},
            },
            "machines": {"G1": machine | {"V_pu": 1.0, "slack": True}},
        },
        where="one",
    )


def started(*events: dict[str, Any], case: Case | None = None) -> BlockShim:
    case = grid() if case is None else case
    return BlockShim(plant_block(case), event_parameters(case, events_of(events, where="test")))


def oscillation(on: str = "mechanical_power", f: float = 0.7, **more: Any) -> dict[str, Any]:
    at = {} if {"load", "bus"} & set(more) else {"machine": "G1"}
    return {"kind": "oscillation", "on": on, "frequency_hz": f, "size_pu": SIZE, "start_s": 0.0, **at, **more}


def coefficients(stop_s: float, f: float, *events: dict[str, Any]) -> np.ndarray:
    """Return the sine's Fourier coefficients 1 to 7 of the mechanical power over whole periods, over SIZE."""
    plant = started(*events)
    slip = plant.state_names.index("G1.slip")
    edges, powers, t = [], [], 0.0
    while t < stop_s * (1.0 - 1e-12):
        edges.append(t)
        powers.append(2.0 * H * plant.derivatives(plant.x)[0][slip])
        t = plant.next_event(t)
        plant.event(t, plant.x.copy())
    edges.append(stop_s)
    return np.array(
        [
            sum(
                p * (math.cos(w * a) - math.cos(w * b)) / w
                for p, a, b in zip(powers, edges[:-1], edges[1:], strict=True)
            )
            * 2.0
            / (stop_s * SIZE)
            for w in 2.0 * math.pi * f * np.arange(1, 8)
        ]
    )


@pytest.mark.parametrize("f", [0.1, 0.63, 9.7])
def test_the_first_harmonic_of_a_sine_has_its_size_and_others_are_those_asked_for(f: float) -> None:
    periods = 3.0 / f
    assert coefficients(periods, f, oscillation(f=f)) == pytest.approx([1, *[0] * 6], abs=1e-9)
    shares = (0.3, -0.1) if f < 3.0 else ()
    expected = [1.0, *shares, *[0.0] * (6 - len(shares))]
    assert coefficients(periods, f, oscillation(f=f, harmonics=shares)) == pytest.approx(expected, abs=1e-9)


def test_a_square_wave_has_the_harmonics_of_one_and_its_edges_are_events() -> None:
    f = 0.7
    expected = [4.0 / (math.pi * n) if n % 2 else 0.0 for n in range(1, 8)]
    assert coefficients(3.0 / f, f, oscillation(f=f, shape="square")) == pytest.approx(expected, abs=1e-9)
    plant = started(oscillation(f=f, shape="square", start_s=0.123, end_s=2.0))
    times = [0.0]
    while times[-1] < math.inf:
        times.append(plant.next_event(times[-1]))
    assert times[1:-1] == pytest.approx([0.123, 0.123 + 0.5 / f, 0.123 + 1.0 / f, 2.0], rel=1e-15)


def test_steps_of_a_solver_end_at_the_edges() -> None:
    """The slip under a square wave is a triangle; Runge-Kutta steps that end at its edges make it exactly."""
    f = 0.7
    times, states, _ = started(oscillation(f=f, shape="square")).run(4.0, 0.3)
    phase = (times * f) % 1.0
    triangle = np.minimum(phase, 1.0 - phase) / f * SIZE / (2.0 * H)
    slip = states[:, BlockShim(plant_block(grid())).state_names.index("G1.slip")]
    assert slip == pytest.approx(triangle, abs=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("on", "at"),
    [("voltage_reference", {}), ("mechanical_power", {}), ("load", {"load": "L7"}), ("load", {"bus": 9})],
)
def test_the_forced_answer_is_the_resolvents(on: str, at: dict[str, Any]) -> None:
    """C (jw - A)^-1 b + d of the linear plant; b from the input, or from the rates under a step.

    The run starts in its periodic motion; what is left is the motion of the stairs' higher harmonics, 1/136
    and less.
    """
    case, f, w = load_case("two-area-thesis"), 0.37, 2.0 * math.pi * 0.37
    plant = started(oscillation(on, f, **at), case=case)
    A, B, C, D = BlockShim(plant_block(case)).jacobians()
    if on == "voltage_reference":
        b, d = B[:, plant.input_names.index("G1_vs")], D[:, plant.input_names.index("G1_vs")]
    else:
        kind = "load_step" if on == "load" else "pm_step"
        where = at or {"machine": "G1"}
        up, down = (
            started({"kind": kind, "size_pu": s * SIZE, "start_s": 0.0, **where}, case=case)
            for s in (1.0, -1.0)
        )
        b, d = (
            (a - c) / (2.0 * SIZE)
            for a, c in zip(up.derivatives(up.x), down.derivatives(down.x), strict=True)
        )
    x = np.linalg.solve(1j * w * np.eye(len(A)) - A, b)
    expected = (C @ x + d) * SIZE
    plant.x += SIZE * x.imag  # of Im(x e^jwt) at 0
    times, _, outputs = plant.run(6.0 / f, 0.002)
    last = times > 2.0 / f
    basis = np.column_stack(
        [np.ones(last.sum()), times[last], np.sin(w * times[last]), np.cos(w * times[last])]
    )
    fit = np.linalg.lstsq(basis, outputs[last], rcond=None)[0]
    answer = fit[2] + 1j * fit[3]
    for name in ("G1_dw", "G3_dw", "G2_delta", "G1_vt"):
        k = plant.output_names.index(name)
        late = abs(d[k]) * SIZE * w * 0.002  # a leap is seen at the end of its step
        assert abs(answer[k] - expected[k]) <= 3e-3 * abs(expected[k]) + late, name


def shares_of(plant: BlockShim, count: int, first: int = 0) -> np.ndarray:
    """Return the electric power of each stair less that at rest."""
    k, x = plant.output_names.index("G1_pe"), plant.x.copy()
    rest = BlockShim(plant_block(grid())).derivatives(x)[1][k]
    values = []
    for stair in range(first, first + count):
        plant.event(stair * STAIR_S, x)
        values.append(plant.derivatives(x)[1][k] - rest)
    return np.array(values)


def noise(**more: Any) -> dict[str, Any]:
    return {"kind": "load_noise", "size_pu": SIZE, "start_s": 0.0, "corner_hz": 5.0, "seed": 3, **more}


@pytest.mark.parametrize("corner_hz", [0.5, 5.0])
def test_noise_has_the_variance_and_the_spectrum_of_its_process(corner_hz: float) -> None:
    step = started({"kind": "load_step", "load": "L2", "size_pu": SIZE, "start_s": 0.0})
    k = step.output_names.index("G1_pe")
    unit = step.derivatives(step.x)[1][k] - BlockShim(plant_block(grid())).derivatives(step.x)[1][k]
    n, r = 1 << 14, math.exp(-2.0 * math.pi * corner_hz * STAIR_S)
    z = shares_of(started(noise(load="L2", corner_hz=corner_hz)), n) / unit
    independent = n * (1.0 - r * r) / (1.0 + r * r)  # numbers that tell as much of the variance
    assert abs(z.mean()) < 4.0 * math.sqrt((1.0 + r) / (1.0 - r) / n)
    assert abs(z.var() - 1.0) < 4.0 * math.sqrt(2.0 / independent)
    assert abs(np.mean(z**4) / z.var() ** 2 - 3.0) < 6.0 * math.sqrt(24.0 / independent)
    # averages of the periodogram over 8 bands against (1 - r^2) / |1 - r exp(-jw)|^2
    w = 2.0 * math.pi * np.fft.rfftfreq(n)[1:]
    ratio = np.abs(np.fft.rfft(z))[1:] ** 2 / n * np.abs(1.0 - r * np.exp(-1j * w)) ** 2 / (1.0 - r * r)
    bands = ratio[: 8 * (len(ratio) // 8)].reshape(8, -1)
    assert bands.mean(axis=1) == pytest.approx(np.ones(8), abs=4.0 / math.sqrt(bands.shape[1]))


def test_noise_follows_from_seed_load_and_time_alone() -> None:
    plant = started(noise(load="L2"))
    forward = shares_of(plant, 200)
    assert np.array_equal(shares_of(plant, 50, 100), forward[100:150])  # asked again, later ones known
    assert not np.any(shares_of(started(noise(load="L2", seed=4)), 200) == forward)
    first, every = shares_of(started(noise(load="L1")), 200), shares_of(started(noise()), 200)
    assert abs(np.corrcoef(first, forward)[0, 1]) < 4.0 / math.sqrt(200 * 0.5)
    assert every == pytest.approx(first + forward, abs=5.0 * SIZE**2)  # both loads, each as alone


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"event[1].wave": 4}, r"event\[1\] \(pm_pulse\): wave = 4, allowed: 0 to 3"),
        ({"event[1].frequency": 11.0}, r"frequency = 11 Hz, allowed: 0\.0001 to 10"),
        ({"event[1].rise": 0.5}, r"rise = 0\.5 s, allowed: 0 to 0"),
        ({"event[1].kind": 7}, r"event\[1\] \(machine_trip\): wave = 1, allowed: 0 to 0"),
        ({"event[1].kind": 5, "event[1].target": 0}, r"target = 0 for load_step, allowed: 1 to 2"),
    ],
)
def test_a_slot_that_makes_no_wave_is_refused(values: dict[str, Any], message: str) -> None:
    case = grid()
    start = event_parameters(case, events_of([oscillation()], where="test"))
    with pytest.raises(BlockFailure, match=message):
        BlockShim(plant_block(case), start | values)
