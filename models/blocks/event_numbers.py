"""The numbers that a plant's `event[k].target` takes, as a table for whoever has the FMU alone."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any

from ..case.case import Case

#: what an event acts on -> rows of the case, and which kinds of event act on it
_ACTS_ON = {
    "bus": ("buses", "bus_fault"),
    "branch": ("branches", "branch_trip, branch_reclose"),
    "machine": ("machines", "vref_pulse, pm_pulse, machine_trip, frequency_trip"),
    "load": ("loads", "load_step, frequency_shed"),
    "shunt": ("shunts", "shunt_switch"),
}


def event_numbers(case: Case) -> dict[str, list[str]]:
    """Return what there is to act on -> names in the order of their numbers, which begin at 1.

    case : with its machines as the plant has them (`in_plant_order`).
    """
    return {
        what: [str(row.number if what == "bus" else row.name) for row in getattr(case, table)]
        for what, (table, _) in _ACTS_ON.items()
    }


def event_numbers_html(case: Case) -> str:
    """Return the table as HTML."""
    rows = "".join(_row(what, names) for what, names in event_numbers(case).items() if names)
    return (
        "<p>An event slot says by <code>event[k].target</code> what it acts on: a number from 1.</p>"
        f"<table><tr><th>kind</th><th>target</th><th>numbers</th></tr>{rows}</table>"
    )


def _row(what: str, names: Sequence[Any]) -> str:
    listed = ", ".join(f"{k}&nbsp;=&nbsp;{html.escape(name)}" for k, name in enumerate(names, start=1))
    return f"<tr><td>{_ACTS_ON[what][1]}</td><td>{what}</td><td>{listed}</td></tr>"
