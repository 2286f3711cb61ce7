"""Eigenvalues of the plant FMU against what others printed."""

from __future__ import annotations

from functools import lru_cache

import control
import numpy as np
import printed
import pytest

from interarea.cosim.run.artefacts import plant_fmu
from interarea.design.linear.linearise import linearise
from interarea.design.modes.modes import Modes, modes_of
from interarea.fmu_build.open.plant import open_plant
from interarea.models.case.case import Case, load_case
from interarea.models.grid.powerflow import solve_powerflow


def with_impedance_loads(case: Case) -> Case:
    rows = {}
    for load in case.loads:
        rows[load.name] = {
            f"{letter}_zip" if getattr(load, f"{letter}_zip") else f"{letter}_exponent": value
            for letter in "PQ"
            for value in [[1.0, 0.0, 0.0] if getattr(load, f"{letter}_zip") else 2.0]
        }
    return case.with_changes({"loads": rows})


@pytest.fixture(scope="module")
def linear(cache):
    """Linear models of the FMUs by case, made once."""
    models: dict[tuple[str, bool], control.StateSpace] = {}

    def make(name: str, *, impedance: bool = False) -> control.StateSpace:
        if (name, impedance) not in models:
            case = with_impedance_loads(load_case(name)) if impedance else load_case(name)
            with open_plant(plant_fmu(case, cache)) as plant:
                models[name, impedance] = linearise(plant)
        return models[name, impedance]

    return make


@pytest.fixture(scope="module")
def modes(linear):
    def make(name: str) -> Modes:
        return modes_of(linear(name), load_case(name).areas)

    return make


@pytest.fixture(scope="module")
def unsaturated_modes(cache):
    @lru_cache
    def make(name: str) -> Modes:
        case = load_case(name).with_changes({"machines": {"defaults": {"saturation": "none"}}})
        with open_plant(plant_fmu(case, cache)) as plant:
            return modes_of(linearise(plant), case.areas)

    return make


def test_every_eigenvalue_of_table_e12_3(linear):
    rows = printed.rows("modes_kundur_manual")
    result = sorted(np.linalg.eigvals(linear("kundur-manual").A), key=lambda e: (e.real, abs(e.imag)))
    left = [complex(e.real, abs(e.imag)) for e in result]
    assert len(left) == 24
    for row in rows:
        real = printed.approx_printed(row["real"], row.get("gap", {}).get("real"))
        digits = "0.000" if row["imag"] == "0" else row["imag"]
        imag = printed.approx_printed(digits, row.get("gap", {}).get("imag"))
        equal = [e for e in left if e.real == real and e.imag == imag]
        count = 1 if row["imag"] == "0" else 2
        assert len(equal) == count, (row, left)
        left = [e for e in left if e not in equal]
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
            expected = printed.approx_printed(row[quantity], row.get("gap", {}).get(quantity))
            assert value == expected, (quantity, row[quantity], value)


@pytest.mark.parametrize("name", ["new-england", "nets-nyps"])
def test_every_swing_mode_of_another_tool(name, linear):
    """ANDES on the same rows: 9 and 15 modes of 10 and 16 machines, each found once."""
    expected = [r for r in printed.rows("modes_andes") if r["case"] == name]
    result = [
        e for e in np.linalg.eigvals(linear(name, impedance=True).A) if 2.0 < e.imag < 12.0 and e.real > -3.2
    ]
    assert len(result) == len(expected) == len(load_case(name).machines) - 1
    for row in expected:
        real, imag = (printed.approx_printed(row[key], CLOSE) for key in ("real", "imag"))
        assert len([e for e in result if e.real == real and e.imag == imag]) == 1, row


@pytest.mark.parametrize(
    "row", printed.rows("modes_andes_kundur"), ids=lambda row: f"{row['case']}, {row['mode']}"
)
def test_swing_modes_of_the_book_s_example_in_another_tool(row, unsaturated_modes):
    """ANDES on the same rows, with the book's loads; the stabilized row too, which the book has otherwise."""
    modes = unsaturated_modes(row["case"])[row["mode"]].eigenvalue
    assert modes.real == printed.approx_printed(row["real"], CLOSER)
    assert modes.imag == printed.approx_printed(row["imag"], CLOSER)


CLOSER = {"allow": 8e-5, "because": "half a unit of the last digit, and 2e-5 between the tools"}
CLOSE = {"allow": 6e-4, "because": "half a unit of the last digit, and 3e-5 between the tools"}


@pytest.mark.parametrize("name", ["new-england", "nets-nyps"])
def test_large_grids_rest_at_their_power_flow(cache, name):
    case = load_case(name)
    flow = solve_powerflow(case)
    with open_plant(plant_fmu(case, cache)) as plant:
        dx, y = plant.derivatives(*plant.operating_point())
        values = dict(zip(plant.output_names, y, strict=True))
    assert np.abs(dx).max() < 1e-9
    for m, power in zip(case.machines, flow.generation, strict=True):
        assert values[f"{m.name}_pe"] == pytest.approx(power.real, abs=1e-8)
        assert values[f"{m.name}_vt"] == pytest.approx(abs(flow.voltage(m.bus)), abs=1e-9)


@pytest.mark.parametrize(("name", "areas", "locals_"), [("new-england", 1, 8), ("nets-nyps", 4, 11)])
def test_large_grids_have_the_known_number_of_modes(modes, name, areas, locals_):
    """N - 1 swing modes; between the five areas of NETS-NYPS four, of .2 to .8 Hz.

    [Pal2005, ch. 4; SinghPal2013, Table 4, on other exciters: 15 modes, four of them of .31 to .78 Hz]
    New England has two areas here, and so one: G10, which stands for the neighbours, against all others.
    """
    result = modes(name)
    inter = [mode for key, mode in result.items() if key.startswith("inter-area")]
    assert len(inter) == areas
    assert len(result) == areas + locals_ == len(load_case(name).machines) - 1
    assert all(0.2 < mode.frequency_hz < 0.8 for mode in inter)
    assert all(mode.frequency_hz > 0.9 for key, mode in result.items() if not key.startswith("inter-area"))
