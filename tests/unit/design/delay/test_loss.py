"""Mean-square stability under packet loss: closed forms, brute force, the co-simulation packet by packet."""

from __future__ import annotations

import itertools
from pathlib import Path

import control
import numpy as np
import pytest
from scenario_loop import Loop

from interarea.cosim.run.artefacts import linear_plant
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.controller import Controller
from interarea.design.delay.packet_loss import LossyChannel, PacketLoop, critical_loss
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.models.case.case import load_case

T = 0.1


def scalar(a: float, k: float) -> tuple[control.StateSpace, control.StateSpace]:
    """dx/dt = a x + u, u = -k (what is read of x)."""
    plant = control.ss([[a]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"])
    return plant, control.ss([], [], [], [[-k]], inputs=["y"], outputs=["u"])


def two_by_two() -> tuple[control.StateSpace, control.StateSpace]:
    plant = control.ss(
        [[0.2, 3.0], [-3.0, 0.1]],
        [[1.0], [0.5]],
        np.eye(2),
        np.zeros((2, 1)),
        inputs=["u"],
        outputs=["p", "q"],
    )
    K = control.ss([[-4.0]], [[1.0, -0.5]], [[1.5]], [[-0.8, -0.6]], inputs=["p", "q"], outputs=["u"])
    return plant, K


@pytest.mark.parametrize("p", [0.0, 0.2, 0.7, 1.0])
def test_scalar_loop_in_closed_form(p: float) -> None:
    """Zero on loss, no latency: rho = (1 - p) (e^{aT} - k (e^{aT} - 1)/a)^2 + p e^{2aT}."""
    a, k = 0.5, 2.0
    grown = np.exp(a * T)
    rho = (1.0 - p) * (grown - k * (grown - 1.0) / a) ** 2 + p * grown**2
    result = PacketLoop(*scalar(a, k), T, {"y": LossyChannel(loss_good=p)}).mean_square()
    assert result.radius == pytest.approx(rho, rel=1e-9)
    assert result.decay_rate == pytest.approx(-np.log(rho) / (2.0 * T), rel=1e-6)


def test_critical_loss_in_closed_form() -> None:
    a, k = 0.5, 2.0
    grown = np.exp(a * T)
    closed = (grown - k * (grown - 1.0) / a) ** 2
    p = (1.0 - closed) / (grown**2 - closed)
    result = critical_loss(*scalar(a, k), T, {"y": LossyChannel()}, tolerance=1e-6)
    assert result == pytest.approx(p, abs=2e-6)
    assert critical_loss(*scalar(-0.5, 0.1), T, {"y": LossyChannel()}) == 1.0


def kronecker_radius(loop: PacketLoop) -> float:
    """Spectral radius of sum P(S) A_S x A_S over the states of the chains, as one dense matrix."""
    chains = [loop.channels[s].chain for s in loop.signals]
    modes = list(itertools.product(*(range(len(c[1])) for c in chains)))
    n2 = loop.order**2
    total = np.zeros((len(modes) * n2,) * 2)
    for (i, a), (j, b) in itertools.product(enumerate(modes), enumerate(modes)):
        move = np.prod([c[0][x, y] for c, x, y in zip(chains, a, b, strict=True)])
        for arrives in itertools.product((False, True), repeat=len(chains)):
            losses = [c[1][x] for c, x in zip(chains, a, strict=True)]
            odds = np.prod([1.0 - p if yes else p for yes, p in zip(arrives, losses, strict=True)])
            A = loop.step([s for s, yes in zip(loop.signals, arrives, strict=True) if yes])
            total[j * n2 : (j + 1) * n2, i * n2 : (i + 1) * n2] += move * odds * np.kron(A, A)
    return float(np.abs(np.linalg.eigvals(total)).max())


@pytest.mark.parametrize("on_loss", ["zero", "hold"])
@pytest.mark.parametrize(
    ("first", "second"),
    [
        ({"loss_good": 0.3}, {"loss_good": 0.1, "latency_s": 0.13}),
        ({"loss_good": 0.3, "latency_s": 0.04}, {"loss_good": 0.5, "latency_s": 0.07}),
        ({"loss_good": 0.05, "loss_bad": 0.9, "good_to_bad": 0.1, "bad_to_good": 0.3}, {"loss_good": 0.2}),
    ],
)
def test_against_the_whole_kronecker_matrix(
    on_loss: str, first: dict[str, float], second: dict[str, float]
) -> None:
    channels = {
        "p": LossyChannel(on_loss=on_loss, **first),  # type: ignore[arg-type]
        "q": LossyChannel(on_loss=on_loss, **second),  # type: ignore[arg-type]
    }
    loop = PacketLoop(*two_by_two(), T, channels)
    assert loop.mean_square().radius == pytest.approx(kronecker_radius(loop), rel=1e-7)


def test_without_loss_and_latency_short_packets_are_the_continuous_loop() -> None:
    """rho -> exp(2 alpha T) with the continuous abscissa alpha; the hold costs O(T)."""
    plant, K = two_by_two()
    closed = np.block([[plant.A + plant.B @ K.D @ plant.C, plant.B @ K.C], [K.B @ plant.C, K.A]])
    alpha = np.linalg.eigvals(closed).real.max()
    gaps = []
    for T_k in (4e-3, 2e-3, 1e-3):
        loop = PacketLoop(plant, K, T_k, {"p": LossyChannel(), "q": LossyChannel()})
        gaps.append(loop.mean_square().decay_rate + alpha)
    assert abs(gaps[2]) < 0.01 * abs(alpha)
    assert gaps[0] / gaps[1] == pytest.approx(2.0, rel=0.05) and gaps[1] / gaps[2] == pytest.approx(
        2.0, rel=0.05
    )


def test_bad_numbers_are_named() -> None:
    with pytest.raises(ValueError, match="loss_good is 1"):
        LossyChannel(loss_good=1.5)
    with pytest.raises(ValueError, match="latency_s is nan"):
        LossyChannel(latency_s=float("nan"))
    with pytest.raises(ValueError, match="channels for z"):
        PacketLoop(*two_by_two(), T, {"z": LossyChannel()})
    with pytest.raises(ValueError, match="interval_s is 0"):
        PacketLoop(*two_by_two(), 0.0, {})


def test_cosimulation_packet_by_packet(cache: Path, by_hand: Controller) -> None:
    """The FMUs and A_S agree along one sequence of lost packets: same seed, small pulse, linear range."""
    interval, latency = 0.02, 0.05
    channel = {"latency_s": latency, "reporting_interval_s": interval, "on_loss": "hold"}
    lossy = channel | {"loss": {"kind": "bernoulli", "rate": 0.3}}
    scenario = load_scenario(
        {
            "case": "two-area-thesis",
            "controller": "ftc",
            "stop_s": 6.0,
            "step_s": 0.01,
            "channels": {
                "remote": {"signal": "G2_dw", "seed": 7, **lossy},
                "local": {"signal": "G4_dw", "seed": 8, **lossy},
            },
            "event": [{"kind": "vref_pulse", "machine": "G1", "size_pu": 1e-4, "start_s": 0.5, "end_s": 0.6}],
        }
    )
    with Loop(scenario, cache=cache, controller=by_hand) as loop:
        run = loop.master.run()
    case = load_case("two-area-thesis")
    plant = speeds_in_rad(remove_reference(linear_plant(case, cache)), case.omega_b)
    K = by_hand.system
    fields = {"latency_s": latency, "on_loss": "hold", "loss_good": 0.3}
    model = PacketLoop(plant, K, interval, {s: LossyChannel(**fields) for s in K.input_labels})  # type: ignore[arg-type]
    time = run.time_s
    ends = {round(t, 9): k for k, t in enumerate(time)}
    outputs = list(plant.output_labels)
    C = np.asarray(plant.C)[[outputs.index("G2_dw"), outputs.index("G4_dw")]]
    # the pulse goes into the model too: the input G1_vs acts where the reference does
    column = np.asarray(plant.B)[:, list(plant.input_labels).index("G1_vs")]
    assert np.any(column)
    z = np.zeros(model.order)
    n = plant.nstates
    worst, peak = 0.0, 0.0
    for k in range(round(6.0 / interval)):
        arriving = [
            s
            for s in model.signals
            if (run["remote.valid"] if s == "G2_dw" else run["local.valid"])[
                ends[round(min(k * interval + latency, 6.0), 9)]
            ]
        ]
        z = model.step(arriving) @ z
        t = k * interval
        if 0.5 <= t < 0.6 - 1e-9:
            z[:n] += pulse(plant, column, interval)
        i = ends.get(round(t + interval, 9))
        assert i is not None
        if t < 0.6:
            continue
        speeds = C @ z[:n] / case.omega_b
        for value, s in zip(speeds, ("G2_dw", "G4_dw"), strict=True):
            worst = max(worst, abs(value - run[f"plant.{s}"][i]))
            peak = max(peak, abs(run[f"plant.{s}"][i]))
    # measured 0.4 %: the plant is not linear, and its FMU steps by Runge and Kutta
    assert worst <= 0.01 * peak


def pulse(plant: control.StateSpace, column: np.ndarray, interval: float) -> np.ndarray:
    """What 1e-4 pu on G1's reference adds to the plant's states over one interval."""
    from scipy.linalg import expm

    n = plant.nstates
    A = np.zeros((n + 1, n + 1))
    A[:n, :n], A[:n, n] = plant.A, column
    return np.asarray(expm(A * interval)[:n, n] * 1e-4)
