"""A concentrator of a system: its keys, the FMU parameters they become, the arrivals and delays they mean."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from interarea.models.blocks.sizes import MOST_SIGNALS
from interarea.models.table import Table

from ..clock import TICKS_PER_SECOND, Clock, on_tick, seconds
from ..errors import ScenarioError
from .channels import ChannelLine, Delays, Probability, Seconds, derived_seed
from .signal_faults import SignalFault, check_faults, fault_parameters

if TYPE_CHECKING:  # tables are checked before what runs them, numpy with it, is loaded
    from interarea.models.blocks.concentrator import FrameSets

    from ..master.instances import Value


class PathTable(Table):
    """How one signal gets to the concentrator; `lost_s`: stamps in [start, end) never do."""

    latency_s: Seconds = 0.0  #: from the source to the concentrator
    jitter_s: Seconds = 0.0  #: additional delay of each packet, uniform from 0 to this
    loss: Probability = 0.0  #: share of lost packets
    lost_s: tuple[Seconds, Seconds] | None = None  #: [from, to]: lost in between
    #: wrong signals that are flagged as valid, in order of time, at most 4
    signal_faults: tuple[SignalFault, ...] = ()


class ConcentratorLine(Table):
    """Several signals aligned by time stamp (semantics: models/c/concentrator/concentrator.h)."""

    #: the aligned signals, a table each
    signals: Annotated[tuple[PathTable, ...], Field(min_length=1, max_length=MOST_SIGNALS)]
    reporting_interval_s: Annotated[float, Field(ge=1e-4)] = 0.02  #: time between the sets
    wait_s: Seconds = 0.1  #: longest wait for a set
    relative: bool = False  #: wait from the first arrival of a set on, not from its time stamp
    latency_s: Seconds = 0.0  #: from the concentrator to the controller
    #: value of a missing signal: zero, its last value, or the last value for `hold_s`
    on_loss: Literal["zero", "hold", "hold_then_zero"] = "hold_then_zero"
    hold_s: Seconds = 0.5  #: hold time of `hold_then_zero`
    #: of the random numbers; default: derived from the concentrator's name
    seed: Annotated[int, Field(ge=0, lt=2**31)] | None = None

    @field_validator("latency_s", "wait_s")
    @classmethod
    def _on_the_clock(cls, value: float) -> float:
        return on_tick(value, "latency_s and wait_s")

    @model_validator(mode="after")
    def _windows(self) -> Self:
        for s in self.signals:
            check_faults(s.signal_faults, self.reporting_interval_s, len(self.signals))
            if s.lost_s is not None and not s.lost_s[1] > s.lost_s[0]:
                raise ValueError(f"lost_s has {list(s.lost_s)}, allowed: end > start")
        return self

    def parameters(self, where: str) -> dict[str, Value]:
        """Return the parameters of the FMU; `where` would name a mistake, of which there is none left."""
        start: dict[str, Value] = {
            "reporting_interval": self.reporting_interval_s,
            "wait": self.wait_s,
            "latency": self.latency_s,
            "hold_time": self.hold_s,
            "relative": int(self.relative),
            "on_loss": self.on_loss,
            "seed": self.seed or 0,
        }
        for i, s in enumerate(self.signals, start=1):
            start |= {f"latency[{i}]": s.latency_s, f"jitter[{i}]": s.jitter_s, f"loss[{i}]": s.loss}
            if s.lost_s is not None:
                start |= {f"lost[{i}].start": s.lost_s[0], f"lost[{i}].end": s.lost_s[1]}
            start |= fault_parameters(s.signal_faults, f"{i},")
        return start

    @property
    def least_latency_s(self) -> float:
        """The least time from input to output, s: the slowest signal, or the end of the wait."""
        latencies = [s.latency_s for s in self.signals]
        end = (min(latencies) if self.relative else 0.0) + self.wait_s
        return self.latency_s + min(max(latencies), end)

    @property
    def timing(self) -> tuple[object, ...]:
        """All of it that a master's clock and order depend on."""
        return (self.least_latency_s, self)

    @property
    def event_times_s(self) -> tuple[float, ...]:
        """Instants at which an output may jump, sets aside: none."""
        return ()

    @property
    def steady(self) -> Self:
        """The same concentrator with nothing random, nothing lost and nothing wrong."""
        off = {"jitter_s": 0.0, "loss": 0.0, "lost_s": None, "signal_faults": ()}
        tables = tuple(s.model_copy(update=off) for s in self.signals)
        return self.model_copy(update={"signals": tables})

    @property
    def random(self) -> bool:
        """Whether anything depends on the seed."""
        wrong = any(fault.seeded for s in self.signals for fault in s.signal_faults)
        return wrong or any(s.jitter_s or s.loss for s in self.signals)

    def seeded(self, name: str) -> Self:
        """Return this concentrator with the seed it has under `name`, where anything is random."""
        if self.seed is not None or not self.random:
            return self
        return self.model_copy(update={"seed": derived_seed(0, name)})

    def arrivals(self, start_s: float, stop_s: float) -> list[int]:
        """Return the ticks at which a set comes out, or what is held for a missing signal ends."""
        import numpy as np

        sets = self._sets(start_s, stop_s)
        due = sets.due_s
        if self.on_loss == "hold_then_zero":
            due = np.concatenate([due, due[sets.first_missing] + self.hold_s])
        scaled = due[(due > start_s) & (due < stop_s)] * TICKS_PER_SECOND
        near = np.round(scaled)
        return sorted({int(t) for t in np.where(np.abs(scaled - near) < 0.05, near, np.ceil(scaled))})

    def delays(self, clock: Clock | None = None) -> Delays:
        """Return what the ledger states; with the `clock` of a run the mean over its sets too."""
        import numpy as np

        least = self.least_latency_s
        mean = wait = 0.0
        if clock is not None:
            start_s, stop_s = seconds(clock.start), seconds(clock.stop)
            sets = self._sets(start_s, stop_s)
            if sets.due_s.size:
                mean = max(0.0, float(np.mean(sets.due_s - sets.stamp_s)) - least)
            due = np.array(self.arrivals(start_s, stop_s))
            ends = np.array(clock.steps.ends)
            if due.size:
                wait = float(np.mean(ends[np.searchsorted(ends, due)] - due)) / TICKS_PER_SECOND
        # rounding of a mean over many sets is no jitter
        jitter = mean if mean > 1e-9 else 0.0
        seed = self.seed if self.random else None
        return Delays(least, least, 0.5 * self.reporting_interval_s, jitter, wait, seed)

    def _sets(self, start_s: float, stop_s: float) -> FrameSets:
        from interarea.models.blocks.concentrator import frame_sets

        numbers = {k: float(v) for k, v in self.parameters("").items() if not isinstance(v, str)}
        return frame_sets(numbers, len(self.signals), start_s, stop_s)


def require_effect(lines: Mapping[str, ChannelLine | ConcentratorLine]) -> None:
    """Require that each key that was given changes something. lines : by their place, for the messages.

    Raises
    ------
    ScenarioError : a line for each key without effect.
    """
    idle = []
    for where, line in lines.items():
        if "hold_s" in line.model_fields_set and line.on_loss != "hold_then_zero":
            idle.append(
                f"{where}.hold_s = {line.hold_s:g} has no effect with on_loss = {line.on_loss!r}, "
                "allowed: with 'hold_then_zero'"
            )
        if "seed" in line.model_fields_set and not (line.reporting_interval_s or line.random):
            idle.append(
                f"{where}.seed = {line.seed} has no effect without packets, "
                "allowed: with reporting_interval_s"
            )
    if idle:
        raise ScenarioError(*idle)
