"""Shapes on a map: arrows at the machines' places, alike in all directions; a compass without places."""

from __future__ import annotations

import cmath
import io
import json
import math

import numpy as np
import pytest
from matplotlib.quiver import Quiver

from interarea.cosim.plots.mode_map import mode_map, places_of
from interarea.design.modes.modes import Mode, Participation
from interarea.models.case.case import Case, load_case
from interarea.models.case.write_toml import export_toml
from interarea.shown import SwingModes

CASE = "two-area-thesis"
NONE = np.zeros(0, dtype=complex)
SHAPE = {"G1": 1.0 + 0j, "G2": 0.5j, "G3": -0.8 + 0.1j, "G4": 0.01 + 0j}


def placed(places: dict[int, tuple[float, float]]) -> Case:
    """Return the four machines with buses at latitude, longitude."""
    rows = {str(k): {"latitude_deg": y, "longitude_deg": x} for k, (y, x) in places.items()}
    return load_case(CASE).with_changes({"buses": rows})


@pytest.fixture(scope="module")
def north() -> Case:
    """All eleven buses round 60 degrees north."""
    numbers = [bus.number for bus in load_case(CASE).buses]
    return placed({n: (60.0 + 0.1 * (n % 3), 20.0 + 0.5 * k) for k, n in enumerate(numbers)})


def arrows(figure) -> dict[tuple[float, float], complex]:  # type: ignore[no-untyped-def]
    """Place -> arrow over the longest, of all machines that move."""
    result = {}
    for drawn in figure.axes[0].collections:
        if isinstance(drawn, Quiver):
            for (x, y), u, v in zip(drawn.get_offsets(), drawn.U, drawn.V, strict=True):
                result[float(x), float(y)] = complex(u, v)
    longest = max(abs(z) for z in result.values())
    return {place: z / longest for place, z in result.items()}


@pytest.mark.parametrize("turn", [1.0, cmath.exp(2.1j), -3.0])
def test_arrows_are_the_shape_at_the_machines_places(north: Case, turn: complex) -> None:
    """An eigenvector has no phase and no size of its own: turned and scaled, the map stays."""
    places = places_of(north)
    shape = {name: z * turn for name, z in SHAPE.items()}
    result = arrows(mode_map(shape, north, places, "shape"))
    expected = {places[m.bus]: SHAPE[m.name] for m in north.machines if m.name != "G4"}  # a dot
    assert result.keys() == expected.keys()
    assert all(abs(result[at] - expected[at]) < 1e-12 for at in expected)


def test_a_degree_of_longitude_is_drawn_as_long_as_it_is(north: Case) -> None:
    """At 60 degrees north half as long as one of latitude."""
    figure = mode_map(SHAPE, north, places_of(north), "north")
    axes = figure.axes[0]
    figure.savefig(io.BytesIO())  # laid out
    origin, east, up = axes.transData.transform([(21.0, 60.1), (22.0, 60.1), (21.0, 61.1)])
    ratio = (east - origin)[0] / (up - origin)[1]
    assert ratio == pytest.approx(math.cos(math.radians(60.1)), rel=1e-6)


def test_windings_of_a_transformer_stand_in_one_place_and_ends_of_a_line_do_not() -> None:
    case = load_case(CASE)
    step_up = next(b for b in case.branches if b.kind == "transformer")
    places = places_of(placed({step_up.to_bus: (61.0, 20.0)}))
    assert places == {step_up.to_bus: (20.0, 61.0), step_up.from_bus: (20.0, 61.0)}
    line = next(b for b in case.branches if b.kind == "line" and step_up.to_bus in (b.from_bus, b.to_bus))
    assert not {line.from_bus, line.to_bus} <= places.keys()


def test_longitudes_run_on_over_the_180th_meridian() -> None:
    a, b = (bus.number for bus in load_case(CASE).buses[:2])
    places = places_of(placed({a: (-17.0, 179.5), b: (-17.0, -179.5)}))
    assert places[b][0] - places[a][0] == pytest.approx(1.0)


def test_machines_without_a_place_are_named_and_too_few_places_give_a_compass(north: Case) -> None:
    machines = load_case(CASE).machines
    places = places_of(north)
    few = {m.bus: places[m.bus] for m in machines[:3]}
    figure = mode_map(SHAPE, north, few, "three")
    assert "no place in the case: G4 (0.01, +0°)" in figure.get_supxlabel()

    def drawn(case: Case) -> str:
        mode = Mode("inter-area", 1j, SHAPE, Participation(), 1.0, NONE, NONE)
        return str(SwingModes({"inter-area": mode}, NONE, case=case).plot().axes[0].name)

    assert drawn(load_case(CASE)) == "polar"
    assert drawn(placed({m.bus: (60.0, 20.0) for m in machines})) == "polar"
    assert drawn(north) == "rectilinear"


@pytest.mark.slow
@pytest.mark.parametrize("band", [(), ("--band", "0.1:0.9")])
def test_the_command_draws_every_mode_dense_and_sparse(tmp_path, interarea, north: Case, band) -> None:  # type: ignore[no-untyped-def]
    grid, folder = tmp_path / "north.toml", tmp_path / "maps"
    export_toml(north, grid)
    code, out, _ = interarea("modes", str(grid), *band, "--plot", str(folder), "--json")
    assert code == 0
    document = json.loads(out)
    modes = (
        document["modes"] if isinstance(document["modes"], dict) else [m["name"] for m in document["modes"]]
    )
    assert [f"{name.replace(' ', '-')}.svg" for name in modes] == [
        p.rsplit("/", 1)[-1] for p in document["plots"]
    ]
    assert all(file.read_text().count("<g ") > 10 for file in folder.iterdir())
    assert sorted(map(str, folder.iterdir())) == sorted(document["plots"])
