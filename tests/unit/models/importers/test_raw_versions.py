"""One grid in every layout of RAW: the same elements, whatever the first line says."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raw_grids import VERSIONS, raw_grid

from interarea.models.errors import CaseError
from interarea.models.grid.powerflow import solve_powerflow
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.psse import import_psse, static_grid
from interarea.models.importers.raw.file import RawFile, read_raw
from interarea.models.importers.report import Report


def read(folder: Path, text: str) -> RawFile:
    path = folder / "grid.raw"
    path.write_text(text)
    return read_raw(path)


def elements(folder: Path, text: str) -> dict[str, Any]:
    grid = static_grid(read(folder, text), Report(), 50.0)
    rows = {"buses": list(grid.buses.values())} | {k: getattr(grid, k) for k in ("branches", "units")}
    plain = {
        kind: [{k: v for k, v in asdict(row).items() if k not in ("where", "position")} for row in table]
        for kind, table in rows.items()
    }
    plain["branches"].sort(key=lambda row: row["name"])
    totals = {"load": 0j, "current": 0j, "admittance": 0j}
    for load in grid.loads:
        totals["load"] += complex(load.p, load.q)
        totals["current"] += complex(load.ip, load.iq)
        totals["admittance"] += complex(load.yp, -load.yq)
    for shunt in grid.shunts:
        key = f"shunt {shunt.bus} {shunt.letter if shunt.letter != 'M' else 'E'}"
        totals[key] = totals.get(key, 0j) + complex(shunt.p, shunt.q)
    return plain | totals | {"hz": grid.frequency_hz}


@pytest.mark.parametrize("version", [v for v in VERSIONS if v >= 26])
def test_every_version_gives_the_same_elements(tmp_path: Path, version: int) -> None:
    assert elements(tmp_path, raw_grid(version)) == elements(tmp_path, raw_grid(33))


def test_version_23_holds_loads_and_shunts_at_the_bus(tmp_path: Path) -> None:
    old, new = elements(tmp_path, raw_grid(23)), elements(tmp_path, raw_grid(33))
    assert (old["load"], new["load"]) == (80 + 20j, 80 + 20j)
    assert (old["current"], new["current"], new["admittance"]) == (0, 5 + 2j, 4 - 3j)
    assert (old["shunt 3 C"], new["shunt 3 C"]) == (5.5 + 12j, 1.5 + 12j)
    for key in ("buses", "branches", "units", "shunt 1 E", "shunt 2 E", "shunt 3 E", "shunt 3 S"):
        assert old[key] == new[key]


@pytest.mark.parametrize("version", VERSIONS)
def test_without_a_revision_the_shape_tells_the_version(tmp_path: Path, version: int) -> None:
    raw = read(tmp_path, raw_grid(version, revision=-1))
    taken = {30: 29, 31: 32, 34: 35}.get(version, version)  # no shape tells these apart
    assert (raw.version, raw.revision, raw.notes) == (taken, None, [])
    if version not in (31, 34):
        old, new = (elements(tmp_path, raw_grid(version, revision=r)) for r in (-1, version))
        assert old == new


#: (layout, what the first line says) -> layout taken
LIES = {(33, 30): 33, (30, 33): 29, (23, 33): 23, (33, 35): 33, (26, 30): 26}


@pytest.mark.parametrize(("version", "said"), LIES)
def test_a_file_that_lies_about_its_version_is_read_as_it_is_laid_out(
    tmp_path: Path, version: int, said: int
) -> None:
    raw = read(tmp_path, raw_grid(version, revision=said))
    assert raw.version == LIES[version, said] and f"says version {said}" in raw.notes[0]
    path = tmp_path / "grid.raw"
    assert any("says version" in remark for remark in import_psse(path).report.assumed)
    with pytest.raises(CaseError, match=rf"grid\.raw:1: says version {said} .*--strict"):
        import_psse(path, options=ImportOptions(strict=True))


def test_versions_32_and_33_are_one_layout(tmp_path: Path) -> None:
    assert read(tmp_path, raw_grid(32, revision=33)).notes == []
    assert elements(tmp_path, raw_grid(32, revision=33)) == elements(tmp_path, raw_grid(33))


def test_places_of_buses_come_from_the_substations(tmp_path: Path) -> None:
    path = tmp_path / "grid.raw"
    path.write_text(raw_grid(35))
    case = import_psse(path).case
    places = {bus.number: (bus.latitude_deg, bus.longitude_deg) for bus in case.buses}
    assert places == {1: (61.5, -12.25), 2: (61.5, -12.25), 3: (None, None)}


@pytest.mark.parametrize("version", [23, 26, 30, 33, 36])
def test_the_case_solves_to_the_power_balance_of_the_file(tmp_path: Path, version: int) -> None:
    """At every bus of the case the flow into the branches is what the records give there."""
    path = tmp_path / "grid.raw"
    path.write_text(raw_grid(version))
    imported = import_psse(path)
    flow = solve_powerflow(imported.case)
    V = np.array([flow.voltage(k) for k in (1, 2, 3)])
    assert abs(V[0]) == pytest.approx(1.02, abs=1e-12)
    t = 1.05 * np.exp(1j * np.deg2rad(3.0))
    y, z = 1.0 / (0.002 + 0.08j), 1.0 / (0.01 + 0.1j)
    into_2 = y * (V[0] / t - V[1]) - z * (V[1] - V[2]) - (0.02j + 0.001 + 0.002j) * V[1]
    assert abs(into_2) < 1e-9
    into_3 = z * (V[1] - V[2]) - (0.02j + 0.003 + 0.004j + 0.18j) * V[2]
    taken = V[2] * np.conj(into_3)
    v = abs(V[2])
    conductance, constant = (0.055, 0.8 + 0.2j) if version == 23 else (0.015, 0.8 + 0.2j)
    expected = constant + conductance * v**2
    if version > 23:
        expected += (0.05 + 0.02j) * v + complex(0.04, 0.03) * v**2
    assert taken == pytest.approx(expected, abs=1e-9)


def test_sections_that_are_missing_are_empty_but_a_file_cut_inside_the_network_is_refused(
    tmp_path: Path,
) -> None:
    text = raw_grid(33)
    short = text[: text.index("0 / END OF AREA")]
    assert elements(tmp_path, short)["branches"] == elements(tmp_path, text)["branches"]
    for section in ("LOAD", "GENERATOR", "BRANCH", "TRANSFORMER"):
        with pytest.raises(
            CaseError, match=rf"grid\.raw:\d+: the file ends inside the {section.lower()} data"
        ):
            read(tmp_path, text[: text.index(f"0 / END OF {section} DATA")])
    with pytest.raises(CaseError, match="the file ends inside the transformer record of line"):
        read(tmp_path, text[: text.index("1.05,0.0,3.0")])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"grid\.raw:1: the file is empty"),
        ("0, 100, 33\na\nb\n0 / END\n", r"grid\.raw:4: no bus record"),
        ("hello\n", r"grid\.raw:1: header record: IC \(field 1\) = 'hello'"),
        ("0, -5, 33\na\nb\n1,'a'\n", r"grid\.raw:1: header record: SBASE \(field 2\) = -5, allowed: above 0"),
        ("0, 100, 33\na\nb\n'NORTH   230.00','a',1,1\n0\n0\n0\n0\n0\n0\n", r"grid\.raw:4: .* names a bus"),
    ],
)
def test_what_is_no_raw_file_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "grid.raw"
    path.write_text(text)
    with pytest.raises(CaseError, match=message):
        import_psse(path)
