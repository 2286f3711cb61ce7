r"""A phasor measurement unit as a block (semantics: pmu/pmu.h), and its filter as a linear system.

A report comes out one half window and one sample after the instant it is of: that is its group delay, the
same for every frequency because the windows are symmetric. From the angle of the bus to the measured
frequency deviation the filter is, with h the time between samples,

.. math:: H(s) = e^{-s (M + 1) h} \, \frac{\sinh(s h)}{h} \sum_{k=-M}^{M} w_k e^{-s k h} .
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from .variables import Block, Enumeration, Variable, VariableTable

_FOLDER = Path(__file__).resolve().parents[1] / "c"
Performance = Literal["P", "M"]
SAMPLES = 16  #: of a cycle
#: M class: (nominal frequency in Hz, reports per second) -> reference frequency in Hz, order of the filter
#: [IEC60255, table D.1]
M_FILTERS: dict[tuple[int, int], tuple[float, int]] = {
    (50, 10): (1.779, 806),
    (50, 25): (4.355, 338),
    (50, 50): (7.75, 142),
    (50, 100): (14.1, 66),
    (60, 10): (1.78, 968),
    (60, 12): (2.125, 816),
    (60, 15): (2.64, 662),
    (60, 20): (3.5, 502),
    (60, 30): (5.02, 306),
    (60, 60): (8.19, 164),
    (60, 120): (16.25, 70),
}

PERFORMANCE = Enumeration(
    "PerformanceClass",
    (
        ("P", 0, "Protection: two cycles, triangular"),
        ("M", 1, "Measurement: low-pass filter for the reporting rate"),
    ),
)


@dataclass(frozen=True)
class PmuFilter:
    """The filter of a PMU: class, nominal and (M class) reference frequency in Hz, half width in samples."""

    performance: Performance
    nominal_hz: float
    half: int = SAMPLES - 1
    reference_hz: float = 1.0

    @property
    def sample_s(self) -> float:
        """Time between samples, s."""
        return 1.0 / (SAMPLES * self.nominal_hz)

    @property
    def delay_s(self) -> float:
        """Group delay of frequency, angle and magnitude, s."""
        return (self.half + 1) * self.sample_s

    @property
    def parameters(self) -> dict[str, float | int | str]:
        """Parameters of the FMU."""
        return {
            "nominal_frequency": self.nominal_hz,
            "reference_frequency": self.reference_hz,
            "performance_class": self.performance,
            "half_window": self.half,
        }

    @property
    def weights(self) -> npt.NDArray[np.float64]:
        """Weights of the samples -half .. half, their sum 1."""
        k = np.arange(-self.half, self.half + 1)
        if self.performance == "P":
            w = 1.0 - np.abs(k) / (self.half + 1)
        else:
            w = np.sinc(4.0 * self.reference_hz * self.sample_s * k) * np.hamming(2 * self.half + 1)
        return np.asarray(w / w.sum())

    def window(self, s: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
        """Return what becomes of a small swing of the phasor at s (1/s), the delay included."""
        rotated = np.exp(-s * self.sample_s)
        return np.asarray(rotated * np.polynomial.polynomial.polyval(rotated, self.weights))

    def frequency(self, s: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
        """Return the transfer function from the bus frequency to the measured one at s, 1/s."""
        return np.asarray(self.window(s) * np.sinc(1j * s * self.sample_s / np.pi))

    def rate(self, s: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
        """Return the transfer function from the angle (rad) to the measured deviation (rad/s) at s, 1/s."""
        return np.asarray(s * self.frequency(s))


def pmu_filter(performance: Performance, nominal_hz: float, rate_hz: float) -> PmuFilter:
    """Return the standard's filter of a class for so many reports a second.

    Raises
    ------
    ValueError : an M class filter for a nominal frequency or a rate that the standard has none for.
    """
    if performance == "P":
        return PmuFilter("P", nominal_hz)
    filter_ = M_FILTERS.get((round(nominal_hz), round(rate_hz)))
    if filter_ is None or abs(rate_hz - round(rate_hz)) > 1e-6 or nominal_hz not in (50, 60):
        allowed = ", ".join(str(rate) for f0, rate in M_FILTERS if f0 == nominal_hz) or "none"
        raise ValueError(
            f"PMU of M class at {nominal_hz:g} Hz with {rate_hz:g} reports a second, allowed: {allowed} "
            "(at 50 and 60 Hz); or P class"
        )
    return PmuFilter("M", nominal_hz, filter_[1] // 2, filter_[0])


def pmu_block(name: str = "pmu", *, capacity: int = 4096, step_s: float = 0.01) -> Block:
    """Return the block of a PMU: inputs ``re``, ``im`` of a bus voltage in the frame of nominal frequency.

    Outputs ``v`` (pu), ``angle`` (rad), ``deviation`` of the frequency (pu of nominal), ``frequency`` (Hz),
    ``rocof`` (Hz/s). Parameters: see `PmuFilter.parameters`.

    Parameters
    ----------
    capacity : communication points that are remembered; the window / step must stay below it.

    Raises
    ------
    ValueError : capacity below 2 or above 1 000 000.
    """
    if not 2 <= capacity <= 1_000_000:
        raise ValueError(f"pmu {name}: capacity is {capacity}, allowed are 2 to 1000000 communication points")
    both = ("re", "im")
    variables = [
        Variable("re", "input", "Real part of the voltage", unit="pu", start=1.0),
        Variable("im", "input", "Imaginary part of the voltage", unit="pu", start=0.0),
        Variable("v", "output", "Magnitude of the voltage", unit="pu", depends_on=both),
        Variable("angle", "output", "Angle at the reported time", unit="rad", depends_on=both),
        Variable("deviation", "output", "Relative frequency deviation", unit="pu", depends_on=both),
        Variable("frequency", "output", "Frequency", unit="Hz", depends_on=both),
        Variable("rocof", "output", "Rate of change of frequency", unit="Hz/s", depends_on=both),
        Variable("nominal_frequency", "parameter", "f0", unit="Hz", start=50.0, min=1.0, max=1000.0),
        Variable("reference_frequency", "parameter", "M class: half of the -6 dB frequency of the filter",
                 unit="Hz", start=7.75, min=1e-3, max=1000.0),
        Variable("performance_class", "parameter", "Class", type="Enumeration", enumeration=PERFORMANCE,
                 start=0),
        Variable("half_window", "parameter", "Samples on each side of the centre; 16 per cycle",
                 type="Integer", start=SAMPLES - 1, min=1, max=512),
    ]  # fmt: skip
    return Block(
        kind="pmu",
        name=name,
        description="Phasor measurement unit: filters of IEC/IEEE 60255-118-1, P and M class",
        table=VariableTable(variables),
        data={"capacity": np.array([capacity], dtype=np.int32)},
        sources=(_FOLDER / "pmu" / "pmu.c", _FOLDER / "channel" / "history.c"),
        step_s=step_s,
        model_exchange=False,
        documentation={"Behaviour": _BEHAVIOUR},
    )


_BEHAVIOUR = (
    "<p>The reference filters of IEC/IEEE 60255-118-1:2018, annex D, on the phasor of a bus: a report is the "
    "weighted mean over 2 <code>half_window</code> + 1 samples, 16 a cycle; frequency and its rate are "
    "differences of the angles of neighbouring samples. It comes out as soon as its window is complete: "
    "(<code>half_window</code> + 1) samples, one cycle in class P, after the instant it is of.</p>"
)
