"""A device, pipe, socket or folder in place of an input is refused before anything is read from it."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import invoke


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(path.name)  # the name of a socket has at most 108 characters


def _linked(make: Callable[[Path], object], path: Path) -> None:
    make(path.with_name(f"real-{path.name}"))
    path.symlink_to(f"real-{path.name}")


#: kind -> what makes it; reading the first never ends, opening the second never returns
KINDS: dict[str, Callable[[Path], object]] = {
    "device": lambda path: path.symlink_to("/dev/zero"),
    "pipe": lambda path: os.mkfifo(path),
    "socket": _socket,
    "folder": lambda path: path.mkdir(),
    "link to a pipe": lambda path: _linked(os.mkfifo, path),
    "link to a folder": lambda path: _linked(os.mkdir, path),
}
INPUTS = {
    "scenario": "run input.toml --out out",
    "SSP to run": "run input.ssp --out out",
    "case": "modes input.toml",
    "sweep": "sweep input.toml --out out",
    "design": "design input.toml --out out.json",
    "device": "device input.toml",
    "study": "study input.toml --out out",
    "grid": "import input.raw --out out.toml",
    "packed grid": "import input.m.gz --out out.toml",
    "FMU": "check input.fmu",
    "SSP": "check input.ssp",
    "controller": "certify input.json",
    "record to meter": "meter input.csv",
    "record to locate in": "locate input.csv",
    "COMTRADE record": "meter input.cfg",
    "trajectory": "meter input.parquet",
    "detector": "certify wide_area --wrong-signals --detector input.json",
    "spec": "certify wide_area --spec input.toml",
    "DLL": "check input.dll",
    "grid to study": "study input.raw --out out",
    "grid to choose for": "new study input.raw --out out.toml",
    "grid of study worth": "study worth --grid input.raw --out out",
    "dynamic data": "study two-area-thesis --dyr input.dyr --out out",
    "RAWX": "import input.rawx --out out.toml",
    "scenario to compare on": "compare none robust --scenario input.toml --out out",
    "controller to build": "build two-area-thesis --controller input.json --out out",
    "scenario to export": "container input.toml --out out.fmu",
    "COMTRADE in one file": "locate input.cff",
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("command", INPUTS.values(), ids=INPUTS)
@pytest.mark.timeout(240)  # what hangs ends then; the first of a command imports, on a busy machine for long
def test_what_is_no_regular_file_is_refused(
    kind: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    name = next(word for word in command.split() if word.startswith("input."))
    KINDS[kind](tmp_path / name)
    before = sorted(tmp_path.iterdir())
    code, out, err = invoke(command.split(), monkeypatch)
    assert code == 2, err
    assert not out
    assert err.count("\n") == 1, err
    assert name in err
    assert "internal error" not in err
    assert sorted(tmp_path.iterdir()) == before  # nothing was written
