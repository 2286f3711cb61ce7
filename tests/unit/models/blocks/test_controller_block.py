"""The linear controller block: names, promises to masters, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmu_runner import Runner

from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.controller import controller_block

A = np.array([[-1.0, 2.0], [0.0, -3.0]])
B = np.array([[1.0, 0.5], [0.0, 1.0]])
C = np.array([[1.0, -1.0]])


def test_matrices_are_parameters() -> None:
    table = controller_block("k", A, B, C, np.zeros((1, 2)), ["a", "b"], ["y"]).table
    assert table["A[1,2]"].start == 2.0
    assert table["C[1,2]"].start == -1.0
    assert table["limit"].start == 0.15
    assert table.layout().tolist() == [2, 2, 1, 0, 4 + 4 + 2 + 2 + 1, 0, 0, 0, 0]


def test_outputs_depend_on_inputs_where_d_says_so() -> None:
    table = controller_block("k", A, B, C, [[0.0, 0.3]], ["a", "b"], ["y"]).table
    assert table["y"].depends_on == ("x[1]", "x[2]", "b")
    assert (table["D[1,1]"].min, table["D[1,1]"].max) == (0.0, 0.0)
    assert table["D[1,2]"].max is None


def test_a_zero_of_d_stays_zero_and_static_gains_work(tmp_path: Path) -> None:
    """y = clip(2 a, +-limit) with no states."""
    block = controller_block(
        "gain", np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[2.0, 0.0]], ["a", "b"], ["y"]
    )
    file = build_fmu(block, tmp_path)
    with Runner(file) as run:
        run.start()
        run.set(a=0.05)
        assert run.get("y") == 0.1
        run.set(a=-1.0)
        assert run.get("y") == -0.15
        run.step(0.0, 0.1)
    with Runner(file) as run, pytest.raises(FMICallException):
        run.set_of({"D[1,2]": 1.0})


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"A": np.zeros((2, 3))}, "must be square"),
        ({"B": np.zeros((2, 1))}, r"B has shape \(2, 1\), wanted \(2, 2\)"),
        ({"C": [[np.nan, 0.0]]}, "not finite"),
        ({"limit": 0.0}, "limit is 0.0"),
        ({"limit": np.nan}, "limit is nan"),
    ],
)
def test_what_it_refuses(changes: dict[str, object], text: str) -> None:
    good: dict[str, object] = {
        "A": A,
        "B": B,
        "C": C,
        "D": np.zeros((1, 2)),
        "inputs": ["a", "b"],
        "outputs": ["y"],
    }
    with pytest.raises(ValueError, match=text):
        controller_block("k", **{**good, **changes})  # type: ignore[arg-type]
