"""Which disturbances a detector is designed by, and how far its runs are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from interarea.cosim.designs.fault_runs import TOGETHER, Outcome
from interarea.cosim.scenario.names import wrong_targets
from interarea.cosim.screen import detector_design
from interarea.cosim.screen.detector_design import (
    MOST_BUSES,
    MOST_MACHINES,
    MOST_TRIPS,
    _events,
    _machines,
    _near,
    _trips,
    design_detector,
)
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
    near = _near(case, signals)
    events = list(_events(case, chosen, (4,), near))
    assert wrong_targets(case, [event_of(e, where="event") for e in events], case.name) == []
    kinds = [e["kind"] for e in events]
    assert kinds.count("pm_pulse") == len(chosen)
    assert kinds.count("vref_pulse") == sum(m.exciter.kind != "constant" for m in chosen)
    assert 3 <= kinds.count("bus_fault") <= MOST_BUSES + len(near)
    assert near <= {e["bus"] for e in events if e["kind"] == "bus_fault"}


def test_faults_are_also_at_the_machines_whose_speeds_are_compared() -> None:
    """Bus 2630 of G2630 has one branch, to bus 2610; none of them is among every 21st bus."""
    case = load_case("wecc-240")
    assert _near(case, ["G2630_dw"]) == {2630, 2610}
    faults = [
        [e["bus"] for e in _events(case, [], (4,), near) if e["kind"] == "bus_fault"]
        for near in ((), (2630, 2610))
    ]
    assert {*faults[1]} - {*faults[0]} == {2630, 2610}
    assert len(faults[1]) == len(faults[0]) + 2


@pytest.mark.parametrize("name", ["two-area-thesis", "new-england", "nets-nyps", "wecc-240"])
def test_branches_that_trip_cut_off_no_bus(name: str) -> None:
    case = load_case(name)
    at = {bus.number: k for k, bus in enumerate(case.buses)}

    def parts(without: str | None) -> int:
        links = [(at[b.from_bus], at[b.to_bus]) for b in case.branches if b.in_service and b.name != without]
        rows, columns = np.array(links).T
        matrix = coo_array((np.ones(len(links)), (rows, columns)), shape=(len(at), len(at)))
        return int(connected_components(matrix, directed=False)[0])

    trips = _trips(case)
    of_tie = () if case.tie is None else case.tie.branches
    assert {*of_tie} <= {*trips}
    assert len(of_tie) < len(trips) == len({*trips}) <= MOST_TRIPS + len(of_tie)
    assert {parts(branch) for branch in trips} == {parts(None)}
    assert {e["branch"] for e in _events(case, [], (4, 8), ()) if e["kind"] == "branch_trip"} == {*trips}
    # a machine behind one transformer is cut off with it
    behind = [b.name for b in case.branches if parts(b.name) > parts(None)]
    assert behind and not {*behind} & {*trips}


def test_machines_that_are_pulsed_are_spread_over_a_large_grid() -> None:
    case = load_case("wecc-240")
    places = [case.machines.index(m) for m in _machines(case, [])]
    assert len({b - a for a, b in pairwise(places)}) == 1
    assert len(places) > MOST_MACHINES // 2


class Ring(dict[str, np.ndarray]):
    """A run's signals: damped modes, of random sizes and phases, from 2 s on."""

    def __init__(self, random: np.random.Generator) -> None:
        self.time_s = np.arange(0.0, 10.0, 0.02)
        t = np.clip(self.time_s - 2.0, 0.0, None)
        sizes, phases = random.uniform(5e-4, 2e-3, (4, 2)), random.uniform(0.0, 6.3, 2)
        waves = np.exp(-0.2 * t) * np.sin(np.outer([3.5, 7.0], t) + phases[:, None]) * (t > 0.0)
        super().__init__({f"plant.G{i + 1}_dw": sizes[i] @ waves for i in range(4)})
        self.units = dict.fromkeys(self, "pu")


@pytest.mark.slow
def test_the_share_that_is_reported_is_that_of_the_runs_that_have_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Runs that are stepped together end together: the time left follows from the first report on."""
    ran: list[int] = []
    random = np.random.default_rng(3)

    class Counted:
        def __init__(self, *_: Any) -> None: ...
        def __enter__(self) -> Counted:
            return self

        def __exit__(self, *_: object) -> None: ...
        def judged(self, part: Sequence[Any], _: object) -> Iterator[tuple[Outcome, Ring]]:
            ran.append(len(part))
            for _run in part:
                yield Outcome(1.0, None), Ring(random)

    monkeypatch.setattr(detector_design, "FaultRuns", Counted)
    reported: list[float] = []
    signals = [f"G{i}_dw" for i in range(1, 5)]
    design = design_detector("two-area-thesis", "robust", signals, progress=reported.append)
    assert sum(ran) == design.made_of + design.judged_by == 162
    assert max(ran) <= TOGETHER
    assert reported == pytest.approx(np.cumsum(ran) / sum(ran))
