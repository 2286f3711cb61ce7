"""Order of a step: cut at channels, strongly connected parts, and the mistakes a wiring can have."""

from __future__ import annotations

import itertools

import pytest

from interarea.cosim.errors import GraphError
from interarea.cosim.master.graph import build_graph, strongly_connected
from interarea.fmu_build.open.ports import Description, Port
from interarea.fmu_build.open.units import UnitOf

RAD = UnitOf("rad", (0, 0, 0, 0, 0, 0, 0, 1))
DEG = UnitOf("deg", (0, 0, 0, 0, 0, 0, 0, 1), factor=0.017453292519943295)
CELSIUS = UnitOf("degC", (0, 0, 0, 0, 1, 0, 0, 0), factor=1.0, offset=273.15)
KELVIN = UnitOf("K", (0, 0, 0, 0, 1, 0, 0, 0))


def block(
    *, direct: bool = False, unit_in: UnitOf | None = None, unit_out: UnitOf | None = None
) -> Description:
    used = frozenset({"u"}) if direct else frozenset()
    return Description((Port("u", unit=unit_in),), (Port("y", unit=unit_out),), {"y": used})


LOOP = {"plant": block(), "controller": block(), "remote": block()}
WIRES = [("plant.y", "remote.u"), ("remote.y", "controller.u"), ("controller.y", "plant.u")]


def test_a_channel_that_covers_the_step_goes_first_and_nothing_loops() -> None:
    graph = build_graph(LOOP, WIRES, step_ticks=10, latency_ticks={"remote": 10})
    assert graph.order == ("remote", "controller", "plant")
    assert not any(g.is_loop for g in graph.groups)


def test_a_channel_shorter_than_the_step_leaves_a_loop() -> None:
    graph = build_graph(LOOP, WIRES, step_ticks=10, latency_ticks={"remote": 9})
    assert [set(g.members) for g in graph.groups] == [{"plant", "controller", "remote"}]
    assert len(graph.groups[0].tearing) == 1


def test_a_loop_is_torn_where_nothing_depends_directly() -> None:
    parts = {"a": block(direct=True), "b": block(direct=True), "c": block()}
    graph = build_graph(parts, [("a.y", "b.u"), ("b.y", "c.u"), ("c.y", "a.u")], step_ticks=1)
    assert [str(c) for c in graph.groups[0].tearing] == ["b.y -> c.u"]


@pytest.mark.parametrize("wires", list(itertools.permutations(WIRES)))
def test_declaration_order_does_not_matter(wires: list[tuple[str, str]]) -> None:
    for names in itertools.permutations(LOOP):
        graph = build_graph({n: LOOP[n] for n in names}, wires, step_ticks=1)
        reference = build_graph(LOOP, WIRES, step_ticks=1)
        assert (graph.groups, graph.connections) == (reference.groups, reference.connections)


def test_parts_come_after_what_they_wait_for() -> None:
    waits = {"a": ["b"], "b": ["c", "a"], "c": [], "d": ["a"], "e": []}
    assert strongly_connected(waits) == [("c",), ("a", "b"), ("d",), ("e",)]


def test_compatible_units_are_converted() -> None:
    parts = {"a": block(unit_out=DEG), "b": block(unit_in=RAD)}
    (wire,) = build_graph(parts, [("a.y", "b.u")], step_ticks=1).connections
    assert wire.gain * 180.0 + wire.offset == pytest.approx(3.141592653589793, rel=1e-15)


def test_units_with_an_offset_are_converted() -> None:
    parts = {"a": block(unit_out=CELSIUS), "b": block(unit_in=KELVIN)}
    (wire,) = build_graph(parts, [("a.y", "b.u")], step_ticks=1).connections
    assert wire.gain * 20.0 + wire.offset == pytest.approx(293.15, rel=1e-15)


@pytest.mark.parametrize(
    ("wires", "says"),
    [
        ([("plan.y", "remote.u")], "did you mean 'plant'"),
        ([("plant.z", "remote.u")], "plant has no output 'z'; there are: y"),
        ([("plant.y", "remote.v")], "remote has no input 'v'"),
        ([("plant.u", "remote.u")], "wrong causality for a source"),
        ([("plant.y", "remote.y")], "wrong causality for a target"),
        ([("plant.y", "remote.u"), ("controller.y", "remote.u")], "two sources"),
    ],
)
def test_wrong_ends_are_refused(wires: list[tuple[str, str]], says: str) -> None:
    with pytest.raises(GraphError, match=says):
        build_graph(LOOP, wires, step_ticks=1)


def test_units_that_do_not_fit_are_refused() -> None:
    with pytest.raises(GraphError, match=r"'K' \(K\^1\) does not fit 'rad' \(rad\^1\)"):
        build_graph({"a": block(unit_out=KELVIN), "b": block(unit_in=RAD)}, [("a.y", "b.u")], step_ticks=1)


def test_unconnected_inputs_are_reported() -> None:
    graph = build_graph(LOOP, WIRES[:2], step_ticks=1)
    assert [str(e) for e in graph.unconnected] == ["plant.u"]
