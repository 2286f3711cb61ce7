"""A folder stands where one of the files of a command should go: none of its files is written."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import invoke
from grid_text import matpower_text

from interarea.cosim.designs.comparison import FIGURES
from interarea.models.case.case import load_case
from interarea.models.files import together, write_whole

SCENARIO = """case = "two-area-thesis"
stop_s = 0.4
[[event]]
kind = "vref_pulse"
machine = "G1"
size_pu = 0.05
start_s = 0.1
end_s = 0.2
"""
SWEEP = """scenario = "short.toml"
seed = 1
[parameters.clearing]
path = "event.1.size_pu"
values = [0.01, 0.02]
"""
#: command -> words and how many files it writes: all that one run of it has written, each blocked in turn
COMMANDS = {
    "run": ("run short.toml --out out", 8),
    "run and explore": ("run short.toml --out out --explore", 9),
    "build": ("build two-area-thesis --controller robust --out out", 3),
    "export": ("export two-area-thesis --out out/grid.raw", 2),
    "case": ("export two-area-thesis --out out/case.toml", 1),
    "import": ("import grid.m --out out/grid.toml", 1),
    "modes": ("modes two-area-thesis --plot out", 3),
    "ssp": ("ssp short.toml --out out/loop.ssp", 1),
    "container": ("container short.toml --out out/loop.fmu", 1),
    "explore": ("explore short.toml --out out/page.html", 1),
    "new": ("new scenario --out out/mine.toml", 1),
    "device": ("device tgov1 --set R=0.05 --set T1=0.5 --set T2=2 --set T3=7 --draw out/device.svg", 1),
    "compare": ("compare none robust --scenario short.toml --out out", 18),
    "dlls": ("build two-area-thesis --controller robust --dll linux64 --out out", 6),
    "chain": ("container wide-area-damping --dll linux64 --out out/chain.so", 1),
    "locus": (
        "modes two-area-thesis --along machines.G1.exciter.KA=100:200:2 --save out --plot out/drawn",
        5,
    ),
    "new study": ("new study two-area-thesis --out out/study.toml", 1),
}
LONG = pytest.mark.timeout(900)
SLOW = ("run and explore", "explore", "compare", "dlls", "chain", "locus", "new study")


def written(folder: Path) -> set[str]:
    """Return the files below `folder`, relative to it; what is hidden too."""
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if not p.is_dir()}


@pytest.fixture(autouse=True)
def _inputs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.toml").write_text(SCENARIO, encoding="utf-8")
    (tmp_path / "sweep.toml").write_text(SWEEP, encoding="utf-8")
    (tmp_path / "grid.m").write_text(matpower_text(load_case("two-area-thesis")), encoding="utf-8")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow, LONG] * (n in SLOW)) for n in COMMANDS]
)
def test_each_file_of_a_command_blocked(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command, count = COMMANDS[name]
    code, _, err = invoke(command.split(), monkeypatch)
    assert code == 0, err
    names = written(tmp_path / "out")
    assert len(names) == count, sorted(names)
    for k, blocked in enumerate(sorted(names)):
        folder = f"out{k}"
        (tmp_path / folder / blocked).mkdir(parents=True)
        words = [folder + w.removeprefix("out") if w.split("/")[0] == "out" else w for w in command.split()]
        code, _, err = invoke(words, monkeypatch)
        assert code == 2, (blocked, err)
        assert Path(blocked).name in err.splitlines()[-1], err
        assert not written(tmp_path / folder), blocked


@pytest.mark.slow
def test_a_sweep_its_maps_and_a_screening(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The pages are refused before a run is done; nobody knows the names of a sweep's parts before."""
    options = ["--workers", "1", "--out"]
    screening = ["screen", "two-area-thesis", "--bus", "8", "--stop", "1", "--explore", *options]
    sweep = ["sweep", "sweep.toml", *options]
    for words, pages in (
        (sweep, ("manifest.json", "sweep.json")),
        (screening, ("explorer.html", "screen.csv", "screen.html", "screen.json")),
    ):
        for blocked in pages:
            folder = tmp_path / words[0] / blocked
            (folder / blocked).mkdir(parents=True)
            code, _, err = invoke([*words, str(folder)], monkeypatch)
            assert code == 2 and blocked in err, (words, blocked, err)
            assert not {n for n in written(folder) if "lock" not in n}, blocked
    assert invoke([*sweep, "done"], monkeypatch)[0] == 0
    before = written(tmp_path / "done")
    assert invoke(["maps", "done", "--out", "pages/maps.html"], monkeypatch)[0] == 0
    pages = written(tmp_path / "pages")
    assert pages == {"maps.html", "maps-explorer.html"}
    for blocked in pages:
        (tmp_path / f"no {blocked}" / blocked).mkdir(parents=True)
        code, _, err = invoke(["maps", "done", "--out", f"no {blocked}/maps.html"], monkeypatch)
        assert code == 2 and blocked in err, err
        assert not written(tmp_path / f"no {blocked}")
    assert written(tmp_path / "done") == before


