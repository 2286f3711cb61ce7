"""Faults of a signal that its flag does not show: tables of a scenario and the FMU parameters they become."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from interarea.models.blocks.sizes import REPLAYED, SIGNAL_FAULTS
from interarea.models.table import Table

from ..clock import on_tick

if TYPE_CHECKING:  # tables are checked before what runs them, numpy with it, is loaded
    from ..master.instances import Value

SWAP = "swap"
_NEVER_S = 1e30  # what a window without an end has as one, as an outage of the FMU that is off

Seconds = Annotated[float, Field(ge=0.0)]


class _Fault(Table):
    """Measurements in [start_s, end_s) are wrong (semantics: models/c/channel/signal_fault.h)."""

    start_s: Annotated[Seconds, Field(examples=[2.0])]  #: start of the wrong signal (time of measurement)
    #: end of the wrong signal; default: never
    end_s: Annotated[float, Field(gt=0.0)] | None = Field(default=None, examples=[3.0])

    packets: ClassVar[bool] = False  # whether it acts on packets alone
    seeded: ClassVar[bool] = False  # whether it has random numbers

    @field_validator("start_s", "end_s")
    @classmethod
    def _on_the_clock(cls, value: float | None) -> float | None:
        return None if value is None else on_tick(value, "start_s and end_s")

    @model_validator(mode="after")
    def _window(self) -> Self:
        if self.end_s is not None and not self.end_s > self.start_s:
            raise ValueError(f"end_s = {self.end_s:g}, allowed: above start_s = {self.start_s:g}")
        return self

    @property
    def until_s(self) -> float:
        """The end, far beyond every run where there is none."""
        return _NEVER_S if self.end_s is None else self.end_s

    @property
    def numbers(self) -> tuple[float, float]:
        """Size and detail of the FMU."""
        return 0.0, 0.0


class StuckSignal(_Fault):
    """The signal stays at its value at `start_s`."""

    kind: Literal["stuck"]  #: a constant value


class BiasedSignal(_Fault):
    """`size` is added."""

    kind: Literal["bias"]  #: a constant is added
    size: Annotated[float, Field(examples=[0.003])]  #: in the unit of the signal

    @property
    def numbers(self) -> tuple[float, float]:
        """Size."""
        return self.size, 0.0


class RampedSignal(_Fault):
    """`rate_per_s` is added each second."""

    kind: Literal["ramp"]  #: an offset that grows linearly
    rate_per_s: Annotated[float, Field(examples=[0.001])]  #: in the unit of the signal each second

    @property
    def numbers(self) -> tuple[float, float]:
        """Rate."""
        return self.rate_per_s, 0.0


class DriftingSignal(_Fault):
    """`size` is added, reached with a time constant: size (1 - exp(-(t - start_s) / time_s))."""

    kind: Literal["drift"]  #: an offset that grows towards `size`
    size: Annotated[float, Field(examples=[0.003])]  #: in the unit of the signal
    time_s: Annotated[float, Field(gt=0.0, examples=[2.0])]  #: time constant

    @property
    def numbers(self) -> tuple[float, float]:
        """Size and time constant."""
        return self.size, self.time_s


class ScaledSignal(_Fault):
    """The signal is multiplied by `factor`; 0: it is zero."""

    kind: Literal["scale"]  #: a wrong scale
    factor: float  #: 1: correct

    @property
    def numbers(self) -> tuple[float, float]:
        """Factor."""
        return self.factor, 0.0


class InvertedSignal(_Fault):
    """The signal has the wrong sign."""

    kind: Literal["polarity"]  #: the wrong sign


class NoisySignal(_Fault):
    """Each packet has random noise."""

    kind: Literal["noise"]  #: random noise, independent from packet to packet
    rms: Annotated[float, Field(ge=0.0, examples=[2e-5])]  #: standard deviation in the unit of the signal

    packets: ClassVar[bool] = True
    seeded: ClassVar[bool] = True

    @property
    def numbers(self) -> tuple[float, float]:
        """Standard deviation."""
        return self.rms, 0.0


class SpikedSignal(_Fault):
    """Some packets have a large error, up or down."""

    kind: Literal["spike"]  #: single wrong packets
    size: Annotated[float, Field(examples=[0.01])]  #: their error, in the unit of the signal
    probability: Annotated[float, Field(ge=0.0, le=1.0)] = 0.1  #: of each packet

    packets: ClassVar[bool] = True
    seeded: ClassVar[bool] = True

    @property
    def numbers(self) -> tuple[float, float]:
        """Size and probability."""
        return self.size, self.probability


class ReplayedSignal(_Fault):
    """The packets of the last `length_s` before the start are sent repeatedly, with new stamps."""

    kind: Literal["replay"]  #: repeated old packets
    length_s: Annotated[float, Field(gt=0.0, examples=[1.5])]  #: length of the repeated interval

    packets: ClassVar[bool] = True

    @model_validator(mode="after")
    def _has_been(self) -> Self:
        if not self.length_s <= self.start_s:
            raise ValueError(
                f"length_s = {self.length_s:g}, allowed: at most start_s = {self.start_s:g} (the signal "
                "before it)"
            )
        return self

    @property
    def numbers(self) -> tuple[float, float]:
        """Length."""
        return self.length_s, 0.0


class MistimedSignal(_Fault):
    """The clock of the source is wrong: values are older than their stamps."""

    kind: Literal["time_error"]  #: a wrong time stamp
    offset_s: Annotated[Seconds, Field(examples=[0.3])]  #: age of a value minus that of its time stamp
    drift_s_per_s: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0  #: its growth per second

    @property
    def numbers(self) -> tuple[float, float]:
        """Offset and drift."""
        return self.offset_s, self.drift_s_per_s


class OscillatingSignal(_Fault):
    """A sine is added."""

    kind: Literal["oscillating"]  #: a sine is added
    amplitude: Annotated[float, Field(examples=[0.001])]  #: in the unit of the signal
    frequency_hz: Annotated[float, Field(gt=0.0, examples=[0.55])]  #: such as that of the mode

    @property
    def numbers(self) -> tuple[float, float]:
        """Amplitude and frequency."""
        return self.amplitude, self.frequency_hz


class SwappedSignal(_Fault):
    """Another signal of the same concentrator is sent instead."""

    kind: Literal["swap"]  #: another signal instead
    other: Annotated[int, Field(ge=1, examples=[2])]  #: number of that signal in the concentrator, from 1

    packets: ClassVar[bool] = True

    @property
    def numbers(self) -> tuple[float, float]:
        """Number of the other."""
        return float(self.other), 0.0


SignalFault = Annotated[
    StuckSignal
    | BiasedSignal
    | RampedSignal
    | DriftingSignal
    | ScaledSignal
    | InvertedSignal
    | NoisySignal
    | SpikedSignal
    | ReplayedSignal
    | MistimedSignal
    | OscillatingSignal
    | SwappedSignal,
    Field(discriminator="kind"),
]


def wrong_kinds(rated_hz: float, mode_hz: float) -> dict[str, dict[str, Any]]:
    """Return what is wrong in words -> its table of `signal_faults`, without start: twelve kinds, some twice.

    rated_hz : of the grid; signals are speeds in pu. mode_hz : of its inter-area swing.
    """
    return {
        "stuck": {"kind": "stuck"},
        "zero": {"kind": "scale", "factor": 0.0},
        "times 3": {"kind": "scale", "factor": 3.0},
        "times 10": {"kind": "scale", "factor": 10.0},
        "polarity": {"kind": "polarity"},
        "bias of 100 mHz": {"kind": "bias", "size": 0.1 / rated_hz},
        "ramp of 50 mHz/s": {"kind": "ramp", "rate_per_s": 0.05 / rated_hz},
        "drift to 100 mHz": {"kind": "drift", "size": 0.1 / rated_hz, "time_s": 2.0},
        "replay of 1.5 s": {"kind": "replay", "length_s": 1.5},
        "spikes of 500 mHz, 5 %": {"kind": "spike", "size": 0.5 / rated_hz, "probability": 0.05},
        "noise of 10 mHz": {"kind": "noise", "rms": 0.01 / rated_hz},
        "stamp 0.3 s wrong": {"kind": "time_error", "offset_s": 0.3},
        "stamp 0.8 s wrong": {"kind": "time_error", "offset_s": 0.8},
        "sine of 50 mHz at the mode": {
            "kind": "oscillating",
            "amplitude": 0.05 / rated_hz,
            "frequency_hz": round(mode_hz, 2),
        },
        "swapped with another": {"kind": SWAP},
    }


def check_faults(faults: Sequence[SignalFault], interval_s: float, signals: int = 1) -> None:
    """Refuse faults of one signal that cannot be; interval_s : between its packets, 0 where it has none.
    signals : of the concentrator; 1: a channel.

    Raises
    ------
    ValueError : too many, overlapping windows, packets needed but absent, a replay of no number of them.
    """
    if len(faults) > SIGNAL_FAULTS:
        raise ValueError(f"signal_faults has {len(faults)} tables, allowed: at most {SIGNAL_FAULTS}")
    last_s = 0.0
    for fault in faults:
        if not fault.start_s >= last_s:
            before = "the end of the previous one, which has none" if last_s == _NEVER_S else f"{last_s:g} s"
            raise ValueError(
                f"signal_faults: {fault.kind} starts at {fault.start_s:g} s, before {before}, "
                "allowed: in order, no overlap"
            )
        last_s = fault.until_s
        if fault.packets and not interval_s:
            raise ValueError(f"signal_faults: {fault.kind} acts on packets: set reporting_interval_s")
        if isinstance(fault, SwappedSignal) and not fault.other <= signals > 1:
            raise ValueError(
                f"signal_faults: swap with signal {fault.other} of {signals}, allowed: one of a concentrator"
            )
        if isinstance(fault, ReplayedSignal):
            count = fault.length_s / interval_s
            if not (abs(count - round(count)) < 1e-6 and 1 <= round(count) <= REPLAYED):
                raise ValueError(
                    f"signal_faults: a replay of {fault.length_s:g} s with packets every {interval_s:g} s, "
                    f"allowed: a whole number of packets, at most {REPLAYED}"
                )


def fault_parameters(faults: Sequence[SignalFault], signal: str = "") -> dict[str, Value]:
    """Return the parameters ``fault[k].kind`` and so on of a channel's FMU, with `signal` before k."""
    start: dict[str, Value] = {}
    for k, fault in enumerate(faults, start=1):
        size, detail = fault.numbers
        values: dict[str, Value] = {
            "kind": fault.kind,
            "start": fault.start_s,
            "end": fault.until_s,
            "size": size,
            "detail": detail,
        }
        start |= {f"fault[{signal}{k}].{key}": value for key, value in values.items()}
    return start
