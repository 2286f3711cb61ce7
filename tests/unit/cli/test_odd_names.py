"""Folders and texts with odd characters: they work, or are refused in one line."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from command_line import invoke
from grid_text import matpower_text

from interarea.models.case.case import load_case
from interarea.models.errors import CaseError
from interarea.models.importers.file import import_grid

FOLDERS = {
    "newline": "a\nb",
    "undecodable byte": os.fsdecode(b"a\xffb"),
    "3600 characters": "/".join(["c" * 200] * 18),
    "quotes": "a'b\"c`d",
    "variable": "$HOME",
    "leading dash": "-rf",
    "space and percent": " 100 %s {x} #",
}
SCENARIO = """case = "two-area-thesis"
stop_s = 0.2
[[event]]
kind = "vref_pulse"
machine = "G1"
size_pu = 0.05
start_s = 0.1
end_s = 0.15
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="such names are not allowed there")
@pytest.mark.parametrize("name", FOLDERS.values(), ids=FOLDERS)
def test_a_folder_with_an_odd_name(name: str, tmp_path: Path, cache: Path) -> None:
    """Files are read from it and written into it; the present folder, and one below it the temporary one."""
    folder = tmp_path
    for part in name.split("/"):
        folder /= part
        folder.mkdir()
        os.chdir(folder)
    (Path() / "tmp").mkdir()
    Path("s.toml").write_text(SCENARIO, encoding="utf-8")
    environment = {**os.environ, "INTERAREA_CACHE": str(cache), "TMPDIR": str(folder / "tmp")}
    environment["PYTHONIOENCODING"] = "utf-8"  # strict, as a terminal is
    for words in (
        ["new", "case", "--out", str(folder / "new.toml")],
        ["run", str(folder / "s.toml"), "--out", str(folder / "out")],
        ["build", "two-area-thesis", "--out", "fmus"],
        ["modes", str(folder / "missing.toml")],
    ):
        done = subprocess.run(
            [sys.executable, "-m", "interarea", *words], env=environment, capture_output=True, check=False
        )
        said = done.stderr.decode("utf-8", "replace")
        assert done.returncode == (2 if words[0] == "modes" else 0), said
        assert "internal error" not in said and "Traceback" not in said
    assert len(list(Path("out").iterdir())) == 8 and list(Path("fmus").iterdir())
    assert not list(Path("tmp").iterdir())


@pytest.mark.parametrize("text", ["\\u001b[31mred", "\\u009b2J", "bell\\u0007", "\\u007f"])
def test_control_characters_do_not_reach_the_terminal(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert invoke(["new", "device", "--out", "d.toml"], monkeypatch)[0] == 0
    good = Path("d.toml").read_text(encoding="utf-8")
    Path("d.toml").write_text(re.sub(r'(?m)^title = ".*?"', f'title = "{text}"'.replace("\\", r"\\"), good))
    code, out, err = invoke(["device", "d.toml"], monkeypatch)
    assert code == 2 and not out
    assert "d.toml" in err and "title: control character U+00" in err and err.count("\n") == 1
    assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]", err)


@pytest.mark.slow
@pytest.mark.parametrize("value", ["1e300", "-1e300", "1e155", "1e-300", "-1e-200"])
def test_a_grid_of_huge_numbers_gives_no_warning_of_numpy(value: str, tmp_path: Path) -> None:
    good = matpower_text(load_case("two-area-thesis"))
    numbers = list(re.finditer(r"(?<=[\s,])-?\d+(\.\d+)?(?=[\s,;])", good))
    refused = 0
    for number in numbers[8::31]:
        (tmp_path / "g.m").write_text(good[: number.start()] + value + good[number.end() :])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                import_grid(tmp_path / "g.m")
            except CaseError as error:
                assert all("\n" not in line for line in error.args)
                refused += 1
    assert refused > 0
