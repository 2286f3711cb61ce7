"""Eigenvalues of the plant FMU against what others printed."""

from __future__ import annotations

import control
import numpy as np
import printed
import pytest

from interarea.cosim.artefacts import plant_fmu
from interarea.design.linearise import linearise
from interarea.design.modes import Modes, modes_of
from interarea.fmu_build.open import open_plant
from interarea.models.case import load_case


@pytest.fixture(scope="module")
def linear(cache):
    """Linear models of the FMUs by case, made once."""
    made: dict[str, control.StateSpace] = {}

    def make(name: str) -> control.StateSpace:
        if name not in made:
            with open_plant(plant_fmu(load_case(name), cache)) as plant:
                made[name] = linearise(plant)
        return made[name]

    return make


@pytest.fixture(scope="module")
def modes(linear):
    def make(name: str) -> Modes:
        return modes_of(linear(name), load_case(name).areas)

    return make


def test_every_eigenvalue_of_table_e12_3(linear):
    rows = printed.rows("modes_kundur_manual")
    found = sorted(np.linalg.eigvals(linear("kundur-manual").A), key=lambda e: (e.real, abs(e.imag)))
    left = [complex(e.real, abs(e.imag)) for e in found]
    assert len(left) == 24
    for row in rows:
        real = printed.approx_printed(row["real"], row.get("gap", {}).get("real"))
        digits = "0.000" if row["imag"] == "0" else row["imag"]
        imag = printed.approx_printed(digits, row.get("gap", {}).get("imag"))
        here = [e for e in left if e.real == real and e.imag == imag]
        count = 1 if row["imag"] == "0" else 2
        assert len(here) == count, (row, left)
        left = [e for e in left if e not in here]
    assert not left


@pytest.mark.parametrize("row", printed.rows("swing_kundur"), ids=lambda row: f"{row['case']}, {row['mode']}")
def test_swing_modes_of_kundur(modes, row):
    mode = modes(row["case"])[row["mode"]]
    ours = {
        "real": mode.eigenvalue.real,
        "imag": mode.eigenvalue.imag,
        "frequency_hz": mode.frequency_hz,
        "damping_ratio": mode.damping_ratio,
    }
    for quantity, value in ours.items():
        if quantity in row:
            wanted = printed.approx_printed(row[quantity], row.get("gap", {}).get(quantity))
            assert value == wanted, (quantity, row[quantity], value)
