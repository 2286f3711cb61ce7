"""Names round a compass: apart, in order, near their arrows."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from interarea.cosim.plots.mode_shapes import NAMED, mode_shape_plot, rim_angles

GAP = 0.2


@given(st.lists(st.floats(-math.pi, math.pi), min_size=1, max_size=16))
def test_names_keep_their_order_and_are_apart(angles):
    places = rim_angles(angles, GAP)
    order = sorted(range(len(angles)), key=lambda k: places[k])
    assert all(places[b] - places[a] >= GAP * (1 - 1e-6) for a, b in itertools.pairwise(order))
    round_the_circle, line = [angles[k] for k in order], sorted(angles)
    assert any(round_the_circle == line[k:] + line[:k] for k in range(len(line)))
    turns = (sum(places) - sum(angles)) / (2 * math.pi)  # a cluster is spread about its mean
    assert turns == pytest.approx(round(turns), abs=1e-9)


def test_arrows_with_room_keep_their_angles():
    angles = [0.0, 1.0, -2.0]
    assert rim_angles(angles, GAP) == pytest.approx(angles)


def test_too_many_names_are_refused():
    with pytest.raises(ValueError, match="do not fit round a circle"):
        rim_angles([0.0] * 40, GAP)


def test_a_compass_of_many_machines_names_each_once():
    shape = {f"G{k}": complex(math.cos(k / 50), math.sin(k / 50)) for k in range(48)}
    figure = mode_shape_plot(shape, {name: 1 + k % 5 for k, name in enumerate(shape)}, "many")
    words = [text.get_text() for text in figure.axes[0].texts]
    assert sorted(word for word in words if word) == sorted(shape)


def test_a_compass_of_a_large_grid_names_the_largest() -> None:
    shape = {f"G{k}": complex(1.0 / (1 + k)) for k in range(400)}
    figure = mode_shape_plot(shape, dict.fromkeys(shape, 1), "large")
    words = {text.get_text() for text in figure.axes[0].texts} - {""}
    assert words == {f"G{k}" for k in range(NAMED)}
