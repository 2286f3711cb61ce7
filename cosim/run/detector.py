"""The detector of a system: its instance, what it sees, and whom it tells."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import partial

from interarea.models.blocks.detector import detector_block

from ..scenario.detector import DETECTOR, few_signals
from ..scenario.scenario import Scenario
from .instance import Instance
from .system import CONTROLLER, System


def add_detector(system: System, scenario: Scenario) -> None:
    """Add the detector that a scenario has: it sees every signal that travels through a channel."""
    ways, table = scenario.signals, scenario.detector
    if table is None:
        return
    names = tuple(w.signal for w in ways)
    block = partial(detector_block, names)
    system.put(Instance(DETECTOR, system.fmus.detector(names), table.parameters(ways), block))
    system.warnings += few_signals(ways)
    for w in ways:
        for source, variable in ((w.y, w.signal), (w.age, f"{w.signal}_age"), (w.valid, f"{w.signal}_valid")):
            system.connections.append((source, f"{DETECTOR}.{variable}"))


def flags(signal: str, valid: str, inputs: Collection[str], detector: bool) -> Iterator[tuple[str, str]]:
    """Yield the connections by which a controller with these inputs learns whether a signal can be used.

    valid : flag of the signal's channel. detector : whether there is one, which rules in its place.
    """
    if f"{signal}_valid" in inputs:
        yield (f"{DETECTOR}.{signal}_usable" if detector else valid), f"{CONTROLLER}.{signal}_valid"
    if detector and f"{signal}_trusted" in inputs:
        yield f"{DETECTOR}.{signal}_trusted", f"{CONTROLLER}.{signal}_trusted"
