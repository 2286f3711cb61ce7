"""Runs whose plants advance side by side: the bits of each run alone, whatever the others do."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario_loop import Loop

from interarea.cosim.errors import StepError
from interarea.cosim.master.lockstep import advance_together
from interarea.cosim.master.master import Master
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.lane_library import GroupLibrary, plant_group
from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import load_case

REMOTE = {"signal": "G2_dw", "latency_s": 0.1}
LOCAL = {"signal": "G4_dw", "latency_s": 0.1}
CHANNELS = {"remote": REMOTE, "local": LOCAL}
NOISY = {
    "reporting_interval_s": 0.02,
    "jitter_s": 0.03,
    "seed": 7,
    "loss": {"kind": "bernoulli", "rate": 0.2},
}
LOST = {"outages_s": [[0.31, 0.6], [0.75, 0.9]]}


def pulse(k: int) -> dict[str, Any]:
    start = 0.2 + 0.0137 * k
    return {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.02 + 0.01 * k, "start_s": start, "end_s": 0.7}


def fault(bus: int, start_s: float, end_s: float, **more: float) -> dict[str, Any]:
    return {"kind": "bus_fault", "bus": bus, "start_s": start_s, "end_s": end_s} | more


def trip(machine: str, start_s: float) -> dict[str, Any]:
    return {"kind": "machine_trip", "machine": machine, "start_s": start_s}


#: runs as unlike each other as one grid allows
RUNS: tuple[dict[str, Any], ...] = (
    {"event": [pulse(0)]},
    {"event": [pulse(1)], "channels": {"remote": REMOTE | {"latency_s": 0.0331}, "local": LOCAL}},
    {"event": [fault(8, 0.2033, 0.3), pulse(2)]},
    {"event": [fault(7, 0.2, 0.2704), trip("G2", 0.5071)], "stop_s": 0.8},
    {"event": [pulse(3)], "channels": {"remote": REMOTE | LOST, "local": LOCAL | {"on_loss": "hold"} | LOST}},
    {"event": [pulse(4)], "channels": {"remote": REMOTE | NOISY, "local": LOCAL}},
    {"event": [fault(9, 0.05, 0.1, x_pu=0.01), fault(5, 0.1, 0.2, x_pu=0.02)], "step_s": 0.02},
    {"event": [pulse(5)], "channels": {"remote": REMOTE}},  # a loop without a channel: iterated
    {"event": [pulse(6)], "master": {"inputs": "hold-gauss-seidel"}},
    {"event": [], "controller": "none", "channels": {}},
    {
        "event": [
            pulse(7),
            {"kind": "pm_pulse", "machine": "G3", "size_pu": -0.1, "start_s": 0.4, "end_s": 0.6},
        ]
    },
)


def loop_of(changes: dict[str, Any], cache: Path, by_hand: Controller) -> Loop:
    fields: dict[str, Any] = {
        "case": "two-area-thesis",
        "controller": "wdc",
        "stop_s": 1.2,
        "channels": CHANNELS,
    } | changes
    start = fields.pop("start", {})
    loop = Loop(load_scenario(fields), cache=cache, controller=by_hand)
    plant: Any = loop.master.participants["plant"]
    plant.set_start({name: value for name, (_, value) in plant._start.items()} | start)
    return loop


@contextmanager
def side_by_side(
    described: Iterable[dict[str, Any]], cache: Path, by_hand: Controller, library: GroupLibrary
) -> Iterator[list[Master]]:
    """Masters that have not begun, their plants to be stepped by `library`."""
    with ExitStack() as stack:
        loops = [stack.enter_context(loop_of(changes, cache, by_hand)) for changes in described]
        for loop in loops:
            loop.master.participants["plant"].group = library  # type: ignore[attr-defined]
        yield [loop.master for loop in loops]


def bits(master: Master) -> tuple[str, int]:
    """Every recorded number of a run, as one hash; how often loops were iterated."""
    result = hashlib.sha256()
    for column, values in master.trajectory.data.items():
        result.update(column.encode() + values.to_numpy().tobytes())
    return result.hexdigest(), master.repeated


@pytest.fixture(scope="module")
def library(cache: Path) -> GroupLibrary:
    return plant_group(cache=cache)


@pytest.fixture(scope="module")
def alone(cache: Path, by_hand: Controller) -> list[tuple[str, int]]:
    """Each of RUNS by itself, with the FMU's own binary."""
    result = []
    for changes in RUNS:
        with loop_of(changes, cache, by_hand) as loop:
            loop.master.advance()
            result.append(bits(loop.master))
    return result


