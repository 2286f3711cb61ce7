"""The text of a case in another format, and what that format cannot hold."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..case.case import Case
from ..case.schema import Branch


@dataclass(frozen=True)
class Written:
    """A file's text; losses : one line for each kind of thing that the file does not say."""

    text: str
    losses: tuple[str, ...]


def named(names: Iterable[str], most: int = 5) -> str:
    """Return the first names of a list, and how many more there are."""
    every = list(names)
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return ", ".join(every[:most]) + more


def is_transformer(branch: Branch) -> bool:
    """Return whether a branch needs the record of a transformer, whatever it is called."""
    return branch.kind == "transformer" or branch.tap != 1.0 or branch.shift_deg != 0.0


def types_of_buses(case: Case) -> dict[int, int]:
    """Return bus -> type for those with a machine: 3 at the slack, else 2."""
    return {m.bus: 3 if m.slack else 2 for m in sorted(case.machines, key=lambda m: m.slack)}


def losses_of_network(case: Case, *, links: bool = False) -> list[str]:
    """Return what no file of a power flow holds; links : it holds dc links, without their control."""
    losses = []
    curved = [q.name for q in case.loads if q.P_zip or q.Q_zip or (q.P_exponent, q.Q_exponent) != (2.0, 2.0)]
    if curved:
        losses.append(f"how loads follow the voltage ({named(curved)})")
    losses += _devices(case, links=links)
    if case.tcscs:
        losses.append(f"that series capacitors move ({named(row.name for row in case.tcscs)})")
    if case.tie is not None:
        losses.append("the tie")
    if case.events:
        losses.append("the events")
    if case.solver_step_s is not None:
        losses.append("the solver step")
    return losses


def _devices(case: Case, *, links: bool) -> list[str]:
    """What is lost of devices at buses."""
    losses = []
    written = {d.name for d in case.links} if links else set()
    others = [d.name for d in case.at_buses if d.name not in written]
    if others:
        what = f"SVCs, STATCOMs{' and converters' if links else ', converters and dc links'}"
        losses.append(f"{what} with their power ({named(others)})")
    if written:
        names = named(row.name for row in case.links)
        losses.append(f"control, rating, inductance and capacitance of dc links ({names})")
    return losses
