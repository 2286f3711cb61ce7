"""Broken grids: whatever is done to a file, the import gives a case that solves or one line that says why."""

from __future__ import annotations

import lzma
import os
import random
from collections.abc import Iterable
from pathlib import Path

import pytest
from grid_text import dyr_text, matpower_text, raw_text
from raw_grids import VERSIONS, raw_grid

from interarea.models.case.case import load_case
from interarea.models.errors import CaseError
from interarea.models.grid.powerflow import solve_powerflow
from interarea.models.importers.matpower import import_matpower
from interarea.models.importers.psse import import_psse
from interarea.models.importers.raw.file import read_raw

WORDS = ["", "0", "-1", "1e400", "nan", "abc", "'", '"', "/", ",,", "99999", "1e-30", "\x00", "ß", "Q", "0.5"]


def broken(text: str, rng: random.Random) -> str:
    """Return `text` with one of: a word changed, a line lost, doubled, moved or cut, a byte changed."""
    lines = text.split("\n")
    k = rng.randrange(len(lines))
    path = rng.randrange(7)
    if path == 0:
        words = lines[k].split(",")
        words[rng.randrange(len(words))] = rng.choice(WORDS)
        lines[k] = ",".join(words)
    elif path == 1:
        del lines[k]
    elif path == 2:
        lines.insert(k, lines[k])
    elif path == 3:
        lines.insert(rng.randrange(len(lines)), lines.pop(k))
    elif path == 4:
        lines[k] = lines[k][: rng.randrange(len(lines[k]) + 1)]
    elif path == 5:
        lines = lines[:k]
    else:
        at = rng.randrange(max(len(text), 1))
        return text[:at] + rng.choice(WORDS) + text[at + 1 :]
    return "\n".join(lines)


def check_outcome(read, path: Path) -> str:
    """Return "case", or the one line of the error, which must name the file."""
    try:
        solve_powerflow(read(path).case)
    except CaseError as error:
        text = str(error)
        assert "\n" not in text and "Traceback" not in text
        assert path.stem in text or path.name in text, text
        return text
    return "case"


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_raw_files_with_one_mistake(tmp_path: Path, version: int) -> None:
    rng = random.Random(version)
    path = tmp_path / "grid.raw"
    seen = set()
    for _ in range(40):
        path.write_text(broken(raw_grid(version), rng), encoding="utf-8")
        seen.add(check_outcome(import_psse, path) == "case")
    assert seen == {True, False}


@pytest.mark.slow
def test_raw_and_dyr_files_with_three_mistakes(tmp_path: Path) -> None:
    rng = random.Random(1)
    case = load_case("kundur-pss")
    raw, dyr = tmp_path / "grid.raw", tmp_path / "grid.dyr"
    good = (raw_text(case), dyr_text(case))
    for _ in range(40):
        texts = list(good)
        for _ in range(3):
            k = rng.randrange(2)
            texts[k] = broken(texts[k], rng)
        raw.write_text(texts[0], encoding="utf-8")
        dyr.write_text(texts[1], encoding="utf-8")
        check_outcome(lambda path: import_psse(path, dyr), raw)


def test_matpower_files_with_two_mistakes(tmp_path: Path) -> None:
    rng = random.Random(2)
    path = tmp_path / "grid.m"
    text = matpower_text(load_case("kundur-manual"))
    for _ in range(40):
        path.write_text(broken(broken(text, rng), rng), encoding="utf-8")
        check_outcome(import_matpower, path)


def test_a_command_that_fails_writes_nothing(tmp_path: Path, monkeypatch, capsys) -> None:
    import sys

    from interarea.cli.app import main

    raw, out = tmp_path / "grid.raw", tmp_path / "case.toml"
    raw.write_text(raw_grid(33).replace("80.0,20.0", "80.0,2x.0"))
    monkeypatch.setattr(sys, "argv", ["interarea", "import", str(raw), "--out", str(out)])
    with pytest.raises(SystemExit) as stopped:
        main()
    captured = capsys.readouterr()
    assert stopped.value.code == 2 and not out.exists() and captured.out == ""
    assert captured.err.count("\n") == 1 and "grid.raw:9: load record: QL (field 7) = '2x.0'" in captured.err


def huge(path: Path, rows: Iterable[str], before: str = "", after: str = "") -> Path:
    """Write a file of more than 20 MB, in `make fuzz` 100."""
    with path.open("w") as file:
        file.writelines([before, *rows, after])
    assert path.stat().st_size > TIMES * 20e6
    return path


BLANK = " " * 40


# Six seconds of a processor each; many minutes, were any step quadratic.
TIMES = 5 if os.environ.get("INTERAREA_EVERY_FAULT") else 1
HUGE = pytest.mark.timeout(180 * TIMES)


@pytest.mark.slow
@HUGE
def test_a_huge_raw_file_is_refused_in_one_line(tmp_path: Path) -> None:
    row = f"{{}},'BUS         ',110.0,1,1,1,1,1.0,0.0,1.1,0.9,1.1,0.9{BLANK}\n"
    head = "0, 100.0, 33, 0, 1, 50.0\na\nb\n"
    path = huge(tmp_path / "huge.raw", map(row.format, range(1, 232_000 * TIMES)), head, "0\n" * 18)
    with pytest.raises(CaseError, match=r"^huge\.raw .*: no unit in service, allowed: at least one"):
        import_psse(path)


@pytest.mark.slow
@HUGE
def test_a_huge_dyr_file_is_read(tmp_path: Path) -> None:
    record = f"{{}} 'GENROU' 1 8.0 0.03 0.4 0.05 6.5 0.0 1.8 1.7 0.3 0.55 0.25 0.2 0.0 0.0 /{BLANK}\n"
    path = huge(tmp_path / "huge.dyr", map(record.format, range(1, 190_000 * TIMES)))
    raw = tmp_path / "grid.raw"
    raw.write_text(raw_grid(33))
    report = import_psse(raw, path).report
    assert report.assumed["DYR record of a unit that is not in the grid: ignored"] == 190_000 * TIMES - 2


@pytest.mark.slow
@HUGE
def test_a_huge_matpower_file_is_read(tmp_path: Path) -> None:
    row = f"{{}} 1 0 0 0 0 1 1.0 0.0 110 1 1.1 0.9;{BLANK}\n"
    head = "mpc.version = '2';\nmpc.baseMVA = 100;\nmpc.bus = [\n1 3 0 0 0 0 1 1.0 0.0 110 1 1.1 0.9;\n"
    tail = "];\nmpc.gen = [\n1 0 0 9 -9 1 100 1 9 0;\n];\nmpc.branch = [\n];\n"
    path = huge(tmp_path / "huge.m", map(row.format, range(2, 270_000 * TIMES)), head, tail)
    imported = import_matpower(path)
    assert [bus.number for bus in imported.case.buses] == [1]
    assert imported.report.dropped["bus without a slack bus"] == 270_000 * TIMES - 2


@pytest.mark.slow
def test_a_packed_file_that_unpacks_to_more_than_a_gigabyte_is_refused(tmp_path: Path) -> None:
    packed = tmp_path / "bomb.raw.xz"
    with lzma.open(packed, "wb", preset=0) as file:
        for _ in range(1100):
            file.write(b" " * (1 << 20))
    with pytest.raises(CaseError, match=r"bomb\.raw\.xz: more than 1024 MiB of text, allowed: less"):
        read_raw(packed)