@pytest.fixture
def masters(cache: Path, by_hand: Controller, library: GroupLibrary) -> Iterator[list[Master]]:
    with side_by_side(RUNS, cache, by_hand, library) as masters:
        yield masters


@pytest.mark.parametrize(
    "lanes", [pytest.param(2, marks=pytest.mark.slow), 4, pytest.param(8, marks=pytest.mark.slow)]
)
def test_runs_side_by_side_have_the_bits_of_each_alone(
    lanes: int, cache: Path, by_hand: Controller, library: GroupLibrary, alone: list[Any]
) -> None:
    if lanes > library.lanes:
        pytest.skip(f"this processor has {library.lanes} lanes")
    narrow = GroupLibrary(library.path)
    narrow.lanes = lanes
    with side_by_side(RUNS, cache, by_hand, narrow) as result:
        assert advance_together(result) == [None] * len(RUNS)
        assert [bits(m) for m in result] == alone
        assert {m.ran for m in result} == {"kernel"}


@pytest.mark.parametrize("chosen", [[0], [6, 3, 0], [9, 8, 7, 2, 5], [1, 1, 1, 2, 0, 5, 10]])
def test_any_company_gives_the_same_bits(
    chosen: list[int], cache: Path, by_hand: Controller, library: GroupLibrary, alone: list[Any]
) -> None:
    with side_by_side((RUNS[k] for k in chosen), cache, by_hand, library) as result:
        for _ in range(2):  # the second time on instances that were reset
            assert advance_together(result) == [None] * len(chosen)
            assert [bits(m) for m in result] == [alone[k] for k in chosen]
            for master in result:
                master.start()


def test_the_python_reference_agrees(masters: list[Master]) -> None:
    assert advance_together(masters[2:6]) == [None] * 4
    for master in masters[2:6]:
        fast = bits(master)
        master.engine = "python"
        master.start()
        master.advance()
        assert bits(master) == fast


def test_the_kernel_alone_goes_on_where_a_group_stopped_and_back(
    masters: list[Master], alone: list[Any]
) -> None:
    for k, master in enumerate(masters[:4]):
        master.advance(0.1 + 0.1 * k)
    saved = [m.save() for m in masters[:4]]
    assert advance_together(masters[:4]) == [None] * 4
    assert [bits(m)[0] for m in masters[:4]] == [numbers for numbers, _ in alone[:4]]
    for master, state in zip(masters, saved, strict=False):
        master.restore(state)
        master.release(state)
    assert advance_together(masters[:4]) == [None] * 4
    assert [bits(m)[0] for m in masters[:4]] == [numbers for numbers, _ in alone[:4]]


#: speeds at which the sine of the angle is not known any more; every machine gone
FAILING: dict[str, dict[str, Any]] = {
    "a state is not finite": {"start": {"G1.slip": 1e15}},
    "an output is not finite": {"start": {"G1.slip": 1e16}},
    "the last machine is tripped": {"event": [trip(f"G{k}", 0.3 + 0.1337 * k) for k in range(1, 5)]},
}


