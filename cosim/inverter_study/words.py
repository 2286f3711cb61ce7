"""The conclusions of a sweep of inverters, derived from its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from interarea.design.robust.signal_worth import PAYS

Row = Mapping[str, Any]
SHOWN = 5e-4  #: of a damping ratio: what three digits after the point show


def conclusion(rows: Sequence[Row]) -> list[str]:
    """Return the conclusions for one grid: each kind of inverter, then their comparison.

    >>> conclusion([])
    ['no step was computed']
    """
    done = [row for row in rows if row["complete"] is not None]
    if not done:
        return ["no step was computed"]
    kinds = list(dict.fromkeys(row["kind"] for row in done))
    lines = [line for kind in kinds for line in _of_kind(kind, [r for r in done if r["kind"] == kind])]
    return [*lines, *_beside(done, kinds), _proof(rows)]


def _of_kind(kind: str, rows: Sequence[Row]) -> list[str]:
    lines = [f"{kind}: {text}" for text in (_inter_area(rows), _worst(rows), _clearing(rows)) if text]
    lines += [f"{kind}: {text}" for text in (_controller(rows), _link(rows)) if text]
    return lines


def _inter_area(rows: Sequence[Row]) -> str:
    """Return the change of the inter-area mode, and its least damping."""
    seen = [row for row in rows if row["inter_area_hz"] is not None]
    if len(seen) < 2:
        return ""
    first, last = seen[0], seen[-1]
    least = min(seen, key=lambda row: row["inter_area_damping"])
    text = (
        f"from {_percent(first)} to {_percent(last)} the inter-area mode changes from "
        f"{first['inter_area_hz']:.2f} to {last['inter_area_hz']:.2f} Hz and its damping ratio from "
        f"{first['inter_area_damping']:.3f} to {last['inter_area_damping']:.3f}"
    )
    if least not in (first, last):
        text += f", minimum {least['inter_area_damping']:.3f} at {_percent(least)}"
    gone = [row for row in rows if row["share"] > last["share"]]
    return f"{text}; at larger shares no mode has its shape" if gone else text


def _worst(rows: Sequence[Row]) -> str:
    """Return the least damped swing mode, and the shares at which the grid is unstable."""
    grows = [row for row in rows if not row["stable"]]
    text = "stable at every share"
    if grows:
        text = f"unstable at {', '.join(_percent(row) for row in grows)} ({grows[0]['growing']})"
    seen = [row for row in rows if row["worst_damping"] is not None]
    if not seen:
        return text
    least = min(seen, key=lambda row: row["worst_damping"])
    return (
        f"{text}; the least damped swing mode is {least['worst_name']} at {_percent(least)}: "
        f"{least['worst_hz']:.2f} Hz, damping ratio {least['worst_damping']:.3f}"
    )


def _clearing(rows: Sequence[Row]) -> str:
    """Return the change of the critical clearing time."""
    seen = [row for row in rows if row["clearing_cycles"] is not None]
    if len(seen) < 2:
        return ""
    least = min(seen, key=lambda row: row["clearing_cycles"])
    return (
        f"the critical clearing time is {seen[0]['clearing_cycles']:.1f} cycles at {_percent(seen[0])}, "
        f"{seen[-1]['clearing_cycles']:.1f} at {_percent(seen[-1])}, minimum "
        f"{least['clearing_cycles']:.1f} at {_percent(least)}"
    )


def _controller(rows: Sequence[Row]) -> str:
    """Return at which shares the bundled controller, designed without inverters, is still effective."""
    seen = [row for row in rows if row["controlled_stable"] is not None and row["worst_damping"] is not None]
    if not seen:
        return ""
    grows = [_percent(row) for row in seen if row["stable"] and not row["controlled_stable"]]
    shorter = [_percent(row) for row in seen if _is_shorter(row)]
    text = f"with the bundled controller the damping of the worst swing mode is {_moved(seen)}"
    if grows:
        text += f"; the loop is unstable at {', '.join(grows)}"
    if shorter:
        text += f"; the critical clearing time is shorter with it at {', '.join(shorter)}"
    return text


def _moved(rows: Sequence[Row]) -> str:
    """Return the shares at which the damping of the worst swing mode is higher, equal and lower."""
    groups: dict[str, list[str]] = {"higher": [], "equal": [], "lower": []}
    for row in rows:
        gain = _gain(row)
        groups["higher" if gain > SHOWN else "equal" if gain >= -SHOWN else "lower"].append(_percent(row))
    where = {how: "every share" if len(at) == len(rows) else ", ".join(at) for how, at in groups.items()}
    return "; ".join(f"{how} at {at}" for how, at in where.items() if at)


def _is_shorter(row: Row) -> bool:
    """Whether the critical clearing time is shorter with the controller; False if either is unknown."""
    without, controlled = row["clearing_cycles"], row["clearing_controlled"]
    return None not in (without, controlled) and not controlled >= without


def _gain(row: Row) -> float:
    """Return by how much the worst swing is damped more: inf without a swing in the region, -inf unstable."""
    if not row["controlled_stable"]:
        return -math.inf
    with_it = row["controlled_worst_damping"]
    return math.inf if with_it is None else float(with_it - row["worst_damping"])


def _link(rows: Sequence[Row]) -> str:
    """Return at which shares a signal of another area pays."""
    seen = [row for row in rows if row["link_own"] is not None]
    if not seen:
        return ""
    paying = [row for row in seen if row["link_afar"] - row["link_own"] >= PAYS]
    computed = ", ".join(_percent(row) for row in seen)
    if not paying:
        return f"a signal of another area does not pay (computed at {computed})"
    gains = ", ".join(f"{_percent(row)} ({row['link_own']:.3f} to {row['link_afar']:.3f})" for row in paying)
    return f"a signal of another area pays at {gains}; computed at {computed}"


def _beside(rows: Sequence[Row], kinds: Sequence[str]) -> list[str]:
    """Return the damping of both kinds at the largest share that both have."""
    if len(kinds) < 2:
        return []
    worst = [{r["share"]: r["worst_damping"] for r in rows if r["kind"] == kind} for kind in kinds]
    both = [s for s in worst[0] if worst[0][s] is not None and worst[1].get(s) is not None and s > 0.0]
    if not both:
        return []
    share = max(both)
    listed = ", ".join(f"{kind} {one[share]:.3f}" for kind, one in zip(kinds, worst, strict=True))
    return [f"damping ratio of the worst swing mode at {100 * share:.0f} %: {listed}"]


def _proof(rows: Sequence[Row]) -> str:
    """Return of how many rows the modes are proven complete."""
    lists = [row[key] for row in rows for key in ("complete", "controlled_complete") if row[key] is not None]
    if all(lists):
        return f"an independent count confirms that all {len(lists)} lists of modes are complete"
    return (
        f"an independent count confirms that {sum(lists)} of {len(lists)} lists of modes are complete; "
        "the table names the others"
    )


def _percent(row: Row) -> str:
    return f"{100 * row['share']:.0f} %"
