"""Start of a case: controls without an equilibrium, distances of the others from limits, widened limits."""

from __future__ import annotations

from dataclasses import dataclass

from ..case.case import Case, CaseError
from ..devices.instance import Margin
from ..devices.language.device import NO_LIMIT
from ..devices.release import released
from ..errors import DeviceError
from .control_tables import Unrest, rests_of, row_name, table_of
from .equilibrium import machine_points
from .powerflow import PowerFlow, solve_powerflow, with_nodes
from .series import with_series_nodes

#: a signal nearer to its limit than this, relative to it, rests at the limit: linear models hold for one
#: side of it, and `release_limits` widens it
AT_LIMIT = 1e-6

#: limit of the device of a dc link -> key of its row
LINK_LIMITS = {
    "AMIN": "alpha_min_deg",
    "AMAX": "alpha_max_deg",
    "GMIN": "gamma_min_deg",
    "GMAX": "gamma_max_deg",
}
LINK_LIMITS |= {"IMIN": "i_min_pu", "IMAX": "i_max_pu"}


@dataclass(frozen=True)
class ControlMargin:
    """A limited signal of a control at the equilibrium."""

    control: str  #: as G1.exciter
    kind: str
    margin: Margin
    at_bus: bool = False  #: of a device at a bus, which on its limit is another system on either side

    @property
    def limit(self) -> str:
        """Name of the nearer limit."""
        m = self.margin
        upper = m.high - m.value <= m.value - m.low
        return (m.high_text if upper else m.low_text) or f"{m.high if upper else m.low:g}"

    @property
    def fixed(self) -> bool:
        """Whether the limit is a fixed number, not a parameter."""
        return self.limit.lstrip("-").replace(".", "", 1).isdigit()

    @property
    def held(self) -> bool:
        """Whether its limits coincide, so that it is constant."""
        return self.margin.low == self.margin.value == self.margin.high

    @property
    def at_limit(self) -> bool:
        """Whether it is at that limit."""
        return self.margin.least <= AT_LIMIT * max(1.0, abs(self.margin.value))


@dataclass(frozen=True)
class Start:
    """Obstacles to the start of a case, or, if `unrest` is empty, its distances from limits."""

    unrest: tuple[Unrest, ...]
    margins: tuple[ControlMargin, ...]  #: nearest first

    def text(self) -> str:
        """Return one line, and one for each control without an equilibrium."""
        if not self.unrest:
            at = self._at_limits() or ["start: every control is within its limits"]
            return "\n".join([*at, *self._waiting(), *self._held()])
        head = f"start: {len(self.unrest)} controls have no equilibrium (--release-limits widens limits)"
        return "\n".join([head, *(f"  {item.error}" for item in self.unrest)])

    def _at_limits(self) -> list[str]:
        at = [item for item in self.margins if item.at_limit and not item.fixed and not item.held]
        if not at:
            return []
        head = f"start: {len(at)} controls are at a limit (--release-limits widens it)"
        listed = (
            f"  {one.control}: {one.margin.signal} is {one.margin.value:.6g} at the equilibrium, at "
            f"{one.limit} "
            f"({one.margin.least:.1g} from it); {self._linear(one)}"
            for one in at
        )
        return [head, *listed]

    @staticmethod
    def _linear(one: ControlMargin) -> str:
        """Treatment of a control at its limit in a linear study, as in `require_off_limits`."""
        if one.at_bus:
            return "a linear study is rejected, because the limit acts in one direction"
        return f"linear models treat the limit as {'active' if one.margin.least < 0.0 else 'inactive'}"

    def _waiting(self) -> list[str]:
        """Signals that are at a limit by design, such as the integrator of a limiter at 0: one line."""
        at = [item for item in self.margins if item.at_limit and item.fixed and not item.held]
        signals = ", ".join(dict.fromkeys(f"{one.kind} {one.margin.signal}" for one in at))
        return [f"start: {len(at)} signals are at a limit by design ({signals})"] if at else []

    def _held(self) -> list[str]:
        held = ", ".join(f"{item.control} {item.margin.signal}" for item in self.margins if item.held)
        return [f"start: limits that coincide, so the signal is constant: {held}"] if held else []


