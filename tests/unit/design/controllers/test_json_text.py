"""The layout of a controller's file: its values survive, a matrix row is a line."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from interarea.design.controllers.json_text import json_text

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
)


@pytest.mark.slow
@given(VALUES)
def test_every_value_comes_back(value: object) -> None:
    assert json.loads(json_text(value)) == value


def test_a_row_of_a_matrix_is_a_line() -> None:
    assert json_text({"A": [[1.0, 2.5], [0.1, 3]]}) == '{\n "A": [\n  [1.0, 2.5],\n  [0.1, 3]\n ]\n}\n'
