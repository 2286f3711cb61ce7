"""Value of the links of a grid for each set of loops, as numbers and as a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from interarea.design.modes.loop_points import LoopSet
from interarea.design.robust.signal_worth import PAYS, PAYS_CYCLES

from .link_worth import AFAR, AREA, LATENCIES_MS, OWN, LinkRow


@dataclass(frozen=True)
class LinkSet:
    """A set of loops, its rows, and the reasons for missing ones (one of `SIGNALS` -> the reason)."""

    chosen: LoopSet
    rows: tuple[LinkRow, ...]
    missing: Mapping[str, str]

    def row(self, signals: str, latency_ms: int) -> LinkRow | None:
        """Return one row; the row of the own machines' signals is the same at every latency."""
        latency_ms = 0 if signals == OWN else latency_ms
        rows = (r for r in self.rows if (r.signals, r.latency_ms) == (signals, latency_ms))
        return next(rows, None)

    def adds(self, signals: str, latency_ms: int) -> tuple[float, float | None]:
        """Return the inter-area damping and clearing time (cycles) that signals add to the own signals."""
        row, own = self.row(signals, latency_ms), self.row(OWN, 0)
        assert row is not None and own is not None
        cycles = None
        if row.clearing_cycles is not None and own.clearing_cycles is not None:
            cycles = row.clearing_cycles - own.clearing_cycles
        return row.least - own.least, cycles

    def pays(self, signals: str, latency_ms: int) -> bool:
        """Whether they add `PAYS` of damping or `PAYS_CYCLES` of clearing time, as in `SignalWorth`."""
        damping, cycles = self.adds(signals, latency_ms)
        return bool(damping >= PAYS or (cycles or 0.0) >= PAYS_CYCLES)


def conclusion(sets: Sequence[LinkSet]) -> str:
    """Return the value of the links of a grid, one clause for each set of loops.

    >>> conclusion([])
    'no set of loops was designed'
    """
    linked = [one for one in sets if AFAR not in one.missing]
    return "; ".join(_clause(one) for one in linked or sets) or "no set of loops was designed"


def _clause(one: LinkSet) -> str:
    where = f"at {', '.join(a.removesuffix('_vs') for a in one.chosen.actuators)}"
    rows = [row for ms in LATENCIES_MS if (row := one.row(AFAR, ms)) is not None]
    own = one.row(OWN, 0)
    if not rows:
        return f"{where} no link was designed: {one.missing.get(AFAR, 'not designed')}"
    best = max(row.least for row in rows)
    if own is None:
        reached = f"inter-area damping with the link {best:.3f} at most"
        return f"{where} no own signal is available for comparison; {reached}"
    paying = [row.latency_ms for row in rows if one.pays(AFAR, row.latency_ms)]
    if not paying:
        return (
            f"{where} a local stabilizer performs as well: do not build this link (inter-area damping "
            f"{own.least:.3f} with the own signal, {best:.3f} at most with the link)"
        )
    text = f"{where} the link adds {_added(one, paying)}; inter-area damping without it {own.least:.3f}"
    return text + _rest(one, paying, [row.latency_ms for row in rows if row.latency_ms not in paying])


def _rest(one: LinkSet, paying: Sequence[int], others: Sequence[int]) -> str:
    """Return the latencies at which a nearer signal performs as well, and those without a gain."""
    text = ""
    if as_good := [ms for ms in paying if _area_as_good(one, ms)]:
        text += f" (a signal of the own area performs as well at {_listed(as_good)} ms)"
    if others:
        text += f"; at {_listed(others)} ms a local stabilizer performs as well: do not build the link"
    return text


def _added(one: LinkSet, paying: Sequence[int]) -> str:
    """Return what a link adds at the latencies at which it pays."""
    both = {ms: one.adds(AFAR, ms) for ms in paying}
    damping = {ms: adds for ms, (adds, _) in both.items() if adds >= PAYS}
    cycles = {ms: adds for ms, (_, adds) in both.items() if adds is not None and adds >= PAYS_CYCLES}
    parts = [
        f"{_range(adds, digits)} {what} at {_listed(list(adds))} ms"
        for adds, digits, what in (
            (damping, ".3f", "of inter-area damping"),
            (cycles, ".1f", "cycles of clearing time"),
        )
        if adds
    ]
    return " and ".join(parts)


def _range(adds: Mapping[int, float], digits: str) -> str:
    ends = dict.fromkeys(format(end(adds.values()), digits) for end in (min, max))
    return " to ".join(ends)


def _area_as_good(one: LinkSet, latency_ms: int) -> bool:
    area, afar = one.row(AREA, latency_ms), one.row(AFAR, latency_ms)
    return area is not None and afar is not None and not afar.least - area.least >= PAYS


def _listed(values: Sequence[int]) -> str:
    return ", ".join(str(value) for value in values)