def start_of(case: Case, power_flow: PowerFlow | None = None) -> Start:
    """Return how `case` starts at its power flow.

    Raises
    ------
    CaseError : no operating point, for a reason other than a control.
    """
    case, power_flow = _as_plant(case, power_flow)
    unrest: list[Unrest] = []
    margins: list[ControlMargin] = []
    points, _, _, buses = machine_points(case, power_flow)
    at_buses = {svc.name for svc in case.svcs} | {row.name for row in (*case.tcscs, *case.links)}
    for k, word, rest in rests_of(case, points, buses)[1]:
        if isinstance(rest, Unrest):
            unrest.append(rest)
            continue
        control, kind = row_name(case, k, word), rest.instance.model.device.key
        at_bus = control in at_buses
        margins += [ControlMargin(control, kind, m, at_bus) for m in rest.margins if m.least < NO_LIMIT / 2]
    return Start(tuple(unrest), tuple(sorted(margins, key=lambda m: m.margin.least)))


def require_off_limits(case: Case) -> None:
    """Reject a linear study if a device at a bus is at its limit: the linear system differs on either side.

    Raises
    ------
    CaseError : the signal, its limit, its distance, and the remedy; as `start_of`.
    """
    lines = {row.name for row in case.tcscs}
    links, vscs = {row.name for row in case.hvdcs}, {row.name for row in case.vscs}
    for item in start_of(case).margins if case.svcs or lines or links or vscs else ():
        m = item.margin
        if item.at_bus and item.at_limit:
            table, limit, elsewhere = "svcs", item.limit, "V_pu, Q_mvar"
            if item.control in lines:
                table, limit, elsewhere = "tcscs", f"x_{limit[1:].lower()}_pu", "x0_pu"
            elif item.control in links:
                table, limit, elsewhere = "hvdcs", LINK_LIMITS.get(limit, limit), "gamma_deg, idc_ka or P_mw"
            elif item.control in vscs:
                table, elsewhere = "vscs", "P_mw, from_q_mvar, to_q_mvar"
            raise CaseError(
                f"{case.name}: {table}.{item.control}: {m.signal} ({m.text}) is at {m.value:.6g}, "
                f"{max(m.least, 0.0):.1g} from its limit {limit}; the limit acts in one direction, so a "
                f"linear study has two answers; widen {limit}, or change the start ({elsewhere})"
            )


def release_limits(case: Case, power_flow: PowerFlow | None = None) -> tuple[Case, tuple[str, ...]]:
    """Return `case` with the limits widened at or beyond which controls would start, and the changes.

    Raises
    ------
    CaseError : a control without an equilibrium, for a reason other than a limit.
    """
    original, (case, power_flow) = case, _as_plant(case, power_flow)
    # these rest within their limits, or there is no case
    within = {row.name for row in (*case.tcscs, *case.links)}
    points, _, _, buses = machine_points(case, power_flow)
    change: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    messages: list[str] = []
    resting = {
        (k, word) for k, word, rest in rests_of(case, points, buses)[1] if not isinstance(rest, Unrest)
    }
    for k, word, item in rests_of(case, points, buses, room=AT_LIMIT)[1]:
        if not isinstance(item, Unrest) or item.row in within:
            continue
        try:
            new = released(item.model, item.numbers, item.seen, item.output, item.who, AT_LIMIT)
        except DeviceError:
            if (k, word) in resting:  # at a limit that no parameter moves it stays
                continue
            new = released(item.model, item.numbers, item.seen, item.output, item.who)
        change.setdefault(table_of(item.model.device.kind), {}).setdefault(item.row, {})[item.word] = new
        for name, value in new.items():
            messages.append(f"{item.row}.{item.word}.{name}: {item.numbers[name]:g} -> {value:.6g}")
    if not change:
        return original, ()
    return original.with_changes(change), tuple(messages)


def _as_plant(case: Case, power_flow: PowerFlow | None) -> tuple[Case, PowerFlow]:
    case = with_series_nodes(case)
    return case, solve_powerflow(case) if power_flow is None else with_nodes(power_flow, case)
