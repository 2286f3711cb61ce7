"""The PMU against closed forms of its windows, and within what the standard allows."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fmu_runner import Runner

from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.pmu import M_FILTERS, PmuFilter, pmu_block, pmu_filter

F0, STEP_S = 50.0, 0.005
OUTPUTS = ("v", "angle", "deviation", "frequency", "rocof")
FILTERS = {"P": pmu_filter("P", F0, 50.0), "M": pmu_filter("M", F0, 50.0)}
Phasor = Callable[[float], tuple[complex, complex]]  # value and slope at a time, s


@pytest.fixture(scope="module")
def pmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_fmu(pmu_block(), tmp_path_factory.mktemp("pmu") / "pmu.fmu")


def cubic(now: tuple[complex, complex], then: tuple[complex, complex], h: float) -> list[complex]:
    """Derivatives at its start of the cubic between two points, as a master hands inputs over."""
    rise = (then[0] - now[0]) / h
    return [
        now[1],
        2 * (3 * rise - 2 * now[1] - then[1]) / h,
        6 * (now[1] + then[1] - 2 * rise) / h**2,
    ]


def follow(
    path: Path, filter_: PmuFilter, u: Phasor, stop_s: float, step_s: float = STEP_S, jumps: bool = False
) -> np.ndarray:
    """Rows of time and OUTPUTS after each step; an input that jumps is held over it."""
    number = {"P": 0, "M": 1}
    start = {k: number.get(str(v), v) for k, v in filter_.parameters.items()}
    first = u(0.0)[0]
    rows = []
    with Runner(path) as run:
        run.start(start | {"re": first.real, "im": first.imag})  # type: ignore[arg-type]
        for k in range(round(stop_s / step_s)):
            t = k * step_s
            value = u(t)[0]
            slopes = [0j] if jumps else cubic(u(t), u(t + step_s), step_s)
            run.set(re=value.real, im=value.imag)
            run.slopes("re", *(d.real for d in slopes))
            run.slopes("im", *(d.imag for d in slopes))
            run.step(t, step_s)
            rows.append([t + step_s, *(float(run.get(n)) for n in OUTPUTS)])
    return np.array(rows)


def turning(angle: Callable[[float], float], rate: Callable[[float], float], size: float = 1.0) -> Phasor:
    def at(t: float) -> tuple[complex, complex]:
        value = size * np.exp(1j * angle(t))
        return complex(value), complex(1j * rate(t) * value)

    return at


@pytest.mark.parametrize("performance", FILTERS)
@pytest.mark.parametrize("off_hz", [-2.0, 0.5, 2.0])
def test_off_nominal_frequency_is_measured_as_it_is(pmu: Path, performance: str, off_hz: float) -> None:
    """A symmetric window turns no angle: the frequency is exact, the magnitude is the window's sum."""
    filter_, w = FILTERS[performance], 2 * math.pi * off_hz
    rows = follow(pmu, filter_, turning(lambda t: w * t, lambda _: w, 1.02), 0.5)[-5:]
    np.testing.assert_allclose(rows[:, 4], F0 + off_hz, atol=1e-5)
    np.testing.assert_allclose(rows[:, 3], off_hz / F0, atol=2e-7)
    exact = np.angle(np.exp(1j * w * (rows[:, 0] - filter_.delay_s)))
    np.testing.assert_allclose(rows[:, 2], exact, atol=1e-7)
    x = math.pi * off_hz * filter_.sample_s
    if performance == "P":  # Fejer's kernel, over what the standard makes up for
        n = filter_.half + 1
        kernel = (math.sin(n * x) / (n * math.sin(x))) ** 2
        kernel /= math.sin(math.pi * (F0 + 1.625 * off_hz) / (2 * F0))
    else:
        kernel = float(filter_.weights @ np.cos(2 * x * np.arange(-filter_.half, filter_.half + 1)))
    np.testing.assert_allclose(rows[:, 1], 1.02 * kernel, rtol=1e-7)
    assert abs(kernel - 1.0) < 0.01  # the standard's limit of the total vector error