@pytest.mark.slow
@pytest.mark.parametrize("changes", FAILING.values(), ids=FAILING.keys())
@pytest.mark.parametrize("place", [0, 2])
def test_a_run_that_fails_leaves_with_its_own_reason(
    changes: dict[str, Any],
    place: int,
    cache: Path,
    by_hand: Controller,
    library: GroupLibrary,
    alone: list[Any],
) -> None:
    with loop_of(changes, cache, by_hand) as loop:
        with pytest.raises(StepError) as expected:
            loop.master.advance()
        log = list(loop.master.participants["plant"].log)  # type: ignore[attr-defined]
        records = bits(loop.master)
    others = [0, 2, 4]
    described = [RUNS[k] for k in others]
    described.insert(place, changes)
    with side_by_side(described, cache, by_hand, library) as masters:
        ended = advance_together(masters)
        failed, error = masters.pop(place), ended.pop(place)
        assert ended == [None] * 3
        assert isinstance(error, StepError)
        assert str(error) == str(expected.value)
        assert error.time_s == expected.value.time_s
        assert error.trajectory is not None
        assert expected.value.trajectory is not None
        assert error.trajectory.data.equals(expected.value.trajectory.data)
        assert failed.participants["plant"].log == log  # type: ignore[attr-defined]
        assert bits(failed) == records
        assert [bits(m) for m in masters] == [alone[k] for k in others]


def test_what_watches_can_end_one_run(masters: list[Master], alone: list[Any]) -> None:
    looked: set[int] = set()

    def watch(number: int, now_s: float, stop_s: float) -> None:
        assert 0.0 <= now_s <= stop_s
        looked.add(number)
        if number == 1:
            raise RuntimeError("enough")

    ended = advance_together(masters[:3], watch=watch)
    assert looked == {0, 1, 2}
    assert [str(e) for e in ended] == ["None", "enough", "None"]
    assert [bits(masters[k]) for k in (0, 2)] == [alone[k] for k in (0, 2)]


def test_a_cancelled_run_stops_where_it_is_and_can_go_on(masters: list[Master], alone: list[Any]) -> None:
    for master in masters[:3]:
        master.start()
    original = masters[1].to_kernel

    def to_kernel_and_cancel() -> Any:
        kernel = original()
        masters[1].cancel()
        return kernel

    masters[1].to_kernel = to_kernel_and_cancel  # type: ignore[method-assign]
    assert advance_together(masters[:3]) == [None] * 3
    assert [m.finished for m in masters[:3]] == [True, False, True]
    masters[1].to_kernel = original  # type: ignore[method-assign]
    assert advance_together(masters[1:2]) == [None]
    assert [bits(m) for m in masters[:3]] == alone[:3]


@pytest.mark.slow
def test_plants_with_ports_have_the_bits_of_each_alone(
    cache: Path, by_hand: Controller, library: GroupLibrary
) -> None:
    """Constant current and saturation: what ports keep goes from lanes to instances and back."""
    chosen = [RUNS[k] | {"case": "kundur-thyristor"} for k in (0, 2, 3, 5, 6)]
    result = []
    for changes in chosen:
        with loop_of(changes, cache, by_hand) as loop:
            loop.master.advance()
            result.append(bits(loop.master))
    with side_by_side(chosen, cache, by_hand, library) as masters:
        assert advance_together(masters) == [None] * len(chosen)
        component = masters[0].participants["plant"].component  # type: ignore[attr-defined]
        assert library.work(component, 4) is not None
        assert [bits(m) for m in masters] == result


def test_locals_read_after_a_group_step_are_those_of_the_step(
    cache: Path, by_hand: Controller, library: GroupLibrary
) -> None:
    """The group leaves bus voltages out; they are computed when they are asked for."""
    names = [v.name for v in plant_block(load_case("two-area-thesis")).table.of_role("local")]
    chosen = (RUNS[k] for k in (2, 3))
    with side_by_side(chosen, cache, by_hand, library) as masters, loop_of(RUNS[2], cache, by_hand) as loop:
        assert advance_together(masters) == [None, None]
        loop.master.advance()
        plants: list[Any] = [m.participants["plant"] for m in (masters[0], loop.master)]
        result, expected = ([plant.value_of(name) for name in names] for plant in plants)
        np.testing.assert_array_equal(result, expected)
