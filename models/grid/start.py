"""How a case starts: which controls cannot rest, how far the others are from their limits, limits widened."""

from __future__ import annotations

from dataclasses import dataclass

from ..case.case import Case
from ..devices.instance import Margin
from ..devices.language.device import NO_LIMIT
from ..devices.release import released
from .control_tables import Unrest, rests_of, row_name
from .equilibrium import machine_points
from .powerflow import PowerFlow, solve_powerflow


@dataclass(frozen=True)
class ControlMargin:
    """A limited signal of a control at rest."""

    control: str  #: as G1.exciter
    kind: str
    margin: Margin

    @property
    def limit(self) -> str:
        """Name of the nearer limit."""
        m = self.margin
        upper = m.high - m.value <= m.value - m.low
        return (m.high_text if upper else m.low_text) or f"{m.high if upper else m.low:g}"


@dataclass(frozen=True)
class Start:
    """What keeps a case from starting, or, with nothing in `unrest`, how far it is from limits."""

    unrest: tuple[Unrest, ...]
    margins: tuple[ControlMargin, ...]  #: nearest first

    def text(self) -> str:
        """Return one line, and one for each control that cannot rest."""
        if not self.unrest:
            return "start: every control rests within its limits"
        head = f"start: {len(self.unrest)} controls cannot rest (--release-limits widens limits)"
        return "\n".join([head, *(f"  {item.error}" for item in self.unrest)])


def start_of(case: Case, power_flow: PowerFlow | None = None) -> Start:
    """Return how `case` starts at its power flow.

    Raises
    ------
    CaseError : no operating point for another reason than a control.
    """
    power_flow = solve_powerflow(case) if power_flow is None else power_flow
    unrest: list[Unrest] = []
    margins: list[ControlMargin] = []
    points, _, _, buses = machine_points(case, power_flow)
    for k, word, rest in rests_of(case, points, buses)[1]:
        if isinstance(rest, Unrest):
            unrest.append(rest)
            continue
        control, kind = row_name(case, k, word), rest.instance.model.device.key
        margins += [ControlMargin(control, kind, m) for m in rest.margins if m.least < NO_LIMIT / 2]
    return Start(tuple(unrest), tuple(sorted(margins, key=lambda m: m.margin.least)))


def release_limits(case: Case, power_flow: PowerFlow | None = None) -> tuple[Case, tuple[str, ...]]:
    """Return `case` with the limits widened that keep controls from resting, and what was changed.

    Raises
    ------
    CaseError : a control that cannot rest for another reason than a limit.
    """
    change: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    messages: list[str] = []
    for item in start_of(case, power_flow).unrest:
        new = released(item.model, item.numbers, item.seen, item.output, item.who)
        table = "svcs" if item.word == "control" else "machines"
        change.setdefault(table, {}).setdefault(item.row, {})[item.word] = new
        for name, value in new.items():
            messages.append(f"{item.row}.{item.word}.{name}: {item.numbers[name]:g} -> {value:.6g}")
    if not change:
        return case, ()
    return case.with_changes(change), tuple(messages)
