"""What delays a signal, connection by connection, and what became of its packets.

Delay ledger, per connection: *requested* (what the target instance was asked for), *measuring* (the group
delay of the PMU that it leads into), *network* (the channel's own constant latency), *sampling* (held
sub-steps of an FMU that takes no input derivatives), *reporting* (packets: a value is held until the next,
half an interval on average), *jitter mean* (of the random part of the latency) and *master* (what handing
inputs over adds). With inputs as polynomials the master adds nothing. With held inputs it does; a held value
is on average half a step old, so

* ``hold-jacobi``: value at the start of the step; +H/2 into dynamics, +H into
  an output that depends directly on the input and is read at the step's end;
* ``hold-gauss-seidel``: where the source was stepped first, its value at the
  *end* of the step is held back over it: -H/2 into dynamics (a lead), 0 into
  a direct dependence; against the order as above.

A discrete output changes at communication points and is held between them: nothing is added into
dynamics; an output that depends directly on it shows a change at the step's end, +H/2 as a line between
points, unless the change has a point of its own a tick later, as arrivals of packets have.

An instance whose latency covers the step samples its input at communication points, so nothing is held
on the way into it; a shorter latency L is lost in the held value: H - L, or -L after its source.
Packets that come out between communication points wait for the next one, unless their arrivals are
communication points; that wait is the master's too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ..master.graph import Connection
from ..master.master import Master
from ..scenario.channels import Delays
from ..trajectory import Trajectory
from .accumulators import Accumulators


@dataclass(frozen=True)
class LedgerRow:
    """Latencies of one connection in seconds; `note` says what makes them."""

    connection: Connection
    requested_s: float = 0.0
    measuring_s: float = 0.0
    network_s: float = 0.0
    sampling_s: float = 0.0
    reporting_s: float = 0.0
    jitter_mean_s: float = 0.0
    master_s: float = 0.0
    note: str = ""
    direct: bool = False  #: into an output that depends directly on the input, read at the step's end

    @property
    def parts_s(self) -> tuple[float, ...]:
        """What adds up to `total_s`, in the order of `PARTS`."""
        return (
            *(self.measuring_s, self.network_s, self.sampling_s),
            *(self.reporting_s, self.jitter_mean_s, self.master_s),
        )

    @property
    def total_s(self) -> float:
        return sum(self.parts_s)


PARTS = ("measuring", "network", "sampling", "reporting", "jitter mean", "master")


@dataclass(frozen=True)
class DelayLedger:
    """One row for each connection, sorted by target."""

    rows: tuple[LedgerRow, ...]
    step_s: float
    inputs: str
    rounded: tuple[str, ...] = ()  #: times that lay between two ticks of the clock, and what they became

    def __getitem__(self, target: str) -> LedgerRow:
        """Return the row of the connection into `instance.input`."""
        for row in self.rows:
            if str(row.connection.target) == target:
                return row
        known = ", ".join(str(r.connection.target) for r in self.rows)
        raise KeyError(f"no connection into {target!r}; there are {known}")

    def __str__(self) -> str:
        width = max([len(str(r.connection)) for r in self.rows], default=10)
        titles = " ".join(f"{t:>11}" for t in ("requested", *PARTS, "total"))
        lines = [f"{'connection (delays in ms)':<{width}}  {titles}"]
        for r in self.rows:
            cells = " ".join(f"{1e3 * v:11.3f}" for v in (r.requested_s, *r.parts_s, r.total_s))
            lines.append(f"{r.connection!s:<{width}}  {cells}  {r.note}".rstrip())
        return "\n".join([*lines, *self.rounded])

    def as_rows(self) -> list[dict[str, object]]:
        """Return plain dicts, for JSON."""
        return [
            {
                "connection": str(r.connection),
                "requested_s": r.requested_s,
                **{f"{n.replace(' ', '_')}_s": v for n, v in zip(PARTS, r.parts_s, strict=True)},
                "total_s": r.total_s,
                "note": r.note,
            }
            for r in self.rows
        ]


def delay_ledger(
    master: Master, delays: Mapping[str, Delays] | None = None, rounded: Sequence[str] = ()
) -> DelayLedger:
    """Return the delay ledger of a master; `delays`: what is known of channel instances, by name.

    rounded : lines on times that were not taken as written (`roundings`).
    """
    place = {name: k for k, name in enumerate(master.graph.order)}
    known = dict(delays or {})
    rows = [_into_pmu(_row(master, c, place, known), known) for c in master.graph.connections]
    return DelayLedger(tuple(rows), master.step_s, master.plan.inputs, tuple(rounded))


def _row(master: Master, c: Connection, place: Mapping[str, int], delays: Mapping[str, Delays]) -> LedgerRow:
    target = c.target.instance
    if target in master.plan.latency_s:
        ahead = place[c.source.instance] < place[target]
        return _through_channel(master, c, delays.get(target), ahead)
    description, node, h = master.participants[target].description, master.nodes[target], master.step_s
    direct = any(c.target.variable in used for used in description.feedthrough.values())
    late = h if direct else 0.5 * h
    sampled, added, note = 0.0, 0.0, ""
    if master.participants[c.source.instance].description.output_of[c.source.variable].discrete:
        exact = c.source.instance in delays and bool(master.clock.points)
        added = 0.5 * h if direct and not exact else 0.0
        note = "discrete: changes at communication points"
    elif master.plan.inputs == "hold-gauss-seidel" and place[c.source.instance] < place[target]:
        added, note = (0.0 if direct else -0.5 * h), "value at the end of the step held"
    elif master.plan.inputs in ("hold-jacobi", "hold-gauss-seidel"):
        added, note = late, "value at the start of the step held"
    elif node.order == 0 and node.substeps > 1:
        note = f"no input derivatives: means over {node.substeps} parts of a step"
    elif node.order == 0:
        sampled, note = late, "steps of one length and no input derivatives: held"
    return LedgerRow(c, sampling_s=sampled, master_s=added, note=note, direct=direct)


def _into_pmu(row: LedgerRow, delays: Mapping[str, Delays]) -> LedgerRow:
    """Return the row with the group delay of the PMU that it leads into, if it does."""
    known = delays.get(row.connection.target.instance)
    if known is None or not known.measuring_s:
        return row
    return replace(row, requested_s=known.requested_s, measuring_s=known.measuring_s)


def _through_channel(master: Master, c: Connection, known: Delays | None, ahead: bool) -> LedgerRow:
    latency = master.plan.latency_s[c.target.instance]
    known = known or Delays(latency, latency)
    added, notes = known.waiting_s, []
    if c.cut:
        notes.append("first in the step")
    elif master.plan.inputs.startswith("hold"):
        newest = ahead and master.plan.inputs == "hold-gauss-seidel"
        added += (0.0 if newest else master.step_s) - latency
        notes.append(f"value at the {'end' if newest else 'start'} of the step held")
    if known.seed is not None:
        notes.append(known.seed_of(c.target.instance))
    if known.waiting_s:
        notes.append("arrivals are delayed to a communication point")
    return LedgerRow(
        c,
        known.requested_s,
        network_s=known.network_s,
        reporting_s=known.reporting_s,
        jitter_mean_s=known.jitter_mean_s,
        master_s=added,
        note="; ".join(notes),
    )


@dataclass(frozen=True)
class PacketLedger:
    """Per channel instance: packets sent, delivered, dropped, late, and the age of information, s."""

    rows: Mapping[str, Mapping[str, float]]

    def __getitem__(self, channel: str) -> Mapping[str, float]:
        """Return the counts of a channel; the error names the channels that count."""
        if channel not in self.rows:
            raise KeyError(f"{channel!r} counts no packets; there are {', '.join(self.rows) or 'none'}")
        return self.rows[channel]

    def __str__(self) -> str:
        if not self.rows:
            return "no channel counts packets"
        lines = []
        for name, counts in self.rows.items():
            cells = ", ".join(
                f"{key} {value:.6g}{' s' if key.startswith('age') else ''}" for key, value in counts.items()
            )
            lines.append(f"{name}: {cells}")
        return "\n".join(lines)


#: variables a channel may offer, by what the ledger calls them
PACKET_COUNTS = ("sent", "delivered", "dropped", "late")


def packet_ledger(trajectory: Trajectory, accumulators: Accumulators) -> PacketLedger:
    """Return what the channels counted by the end of a run: from its last part, and what all parts add up to.

    Of a channel without packets the age of its information is given: at the end, and mean and largest over
    the communication points.
    """
    rows: dict[str, dict[str, float]] = {}
    for name in accumulators.channels:
        row: dict[str, float] = {}
        for count in PACKET_COUNTS:
            if f"{name}.{count}" in trajectory:
                row[count] = float(trajectory[f"{name}.{count}"][-1])
        if not row.get("sent"):
            row = {}  # continuous: nothing travels in packets
        else:
            arrived = row.get("delivered", 0.0) + row.get("dropped", 0.0) + row.get("late", 0.0)
            row["in transit"] = row["sent"] - arrived
        if name in accumulators.ages:
            age = accumulators.ages[name]
            row |= {"age": age.last, "age mean": age.mean, "age max": age.largest}
        if row:
            rows[name] = row
    return PacketLedger(rows)


def explain(master: Master, ledger: DelayLedger) -> str:
    """Return in words how a master steps: clock, order, loops, unconnected inputs, delay ledger."""
    g = master.graph
    lines = [
        f"step {1e3 * master.step_s:g} ms ({master.step_reason}), {len(master.clock.steps)} steps, "
        f"inputs: {master.plan.inputs}",
        "events at " + (", ".join(f"{m / 1e9:.9g}" for m in master.clock.event_times) or "none") + " s",
        *([f"packets are released at {n} more points"] if (n := len(master.clock.points)) else []),
        "order of a step: "
        + " | ".join(" <-> ".join(x.members) if x.is_loop else x.members[0] for x in g.groups),
    ]
    if master.ran:
        lines.append(f"stepped by: {master.ran}")
    lines += [
        f"loop without a channel: {' <-> '.join(x.members)}, {master.stepping.how(x)}"
        for x in g.groups
        if x.is_loop
    ]
    for e in g.unconnected:
        start = master.participants[e.instance].description.input_of[e.variable].start
        lines.append(f"not connected: {e} keeps its start value {start:g}")
    return "\n".join([*lines, "", str(ledger)])
