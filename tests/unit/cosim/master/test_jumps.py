"""A jump beside an event reaches its readers as a jump: never as a slope of 1e9 times its size."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from participants import Linear

from interarea.cosim.master.master import Master
from interarea.cosim.master.plan import LoopPlan
from interarea.cosim.run.system import System
from interarea.fmu_build.open.ports import Description, Port

ONE = np.ones((1, 1))


class Sampler:
    """Samples its input at the start of a step, 100 times a second, adds `noise(t)`, holds the sum.

    Its output is a plain `Port`: nothing declares that it jumps. Buffers are arrays.
    """

    def __init__(self, noise: Callable[[float], float], inputs: tuple[Port, ...] = (Port("u"),)) -> None:
        self.name, self.noise = "sampler", noise
        self.description = Description(inputs, (Port("y"),), {"y": frozenset(p.name for p in inputs)})
        self.u, self.du, self.y, self.dy = np.zeros(len(inputs)), np.zeros(3), np.zeros(1), np.zeros(0)

    def bind(self, inputs: object, slopes: object) -> None: ...
    def begin(self, start_s: float, stop_s: float) -> None:
        self.next = start_s

    def ready(self) -> None: ...
    def send(self, order: int) -> None: ...
    def advance(self, time_s: float, length_s: float) -> None:
        if time_s >= self.next - 1e-10:
            self.next += 0.01
            self.y[0] = sum(self.u) + self.noise(time_s)

    def receive(self, slopes: bool) -> None: ...
    def last_log(self) -> str:
        return ""

    def close(self) -> None: ...


@pytest.mark.parametrize("inputs", ["hermite", "linear"])
def test_the_slope_of_a_reader_does_not_hold_the_jump(inputs: str) -> None:
    """A step of 1 at 1 s through a gain of 2 into an integrator: 2 (t - 1)."""
    step = Sampler(lambda t: float(t >= 1.0), ())
    gain = Linear("gain", -ONE, 0 * ONE, 0 * ONE, 2.0 * ONE, ["u"], ["y"])
    sum_ = Linear("sum", 0 * ONE, ONE, ONE, 0 * ONE, ["u"], ["y"])
    wires = [("sampler.y", "gain.u"), ("gain.y", "sum.u")]
    with Master(
        LoopPlan(wires, stop_s=2.0, step_s=0.01, event_times_s=[1.0], inputs=inputs), [step, gain, sum_]
    ) as master:
        result = master.run()
    error = result.data["sum.y"].to_numpy() - 2.0 * np.maximum(result.time_s - 1.0, 0.0)
    assert np.abs(error).max() <= 1e-8  # 2e-9 s is the tick in which it jumps; 16668 with a line across it


@pytest.mark.parametrize("event", ["pulse", "fault"])
def test_sampled_noise_of_1_mhz_beside_an_event_ends_no_run(event: str, cache: Path) -> None:
    """1 mHz rms at 100 Hz on the local signal moves the speed by less than a tenth of its peak."""
    speeds = []
    for size in (1e-3 / 60.0, 0.0):
        draw = np.random.default_rng(0)
        loop = System(stop_s=3.0, cache=cache).plant("two-area-thesis").controller("robust")
        loop.add(Sampler(lambda t, size=size, draw=draw: size * draw.standard_normal()))
        loop.connect("plant.G2_dw", "controller.G2_dw").connect("controller.G4_vs", "plant.G4_vs")
        loop.connect("plant.G4_dw", "sampler.u").connect("sampler.y", "controller.G4_dw")
        if event == "pulse":
            loop.event("vref_pulse", machine="G1", size_pu=0.05, start_s=1.0, end_s=1.2)
        else:
            loop.event("bus_fault", bus=8, start_s=1.0, end_s=1.1, x_pu=1e-4)
        speeds.append(loop.run().data["plant.G4_dw"])
    noisy, quiet = speeds
    assert np.abs(noisy - quiet).max() <= 0.1 * np.abs(quiet).max()
