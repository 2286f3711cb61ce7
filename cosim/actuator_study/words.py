"""The conclusions of the comparison of actuators, derived from its numbers."""

from __future__ import annotations

from collections.abc import Sequence

from interarea.design.robust.signal_worth import PAYS

from .cells import REMOTE, Cell
from .installed import KINDS


def conclusion(cells: Sequence[Cell], survived: int) -> list[str]:
    """Return the conclusions: the kinds by damping, then the worth of remote signals for each kind.

    survived : how many faults are stable without control.

    >>> conclusion([], 8)
    ['no controller was designed']
    """
    if not cells:
        return ["no controller was designed"]
    kinds = list(dict.fromkeys(cell.kind for cell in cells))
    lines = [line for line in (_most(cells, "own", 0), *_by_latency(cells)) if line]
    return [*lines, *(_worth([c for c in cells if c.kind == kind], survived) for kind in kinds)]


def _by_latency(cells: Sequence[Cell]) -> list[str]:
    """Return the kinds by damping with remote signals, at the least and at the largest latency."""
    there = sorted({cell.latency_ms for cell in cells if cell.signals == REMOTE})
    return [_most(cells, REMOTE, ms) for ms in dict.fromkeys([*there[:1], *there[-1:]])]


def _most(cells: Sequence[Cell], signals: str, latency_ms: int) -> str:
    """Return the order of the kinds with one kind of signals at one latency."""
    rows = [c for c in cells if (c.signals, c.latency_ms) == (signals, latency_ms)]
    if not rows:
        return ""
    order = sorted(rows, key=lambda cell: -cell.least)
    where = "with own signals" if signals == "own" else f"with remote signals delayed by {latency_ms} ms"
    return f"{where} the inter-area damping ratios are " + ", ".join(
        f"{KINDS[c.kind]} {c.least:.3f}" for c in order
    )


def _worth(cells: Sequence[Cell], survived: int) -> str:
    """Return the worth of remote signals for one kind, compared with its own-signal controller."""
    name = KINDS[cells[0].kind]
    own = next((c for c in cells if c.signals == "own"), None)
    remote = [c for c in cells if c.signals == REMOTE]
    if own is None or not remote:
        return f"{name}: no controllers with own and with remote signals to compare"
    best = max(c.least for c in remote)
    text = f"{name}: own signal {own.least:.3f}, remote signals {best:.3f} at most; {_verdict(own, remote)}"
    unstable = sorted({c.worst_lost for c in remote if not c.lost_stable and c.worst_lost})
    if unstable:
        text += f"; unstable when {' or '.join(unstable)} is lost"
    elif (left := _left_by_a_loss(own, remote)) is not None:
        text += (
            f"; with {left.worst_lost} lost {left.lost:.3f} at {left.latency_ms} ms, less than with the "
            "own signal"
        )
    fewest = min(remote, key=lambda c: c.survived)
    if fewest.survived < own.survived:
        text += f"; {own.survived - fewest.survived} fewer faults are stable at {fewest.latency_ms} ms"
    if own.survived < survived:
        text += (
            f"; with the own signal {survived - own.survived} fewer faults are stable than without control"
        )
    return text


def _left_by_a_loss(own: Cell, remote: Sequence[Cell]) -> Cell | None:
    """Return the remote cell with least damping after a loss, None where `own` has no more."""
    losing = [c for c in remote if c.lost is not None and own.least - c.lost >= PAYS]
    return min(losing, key=lambda c: c.lost or 0.0, default=None)


def _verdict(own: Cell, remote: Sequence[Cell]) -> str:
    """Return at which latencies remote signals pay: more damping, and stable with any one of them lost."""
    paying = [c for c in remote if c.least - own.least >= PAYS and c.lost_stable]
    if not paying:
        return "the own signal performs as well: do not build this link"
    text = f"the link pays at {', '.join(str(c.latency_ms) for c in paying)} ms"
    others = [str(c.latency_ms) for c in remote if c not in paying]
    return f"{text}, not at {', '.join(others)} ms" if others else text
