"""The bundled controllers of New England and NETS-NYPS: full plants, and the record of their faults."""

from __future__ import annotations

from pathlib import Path

import pytest

from interarea.cosim.designs.design_file import load_design, specification_of
from interarea.cosim.designs.family import family_plants
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.delay.signal_conditions import condition_of_many
from interarea.design.modes.modes import modes_of
from interarea.design.robust.operating_points import inter_area_band, judge_family

NAMES = ("new_england", "nets_nyps")


@pytest.mark.parametrize("name", NAMES)
def test_it_is_what_its_design_file_says_and_its_record_is_of_that(name: str) -> None:
    table, K = load_design(name), shipped_controller(name)
    assert specification_of(K) == table
    assert (K.inputs, K.outputs) == (table.signals, table.actuators)
    record = K.certificate
    assert record is not None
    assert record["passed"]
    assert len(record["rows"]) == len(table.point) * len(table.conditions)
    assert all(row["stable"] for row in record["rows"])
    assert record["acceptance"]["lost"] == []
    assert table.acceptance is not None
    assert len(record["acceptance"]["clearing"]) == len(table.point) * len(table.acceptance.fault)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "local_share"), [("new_england", 0.9), ("nets_nyps", 0.7)])
def test_it_raises_the_inter_area_damping_with_any_one_signal_lost(
    name: str, local_share: float, cache: Path
) -> None:
    table, K = load_design(name), shipped_controller(name).system
    points = family_plants(table, cache)
    plants = {name: point.judged for name, point in points.items()}
    modes = {name: modes_of(point.searched, table.grid.areas) for name, point in points.items()}
    # latencies between those of the design too
    codes = ("N", "s150", *(f"s{ms}+L:{signal}" for ms in (50, 200) for signal in table.signals))
    found = judge_family(
        plants,
        K,
        [condition_of_many(code, table.signals) for code in codes],
        bands_hz={name: inter_area_band(each) for name, each in modes.items()},
    )
    assert all(row.stable for row in found.rows)
    least = min(
        m.damping_ratio for each in modes.values() for n, m in each.items() if n.startswith("inter-area")
    )
    local = min(m.damping_ratio for each in modes.values() for n, m in each.items() if n.startswith("local"))
    assert least < 0.09
    assert found.inter_area >= 2.0 * least
    assert found.worst_swing >= local_share * local
