"""Six clicks that tell what delay and loss do to a wide-area loop, as far as they apply to a grid."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from interarea.design.controllers.controller import Controller
from interarea.design.linear.linearise import speeds_in_rad
from interarea.models.case.case import Case

from .subject import Subject

_LATE = 1.1  #: of the delay margin: how late a late signal is
_LATEST_MS = 1000.0  #: of a latency's slider
_LOSS_PERCENT = 20.0
_CLEARING_MS, _CEILING_PU = 400.0, 5.0


def presets_of(subject: Subject, data: dict[str, Any]) -> list[dict[str, Any]]:
    """Return label and state of each preset; a state holds what differs from the page's start.

    Left out: all but the first and the last without a controller; the late signal where no latency makes
    the loop unstable; the lost one where all signals are local; its remedy without a controller made for it.
    """
    quiet = {"op": 0, "g": 1.0, **_undisturbed(subject, data)}
    presets = [{"label": "Left alone", "state": quiet | {"k": "none"}}]
    first = subject.first
    if first is not None:
        calm = _latency(subject, 50.0)
        presets.append({"label": "The wide-area loop", "state": quiet | calm | {"k": first}})
        late = late_ms(subject, first)
        if late is not None:
            presets.append(
                {"label": "A late signal", "state": quiet | _latency(subject, late) | {"k": first}}
            )
        lost = calm | _lost(subject, data, first)
        if lost != calm:
            presets.append({"label": "A lost signal", "state": quiet | lost | {"k": first}})
            tolerant = _tolerant(subject, first)
            if tolerant is not None:
                presets.append({"label": "Made for the loss", "state": quiet | lost | {"k": tolerant}})
                quiet, first = quiet | lost, tolerant
                quiet |= {f"{name}.loss": 0.0 for name in subject.channels}
            else:
                quiet |= calm
    fault = _fault(subject, data)
    if fault:
        presets.append({"label": "The fault", "state": quiet | fault | {"k": first or "none"}})
    return presets


def _undisturbed(subject: Subject, data: dict[str, Any]) -> dict[str, Any]:
    """Event and channels as every preset starts from them: the page's own event, nothing lost."""
    event = {k: data["start"][k] for k in ("ev", "nudge", "power", "sz") if k in data["start"]}
    nothing = {"loss": 0.0, "burst": 1.0, "jitter": 0.0, "lost": data["stop"], "back": data["stop"]}
    channels = {f"{name}.{key}": value for name in subject.channels for key, value in nothing.items()}
    latency = _latency(subject, 0.0)
    ceilings = {"cl": 0.0} if data["ceilings"] else {}
    return event | ceilings | latency | channels


def _latency(subject: Subject, ms: float) -> dict[str, float]:
    return {f"{name}.latency": ms for name in subject.channels}


def late_ms(subject: Subject, name: str) -> float | None:
    """Return a common latency, ms, a tenth beyond the delay margin of a controller; None without a margin."""
    controller = subject.controllers[name]
    if not isinstance(controller, Controller):
        return None
    from interarea.design.delay.curves import delay_margin

    try:
        plant = speeds_in_rad(subject.linear(subject.points[0]), subject.case.omega_b)
        margin = delay_margin(plant, controller.system).margin_s
    except ValueError:
        return None
    late = 10.0 * math.ceil(100.0 * _LATE * margin) if np.isfinite(margin) else np.inf
    return late if late <= _LATEST_MS else None


def _lost(subject: Subject, data: dict[str, Any], first: str) -> dict[str, float]:
    """Packets lost everywhere, and the remote signals gone half a second after the event."""
    remote = [name for name, (signal, _) in subject.channels.items() if subject.is_remote(signal, first)]
    if not remote:
        return {}
    at = float(data["start"].get("at", 1.0))
    return {f"{name}.lost": at + 0.5 for name in remote} | {
        f"{name}.loss": _LOSS_PERCENT for name in subject.channels
    }


def _tolerant(subject: Subject, first: str) -> str | None:
    """A controller designed to live without the remote signal."""
    for name in ("ftc", *subject.controllers):
        if name in subject.controllers and name != first:
            method = str(subject.controllers[name].design.get("method", ""))
            if name == "ftc" or "loss" in method:
                return name
    return None


def _fault(subject: Subject, data: dict[str, Any]) -> dict[str, Any]:
    """A fault amid the tie, cleared late by opening a circuit, with field limits where there are none."""
    case: Case = subject.case
    if case.tie is None:
        return {}
    named = {b.name: b for b in case.branches}
    ends = [e for name in case.tie.branches for e in (named[name].from_bus, named[name].to_bus)]
    bus = next(e for e in ends if e != case.tie.from_bus)
    opened = [t["name"] for t in data["events"]["trip"]]
    beside = [n for n in opened if bus in (named[n].from_bus, named[n].to_bus)]
    # the circuit that is opened is not one that the fault leaves the grid no power over: take the far side
    far = [n for n in beside if n not in case.tie.branches] or beside
    state = {"ev": "fault", "fault": bus, "tc": _CLEARING_MS, "br": far[0] if far else ""}
    return state | ({"cl": _CEILING_PU} if data["ceilings"] else {})
