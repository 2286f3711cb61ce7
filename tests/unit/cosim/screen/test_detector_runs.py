"""Which disturbances a detector is designed by."""

from __future__ import annotations

from itertools import pairwise

import pytest

from interarea.cosim.scenario.names import wrong_targets
from interarea.cosim.screen.detector_design import MOST_BUSES, MOST_MACHINES, _events, _machines
from interarea.models.case.case import load_case
from interarea.models.case.events import event_of


@pytest.mark.parametrize("name", ["new-england", "kundur-manual", "wecc-240"])
def test_the_runs_of_a_design_are_ones_that_the_grid_can_have(name: str) -> None:
    """G10 of New England has constant excitation, so no set-point; so have those of `manual`."""
    case = load_case(name)
    signals = [f"{m.name}_dw" for m in case.machines[-3:]]
    chosen = _machines(case, signals)
    assert {m.name for m in chosen} >= {s.removesuffix("_dw") for s in signals}
    assert len(chosen) == len({m.name for m in chosen}) <= MOST_MACHINES
    events = list(_events(case, chosen, (4,)))
    assert wrong_targets(case, [event_of(e, where="event") for e in events], case.name) == []
    kinds = [e["kind"] for e in events]
    assert kinds.count("pm_pulse") == len(chosen)
    assert kinds.count("vref_pulse") == sum(m.exciter.kind != "constant" for m in chosen)
    assert 3 <= kinds.count("bus_fault") <= MOST_BUSES


def test_machines_that_are_pulsed_are_spread_over_a_large_grid() -> None:
    case = load_case("wecc-240")
    places = [case.machines.index(m) for m in _machines(case, [])]
    assert len({b - a for a, b in pairwise(places)}) == 1
    assert len(places) > MOST_MACHINES // 2
