"""The paths of a scenario's signals to the controller: channels, concentrators, PMUs before them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from interarea.models.blocks.sizes import MOST_SIGNALS
from interarea.models.table import Table

from ..errors import ScenarioError
from .channels import ChannelLine
from .concentrators import ConcentratorLine, PathTable
from .signal_faults import SignalFault, SwappedSignal

if TYPE_CHECKING:  # tables are checked before what runs them, numpy with it, is loaded
    from interarea.models.blocks.pmu import PmuFilter

_OUTPUTS = {"frequency": "deviation", "rocof": "rocof", "v": "v", "angle": "angle"}


class PmuTable(Table):
    """A phasor measurement unit (IEC/IEEE 60255-118-1) at a bus, instead of an output of the plant."""

    bus: Annotated[int, Field(strict=True, ge=1)]  #: number of the bus that it measures
    performance: Literal["P", "M"] = "P"  #: class: P is quick, M filters for the reporting rate
    #: input of the controller: frequency (deviation in pu of nominal), rocof (Hz/s), v (pu), angle (rad)
    quantity: Literal["frequency", "rocof", "v", "angle"] = "frequency"
    #: of the M class filter; default: the packets of its channel, else one each cycle
    reporting_rate_hz: Annotated[float, Field(gt=0.0)] | None = None

    @property
    def inputs(self) -> tuple[tuple[str, str], ...]:
        """Output of the plant and input of the PMU that take it."""
        return (f"bus{self.bus}.re", "re"), (f"bus{self.bus}.im", "im")

    @property
    def output(self) -> str:
        """Output of the PMU that travels to the controller."""
        return _OUTPUTS[self.quantity]

    def filter(self, nominal_hz: float, interval_s: float, where: str) -> PmuFilter:
        """Return its filter on a grid of this frequency, before packets so far apart (0: no packets).

        Raises
        ------
        ScenarioError : an M class filter for a rate that the standard has none for; `where` names it.
        """
        from interarea.models.blocks.pmu import pmu_filter

        rate = self.reporting_rate_hz or (1.0 / interval_s if interval_s else nominal_hz)
        try:
            return pmu_filter(self.performance, nominal_hz, rate)
        except ValueError as error:
            raise ScenarioError(f"{where}: {error}; set reporting_rate_hz") from None


class _Measured(Table):
    """What may have a PMU: it needs the name of the controller's input that it feeds."""

    #: output of the plant that travels to the controller's input of that name; with `pmu` that input
    signal: str = ""
    pmu: PmuTable | None = None  #: measures a bus instead of an output of the plant

    @model_validator(mode="after")
    def _named(self) -> Self:
        if self.pmu is not None and not self.signal:
            raise ValueError("pmu needs signal = the controller's input that it feeds")
        return self


class ChannelTable(ChannelLine, _Measured):
    """A channel: `signal` travels from the plant to the controller's input of that name; without it the
    channel is connected by `connections`."""


class SignalTable(PathTable, _Measured):
    """The path of one signal to a concentrator; `signal` travels from the plant to the controller on it."""


class ConcentratorTable(ConcentratorLine):
    """A concentrator: signals without a name are connected by `connections` (NAME.u1 .., NAME.y1 ..)."""

    signals: Annotated[tuple[SignalTable, ...], Field(min_length=1, max_length=MOST_SIGNALS)]

    @model_validator(mode="after")
    def _swaps(self) -> Self:
        for own in self.signals:
            for fault in own.signal_faults:
                if not isinstance(fault, SwappedSignal):
                    continue
                other = self.signals[fault.other - 1]
                kinds = {_quantity(s) for s in (own, other) if s.signal}
                if len(kinds) > 1:
                    raise ValueError(
                        f"signal_faults: swap of {own.signal} with {other.signal}, of another quantity, "
                        "allowed: signals of one quantity, such as two speeds"
                    )
        return self


def _quantity(s: SignalTable) -> str:
    """Return what a signal is of: a speed and a frequency are one."""
    quantity = s.signal.rpartition("_")[2] if s.pmu is None else s.pmu.quantity
    return {"dw": "frequency"}.get(quantity, quantity)


class SignalPath(NamedTuple):
    """The path of a signal: its name, input, output and flag of its channel, and the PMU before it."""

    signal: str
    u: str
    y: str
    valid: str
    pmu: PmuTable | None
    interval_s: float  #: between packets
    quantum: float = 0.0  #: of which values are multiples

    @property
    def age(self) -> str:
        """Output of its line that says how old the signal is."""
        return f"{self.u.partition('.')[0]}.age"

    @property
    def source(self) -> str:
        """Instance of the PMU, "" where the signal is an output of the plant."""
        return "" if self.pmu is None else self.u.replace(".u", "_pmu")


def signal_faults_of(
    channels: Mapping[str, ChannelTable], concentrators: Mapping[str, ConcentratorTable]
) -> dict[str, tuple[SignalFault, ...]]:
    """Return the faults of each signal, by where they are written."""
    faults = {f"channels.{name}": c.signal_faults for name, c in channels.items()}
    for name, table in concentrators.items():
        for i, s in enumerate(table.signals, start=1):
            faults[f"concentrators.{name}.signals {i}"] = s.signal_faults
    return faults


def signal_paths_of(
    channels: Mapping[str, ChannelTable], concentrators: Mapping[str, ConcentratorTable]
) -> Iterator[SignalPath]:
    """Yield the path of each signal that is named; the others are connected by hand."""
    for name, c in channels.items():
        if c.signal:
            ends = (f"{name}.u", f"{name}.y", f"{name}.valid")
            yield SignalPath(c.signal, *ends, c.pmu, c.reporting_interval_s, c.quantum)
    for name, table in concentrators.items():
        for i, s in enumerate(table.signals, start=1):
            if s.signal:
                ends = (f"{name}.u{i}", f"{name}.y{i}", f"{name}.valid{i}")
                yield SignalPath(s.signal, *ends, s.pmu, table.reporting_interval_s)
