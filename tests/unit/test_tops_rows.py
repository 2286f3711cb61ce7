"""A case to the tables of tops and back (tops itself runs in benchmarks/peers/compare_tops.py only)."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "peers"))
import compare_tops
from tops_rows import case_from, tables_of

from interarea.models.case.case import load_case
from interarea.models.grid.powerflow import solve_powerflow


@pytest.mark.parametrize("name", ["kundur-thyristor-z", "new-england"])
def test_tables_and_back_are_the_same_grid(name):
    """Voltages and every machine constant survive the tables."""
    case = compare_tops.without_resistance(load_case(name), {"exciter": {"kind": "constant"}})
    again = case_from("again", tables_of(case))
    flow, other = solve_powerflow(case), solve_powerflow(again)
    slack = next(k for k, m in enumerate(case.machines) if m.slack)
    turn = np.exp(1j * np.deg2rad(case.machines[slack].angle_deg))
    for bus, bus_again in zip(case.buses, again.buses, strict=True):
        assert other.voltage(bus_again.number) * turn == pytest.approx(flow.voltage(bus.number), abs=1e-9)
    for m, n in zip(case.machines, again.machines, strict=True):
        for key in ("H", "D", "Xl", "Xd", "Xq", "Xd1", "Xq1", "Xd2", "Xq2", "Td01", "Tq01", "Td02", "Tq02"):
            assert getattr(n, key) == getattr(m, key), (m.name, key)


def test_a_transformer_with_ratios_at_both_sides_is_one_with_its_ratio_at_the_first():
    """Two-port admittances f^2 y, f t y, t^2 y are those of a tap t/f and z/t^2."""
    constant = {"exciter": {"kind": "constant"}}
    tables = tables_of(compare_tops.without_resistance(load_case("new-england"), constant))
    f, t = 1.02, 0.97
    trafo = tables["transformers"]
    row = dict(zip(trafo[0], trafo[1], strict=True)) | {"ratio_from": f, "ratio_to": t, "R": 0.001}
    tables["transformers"][1] = list(row.values())
    branch = next(b for b in case_from("ratios", tables).branches if b.name == row["name"])
    y = 1.0 / complex(row["R"], row["X"])
    own = 1.0 / complex(branch.r, branch.x)
    assert own / branch.tap**2 == pytest.approx(f * f * y)
    assert own / branch.tap == pytest.approx(f * t * y)
    assert own == pytest.approx(t * t * y)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"G1": {"Ra": 0.01}}, "Ra"),
        ({"G1": {"exciter": {"kind": "static", "KA": 200.0, "TA": 0.02, "TR": 0.01}}}, "TR"),
        (
            {
                "G1": {
                    "exciter": {"kind": "static", "KA": 200.0, "TA": 0.02},
                    "stabilizer": {"K": 1.0, "Tw": 1.0, "TR": 0.01},
                }
            },
            "transducer",
        ),
    ],
)
def test_what_tops_does_not_represent_is_named(change, word):
    case = compare_tops.without_resistance(load_case("kundur-thyristor-z"), {"exciter": {"kind": "constant"}})
    with pytest.raises(ValueError, match=f"machines.G1.*{word}"):
        tables_of(case.with_changes({"machines": change}))
