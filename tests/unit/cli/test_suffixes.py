"""What a command cannot write is refused by its suffix, before anything is computed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from interarea.cli.app import main


@pytest.mark.parametrize(
    ("command", "name", "allowed"),
    [
        ("ssp", "loop.zip", ".ssp"),
        ("container", "loop.ssp", ".fmu"),
        ("explore", "page", ".html"),
    ],
)
def test_a_suffix_that_cannot_be_written(
    command: str,
    name: str,
    allowed: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["interarea", command, "lost-signal", "--out", str(tmp_path / name)])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert f"suffix {Path(name).suffix!r}, allowed: {allowed}" in said.replace("\n", " ")
    assert not any(tmp_path.iterdir())
