"""What delays a signal, connection by connection, and what became of its packets.

Delay ledger, per connection: *requested* (what the target instance declares),
*network* (the same: a channel's own latency), *sampling* (held sub-steps of an
FMU that takes no input derivatives) and *master* (what handing inputs over
adds). With inputs as polynomials the master adds nothing. With held inputs it
does; a held value is on average half a step old, so

* ``hold-jacobi``: value at the start of the step; +H/2 into dynamics, +H into
  an output that depends directly on the input and is read at the step's end;
* ``hold-gauss-seidel``: where the source was stepped first, its value at the
  *end* of the step is held back over it: -H/2 into dynamics (a lead), 0 into
  a direct dependence; against the order as above.

An instance with a declared latency samples its input at communication points,
so nothing is held on the way into it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .graph import Connection
from .master import Master


@dataclass(frozen=True)
class LedgerRow:
    """Latencies of one connection in seconds; `note` says what makes them."""

    connection: Connection
    requested_s: float
    network_s: float
    sampling_s: float
    master_s: float
    note: str = ""

    @property
    def total_s(self) -> float:
        return self.network_s + self.sampling_s + self.master_s


@dataclass(frozen=True)
class DelayLedger:
    """One row for each connection, sorted by target."""

    rows: tuple[LedgerRow, ...]
    step_s: float
    inputs: str

    def __getitem__(self, target: str) -> LedgerRow:
        """Return the row of the connection into `instance.input`."""
        for row in self.rows:
            if str(row.connection.target) == target:
                return row
        known = ", ".join(str(r.connection.target) for r in self.rows)
        raise KeyError(f"no connection into {target!r}; there are {known}")

    def __str__(self) -> str:
        width = max([len(str(r.connection)) for r in self.rows], default=10)
        titles = " ".join(f"{t:>10}" for t in ("requested", "network", "sampling", "master"))
        head = f"{'connection':<{width}}  {titles}  (ms)"
        lines = [head]
        for r in self.rows:
            numbers = (r.requested_s, r.network_s, r.sampling_s, r.master_s)
            cells = " ".join(f"{1e3 * v:10.3f}" for v in numbers)
            lines.append(f"{r.connection!s:<{width}}  {cells}  {r.note}".rstrip())
        return "\n".join(lines)

    def as_rows(self) -> list[dict[str, object]]:
        """Return plain dicts, for JSON."""
        return [
            {
                "connection": str(r.connection),
                "requested_s": r.requested_s,
                "network_s": r.network_s,
                "sampling_s": r.sampling_s,
                "master_s": r.master_s,
                "note": r.note,
            }
            for r in self.rows
        ]


def delay_ledger(master: Master) -> DelayLedger:
    """Return the delay ledger of a master."""
    place = {name: k for k, name in enumerate(master.graph.order)}
    rows = [_row(master, c, place) for c in master.graph.connections]
    return DelayLedger(tuple(rows), master.step_s, master.inputs)


def _row(master: Master, c: Connection, place: Mapping[str, int]) -> LedgerRow:
    target = c.target.instance
    network = master.latency_s.get(target, 0.0)
    description = master.participants[target].description
    node = master.nodes[target]
    signal = next(s for s in master.signals if s.name == str(c.source))
    direct = any(c.target.variable in used for used in description.feedthrough.values())
    h = master.step_s
    if target in master.latency_s:
        return LedgerRow(c, network, network, 0.0, 0.0, "cut: first in the step" if c.cut else "")
    if master.inputs == "hold-jacobi":
        return LedgerRow(
            c, network, network, 0.0, h if direct else 0.5 * h, "value at the start of the step held"
        )
    if master.inputs == "hold-gauss-seidel":
        ahead = place[c.source.instance] < place[target]
        added = (0.0 if direct else -0.5 * h) if ahead else (h if direct else 0.5 * h)
        note = "value at the end of the step held" if ahead else "value at the start of the step held"
        return LedgerRow(c, network, network, 0.0, added, note)
    if signal.kind == "held":
        return LedgerRow(c, network, network, 0.0, 0.0, "discrete: changes at communication points")
    if node.order == 0:
        if node.substeps > 1:
            note = f"no input derivatives: means over {node.substeps} parts of a step"
            return LedgerRow(c, network, network, 0.0, 0.0, note)
        late = h if direct else 0.5 * h
        return LedgerRow(c, network, network, late, 0.0, "steps of one length and no input derivatives: held")
    return LedgerRow(c, network, network, 0.0, 0.0, "")


@dataclass(frozen=True)
class PacketLedger:
    """Per channel instance: what it counted (sent, delivered, dropped, late, age of information in s)."""

    rows: Mapping[str, Mapping[str, float]]

    def __str__(self) -> str:
        if not self.rows:
            return "no channel counts packets"
        lines = []
        for name, counts in self.rows.items():
            cells = ", ".join(f"{key} {value:.6g}" for key, value in counts.items())
            lines.append(f"{name}: {cells}")
        return "\n".join(lines)


#: variables a channel may offer, by what the ledger calls them
PACKET_VARIABLES = ("sent", "delivered", "dropped", "late", "age")


def explain(master: Master) -> str:
    """Return in words how a master steps: clock, order, loops, unconnected inputs, delay ledger."""
    g = master.graph
    lines = [
        f"step {1e3 * master.step_s:g} ms, {len(master.clock.steps)} steps, inputs: {master.inputs}",
        "events at " + (", ".join(f"{m / 1e9:.9g}" for m in master.clock.marks) or "none") + " s",
        "order of a step: "
        + " | ".join(" <-> ".join(x.members) if x.is_loop else x.members[0] for x in g.groups),
    ]
    lines += [
        f"loop without a channel: {' <-> '.join(x.members)}, {master.how(x)}" for x in g.groups if x.is_loop
    ]
    lines += [f"not connected: {e} keeps its start value {master.start_of(e):g}" for e in g.unconnected]
    return "\n".join([*lines, "", str(delay_ledger(master))])