@pytest.mark.parametrize("performance", FILTERS)
def test_a_ramp_is_followed_within_the_standard(pmu: Path, performance: str) -> None:
    """1 Hz/s through nominal frequency: 0.01 Hz and 0.4 (P) or 0.2 Hz/s (M), each of its instant."""
    filter_, rate = FILTERS[performance], 2 * math.pi * 1.0
    u = turning(lambda t: 0.5 * rate * (t - 0.7) ** 2, lambda t: rate * (t - 0.7))
    rows = follow(pmu, filter_, u, 1.2)
    rows = rows[rows[:, 0] > 3 * filter_.delay_s]
    np.testing.assert_allclose(rows[:, 4], F0 + rows[:, 0] - filter_.delay_s - 0.7, atol=1e-4)
    np.testing.assert_allclose(rows[:, 5], 1.0, atol=0.02)


@pytest.mark.parametrize("performance", FILTERS)
def test_a_swing_is_seen_through_the_stated_response(pmu: Path, performance: str) -> None:
    """0.6 Hz and 2 Hz: amplitude and phase of the deviation are H(j w); in class P a closed form."""
    filter_ = FILTERS[performance]
    for hertz in (0.6, 2.0):
        w, a = 2 * math.pi * hertz, 1e-3
        u = turning(lambda t: a * math.sin(w * t), lambda t: a * w * math.cos(w * t))  # noqa: B023
        rows = follow(pmu, filter_, u, 1.0)
        rows = rows[rows[:, 0] > 2.2 * filter_.delay_s]
        H = filter_.rate(np.array([1j * w]))[0]
        seen = 2 * math.pi * F0 * rows[:, 3]
        np.testing.assert_allclose(seen, a * (H * np.exp(1j * w * rows[:, 0])).imag, atol=2e-6 * a * w)
        if performance == "P":
            n, x, h = filter_.half + 1, 0.5 * w * filter_.sample_s, filter_.sample_s
            kernel = (math.sin(n * x) / (n * math.sin(x))) ** 2 * math.sin(w * h) / h
            assert abs(H - 1j * kernel * np.exp(-1j * w / F0)) < 1e-12 * abs(H)


def test_a_jump_of_the_angle_is_a_pulse_of_the_same_area(pmu: Path) -> None:
    """10 degrees at 0.2 s: the frequency's mean over the window and one sample is the jump."""
    filter_, jump, h = FILTERS["P"], math.radians(10.0), FILTERS["P"].sample_s
    rows = follow(pmu, filter_, turning(lambda t: jump * (t >= 0.2 - 1e-9), lambda _: 0.0), 0.3, h / 2, True)[
        ::2
    ]
    away = (rows[:, 0] < 0.2) | (rows[:, 0] > 0.2 + 2 * filter_.delay_s + h)
    np.testing.assert_allclose(rows[away, 3], 0.0, atol=1e-9)
    assert np.sum(rows[:, 3]) * h * 2 * math.pi * F0 == pytest.approx(jump, rel=1e-9)


def test_delay_and_stop_band_are_the_standards() -> None:
    """P: one cycle. M: nothing of half the reporting rate gets through, one of the modes we damp does."""
    assert pmu_filter("P", 60.0, 30.0).delay_s == pytest.approx(1 / 60)
    for (f0, rate), (_, order) in M_FILTERS.items():
        filter_ = pmu_filter("M", float(f0), float(rate))
        assert filter_.delay_s == pytest.approx((order / 2 + 1) / (16 * f0)) and filter_.delay_s < 7 / rate
        s = 2j * np.pi * np.array([0.5 * rate, min(0.1 * rate, 5.0)])
        stopped, passed = np.abs(filter_.window(s))
        assert stopped < 0.0135 and abs(passed - 1.0) < 0.006, (f0, rate)


def test_what_no_filter_is_given_for_is_refused() -> None:
    with pytest.raises(
        ValueError, match="M class at 50 Hz with 60 reports a second, allowed: 10, 25, 50, 100"
    ):
        pmu_filter("M", 50.0, 60.0)
    with pytest.raises(ValueError, match="capacity is 1, allowed are 2 to 1000000"):
        pmu_block(capacity=1)
