"""What the events of a case or scenario act on, and whether that is there."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from ..errors import CaseError, nearest

if TYPE_CHECKING:  # names are looked up in an `outline` too
    from .tables import CaseTables


def target_index(case: CaseTables, event: Any) -> int:
    """Return the position of the event's target among the rows of its table in `case`.

    Raises
    ------
    CaseError : no such target (with the nearest names), a bus with none or several loads, a Vref event at a
        machine with constant excitation, a relay whose threshold is the rated frequency.
    """
    if event.kind.startswith("frequency"):
        _check_threshold(case, event)
    if hasattr(event, "load") and event.bus is not None:
        return _load_at(case, event.kind, event.bus)
    if event.kind == "bus_fault":
        numbers = [bus.number for bus in case.buses]
        if event.bus not in numbers:
            raise CaseError(
                f"{case.name}: {event.kind}: bus {event.bus} does not exist; {nearest(event.bus, numbers)}"
            )
        return numbers.index(event.bus)
    table = next(t for t in ("branch", "machine", "load", "shunt") if hasattr(event, t))
    names = [row.name for row in getattr(case, "branches" if table == "branch" else f"{table}s")]
    name = getattr(event, table)
    if name not in names:
        raise CaseError(f"{case.name}: {event.kind}: {table} {name!r} does not exist; {nearest(name, names)}")
    if event.kind.startswith("vref") and _excitation(case.machines[names.index(name)]) == "constant":
        raise CaseError(
            f"{case.name}: {event.kind}: machine {name!r} has constant excitation, so no voltage set-point, "
            "allowed: a machine whose exciter regulates"
        )
    return names.index(name)


def _excitation(machine: Any) -> Any:
    exciter = getattr(machine, "exciter", None)  # an outline has none where the file has none
    return "constant" if exciter is None else exciter.kind


def _check_threshold(case: CaseTables, event: Any) -> None:
    rated = case.frequency_hz
    if not 0.0 < abs(event.threshold_hz - rated) < rated:
        raise CaseError(
            f"{case.name}: {event.kind}: threshold_hz = {event.threshold_hz:g}, allowed: below the rated "
            f"{rated:g} Hz (under-frequency) or above it and below {2.0 * rated:g} (over-frequency)"
        )


def _load_at(case: CaseTables, kind: str, bus: int) -> int:
    here = [k for k, load in enumerate(case.loads) if load.bus == bus]
    if len(here) != 1:
        buses = sorted({load.bus for load in case.loads})
        raise CaseError(
            f"{case.name}: {kind}: bus {bus} has {len(here)} loads, allowed: one load ({buses}), "
            "or load = NAME"
        )
    return here[0]


def check_events(case: CaseTables, events: Iterable[Any]) -> None:
    """Check that every target exists; what trips cut off is the plant's concern (plant/events/topology.c).

    Raises
    ------
    CaseError : as `target_index`.
    """
    for event in events:
        target_index(case, event)
