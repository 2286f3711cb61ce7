"""A case written as RAW or MATPOWER and read back is the same grid; what the format loses is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from interarea.models.case.case import Case, load_case
from interarea.models.exporters.matpower import matpower_of
from interarea.models.exporters.raw import raw_of
from interarea.models.exporters.written import Written
from interarea.models.grid.network import admittance_matrix
from interarea.models.grid.powerflow import solve_powerflow
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.matpower import import_matpower
from interarea.models.importers.psse import import_psse


def odd_case() -> Case:
    """A case with what is rare: charged transformers, negative reactance, two units at a bus, parts out."""
    case = load_case("kundur-manual")
    second = {"bus": 1, "base_mva": 120.0, "model": "power_flow", "P_mw": 30.0}
    second["V_pu"] = next(m.V_pu for m in case.machines if m.bus == 1)
    change = {
        "machines": {"G1_B": second},
        "buses": {
            "7": {"name": "O'Seven of the tie", "kv": 230.0, "latitude_deg": 61.0, "longitude_deg": 24.0}
        },
        "branches": {
            "7-8 a": {"x": -0.02, "r": 0.001},
            "1-5": {"tap": 1.03, "shift_deg": -4.0, "b": 0.02, "kind": "transformer"},
            "spare 1": {"from": 5, "to": 6, "r": 0.0, "x": 0.3, "in_service": False},
        },
        "shunts": {"idle 1": {"bus": 8, "Q_mvar": 10.0, "P_mw": 1.0, "in_service": False}},
        "loads": {"L7": {"P_exponent": 1.0}, "extra": {"bus": 7, "P_mw": 5.0, "Q_mvar": -1.0}},
    }
    return case.with_changes(change, name="odd")


CASES = ["kundur-manual", "new-england", "nets-nyps", "odd"]


def case_named(name: str) -> Case:
    return odd_case() if name == "odd" else load_case(name)


def read_back(folder: Path, written: Written, suffix: str) -> Case:
    path = folder / f"grid{suffix}"
    path.write_text(written.text)
    if suffix == ".m":
        imported = import_matpower(
            path, options=ImportOptions(frequency_hz=60.0, P_exponent=2.0, Q_exponent=2.0, strict=True)
        )
    else:
        imported = import_psse(path, options=ImportOptions(P_exponent=2.0, Q_exponent=2.0, strict=True))
    assert imported.solution.stored_mva < 1e-5  # the voltages written are a solution
    return imported.case


@pytest.mark.parametrize("suffix", [".raw", ".m"])
@pytest.mark.parametrize("name", CASES)
def test_a_case_written_and_read_back_is_the_same_grid(tmp_path: Path, name: str, suffix: str) -> None:
    case = case_named(name)
    copy = read_back(tmp_path, raw_of(case) if suffix == ".raw" else matpower_of(case), suffix)
    assert [b.number for b in copy.buses] == [b.number for b in case.buses]
    assert admittance_matrix(copy) == pytest.approx(admittance_matrix(case), rel=1e-13, abs=1e-11)
    ours, theirs = solve_powerflow(case), solve_powerflow(copy)
    assert theirs.voltages == pytest.approx(ours.voltages, abs=1e-10)
    assert theirs.generation == pytest.approx(ours.generation, abs=1e-8)
    assert copy.slack.bus == case.slack.bus
    assert [m.base_mva for m in copy.machines] == [m.base_mva for m in case.machines]
    assert sum(not b.in_service for b in copy.branches) == sum(not b.in_service for b in case.branches)


def test_writing_what_was_read_gives_the_same_file(tmp_path: Path) -> None:
    """The second round trip changes nothing: names and identifiers have settled."""
    case = odd_case()
    once = read_back(tmp_path, raw_of(case), ".raw")
    twice = read_back(tmp_path, raw_of(once), ".raw")
    for table in ("buses", "branches", "shunts", "loads", "machines"):
        for a, b in zip(getattr(once, table), getattr(twice, table), strict=True):
            for (key, x), (_, y) in zip(a, b, strict=True):
                if isinstance(x, float):
                    np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-9, err_msg=f"{table} {key}")
                else:
                    assert x == y, (table, key)


def test_losses_are_named() -> None:
    assert raw_of(load_case("new-england")).losses == ("the tie",)
    losses = raw_of(odd_case()).losses
    assert losses[0] == "how loads follow the voltage (L7, L9)"
    assert "names of buses beyond 12 characters (bus 7)" in losses
    assert "charging of transformers, which becomes shunts (1-5)" in losses
    assert "places of the buses on the map" in losses
    assert set(matpower_of(odd_case()).losses) >= {"the frequency", "names of buses"}
    assert "loads and shunts out of service (idle 1)" in matpower_of(odd_case()).losses


def test_the_command_writes_by_the_suffix_and_tells_what_is_lost(tmp_path, monkeypatch, capsys) -> None:
    import sys

    from interarea.cli.app import main

    for suffix, read in ((".raw", import_psse), (".m", import_matpower)):
        out = tmp_path / f"grid{suffix}"
        monkeypatch.setattr(sys, "argv", ["interarea", "export", "new-england", "--out", str(out)])
        with pytest.raises(SystemExit) as stopped:
            main()
        assert not stopped.value.code and f"not in grid{suffix}: the tie" in capsys.readouterr().err
        assert len(read(out).case.machines) == 10
    monkeypatch.setattr(sys, "argv", ["interarea", "export", "new-england", "--out", str(tmp_path / "a.epc")])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2 and "suffix '.epc', allowed: .toml" in capsys.readouterr().err
