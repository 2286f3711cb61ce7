"""What a sweep of inverters comes to, in sentences that follow from its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from interarea.design.robust.signal_worth import PAYS

Row = Mapping[str, Any]
SHOWN = 5e-4  #: of a damping ratio: what three digits after the point show


def conclusion(rows: Sequence[Row]) -> list[str]:
    """Return what the rows of one grid come to, each kind of inverter in turn, then both beside each other.

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
    """Return where the inter-area mode goes, and where its damping is least."""
    seen = [row for row in rows if row["inter_area_hz"] is not None]
    if len(seen) < 2:
        return ""
    first, last = seen[0], seen[-1]
    least = min(seen, key=lambda row: row["inter_area_damping"])
    text = (
        f"from {_percent(first)} to {_percent(last)} the inter-area mode goes from "
        f"{first['inter_area_hz']:.2f} to {last['inter_area_hz']:.2f} Hz and its damping ratio from "
        f"{first['inter_area_damping']:.3f} to {last['inter_area_damping']:.3f}"
    )
    if least not in (first, last):
        text += f", least {least['inter_area_damping']:.3f} at {_percent(least)}"
    gone = [row for row in rows if row["share"] > last["share"]]
    return f"{text}; beyond that no swing has its shape" if gone else text


def _worst(rows: Sequence[Row]) -> str:
    """Return the swing that is damped least of all, and from which share on something grows."""
    grows = [row for row in rows if not row["stable"]]
    text = "stable at every share"
    if grows:
        text = f"unstable at {', '.join(_percent(row) for row in grows)} ({grows[0]['growing']})"
    seen = [row for row in rows if row["worst_damping"] is not None]
    if not seen:
        return text
    least = min(seen, key=lambda row: row["worst_damping"])
    return (
        f"{text}; the worst swing of all is {least['worst_name']} at {_percent(least)}, "
        f"{least['worst_hz']:.2f} Hz with {least['worst_damping']:.3f}"
    )


def _clearing(rows: Sequence[Row]) -> str:
    """Return what becomes of the clearing time."""
    seen = [row for row in rows if row["clearing_cycles"] is not None]
    if len(seen) < 2:
        return ""
    least = min(seen, key=lambda row: row["clearing_cycles"])
    return (
        f"the fault may last {seen[0]['clearing_cycles']:.1f} cycles at {_percent(seen[0])}, "
        f"{seen[-1]['clearing_cycles']:.1f} at {_percent(seen[-1])}, and least "
        f"{least['clearing_cycles']:.1f} at {_percent(least)}"
    )


def _controller(rows: Sequence[Row]) -> str:
    """Return at which shares the bundled controller, designed without inverters, still helps."""
    seen = [row for row in rows if row["controlled_stable"] is not None and row["worst_damping"] is not None]
    if not seen:
        return ""
    grows = [_percent(row) for row in seen if row["stable"] and not row["controlled_stable"]]
    shorter = [_percent(row) for row in seen if _is_shorter(row)]
    text = f"with the bundled controller the worst swing is damped {_moved(seen)}"
    if grows:
        text += f"; the loop is unstable at {', '.join(grows)}"
    if shorter:
        text += f"; the fault may last less with it at {', '.join(shorter)}"
    return text


def _moved(rows: Sequence[Row]) -> str:
    """Return at which shares the worst swing is damped more, the same and less."""
    groups: dict[str, list[str]] = {"more": [], "the same": [], "less": []}
    for row in rows:
        gain = _gain(row)
        groups["more" if gain > SHOWN else "the same" if gain >= -SHOWN else "less"].append(_percent(row))
    where = {how: "every share" if len(at) == len(rows) else ", ".join(at) for how, at in groups.items()}
    return "; ".join(f"{how} at {at}" for how, at in where.items() if at)


def _is_shorter(row: Row) -> bool:
    """Whether the fault may last less with the controller; False where either is not known."""
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
    asked = ", ".join(_percent(row) for row in seen)
    if not paying:
        return f"a signal of another area does not pay; asked at {asked}"
    gains = ", ".join(f"{_percent(row)} ({row['link_own']:.3f} to {row['link_afar']:.3f})" for row in paying)
    return f"a signal of another area pays at {gains}; asked at {asked}"


def _beside(rows: Sequence[Row], kinds: Sequence[str]) -> list[str]:
    """Return which kind damps more at the largest share that both have."""
    if len(kinds) < 2:
        return []
    worst = [{r["share"]: r["worst_damping"] for r in rows if r["kind"] == kind} for kind in kinds]
    both = [s for s in worst[0] if worst[0][s] is not None and worst[1].get(s) is not None and s > 0.0]
    if not both:
        return []
    share = max(both)
    listed = ", ".join(f"{kind} {one[share]:.3f}" for kind, one in zip(kinds, worst, strict=True))
    return [f"worst swing at {100 * share:.0f} %: {listed}"]


def _proof(rows: Sequence[Row]) -> str:
    """Return of how many rows the modes are proven complete."""
    lists = [row[key] for row in rows for key in ("complete", "controlled_complete") if row[key] is not None]
    if all(lists):
        return f"all {len(lists)} lists of modes are proven complete by an independent count"
    return (
        f"{sum(lists)} of {len(lists)} lists of modes are proven complete, the others are named in the table"
    )


def _percent(row: Row) -> str:
    return f"{100 * row['share']:.0f} %"
