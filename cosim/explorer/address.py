"""Which address of a page opens a run: the state that is a given scenario, where the page can hold it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any
from urllib.parse import urlencode

from ..scenario.channels import GilbertElliottLoss
from ..scenario.scenario import Scenario
from ..scenario.signal_paths import ChannelTable
from .content import PULSES, RANGES, VERSION, state_of
from .subject import Subject

#: keys of a scenario that an address sets, or that change no number of a run
_SET = {"controller", "controller_gain", "controller_limit_pu", "channels", "event", "operating_point"}
_WORDS = {"title", "source", "name", "folder", "expect", "rounded", "master"}
_TIMES = ("at", "end")  #: of the event: in a state, but not in an address
_OF_CHANNELS = {
    *("latency_s", "jitter_s", "reporting_interval_s", "seed", "on_loss", "hold_s", "outages_s", "loss")
}


def link_of(state: Mapping[str, Any]) -> str:
    """Return the part of an address that opens a page in a state (keys and units of its labels).

    >>> link_of({"k": "ftc", "remote.latency": 450.0})
    '#v=1&k=ftc&remote.latency=450'
    """
    texts = {key: f"{x:.15g}" if isinstance(x, int | float) else str(x) for key, x in state.items()}
    return "#" + urlencode({"v": VERSION, **texts})


def address_of(subject: Subject, scenario: Scenario) -> str | None:
    """Return the address that opens the page of `subject` as `scenario`; None where no state is that.

    scenario : of the same case; its operating point one that the page has prepared.
    """
    base = subject.scenario
    if _rest(scenario) != _rest(base) or not _same_channels(base.channels, scenario.channels):
        return None
    state, start = state_of(replace(subject, scenario=scenario)), state_of(subject)
    point = scenario.operating_point.model_dump(exclude_defaults=True)
    places = [k for k, p in enumerate(subject.points) if dict(p.changes) == point]
    if not places or state["k"] not in {"none", *subject.controllers} or not _same_event(base, scenario):
        return None
    nothing = {"loss": 0.0, "burst": 1.0, "lost": base.stop_s, "back": base.stop_s}
    absent = {key: nothing.get(key.partition(".")[2]) for key in start.keys() - state.keys()}
    requested = {"op": places[0], **absent, **state}
    differs = {k: v for k, v in requested.items() if k not in _TIMES and v != start.get(k, 0)}
    return link_of(differs) if all(_within(k, v) for k, v in differs.items()) else None


def _rest(scenario: Scenario) -> dict[str, Any]:
    return scenario.model_dump(exclude=_SET | _WORDS)


def _same_channels(base: Mapping[str, ChannelTable], other: Mapping[str, ChannelTable]) -> bool:
    """Whether channels differ in what an address can say alone."""
    if base.keys() != other.keys():
        return False
    return all(
        base[n].model_dump(exclude=_OF_CHANNELS) == c.model_dump(exclude=_OF_CHANNELS)
        and len(c.outages_s) <= 1 >= len(base[n].outages_s)
        and (not isinstance(c.loss, GilbertElliottLoss) or (c.loss.loss_good, c.loss.loss_bad) == (0.0, 1.0))
        for n, c in other.items()
    )


def _same_event(base: Scenario, other: Scenario) -> bool:
    """Whether events differ at most in what an address can say: machine and size of one pulse."""
    one = len(base.event) == len(other.event) == 1 and {e.kind for e in base.event + other.event} <= PULSES
    if not one:
        return base.event == other.event
    a, b = base.event[0], other.event[0]
    return bool((a.start_s, a.end_s) == (b.start_s, b.end_s))


def _within(key: str, value: Any) -> bool:
    range_ = RANGES.get(key.rpartition(".")[2])
    return value is not None and (range_ is None or range_[0] <= value <= range_[1])
