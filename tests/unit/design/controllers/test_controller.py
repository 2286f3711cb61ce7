"""A controller's file keeps every bit; its block is the same system in per unit."""

from __future__ import annotations

import json
from pathlib import Path

import control
import numpy as np
import pytest

from interarea.design.controllers.controller import Controller, ControllerError


def controller() -> Controller:
    rng = np.random.default_rng(5)
    system = control.ss(
        rng.standard_normal((3, 3)) - 3 * np.eye(3),
        rng.standard_normal((3, 2)),
        rng.standard_normal((1, 3)),
        np.zeros((1, 2)),
        inputs=["G2_dw", "G4_pe"],
        outputs=["G4_vs"],
    )
    return Controller("wdc", system, 0.1, {"method": "given", "poles": np.array([1 + 2j])})


def test_file_round_trip_is_exact(tmp_path: Path) -> None:
    one = controller()
    two = Controller.load(one.save(tmp_path / "k.json"))
    for m in "ABCD":
        assert np.array_equal(getattr(one.system, m), getattr(two.system, m))
    assert (two.inputs, two.outputs, two.limit_pu) == (("G2_dw", "G4_pe"), ("G4_vs",), 0.1)
    assert two.design["poles"] == [[1.0, 2.0]]


def test_block_takes_speeds_in_per_unit() -> None:
    """dw_rad = omega_b dw_pu, other signals stay: the static gain of the block says so."""
    K, omega_b = controller(), 377.0
    data = K.block(omega_b).table
    B = np.array([[data[f"B[{i + 1},{j + 1}]"].start for j in range(2)] for i in range(3)])
    np.testing.assert_allclose(B, K.system.B * [omega_b, 1.0], rtol=1e-15)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"schema": 7}, "schema"),
        ({"A": None}, "missing A"),
        ({"B": [[1.0]]}, "do not fit"),
        ({"limit_pu": -1.0}, "limit_pu"),
        ({"C": [[1.0, float("nan"), 0.0]]}, "NaN is no number"),
    ],
)
def test_bad_file_is_named(tmp_path: Path, change: dict[str, object], word: str) -> None:
    path = controller().save(tmp_path / "k.json")
    data = json.loads(path.read_text())
    data |= change
    data = {k: v for k, v in data.items() if v is not None or k == "certificate"}
    path.write_text(json.dumps(data))
    with pytest.raises(ControllerError, match=word) as error:
        Controller.load(path)
    assert "k.json" in str(error.value)


def test_missing_and_broken_files(tmp_path: Path) -> None:
    with pytest.raises(ControllerError, match="no such file"):
        Controller.load(tmp_path / "none.json")
    (tmp_path / "x.json").write_text("{")
    with pytest.raises(ControllerError, match="not valid JSON"):
        Controller.load(tmp_path / "x.json")
