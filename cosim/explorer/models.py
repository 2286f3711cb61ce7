"""The records of a page: one for each controller and operating point, and where each parameter lies in it."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

from interarea.fmu_build.write.description_xml import record_entries
from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.sizes import SIGNAL_FAULTS
from interarea.models.blocks.variables import Block

from ..export.container import container_block
from ..run.instance import Fmus
from ..scenario.scenario import OperatingPointTable, Scenario
from ..scenario.signal_paths import ChannelTable
from .subject import Point, Subject

GUID = "page"  #: of every record here; page and record always come together
BOOLEAN = 0x80000000  #: marks a reference of a Boolean, as page.c reads it
SLOTS = 4  #: events that a page sets
_PLANT_PARAMETERS = ("plant.event[", "plant.solver.step")
_CONTROLLER_PARAMETERS = ("controller.C[", "controller.D[", "controller.limit")
_UNTOUCHED = (
    "quantile[",
    "quantum",
    "pdc_wait",
    *(f"fault[{k}" for k in range(2, 1 + SIGNAL_FAULTS)),
)  #: of a channel: as the scenario has them


def models_of(subject: Subject) -> tuple[list[dict[str, Any]], list[bytes]]:
    """Return a description of each model and the bytes it is made of.

    A description: ``controller`` (name), ``point`` (number), ``part`` (which bytes) and ``reference`` (the
    part that these bytes change, or -1); and once for each controller ``reals``, ``integers`` (outputs:
    name -> reference, Booleans marked), ``parameters`` and ``whole`` (Real ones and others, likewise).

    Raises
    ------
    ScenarioError : a loop that one container cannot hold; the part is named.
    """
    models: list[dict[str, Any]] = []
    parts: list[bytes] = []
    records: list[bytes] = []
    fmus = Fmus(subject.cache)
    for name in ("none", *subject.controllers):
        for number, point in enumerate(subject.points):
            block = container_block(
                _scenario(subject, name, point),
                cache=subject.cache,
                controller=subject.own.get(name),
                case=point.case,
                fmus=fmus,
            )
            record = pack_record({"guid": GUID.encode() + b"\0", **record_entries(block)})
            part, reference = _least(record, records)
            model: dict[str, Any] = {
                "controller": name,
                "point": number,
                "part": len(parts),
                "reference": reference,
            }
            models.append(model if number else model | _references(block))
            parts.append(part)
            records.append(record)
    fmus.close()
    return models, parts


def _least(record: bytes, records: list[bytes]) -> tuple[bytes, int]:
    """The record, or how it differs from the first or the last one: whichever is shortest."""
    choices = [(record, -1)]
    for k in {0, len(records) - 1} if records else ():
        choices.append((delta(records[k], record), k))
    return min(choices, key=lambda choice: len(choice[0]))


def _scenario(subject: Subject, controller: str, point: Point) -> Scenario:
    """The scenario whose container is the model: no event, nothing lost; the page sets all of that."""
    inputs = subject.controllers[controller].inputs if controller != "none" else ()
    channels = {
        name: ChannelTable.model_validate(table)
        for name, (signal, table) in subject.channels.items()
        if signal in inputs
    }
    changes = {
        "channels": channels,
        "event": (),
        "operating_point": OperatingPointTable.model_validate(point.changes),
        "step_s": step_s(subject.scenario),
    }
    return subject.with_controller(controller).model_copy(update=changes)


def slot_of(name: str) -> int:
    """Return the number of the event slot that a parameter belongs to, 0 for any other parameter.

    >>> slot_of("plant.event[3].start"), slot_of("plant.solver.step")
    (3, 0)
    """
    return int(name[12:].partition("]")[0]) if name.startswith("plant.event[") else 0


def step_s(scenario: Scenario) -> float:
    """Return the communication step of the page, s: the scenario's, else 10 ms."""
    return 0.01 if scenario.step_s is None else scenario.step_s


def _references(block: Block) -> dict[str, Any]:
    table, moved = block.table, list(_moved(block))
    flags = {v.name: BOOLEAN if v.type == "Boolean" else 0 for v in table.integers}
    whole = [v.name for v in table.of_role("output", integers=True)]
    return {
        "reals": {v.name: table.value_reference(v.name) for v in table.of_role("output")},
        "integers": {name: table.value_reference(name) + flags[name] for name in whole},
        "parameters": {n: table.value_reference(n) for n in moved if table[n].type == "Real"},
        "whole": {n: table.value_reference(n) for n in moved if table[n].type != "Real"},
    }


def _moved(block: Block) -> Iterator[str]:
    """Names of the parameters that a page may set."""
    for v in block.table:
        if v.role != "parameter":
            continue
        member, _, rest = v.name.partition(".")
        if member == "plant":
            if slot_of(v.name) > SLOTS:
                continue
            if v.name.startswith(_PLANT_PARAMETERS) or v.name.endswith((".Efd_max", ".Efd_min")):
                yield v.name
        elif member == "controller":
            # an entry of D that is zero is a promise and cannot be set
            if v.name.startswith(_CONTROLLER_PARAMETERS) and not (v.min == v.max == 0.0):
                yield v.name
        elif not rest.startswith(_UNTOUCHED):
            yield v.name


_GRAIN = 8  #: bytes: records are aligned so
_LEAST = 24  #: a shorter run of equal bytes costs more to name than to give


def delta(reference: bytes, target: bytes) -> bytes:
    """Return what turns `reference` into `target`: [u32 from, u32 length, u32 given, given bytes], repeated.

    Each piece copies `length` bytes of the reference and appends `given` bytes.
    """
    places: dict[bytes, int] = {}
    for at in range(0, len(reference) - _LEAST + 1, _GRAIN):
        places.setdefault(reference[at : at + _LEAST], at)
    out = bytearray()
    literal = bytearray()
    copied = (0, 0)
    at, ahead = 0, 0  # ahead: where the last copy would go on; there a match is looked for first
    while at < len(target):
        block = target[at : at + _LEAST]
        start = ahead if block and reference[ahead : ahead + _LEAST] == block else places.get(block, -1)
        if start < 0:
            literal += target[at : at + 1]
            at, ahead = at + 1, ahead + 1
            continue
        length = _equal(reference, start, target, at)
        out += _piece(copied, literal)
        literal = bytearray()
        copied = (start, length)
        at, ahead = at + length, start + length
    return bytes(out + _piece(copied, literal))


def _piece(copied: tuple[int, int], literal: bytearray) -> bytes:
    return struct.pack("<3I", *copied, len(literal)) + bytes(literal)


def _equal(reference: bytes, start: int, target: bytes, at: int) -> int:
    """How many bytes are equal from there on."""
    length, most = 0, min(len(reference) - start, len(target) - at)
    while length < most:
        span = min(4096, most - length)
        local, there = start + length, at + length
        if reference[local : local + span] == target[there : there + span]:
            length += span
            continue
        while reference[start + length] == target[at + length]:
            length += 1
        break
    return length
