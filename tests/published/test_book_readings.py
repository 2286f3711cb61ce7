"""Other readings of Kundur's Example 12.6: what book_readings.toml and its script say of them."""

from __future__ import annotations

import sys
from pathlib import Path

import control
import numpy as np
import printed
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "records"))
import book_readings
import book_search

from interarea.cosim.run.artefacts import plant_fmu
from interarea.design.linear.linearise import linearise
from interarea.design.modes.modes import Modes, modes_of
from interarea.fmu_build.open.plant import open_plant
from interarea.models.case.case import Case, load_case

READINGS = list(book_readings.readings())


def linear(case: Case, cache: Path) -> control.StateSpace:
    with open_plant(plant_fmu(case, cache)) as plant:
        return linearise(plant)


def modes(case: Case, cache: Path) -> Modes:
    return modes_of(linear(case, cache), case.areas)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change", "recorded", "reaches"),
    [(name, change, recorded, reaches) for name, _, change, recorded, reaches in READINGS],
    ids=[f"{name}: {what}" for name, what, *_ in READINGS],
)
def test_a_reading_gives_its_recorded_modes(cache, name, change, recorded, reaches):
    """As recorded; and it is within the printed digits exactly if it says so."""
    case = load_case(name)
    result = modes(case.with_changes(change) if change else case, cache)
    ours = [result[mode].eigenvalue for mode in book_readings.NAMES]
    assert np.abs(np.subtract(ours, recorded)).max() < book_readings.RECORDED
    assert (book_readings.half_units(ours, book_readings.printed(name)) <= 1.0) == reaches


def test_the_stabilizer_needed_at_a_pole_is_the_one_that_puts_it_there(cache):
    """At the poles of kundur-pss the plant without stabilizers asks for the stabilizer of kundur-pss."""
    plant = linear(load_case("kundur-thyristor"), cache)
    with_stabilizers = modes(load_case("kundur-pss"), cache)
    for mode in with_stabilizers.values():
        gain = book_readings.stabilizer_of_the_book(mode.eigenvalue)
        needed = book_readings.stabilizer_needed(plant, mode.eigenvalue, gain)
        assert needed == pytest.approx(gain, rel=1e-6)


def test_no_printed_mode_of_the_stabilized_row_is_the_stabilizer_s(cache):
    """The row asks for more lead at the inter-area mode, less gain at the local ones, beyond its rounding."""
    plant = linear(load_case("kundur-thyristor"), cache)
    ratio = []
    for pole in book_readings.printed("kundur-pss"):
        gain = book_readings.stabilizer_of_the_book(pole)
        ratio.append(book_readings.stabilizer_needed(plant, pole, gain) / gain)
        # half a unit of the last digits moves the answer by at most a hundredth
        for step in (5e-4, 5e-3j):
            moved = book_readings.stabilizer_needed(plant, pole + step, gain)
            assert abs(moved / gain - ratio[-1]) < 0.01
    lead = np.degrees(np.angle(ratio))
    assert lead == pytest.approx([7.05, -0.96, -0.96], abs=0.05)
    assert np.abs(ratio) == pytest.approx([0.997, 0.957, 0.954], abs=1e-3)


def test_dynawo_s_stabilized_modes(cache):
    """Its saturation is the total one also in the linearisation."""
    case = load_case("kundur-pss").with_changes({"machines": {"defaults": {"saturation": {"use": "total"}}}})
    result = modes(case, cache)
    for row in printed.rows("modes_dynawo"):
        mode = result[row["mode"]]
        ours = {"natural_hz": abs(mode.eigenvalue) / (2 * np.pi), "damping_ratio": mode.damping_ratio}
        for quantity, value in ours.items():
            assert value == printed.approx_printed(row[quantity], row["gap"][quantity]), quantity


def test_the_search_finds_the_constants_that_gave_the_modes(cache):
    """From the modes of a reading with two constants changed, by the plant without stabilizers alone."""
    change = {"machines": {"defaults": {"exciter": {"KA": 180.0}, "stabilizer": {"Tw": 2.0}}}}
    result = modes(load_case("kundur-pss").with_changes(change), cache)
    row = book_search.Row([result[mode].eigenvalue for mode in book_readings.NAMES])
    left, constants = row.fit(("KA", "Tw"), starts=1)
    assert left < 1e-3
    assert constants == pytest.approx({"KA": 180.0, "Tw": 2.0}, rel=1e-5)
