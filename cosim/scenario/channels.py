"""One channel of a scenario: its keys, the FMU parameters they become, the arrivals and delays they mean."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal, Protocol, Self

from pydantic import Field, field_validator, model_validator

from interarea.models.blocks.sizes import OUTAGES
from interarea.models.table import Table

from ..clock import TICKS_PER_SECOND, Clock, on_tick, seconds, to_ticks
from ..errors import ScenarioError
from .signal_faults import SignalFault, check_faults, fault_parameters

if TYPE_CHECKING:  # tables are checked before what runs them, numpy with it, is loaded
    from ..master.instances import Value
    from ..participant import Participant


@dataclass(frozen=True)
class Delays:
    """What is known of a channel instance, s: the request, the parts that meet it, and `waiting_s`, how long
    an arrival waits for the next communication point on average; of a PMU its group delay `measuring_s`."""

    requested_s: float
    network_s: float
    reporting_s: float = 0.0
    jitter_mean_s: float = 0.0
    waiting_s: float = 0.0
    seed: int | None = None  #: of the random numbers, where anything is random
    measuring_s: float = 0.0

    def seed_of(self, name: str) -> str:
        """Return in words which random numbers channel `name` takes, "" where nothing is random."""
        if self.seed is None:
            return ""
        return f"seed {self.seed}{', derived from its name' if self.seed == derived_seed(0, name) else ''}"


def derived_seed(seed: int, name: str) -> int:
    """Return the seed of channel `name` in a run with `seed`: 31 bits, different for each channel.

    A channel whose table gives no seed has that of seed 0, so that no two channels lose the same packets.
    """
    return int.from_bytes(hashlib.sha256(f"{seed}/{name}".encode()).digest()[:4], "little") % 2**31


Seconds = Annotated[float, Field(ge=0.0)]
Probability = Annotated[float, Field(ge=0.0, le=1.0)]


class GammaLatency(Table):
    """A random latency on top of `latency_s`, gamma distributed with mean shape * scale_s."""

    kind: Literal["gamma"]  #: a gamma distribution
    shape: Annotated[float, Field(gt=0.0)]  #: its shape
    scale_s: Annotated[float, Field(gt=0.0)]  #: its scale; the mean is shape times scale


class EmpiricalLatency(Table):
    """A random latency on top of `latency_s`: quantiles at equally spaced probabilities 0 to 1."""

    kind: Literal["empirical"]  #: a measured distribution
    #: evenly spaced quantiles from the least to the largest, interpolated linearly
    quantiles_s: Annotated[tuple[Seconds, ...], Field(min_length=2)]

    @field_validator("quantiles_s")
    @classmethod
    def _ascending(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if list(value) != sorted(value):
            raise ValueError(f"quantiles_s = {list(value)}, allowed: not decreasing")
        return value


class BernoulliLoss(Table):
    """Each packet is lost with probability `rate`."""

    kind: Literal["bernoulli"]  #: independent loss of each packet
    rate: Probability  #: share of lost packets


class GilbertElliottLoss(Table):
    """Loss in a good and a bad state; moves between them once per packet."""

    kind: Literal["gilbert_elliott"]  #: losses in bursts: a good and a bad state
    good_to_bad: Probability  #: probability per packet
    bad_to_good: Annotated[float, Field(gt=0.0, le=1.0)]  #: probability per packet
    loss_good: Probability = 0.0  #: share lost in the good state
    loss_bad: Probability = 1.0  #: share lost in the bad state


class ChannelLine(Table):
    """How a channel delays and loses what is sent (semantics: models/c/channel/channel_variables.h)."""

    latency_s: Seconds = 0.0  #: delay of the signal; exact to a nanosecond
    #: value while the signal is lost: zero, the last value, or the last value for `hold_s`
    on_loss: Literal["zero", "hold", "hold_then_zero"] = "hold_then_zero"
    hold_s: Seconds = 0.5  #: hold time of `hold_then_zero`
    reporting_interval_s: Seconds = 0.0  #: time between packets; 0: a continuous signal without packets
    jitter_s: Seconds = 0.0  #: additional delay of each packet, uniform from 0 to this
    #: random latency of each packet on top of `latency_s`
    latency: Annotated[GammaLatency | EmpiricalLatency, Field(discriminator="kind")] | None = None
    #: random loss of packets; a number is the share of independent losses
    loss: Annotated[BernoulliLoss | GilbertElliottLoss, Field(discriminator="kind")] | None = None
    quantum: Seconds = 0.0  #: values are rounded to multiples of this; 0: not rounded
    pdc_wait_s: Seconds = 0.0  #: a packet is forwarded this long after its time stamp, or discarded
    #: of the packets' random numbers; default: derived from the channel's name, so that channels differ
    seed: Annotated[int, Field(ge=0, lt=2**31)] | None = None
    outages_s: tuple[tuple[Seconds, Seconds], ...] = ()  #: [from, to] intervals in which the signal is lost
    #: wrong signals that are flagged as valid, in order of time, at most 4
    signal_faults: tuple[SignalFault, ...] = ()

    @field_validator("loss", mode="before")
    @classmethod
    def _share_lost(cls, value: object) -> object:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if (number and not 0.0 <= value <= 1.0) or isinstance(value, str):  # type: ignore[operator]
            raise ValueError(f"loss = {value!r}, allowed: a share from 0 to 1 (10 % are 0.1), or a table")
        return {"kind": "bernoulli", "rate": float(value)} if number else value  # type: ignore[arg-type]

    @field_validator("latency_s")
    @classmethod
    def _on_the_clock(cls, value: float) -> float:
        return on_tick(value, "latency_s")

    @field_validator("reporting_interval_s")
    @classmethod
    def _frame(cls, value: float) -> float:
        if value and not value >= 1e-4:
            raise ValueError(f"reporting_interval_s = {value:g}, allowed: 0 (continuous) or at least 1e-4")
        return value

    @field_validator("outages_s")
    @classmethod
    def _windows_on_the_clock(cls, value: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        return tuple((on_tick(start, "outages_s"), on_tick(end, "outages_s")) for start, end in value)

    @model_validator(mode="after")
    def _packets(self) -> Self:
        if not self.reporting_interval_s:
            for key in ("jitter_s", "latency", "loss", "pdc_wait_s"):
                if getattr(self, key):
                    raise ValueError(f"{key} acts on packets: set reporting_interval_s")
        return self

    @model_validator(mode="after")
    def _outages(self) -> Self:
        last = 0.0
        for start, end in self.outages_s:
            if not end > start:
                raise ValueError(f"outages_s has [{start:g}, {end:g}], allowed: end > start")
            if not start >= last:
                raise ValueError(
                    f"outages_s has [{start:g}, {end:g}] before {last:g}, allowed: in order, no overlap"
                )
            last = end
        return self

    @model_validator(mode="after")
    def _faults(self) -> Self:
        check_faults(self.signal_faults, self.reporting_interval_s)
        return self

    def parameters(self, where: str) -> dict[str, Value]:
        """Return the parameters of a channel's FMU.

        Raises
        ------
        ScenarioError : more outages than a channel has windows; `where` names it.
        """
        if len(self.outages_s) > OUTAGES:
            raise ScenarioError(
                f"{where}.outages_s has {len(self.outages_s)} windows, allowed: at most {OUTAGES}"
            )
        start: dict[str, Value] = {
            "latency": self.latency_s,
            "on_loss": self.on_loss,
            "hold_time": self.hold_s,
            "reporting_interval": self.reporting_interval_s,
            "jitter": self.jitter_s,
            "quantum": self.quantum,
            "pdc_wait": self.pdc_wait_s,
            "seed": self.seed or 0,
        }
        start |= self._quantiles()
        if isinstance(self.loss, BernoulliLoss):
            start["loss_good"] = self.loss.rate
        elif self.loss is not None:
            chances = ("loss_good", "loss_bad", "good_to_bad", "bad_to_good")
            start |= {key: getattr(self.loss, key) for key in chances}
        for k, (begin, end) in enumerate(self.outages_s, start=1):
            start |= {f"outage[{k}].start": begin, f"outage[{k}].end": end}
        return start | fault_parameters(self.signal_faults)

    def _quantiles(self) -> dict[str, float]:
        from interarea.models.blocks.channel import gamma_quantiles, quantiles_of

        if isinstance(self.latency, GammaLatency):
            return gamma_quantiles(self.latency.shape, self.latency.scale_s)
        return {} if self.latency is None else quantiles_of(self.latency.quantiles_s)

    @property
    def least_latency_s(self) -> float:
        """The least time from input to output, s: what the step and the stepping order can rely on."""
        return max(self.latency_s, self.pdc_wait_s)

    @property
    def event_times_s(self) -> tuple[float, ...]:
        """Instants at which the output may jump, packets aside: outages, the end of holding in one,
        faults of the signal."""
        event_times = {t for window in self.outages_s for t in window}
        if self.on_loss == "hold_then_zero":
            event_times |= {start + self.hold_s for start, end in self.outages_s if start + self.hold_s < end}
        if not self.reporting_interval_s:
            ends = {t for f in self.signal_faults for t in (f.start_s, f.end_s) if t is not None}
            event_times |= {t + self.latency_s for t in ends}
        return tuple(sorted(event_times))

    def arrivals(self, start_s: float, stop_s: float) -> list[int]:
        """Return the ticks at which a packet comes out or is missed, or what is held for it ends."""
        if not self.reporting_interval_s:
            return []
        import numpy as np

        from interarea.models.blocks.packet_schedule import packets_of

        numbers = {k: float(v) for k, v in self.parameters("channel").items() if not isinstance(v, str)}
        packets = packets_of(numbers, start_s, stop_s)
        due = packets.due_s
        if self.on_loss == "hold_then_zero":
            due = np.concatenate([due, packets.due_s[packets.lost] + self.hold_s])
        scaled = due[(due > start_s) & (due < stop_s)] * TICKS_PER_SECOND
        near = np.round(scaled)
        # rounding of k T + latency is far below a tick: such an instant is that tick, others the next
        return sorted({int(t) for t in np.where(np.abs(scaled - near) < 0.05, near, np.ceil(scaled))})

    @property
    def timing(self) -> tuple[object, ...]:
        """All of this channel that a master's clock and order depend on."""
        return (self.least_latency_s, self if self.reporting_interval_s else None)

    @property
    def steady(self) -> Self:
        """The same channel with nothing random, nothing lost, nothing rounded and nothing wrong."""
        off = {"jitter_s": 0.0, "latency": None, "loss": None, "quantum": 0.0, "outages_s": ()}
        return self.model_copy(update={**off, "signal_faults": ()})

    @property
    def random(self) -> bool:
        """Whether anything depends on the seed."""
        lost = self.loss is not None and any(x for x in dict(self.loss).values() if isinstance(x, float))
        wrong = any(fault.seeded for fault in self.signal_faults)
        return bool(self.jitter_s) or self.latency is not None or lost or wrong

    def seeded(self, name: str) -> Self:
        """Return this channel with the seed it has under `name`, where anything is random."""
        if self.seed is not None or not self.random:
            return self
        return self.model_copy(update={"seed": derived_seed(0, name)})

    def delays(self, clock: Clock | None = None) -> Delays:
        """Return what the ledger states about this channel; with the `clock` of a run what arrivals wait too.

        Packets add half a reporting interval, the mean age of a value that is held until the next, and
        the mean of the random latency; a concentrator that waits takes that mean into its wait.
        """
        table = list(self._quantiles().values())
        mean = 0.0
        if table:
            import numpy as np

            mean = float(np.trapezoid(table, dx=1.0 / (len(table) - 1)))
        return Delays(
            requested_s=self.least_latency_s,
            network_s=self.least_latency_s,
            reporting_s=0.5 * self.reporting_interval_s,
            jitter_mean_s=0.0 if self.pdc_wait_s else 0.5 * self.jitter_s + mean,
            waiting_s=0.0 if clock is None else self._waiting_s(clock),
            seed=self.seed if self.random else None,
        )

    def _waiting_s(self, clock: Clock) -> float:
        import numpy as np

        due = np.array(self.arrivals(seconds(clock.start), seconds(clock.stop)))
        ends = np.array(clock.steps.ends)
        if not due.size:
            return 0.0
        interval = to_ticks(self.reporting_interval_s, "reporting_interval_s")
        pattern = math.lcm(interval, clock.step) // interval  # packets after which the waits repeat
        due = due[: max(pattern * (due.size // pattern), 1)] if pattern <= due.size else due
        waits = ends[np.searchsorted(ends, due)] - due
        return float(np.mean(waits)) / TICKS_PER_SECOND


class Reporting(Protocol):
    """Anything that sends packets when its reporting interval is positive."""

    @property
    def reporting_interval_s(self) -> float: ...


def hold_packets(participant: Participant, line: Reporting) -> Participant:
    """Make the outputs of a channel's instance discrete when it sends packets, and continuous when not.

    Between two arrivals the output of such a channel stays what it is: held, never drawn as a line.
    """
    outputs = tuple(
        replace(p, discrete=p.type != "Real" or line.reporting_interval_s > 0.0)
        for p in participant.description.outputs
    )
    participant.description = replace(participant.description, outputs=outputs)
    return participant


class Arriving(Protocol):
    """What delays signals."""

    def arrivals(self, start_s: float, stop_s: float) -> list[int]: ...


def points_of(lines: Iterable[Arriving], arrivals: str, start_s: float, stop_s: float) -> tuple[int, ...]:
    """Return the ticks that are communication points because a packet comes out of a channel."""
    if arrivals == "grid":
        return ()
    return tuple(sorted({t for line in lines for t in line.arrivals(start_s, stop_s)}))
