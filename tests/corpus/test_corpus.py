"""Every malformed or hostile file ends in one clear line and exit code 2; nothing is taken for a result."""

from __future__ import annotations

import io
import random
import re
import zipfile
from importlib.resources import files
from pathlib import Path

import pytest
from command_line import invoke
from corpus.recipe import (
    CASE,
    CASE_WRONG,
    DESIGN,
    RUN,
    SCENARIO,
    SCENARIO_WRONG,
    SWEEP,
    SWEEP_FILE,
    SWEEP_WRONG,
    Entry,
    dyr_entries,
    json_entries,
    matpower_entries,
    raw_entries,
    replaced,
    text,
    toml_entries,
)
from grid_text import dyr_text, matpower_text, raw_text

from interarea.design.controllers.bundled import FOLDER
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.package import build_fmu
from interarea.models.case.case import load_case

CASE_FILE = (files("interarea.models") / "cases" / "kundur-manual.toml").read_text(encoding="utf-8")
DESIGN_FILE = (files("interarea.cosim.designs") / "design_robust.toml").read_text(encoding="utf-8")


GRID = load_case("kundur-thyristor")


def corpus() -> list[Entry]:
    entries = [
        *toml_entries("case", CASE_FILE, CASE),
        *toml_entries("scenario", SCENARIO, RUN),
        *toml_entries("sweep", SWEEP_FILE, SWEEP),
        *toml_entries("design", DESIGN_FILE, DESIGN),
        *raw_entries(raw_text(GRID)),
        *dyr_entries(raw_text(GRID), dyr_text(GRID)),
        *matpower_entries(matpower_text(GRID)),
        *json_entries((FOLDER / "robust.json").read_text(encoding="utf-8")),
    ]
    for kind, good, command, wrong in (
        ("case", CASE_FILE, CASE, CASE_WRONG),
        ("scenario", SCENARIO, RUN, SCENARIO_WRONG),
        ("sweep", SWEEP_FILE, SWEEP, SWEEP_WRONG),
    ):
        entries += [
            Entry(f"{kind}: {name}", ".toml", text(replaced(good, old, new)), command, says)
            for name, old, new, says in wrong
        ]
    return entries


ENTRIES = corpus()


def test_size() -> None:
    assert len(ENTRIES) >= 200
    assert len({e.name for e in ENTRIES}) == len(ENTRIES)


@pytest.mark.slow
@pytest.mark.timeout(120)
@pytest.mark.parametrize("entry", ENTRIES, ids=lambda e: e.name)
def test_one_clear_line(entry: Entry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, out = tmp_path / f"wrong{entry.suffix}", tmp_path / "out"
    out.mkdir()
    entry.write(file)
    before = sorted(tmp_path.rglob("*"))
    code, said, complaint = invoke(
        [part.format(file=file, folder=tmp_path, out=out) for part in entry.command], monkeypatch
    )
    lines = [line for line in complaint.splitlines() if line.startswith("interarea: ")]
    assert code == 2, (code, said, complaint)
    assert lines and "Traceback" not in complaint, complaint  # a line for each mistake that one entry makes
    assert max(map(len, lines)) < 1000, complaint
    assert any(re.search(entry.says, line) for line in lines), lines
    assert sorted(tmp_path.rglob("*")) == before, "something was written"


def damaged(content: bytes, k: int) -> bytes:
    """Cut an archive short, or spoil bytes of its packed data; by number."""
    rng = random.Random(k)
    if k % 3 == 0:
        return content[: rng.randrange(1, len(content))]
    spoilt = bytearray(content)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        entry = rng.choice([e for e in archive.infolist() if e.compress_size > 64])
    start = entry.header_offset + 30 + len(entry.filename.encode()) + len(entry.extra)
    at = start + rng.randrange(entry.compress_size - 16)
    spoilt[at : at + 8] = bytes(b ^ 0xFF for b in spoilt[at : at + 8])
    return bytes(spoilt)


@pytest.fixture(scope="module")
def archives(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """A good FMU and a good SSP, by suffix."""
    folder = tmp_path_factory.mktemp("good")
    fmu = build_fmu(Controller.load(FOLDER / "robust.json").block(377.0), folder)
    scenario = folder / "s.toml"
    scenario.write_text(SCENARIO.replace('controller = "ftc"', f'controller = "{FOLDER / "robust.json"}"'))
    ssp = folder / "s.ssp"
    with pytest.MonkeyPatch.context() as monkeypatch:
        assert invoke(["ssp", str(scenario), "--out", str(ssp)], monkeypatch)[0] == 0
    return {".fmu": fmu.read_bytes(), ".ssp": ssp.read_bytes()}


@pytest.mark.timeout(120)
@pytest.mark.parametrize("suffix", [".fmu", ".ssp"])
@pytest.mark.parametrize("k", range(12))
def test_damaged_archives_are_found(
    suffix: str, k: int, archives: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`check` says that the archive is damaged; whoever only reads it gets one line."""
    file = tmp_path / f"wrong{suffix}"
    file.write_bytes(damaged(archives[suffix], k))
    code, said, complaint = invoke(["check", str(file)], monkeypatch)
    assert code in (1, 2) and "Traceback" not in said + complaint
    assert re.search("damaged|not a ZIP|archive|unpack|CRC|cut", said + complaint), said + complaint
    assert [p.name for p in tmp_path.rglob("*")] == [file.name]


@pytest.mark.timeout(120)
@pytest.mark.parametrize("k", range(6))
def test_a_damaged_controller_fmu_is_one_line(
    k: int, archives: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "wrong.fmu"
    file.write_bytes(damaged(archives[".fmu"], 3 * k))  # cut short: nothing of it can be read
    for arguments in (
        ["certify", str(file)],
        ["run", str(scenario_with(file, tmp_path)), "--out", str(tmp_path / "out")],
    ):
        code, _, complaint = invoke(arguments, monkeypatch)
        assert code == 2 and "Traceback" not in complaint, complaint
        assert sum(line.startswith("interarea: ") for line in complaint.splitlines()) == 1
        assert not (tmp_path / "out").exists()


def scenario_with(fmu: Path, folder: Path) -> Path:
    path = folder / "s.toml"
    path.write_text(SCENARIO.replace('controller = "ftc"', f'controller = "{fmu}"'))
    return path
