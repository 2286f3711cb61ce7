"""Changes to the parameters of a case by name: `inertia -20 %`, `no governors`; those that a case can have.

exciter gain -30 %              of every exciter; `exciter gain of G1`: of one
inertia +20 %                   H of every machine; `inertia of G1`, `inertia of area 2`
reactance of 8-9 a +20 %        of a branch
tie reactance +20 %             of the branches of [tie] and of those in series with them
loads of constant power         current or impedance: P and Q of every load
loads of constant current P, impedance Q
no stabilizer at G3             taken out; `no stabilizers`: of every machine
no governor at G3               constant mechanical power; `no governors`
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeAlias

from ..errors import nearest
from .case import Case, CaseError
from .schema import Machine

Change: TypeAlias = dict[str, dict[str, dict[str, Any]]]

#: what multiplies the voltage error of an exciter; the first of these that one has
_GAINS = (("KA",), ("K",), ("KPR", "KIR"), ("KPA", "KIA", "KDA"))
_LONGEST_NAME = 64  # of a case
_LOADS = {
    "loads of constant impedance": (2.0, 2.0),
    "loads of constant current": (1.0, 1.0),
    "loads of constant power": (0.0, 0.0),
    "loads of constant current P, impedance Q": (1.0, 2.0),
}
_FACTOR = re.compile(r"(?P<what>.+?) (?P<percent>[+-]\d+(?:\.\d+)?) ?%")
_PLACE = re.compile(r"(?P<what>.+?) (?:of|at) (?P<place>.+)")


def with_named_changes(case: Case, texts: Sequence[str]) -> Case:
    """Return `case` with each of these changes made, one after the other.

    >>> from interarea.models.case.case import load_case
    >>> lighter = with_named_changes(load_case("two-area-thesis"), ["inertia of area 1 -30 %"])
    >>> [round(machine.H, 3) for machine in lighter.machines]
    [4.55, 4.55, 6.175, 6.175]

    Raises
    ------
    CaseError : a text that is no change, or one of what the case has not got.
    """
    for text in texts:
        case = case.with_changes(_change(case, text), name=_named(case.name, text))
    return case


def changes_of(case: Case) -> tuple[str, ...]:
    """Return the changes that show what a controller holds with parameters it was not designed for.

    Exciter gain +-30 %, inertia +-20 % and that of each area -30 %, four kinds of loads, tie reactance
    +-20 %, each stabilizer out, governors out: those that `case` can have.
    """
    areas = sorted({machine.area for machine in case.machines})
    changes = [
        *("exciter gain +30 %", "exciter gain -30 %", "inertia +20 %", "inertia -20 %"),
        *(f"inertia of area {area} -30 %" for area in areas if len(areas) > 1),
        *_LOADS,
        *("tie reactance +20 %", "tie reactance -20 %"),
        *(f"no stabilizer at {m.name}" for m in case.machines if m.stabilizer is not None),
        "no governors",
    ]
    return tuple(text for text in changes if _possible(case, text))


def load_kind(case: Case, of_p: float, of_q: float) -> Change:
    """Return the change that gives every load these exponents of active and reactive power."""
    kind = {"P_exponent": of_p, "Q_exponent": of_q, "P_zip": None, "Q_zip": None}
    return {"loads": {load.name: dict(kind) for load in case.loads}}


def _possible(case: Case, text: str) -> bool:
    try:
        _change(case, text)
    except CaseError:
        return False
    return True


def _named(name: str, text: str) -> str:
    """Return a name for the changed case; where it would be too long, its end is a number made of it."""
    words = re.sub("[^A-Za-z0-9_.]+", "-", text.replace("+", "plus-").replace(" -", " minus-")).strip("-")
    whole = f"{name}-{words}"
    digest = hashlib.sha256(whole.encode()).hexdigest()[:8]
    return whole if len(whole) <= _LONGEST_NAME else f"{whole[: _LONGEST_NAME - 9].rstrip('-.')}-{digest}"


def _change(case: Case, text: str) -> Change:
    if text in _LOADS:
        return load_kind(case, *_LOADS[text])
    words, factor = text, None
    if match := _FACTOR.fullmatch(text):
        words, factor = match["what"], 1.0 + float(match["percent"]) / 100.0
        if not factor > 0.0:
            raise CaseError(f"{case.name}: {text!r}: nothing is left, allowed: above -100 %")
    place = None
    if match := _PLACE.fullmatch(words):
        words, place = match["what"], match["place"]
    if factor is not None and (scaled := _SCALED.get(words)):
        change = scaled(case, factor, place)
    elif factor is None and words in _TAKEN_OUT and (place is None) == words.endswith("s"):
        change = _without(case, place, *_TAKEN_OUT[words])
    else:
        raise CaseError(
            f"{case.name}: {text!r} is no change of parameters; allowed: such as exciter gain -30 %, "
            f"exciter gain of G1 -30 %, inertia of area 1 -30 %, tie reactance +20 %, reactance of BRANCH "
            f"+20 %, {', '.join(_LOADS)}, no stabilizer at G1, no stabilizers, no governor at G1, "
            "no governors"
        )
    if not any(change.values()):
        raise CaseError(f"{case.name}: {text!r}: the case has nothing of that kind")
    return change


def _machines(case: Case, place: str | None) -> Iterator[Machine]:
    """Give every machine, that of this name, or those of `area N`."""
    names = [machine.name for machine in case.machines]
    areas = [f"area {area}" for area in sorted({machine.area for machine in case.machines})]
    if place is not None and place not in (*names, *areas):
        raise CaseError(f"{case.name}: no machine or area {place!r}; {nearest(place, (*names, *areas))}")
    for machine in case.machines:
        if place in (None, machine.name, f"area {machine.area}"):
            yield machine


def _exciter_gain(case: Case, factor: float, place: str | None) -> Change:
    rows = {}
    for machine in _machines(case, place):
        names = next((n for n in _GAINS if all(hasattr(machine.exciter, name) for name in n)), ())
        if names:
            gains = {name: factor * getattr(machine.exciter, name) for name in names}
            rows[machine.name] = {"exciter": gains}
    return {"machines": rows}


def _inertia(case: Case, factor: float, place: str | None) -> Change:
    machines = [m for m in _machines(case, place) if m.H is not None and m.model != "infinite_bus"]
    return {"machines": {m.name: {"H": factor * m.H} for m in machines if m.H is not None}}


def _reactance(case: Case, factor: float, place: str | None) -> Change:
    if place is None:
        raise CaseError(f"{case.name}: reactance of what; wanted reactance of BRANCH, or tie reactance")
    return {"branches": {place: {"x": factor * case.branch(place).x}}}


def _tie_reactance(case: Case, factor: float, place: str | None) -> Change:
    if place is not None or case.tie is None:
        raise CaseError(f"{case.name}: tie reactance is that of [tie] in the case; else reactance of BRANCH")
    return {"branches": {name: {"x": factor * case.branch(name).x} for name in _in_series(case)}}


def _in_series(case: Case) -> list[str]:
    """Branches of the tie, and those beyond a bus at which nothing stands and that has two neighbours."""
    assert case.tie is not None
    standing = (*case.machines, *case.loads, *case.shunts, *case.at_buses)
    closed = {case.tie.from_bus, *(row.bus for row in standing)}
    branches = {b.name: {b.from_bus, b.to_bus} for b in case.branches}
    at_bus: dict[int, set[str]] = {}
    for name, ends in branches.items():
        for bus in ends:
            at_bus.setdefault(bus, set()).add(name)
    open_ = {bus for bus, names in at_bus.items() if len(set().union(*(branches[n] for n in names))) == 3}
    taken = set(case.tie.branches)
    while True:
        passed = {bus for name in taken for bus in branches[name]} & (open_ - closed)
        more = taken.union(*(at_bus[bus] for bus in passed))
        if more == taken:
            return [name for name in branches if name in taken]
        taken = more


def _without(case: Case, place: str | None, control: str, nothing: Any) -> Change:
    machines = [m for m in _machines(case, place) if getattr(m, control) is not None]
    there = [m for m in machines if getattr(getattr(m, control), "kind", "") != "none"]
    return {"machines": {m.name: {control: nothing} for m in there}}


_SCALED: dict[str, Callable[[Case, float, str | None], Change]] = {
    "exciter gain": _exciter_gain,
    "inertia": _inertia,
    "reactance": _reactance,
    "tie reactance": _tie_reactance,
}
_TAKEN_OUT: dict[str, tuple[str, Any]] = {
    "no stabilizer": ("stabilizer", "none"),
    "no stabilizers": ("stabilizer", "none"),
    "no governor": ("governor", {"kind": "none"}),
    "no governors": ("governor", {"kind": "none"}),
}
