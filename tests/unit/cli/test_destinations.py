"""Where results cannot go is said before anything is computed, for every option that names a place."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from command_line import invoke

from interarea.cli.app import COMMANDS, load
from interarea.command_help import EXAMPLES

#: options that take a place for results
PLACES = ("--out", "--page", "--plot", "--plots", "--save", "--draw")
#: command and option -> words, where the command's example does not have the option
WORDS = {
    ("maps", "--out"): "maps . --out maps.html",
    ("certify", "--out"): "certify robust --out robust.json",
    ("modes", "--plot"): "modes two-area-thesis --plot shapes",
    ("modes", "--save"): "modes two-area-thesis --along machines.G1.H=6:7:2 --save locus",
    ("design", "--plots"): "design robust --out robust.json --plots drawn",
    ("device", "--draw"): "device tgov1 --draw tgov1.svg",
}
CASES = [(n, p.opts[0]) for n in COMMANDS for p in load(n).params if p.opts[0] in PLACES]


def _words(command: str, option: str, where: str) -> list[str]:
    """Return the words of a command whose `option` names a place below `where`."""
    words = WORDS.get((command, option), EXAMPLES[command].removeprefix("interarea ")).split()
    k = words.index(option) + 1
    words[k] = f"{where}/{Path(words[k]).name}"
    return words


@pytest.mark.parametrize(("command", "option"), CASES, ids=[f"{c} {o}" for c, o in CASES])
def test_a_place_that_takes_nothing(
    command: str, option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    (tmp_path / "grid.dyr").touch()  # of the example of `import`
    (tmp_path / "link").symlink_to("nowhere")
    places = {"file": "is a file", "file/below": "is a file", "link/below": "is a broken link"}
    places |= {"/proc": "nothing can be written in /proc"} if sys.platform == "linux" else {}
    before = sorted(tmp_path.rglob("*"))
    for where, says in places.items():
        words = _words(command, option, where)
        code, out, err = invoke(words, monkeypatch)
        assert code == 2 and not out and err.count("\n") == 1, err
        assert err.startswith(f"interarea: {option} {where}/") and says in err, err
        assert sorted(tmp_path.rglob("*")) == before


def test_looking_at_a_place_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the system has no files without names a folder is made for a moment."""
    from interarea.cli.destination import file_for, folder_for

    monkeypatch.delattr("os.O_TMPFILE", raising=False)
    for destination in (folder_for(tmp_path / "a" / "b"), file_for(tmp_path / "c")):
        assert not destination.exists()
    assert not list(tmp_path.iterdir())
