"""Which address of a page opens a run: the state that is a given scenario, where the page can hold it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any
from urllib.parse import urlencode

from ..scenario.channels import GilbertElliottLoss
from ..scenario.scenario import ChannelTable, Scenario
from .content import RANGES, VERSION, state_of
from .subject import Subject

#: keys of a scenario that an address sets, or that change no number of a run
_SET = {"controller", "controller_gain", "controller_limit_pu", "channels", "event", "operating_point"}
_WORDS = {"title", "source", "name", "folder", "expect", "rounded", "master"}
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
    if _rest(scenario) != _rest(base) or not _same_ways(base.channels, scenario.channels):
        return None
    state, start = state_of(replace(subject, scenario=scenario)), state_of(subject)
    point = scenario.operating_point.model_dump(exclude_defaults=True)
    places = [k for k, p in enumerate(subject.points) if dict(p.changes) == point]
    if not places or state["k"] not in {"none", *subject.controllers}:
        return None
    if any(state.get(key) != start.get(key) for key in ("at", "end")) or (
        state["ev"] == "given" and scenario.event != base.event
    ):
        return None
    nothing = {"loss": 0.0, "burst": 1.0, "lost": base.stop_s, "back": base.stop_s}
    for key in start.keys() - state.keys():
        if key.partition(".")[2] not in nothing:
            return None
        state[key] = nothing[key.partition(".")[2]]
    state["op"] = places[0]
    differs = {k: v for k, v in state.items() if k not in ("at", "end") and v != start.get(k, 0)}
    return link_of(differs) if all(_within(k, v) for k, v in differs.items()) else None


def _rest(scenario: Scenario) -> dict[str, Any]:
    return scenario.model_dump(exclude=_SET | _WORDS)


def _same_ways(base: Mapping[str, ChannelTable], other: Mapping[str, ChannelTable]) -> bool:
    """Whether channels differ in what an address can say alone."""
    if base.keys() != other.keys():
        return False
    return all(
        base[n].model_dump(exclude=_OF_CHANNELS) == c.model_dump(exclude=_OF_CHANNELS)
        and len(c.outages_s) <= 1 >= len(base[n].outages_s)
        and (not isinstance(c.loss, GilbertElliottLoss) or (c.loss.loss_good, c.loss.loss_bad) == (0.0, 1.0))
        for n, c in other.items()
    )


def _within(key: str, value: Any) -> bool:
    range_ = RANGES.get(key.rpartition(".")[2])
    return range_ is None or range_[0] <= value <= range_[1]
