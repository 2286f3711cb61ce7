"""The detector of a system: its instance, what it sees, and whom it tells."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import partial
from pathlib import Path

from interarea.design.controllers.detector_record import load_detector
from interarea.models.blocks.detector import Patterns, detector_block

from ..errors import ScenarioError
from ..scenario.detector import DETECTOR, few_signals
from ..scenario.scenario import Scenario
from .instance import Instance
from .system import CONTROLLER, System


def add_detector(system: System, scenario: Scenario) -> None:
    """Add the detector that a scenario has: it sees every signal that travels through a channel."""
    paths, table = scenario.signals, scenario.detector
    if table is None:
        return
    names, patterns = tuple(w.signal for w in paths), patterns_of(scenario)
    block = partial(detector_block, names, patterns=patterns)
    file = system.fmus.detector(names, patterns)
    system.put(Instance(DETECTOR, file, table.parameters(paths), block))
    system.warnings += few_signals(paths)
    for w in paths:
        for source, variable in ((w.y, w.signal), (w.age, f"{w.signal}_age"), (w.valid, f"{w.signal}_valid")):
            system.connections.append((source, f"{DETECTOR}.{variable}"))


def patterns_of(scenario: Scenario) -> Patterns | None:
    """Return the patterns of the file that a scenario's detector names, in the order of its signals.

    Raises
    ------
    ScenarioError : a file for other signals, another interval or another grid. DetectorDesignError : no file.
    """
    table, paths = scenario.detector, scenario.signals
    if table is None or not table.file:
        return None
    record = load_detector(scenario.folder / table.file)
    names = [w.signal for w in paths]
    where = f"{scenario.name}: detector.file = {table.file!r} was designed for"
    if sorted(names) != sorted(record.signals):
        raise ScenarioError(
            f"{where} {', '.join(record.signals)}, here the signals are {', '.join(names)}, allowed: the "
            "same signals"
        )
    if abs(record.interval_s - paths[0].interval_s) > 1e-9:
        raise ScenarioError(
            f"{where} packets every {record.interval_s:g} s, here the interval is {paths[0].interval_s:g} s"
        )
    case = Path(scenario.case).stem
    if record.case != case:
        raise ScenarioError(
            f"{where} the case {record.case!r}, here it is {case!r}; design a detector for it"
        )
    return record.patterns.of([record.signals.index(name) for name in names])


def flags(signal: str, valid: str, inputs: Collection[str], detector: bool) -> Iterator[tuple[str, str]]:
    """Yield the connections by which a controller with these inputs learns whether a signal can be used.

    valid : flag of the signal's channel. detector : whether there is one, which rules in its place.
    """
    if f"{signal}_valid" in inputs:
        yield (f"{DETECTOR}.{signal}_usable" if detector else valid), f"{CONTROLLER}.{signal}_valid"
    if detector and f"{signal}_trusted" in inputs:
        yield f"{DETECTOR}.{signal}_trusted", f"{CONTROLLER}.{signal}_trusted"
