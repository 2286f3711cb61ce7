"""Operating-point variants: another tie flow, circuits out, loads scaled, other parameters, as changes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from .case import Case, CaseError
from .named_changes import with_named_changes
from .schema import Load


def operating_variant(
    case: Case,
    *,
    tie_flow_mw: float = 0.0,
    out: Sequence[str] = (),
    load_scale: float = 1.0,
    vary: Sequence[str] = (),
    between: tuple[str, str] | None = None,
) -> Case:
    """Return `case` at another operating point, named after what differs.

    Parameters
    ----------
    tie_flow_mw : active load moved from the first to the second load of `between` at unchanged dispatch, so
        that the tie carries about that much more; the slack takes the change of the losses.
    out : names of branches out of service; a series capacitor in one is out with it, as after its trip.
    load_scale : factor on P and Q of every load and on the P of every machine.
    vary : parameters changed by name, such as "inertia -20 %" (`named_changes`).
    between : names of the two loads; default: the largest load in the area where the tie begins and the
        largest outside that area.

    >>> from interarea.models.case.case import load_case
    >>> variant = operating_variant(load_case("two-area-thesis"), tie_flow_mw=100.0, out=["8-9 a"])
    >>> variant.name, variant.load("L7").P_mw, variant.load("L9").P_mw
    ('two-area-thesis-tie-plus-100-out-8-9-a', 867.0, 1867.0)

    Raises
    ------
    CaseError : unknown branch or load, a network cut in pieces, a factor that is not above 0, a text of
        `vary` that is no change.
    """
    if not load_scale > 0.0:
        raise CaseError(f"{case.name}: load_scale = {load_scale:g}, allowed: above 0")
    loads: dict[str, dict[str, float]] = {}
    machines: dict[str, dict[str, float]] = {}
    words = [case.name]
    if load_scale != 1.0:
        words.append(f"load-{_in_name(load_scale)}")
        loads = {q.name: {"P_mw": q.P_mw * load_scale, "Q_mvar": q.Q_mvar * load_scale} for q in case.loads}
        machines = {m.name: {"P_mw": m.P_mw * load_scale} for m in case.machines}
    if tie_flow_mw:
        words.append(f"tie-{'plus' if tie_flow_mw > 0.0 else 'minus'}-{_in_name(abs(tie_flow_mw))}")
        giving, taking = (case.load(name) for name in between) if between else _ends_of_tie(case)
        for load, step in ((giving, -tie_flow_mw), (taking, tie_flow_mw)):
            loads.setdefault(load.name, {})["P_mw"] = load.P_mw * load_scale + step
    for name in out:
        case.branch(name)
        words.append(f"out-{re.sub('[^A-Za-z0-9_.-]+', '-', name)}")
    branches = {name: {"in_service": False} for name in out}
    change: dict[str, Any] = {"loads": loads, "machines": machines, "branches": branches}
    if capacitors := {row.name: "none" for row in case.tcscs if row.branch in out}:
        change["tcscs"] = capacitors
    return with_named_changes(case.with_changes(change, name="-".join(words)), vary)


def _in_name(value: float) -> str:
    """Return a number as the name of a case can have it: without a +."""
    return f"{value:g}".replace("e+", "e")


def _ends_of_tie(case: Case) -> tuple[Load, Load]:
    if case.tie is None:
        raise CaseError(f"{case.name}: tie_flow_mw needs [tie] in the case, or between = (load, load)")
    area_of = {bus.number: bus.area for bus in case.buses}
    sending = area_of[case.tie.from_bus]
    at_end = [q for q in case.loads if area_of[q.bus] == sending and q.in_service]
    there = [q for q in case.loads if area_of[q.bus] != sending and q.in_service]
    if not at_end or not there:
        raise CaseError(f"{case.name}: no load on one side of the tie, allowed: between = (load, load)")
    return max(at_end, key=lambda q: q.P_mw), max(there, key=lambda q: q.P_mw)