@pytest.mark.parametrize("name", ["design.toml", "controller.json", "fmus/plant.fmu", "fmus"])
def test_files_of_a_grid_study_are_refused_before_it_is_begun(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name == "fmus":
        (tmp_path / "out").mkdir()
        (tmp_path / "out/fmus").touch()
    else:
        (tmp_path / "out" / name).mkdir(parents=True)
    before = written(tmp_path)
    code, _, err = invoke(["study", "grid.m", "--out", "out"], monkeypatch)
    assert code == 2 and name.split("/")[0] in err and len(err.splitlines()) == 1, err
    assert written(tmp_path) == before


def test_the_design_file_of_a_grid_is_refused_before_it_is_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for blocked in ("made.design.toml", "made.case.toml", "made.local.json", "made.stabilizers.toml"):
        (tmp_path / blocked).mkdir()
        code, _, err = invoke(["design", "grid.m", "--out", "made.json"], monkeypatch)
        assert code == 2 and blocked in err, err
        assert not (tmp_path / "made.json").exists()
        (tmp_path / blocked).rmdir()


def test_the_page_of_a_certificate_is_refused_before_the_controller_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for option, name in (("--page", "page.html"), ("--out", "made.json")):
        folder = tmp_path / option
        (folder / name).mkdir(parents=True)
        words = f"certify robust --out {option}/made.json --page {option}/page.html"
        code, _, err = invoke(words.split(), monkeypatch)
        assert code == 2 and name in err, err
        assert not written(folder)


def test_figures_of_a_design_are_refused_before_it_is_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in FIGURES:
        (tmp_path / name / name).mkdir(parents=True)
        words = ["design", "robust", "--out", "made.json", "--plots", name]
        code, _, err = invoke(words, monkeypatch)
        assert code == 2 and f"{name} in it is a folder" in err, err
        assert not (tmp_path / "made.json").exists()


def test_files_written_together_are_all_there_or_as_before(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    with pytest.raises(ZeroDivisionError), together():
        write_whole(tmp_path / "a", "new")
        write_whole(tmp_path / "b", "new")
        raise ZeroDivisionError
    assert written(tmp_path) >= {"a"} and "b" not in written(tmp_path)
    assert (tmp_path / "a").read_text() == "old"
    with pytest.raises(IsADirectoryError, match=r"'.*c'"), together():
        write_whole(tmp_path / "a", "new")
        write_whole(tmp_path / "c", "new")
        (tmp_path / "c").mkdir()  # meanwhile, by somebody else
    assert (tmp_path / "a").read_text() == "old"
    with together():
        write_whole(tmp_path / "a", "new")
        with together():
            write_whole(tmp_path / "b", "new")
        assert not (tmp_path / "b").exists()  # the outer one ends both
    assert (tmp_path / "a").read_text() == (tmp_path / "b").read_text() == "new"
    assert not list(tmp_path.glob(".*.partial"))
