"""The same RAW through other readers, pypowsybl and VeraGrid: buses, voltages, admittances, flows."""

from __future__ import annotations

import lzma
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.models.case.case import load_case
from interarea.models.exporters.raw import raw_of
from interarea.models.grid.network import admittance_matrix
from interarea.models.grid.powerflow import solve_powerflow
from interarea.models.importers.psse import import_psse

sys.path.insert(0, str(Path(__file__).parents[4] / "benchmarks" / "peers"))
from compare_readers import differences, problem_of
from readers_run import TOOLS

RAW = Path(__file__).parent / "wecc_240" / "240busWECC_2018_PSS32_fixed_shunts.raw.xz"


def in_service(table: Any) -> Iterator[Any]:
    """Yield the rows of a table of branches that are connected at both ends."""
    return (row for row in table.itertuples() if row.connected1 and row.connected2)


@pytest.mark.slow
def test_another_reader_finds_the_same_buses_voltages_and_admittances(tmp_path: Path) -> None:
    powsybl = pytest.importorskip("pypowsybl", reason="pypowsybl is not installed; pip install pypowsybl")
    case = import_psse(RAW).case
    plain = tmp_path / "grid.raw"
    plain.write_bytes(lzma.decompress(RAW.read_bytes()))
    network = powsybl.network.load(str(plain))
    network.per_unit = True
    buses = network.get_bus_breaker_view_buses()
    place = {f"B{bus.number}": k for k, bus in enumerate(case.buses)}
    assert set(buses.index) == set(place)
    stored = np.array([buses.v_mag[name] for name in place])
    np.testing.assert_allclose([bus.V_pu for bus in case.buses], stored, atol=2e-5)  # polished by us
    Y = np.zeros((len(place), len(place)), dtype=complex)
    for row in in_service(network.get_lines(all_attributes=True)):
        ends = [place[row.bus_breaker_bus1_id], place[row.bus_breaker_bus2_id]]
        y = 1.0 / complex(row.r, row.x)
        at_ends = complex(row.g1, row.b1), complex(row.g2, row.b2)
        Y[np.ix_(ends, ends)] += np.diag(at_ends) + y * np.array([[1.0, -1.0], [-1.0, 1.0]])
    for row in in_service(network.get_2_windings_transformers(all_attributes=True)):
        ends = [place[row.bus_breaker_bus1_id], place[row.bus_breaker_bus2_id]]
        y = 1.0 / complex(row.r_at_current_tap, row.x_at_current_tap)
        magnetising = complex(row.g_at_current_tap, row.b_at_current_tap)
        t = row.rho * np.exp(1j * row.alpha)
        Y[np.ix_(ends, ends)] += np.array([[(y + magnetising) * abs(t) ** 2, -y * np.conj(t)], [-y * t, y]])
    ours = np.asarray(admittance_matrix(case.model_copy(update={"shunts": ()})))
    np.testing.assert_allclose(ours, Y, atol=1e-7 * np.abs(Y).max())


@pytest.mark.parametrize(("tool", "package"), [("pypowsybl", "pypowsybl"), ("veragrid", "VeraGridEngine")])
def test_the_power_flow_of_another_reader_has_the_same_voltages_and_flows(
    tmp_path: Path, tool: str, package: str
) -> None:
    """Shunts, ratios, loads and units of New England, read and solved by them; `compare_readers` has more."""
    pytest.importorskip(
        package, reason=f"{package} is not installed (benchmarks/peers/compare_readers.py names it)"
    )
    case = load_case("new-england")
    path = tmp_path / "grid.raw"
    path.write_text(raw_of(case, solve_powerflow(case)).text)
    imported = import_psse(path)
    result = differences(imported, path, TOOLS[tool](**problem_of(imported, path)))
    assert result["buses"] == len(case.buses)
    assert result["pu"] < 1e-7 and result["flow"] < 1e-7
