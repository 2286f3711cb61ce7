"""A device, pipe, socket or folder in place of an input is refused before anything is read from it."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import invoke
from grid_text import matpower_text

from interarea.models.case.case import load_case


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as opened:
        opened.bind(path.name)  # the name of a socket has at most 108 characters


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
    "record to fit to": "fit input.csv --case two-area-thesis --machine G1",
    "controller to look at modes with": "modes two-area-thesis --controller input.json",
    "FMU to certify": "certify input.fmu",
    "case to certify on": "certify robust --case input.toml",
    "FMU to compare": "compare none input.fmu",
    "case to screen": "screen input.toml --out out",
    "controller to screen with": "screen two-area-thesis --controller input.json --out out",
    "controller to design against": "design robust --out out.json --against input.json",
    "grid to design for": "design input.raw --out out.json",
    "case to explore": "explore input.toml --out out.html",
    "scenario to pack": "ssp input.toml --out out.ssp",
    "case to export": "export input.toml --out out.raw",
    "grid of study inverters": "study inverters --grid input.m --out out",
    "grid of study actuators": "study actuators --grid input.toml --out out",
    "controller of study wrong-signals": "study wrong-signals --controller input.json --out out",
}
_CSV = "time,G1.speed\n" + "".join(f"{k / 50},{1.0 + k % 7}\n" for k in range(500))
_RUN = 'case = "two-area-thesis"\nstop_s = 0.2\n'
_SWEEP = (
    '[scenario]\ncase = "two-area-thesis"\nstop_s = 0.2\n[parameters.end]\npath = "stop_s"\nvalues = [0.1]\n'
)
_COMTRADE = (
    "here,there,1999\n1,1A,0D\n1,VA,A,,V,1,0,0,-32767,32767,1,1,P\n60\n1\n60,10\n"
    "01/01/2020,00:00:00.0\n01/01/2020,00:00:00.0\nASCII\n1\n"
)
#: what a file names, or lies in a folder that is named: command, name of the input, what the file holds
INSIDE = {
    "controller of a scenario": ("run mine.toml", "input.json", f'controller = "input.json"\n{_RUN}'),
    "FMU as its controller": ("run mine.toml", "input.fmu", f'controller = "input.fmu"\n{_RUN}'),
    "DLL as its controller": ("run mine.toml", "input.so", f'controller = "input.so"\n{_RUN}'),
    "FMU of a scenario": ("run mine.toml", "input.fmu", f'{_RUN}[fmus.own]\nfile = "input.fmu"\n'),
    "DLL of a scenario": ("run mine.toml", "input.so", f'{_RUN}[fmus.own]\nfile = "input.so"\n'),
    "case of a scenario": ("run mine.toml", "input.toml", 'case = "input.toml"\nstop_s = 0.2\n'),
    "base of a case": ("modes mine.toml", "input.toml", 'base = "input.toml"\n[change]\nbase_mva = 100.0\n'),
    "device of a case": (
        "modes mine.toml",
        "input.toml",
        'base = "two-area-thesis"\n[change]\ndevices = ["input.toml"]\n',
    ),
    "scenario of a sweep": (
        "sweep mine.toml --out out",
        "input.toml",
        'scenario = "input.toml"\n[parameters.end]\npath = "stop_s"\nvalues = [1.0]\n',
    ),
    "grid of a study": ("study mine.toml --out out", "input.raw", 'grid = "input.raw"\n'),
    "manifest of a sweep to go on with": ("sweep mine.toml --out .", "manifest.json", _SWEEP),
    "manifest of maps": ("maps .", "manifest.json", ""),
    "plan of maps": ("maps .", "sweep.json", ""),
    "data of a COMTRADE record": ("meter mine.cfg", "mine.dat", _COMTRADE),
    "case to meter with": ("meter mine.csv --case input.toml", "input.toml", _CSV),
    "record to meter beside": ("meter mine.csv --beside input.csv", "input.csv", _CSV),
    "where buses lie": (
        "import mine.m --coordinates input.csv --out out.toml",
        "input.csv",
        matpower_text(load_case("two-area-thesis")),
    ),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("command", INPUTS.values(), ids=INPUTS)
@pytest.mark.timeout(240)  # what hangs ends then; the first of a command imports, on a busy machine for long
def test_what_is_no_regular_file_is_refused(
    kind: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    name = next(word for word in command.split() if word.startswith("input."))
    check_refused(kind, command, name, tmp_path, monkeypatch)


@pytest.mark.parametrize("kind", ["device", "pipe", "folder"])
@pytest.mark.parametrize(("command", "name", "text"), INSIDE.values(), ids=INSIDE)
@pytest.mark.timeout(240)
def test_what_a_file_names_is_no_regular_file(
    kind: str, command: str, name: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for word in command.split():
        if word.startswith("mine."):
            Path(word).write_text(text, encoding="utf-8")
    if name == "sweep.json":
        Path("manifest.json").write_text('{"format": 2}', encoding="utf-8")
    check_refused(kind, command, name, tmp_path, monkeypatch)


def check_refused(kind: str, command: str, name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    KINDS[kind](folder / name)
    before = sorted(p for p in folder.iterdir() if p.name != ".lock")
    code, out, err = invoke(command.split(), monkeypatch)
    assert code == 2, err
    assert not out
    assert err.count("\n") == 1, err
    assert name in err
    assert "internal error" not in err
    assert sorted(p for p in folder.iterdir() if p.name != ".lock") == before  # nothing was written
