"""A scenario: what is run, through which channels, and what happens when.

A scenario file is TOML:

    case = "two-area-thesis"           # bundled name or file
    controller = "ftc"                 # none | wdc | cc | ftc | a controller file
    stop_s = 20.0
    step_s = 0.01                      # optional
    [channels.remote]
    signal = "G2_dw"                   # plant output -> controller input of the same name
    latency_s = 0.1
    on_loss = "zero"                   # zero | hold | hold_then_zero (for hold_s)
    outages_s = [[10.0, 20.0]]
    [[event]]                          # interarea.models.events
    kind = "vref_pulse"
    machine = "G1"
    size_pu = 0.05
    start_s = 1.0
    end_s = 1.2

A channel takes besides: reporting_interval_s (packets; needed by what follows), jitter_s (uniform),
latency = {kind = "gamma", shape, scale_s} | {kind = "empirical", quantiles_s} on top of latency_s,
loss = {kind = "bernoulli", rate} | {kind = "gilbert_elliott", good_to_bad, bad_to_good, loss_good, loss_bad},
pdc_wait_s, seed; and, with or without packets, quantum.

Optional besides: `title`, `source`, `[master]` (inputs, loops, tolerance) and `[expect]`, the outcome that
the gallery states and the tests assert. A signal without a channel reaches the controller undelayed.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from interarea.design.shipped import shipped_names
from interarea.models.case_errors import CaseError
from interarea.models.events import events_of

from .clock import to_ticks
from .errors import ScenarioError, nearest
from .master import Inputs, Loops

BUNDLED = Path(__file__).parent / "scenarios"
NAMED_CONTROLLERS = ("none", "wdc", "cc", "ftc", *shipped_names())
_RESERVED = ("plant", "controller")
Seconds = Annotated[float, Field(ge=0.0)]
Probability = Annotated[float, Field(ge=0.0, le=1.0)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class GammaLatency(_Table):
    """A random latency on top of `latency_s`, gamma distributed with mean shape * scale_s."""

    kind: Literal["gamma"]
    shape: Annotated[float, Field(gt=0.0)]
    scale_s: Annotated[float, Field(gt=0.0)]


class EmpiricalLatency(_Table):
    """A random latency on top of `latency_s`: quantiles at equally spaced probabilities 0 to 1."""

    kind: Literal["empirical"]
    quantiles_s: Annotated[tuple[Seconds, ...], Field(min_length=2)]

    @field_validator("quantiles_s")
    @classmethod
    def _ascending(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if list(value) != sorted(value):
            raise ValueError(f"quantiles_s = {list(value)}, allowed: not descending")
        return value


class BernoulliLoss(_Table):
    """Each packet is lost with probability `rate`."""

    kind: Literal["bernoulli"]
    rate: Probability


class GilbertElliottLoss(_Table):
    """Loss in a good and a bad state; moves between them once per packet."""

    kind: Literal["gilbert_elliott"]
    good_to_bad: Probability
    bad_to_good: Annotated[float, Field(gt=0.0, le=1.0)]
    loss_good: Probability = 0.0
    loss_bad: Probability = 1.0


class ChannelTable(_Table):
    """One scalar signal on its way from the plant to the controller (semantics: models/channel/channel.h)."""

    signal: Annotated[str, Field(min_length=1)]
    latency_s: Seconds = 0.0
    on_loss: Literal["zero", "hold", "hold_then_zero"] = "zero"
    hold_s: Seconds = 1.0
    reporting_interval_s: Seconds = 0.0
    jitter_s: Seconds = 0.0
    latency: Annotated[GammaLatency | EmpiricalLatency, Field(discriminator="kind")] | None = None
    loss: Annotated[BernoulliLoss | GilbertElliottLoss, Field(discriminator="kind")] | None = None
    quantum: Seconds = 0.0
    pdc_wait_s: Seconds = 0.0
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    outages_s: tuple[tuple[Seconds, Seconds], ...] = ()

    @field_validator("latency_s")
    @classmethod
    def _on_the_clock(cls, value: float) -> float:
        to_ticks(value, "latency_s")
        return value

    @field_validator("reporting_interval_s")
    @classmethod
    def _frame(cls, value: float) -> float:
        if value and not value >= 1e-4:
            raise ValueError(f"reporting_interval_s = {value:g}, allowed: 0 (continuous) or at least 1e-4")
        to_ticks(value, "reporting_interval_s")
        return value

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
            to_ticks(start, "outages_s")
            to_ticks(end, "outages_s")
            last = end
        return self


class MasterTable(_Table):
    """How the master hands inputs over and what it does with loops (see `Master`)."""

    inputs: Inputs = "hermite"
    loops: Loops = "auto"
    tolerance: Annotated[float, Field(gt=0.0, lt=1.0)] = 1e-7


class Expectation(_Table):
    """The stated outcome: `damping_ratio` and `settling_time_s` as [least, most]."""

    stable: bool | None = None
    damping_ratio: Mapping[str, tuple[float, float]] = {}
    settling_time_s: tuple[float, float] | None = None
    peak_dw24: tuple[float, float] | None = None


class Scenario(_Table):
    """A checked scenario; `folder` is where relative file names start."""

    case: Annotated[str, Field(min_length=1)]
    controller: Annotated[str, Field(min_length=1)] = "none"
    stop_s: Annotated[float, Field(gt=0.0)]
    step_s: Annotated[float, Field(gt=0.0)] | None = None
    channels: Mapping[str, ChannelTable] = {}
    event: tuple[Any, ...] = ()
    title: str = ""
    source: str = ""
    master: MasterTable = MasterTable()
    expect: Expectation = Expectation()
    name: str = "scenario"
    folder: Path = Path()

    @model_validator(mode="after")
    def _fits(self) -> Self:
        to_ticks(self.stop_s, "stop_s")
        if self.step_s is not None:
            to_ticks(self.step_s, "step_s")
            if not self.step_s <= self.stop_s:
                raise ValueError(f"step_s = {self.step_s:g}, allowed: at most stop_s = {self.stop_s:g}")
        for k, e in enumerate(self.event, start=1):
            for key in ("start_s", "end_s"):
                at = getattr(e, key, None)
                if at is None:
                    continue
                to_ticks(at, f"event {k} ({e.kind}): {key}")
                if key == "start_s" and not at < self.stop_s:
                    raise ValueError(
                        f"event {k} ({e.kind}): start_s = {at:g} lies outside the run, "
                        f"allowed: 0 to {self.stop_s:g}"
                    )
        signals: dict[str, str] = {}
        for name, channel in self.channels.items():
            if not name.isidentifier() or name in _RESERVED:
                raise ValueError(
                    f"channels.{name}: a channel's name is an identifier other than {' and '.join(_RESERVED)}"
                )
            if channel.signal in signals:
                raise ValueError(
                    f"channels.{name}: signal = {channel.signal!r} already travels through "
                    f"channels.{signals[channel.signal]}, allowed: one channel for each signal"
                )
            signals[channel.signal] = name
            for start, _ in channel.outages_s:
                if not start < self.stop_s:
                    raise ValueError(
                        f"channels.{name}: an outage starts at {start:g} s, outside the run, "
                        f"allowed: 0 to {self.stop_s:g}"
                    )
        return self

    @property
    def marks_s(self) -> tuple[float, ...]:
        """Instants of events and outages inside the run."""
        times = [t for e in self.event for t in (e.start_s, getattr(e, "end_s", None)) if t is not None]
        times += [t for c in self.channels.values() for window in c.outages_s for t in window]
        return tuple(sorted({t for t in times if 0.0 < t < self.stop_s}))

    @property
    def case_path(self) -> str | Path:
        """The case as `load_case` takes it: a bundled name, or a file beside the scenario."""
        return _beside(self.folder, self.case)

    @property
    def controller_path(self) -> Path | None:
        """The controller file, or None for a named controller."""
        if self.controller in NAMED_CONTROLLERS:
            return None
        return Path(_beside(self.folder, self.controller))


def _beside(folder: Path, name: str) -> str | Path:
    if "/" in name or "\\" in name or Path(name).suffix:
        return folder / name
    return name


def load_scenario(source: str | Path | Mapping[str, Any] | Scenario) -> Scenario:
    """Return the scenario of a TOML file, a bundled name, or a dict of the same keys.

    Raises
    ------
    ScenarioError : one line with file, key, value and what is allowed.
    """
    if isinstance(source, Scenario):
        return source
    if isinstance(source, Mapping):
        return _checked(dict(source), "scenario", Path())
    path = Path(source)
    if not path.suffix and not path.exists():
        path = BUNDLED / f"{path.name}.toml"
        if not path.is_file():
            raise ScenarioError(
                f"scenario {str(source)!r} is neither a file nor bundled; "
                f"{nearest(str(source), scenario_names())}"
            )
    if not path.is_file():
        raise ScenarioError(f"{path}: no such scenario file")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path.name}: is no TOML: {error}") from None
    return _checked({"name": path.stem, **table}, path.name, path.parent)


def scenario_names() -> list[str]:
    """Return the names of the bundled scenarios."""
    return sorted(p.stem for p in BUNDLED.glob("*.toml"))


def _checked(table: dict[str, Any], where: str, folder: Path) -> Scenario:
    try:
        tables = table.get("event", [])
        if not isinstance(tables, list | tuple):
            raise ScenarioError(f"{where}: event = {tables!r}, allowed: [[event]] tables")
        plain = [e for e in tables if isinstance(e, Mapping)]
        events = events_of(plain, where=where) if len(plain) == len(tables) else tuple(tables)
        return Scenario.model_validate({"folder": folder, **table, "event": events})
    except CaseError as error:
        raise ScenarioError(str(error)) from None
    except ValidationError as error:
        raise ScenarioError(f"{where}: {_one_line(error)}") from None


def _one_line(error: ValidationError) -> str:
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "value_error":
        text = first["msg"].removeprefix("Value error, ")
        return f"{key}: {text}" if key else text
    if first["type"] == "missing":
        return f"{key} is missing"
    if first["type"] == "extra_forbidden":
        return (
            f"{key} = {first['input']!r}: no such key; {nearest(str(first['loc'][-1]), _keys(first['loc']))}"
        )
    if first["type"] == "literal_error":
        return f"{key} = {first['input']!r}, allowed: {first['ctx']['expected']}"
    allowed = first["msg"].removeprefix("Input should be ")
    return f"{key} = {first['input']!r}, allowed: {allowed}"


def _keys(location: tuple[int | str, ...]) -> list[str]:
    """Return the keys allowed where `location` points into the scenario."""
    if len(location) == 1:
        hidden = ("name", "folder")
        return [k for k in Scenario.model_fields if k not in hidden]
    tables: dict[str, type[BaseModel]] = {
        "channels": ChannelTable,
        "master": MasterTable,
        "expect": Expectation,
    }
    table = tables.get(str(location[0]))
    return list(table.model_fields) if table is not None else []
