"""What a person does first, and does wrong first: relative folders, wrong files, closed pipes."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from interarea.cosim.artefacts import channel_fmu, default_cache
from interarea.cosim.cli import main
from interarea.cosim.fmu_file import FmuFile
from interarea.cosim.sweep_store import read_rows

SWEEP = """
[scenario]
case = "two-area-thesis"
stop_s = 1.0
step_s = 0.02
[[scenario.event]]
kind = "vref_pulse"
machine = "G1"
size_pu = 0.05
start_s = 0.1
end_s = 0.3
[parameters.size]
path = "event.1.size_pu"
values = [0.01, 0.02]
"""


@pytest.fixture
def interarea(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path):  # type: ignore[no-untyped-def]
    """Return a call of the command in an empty folder: arguments -> (exit code, stdout, stderr)."""
    monkeypatch.delenv("INTERAREA_DEBUG", raising=False)
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["interarea", *(str(a) for a in arguments)])
        code = 0
        try:
            main()
        except SystemExit as stopped:
            code = int(stopped.code or 0)
        out, err = capfd.readouterr()
        return code, out, err

    return call


def test_an_fmu_is_unpacked_to_an_absolute_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scratch").mkdir()
    file = FmuFile(channel_fmu(default_cache()), scratch=Path("scratch"))
    assert file.folder.is_absolute() and file.folder.parent == tmp_path / "scratch"
    file.close()


def test_a_sweep_into_a_folder_named_from_here(interarea) -> None:  # type: ignore[no-untyped-def]
    Path("two.toml").write_text(SWEEP, encoding="utf-8")
    code, out, err = interarea("sweep", "two.toml", "--out", "out/two", "--workers", 1)
    assert code == 0, err
    assert "2 runs: 2 ok" in out
    assert list(read_rows(Path("out/two")).status) == ["ok", "ok"]
