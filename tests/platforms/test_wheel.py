"""The package as most people get it: its wheel, in an environment of its own, where nothing can compile."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

from interarea.fmu_build.write.compile import PLATFORMS, host_platform

ROOT = Path(__file__).resolve().parents[2]
LEFT_OUT = ("ziglang", "interarea", "__editable__")  #: of this environment
OTHER = next(name for name in PLATFORMS if name != host_platform())
pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(1800),  # compiles everything that travels in a wheel, for this machine
    pytest.mark.skipif(sys.platform == "win32", reason="the environment is made of links"),
]


@pytest.fixture(scope="module")
def tracked() -> list[str]:
    """Return the files of the repository, those about to be committed too."""
    words = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    try:
        return [
            n
            for n in subprocess.run(words, check=True, capture_output=True, text=True).stdout.split("\0")
            if n
        ]
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("needs git and a checkout")


@pytest.fixture(scope="module")
def wheel(tracked: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the wheel built of what git would commit, for this machine's platform."""
    pytest.importorskip("setuptools", minversion="77")
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    for name in tracked:
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, source / name)
    words = ["wheel", "--quiet", "--no-deps", "--no-build-isolation", "-C", f"platforms={host_platform()}"]
    subprocess.run([sys.executable, "-m", "pip", *words, "-w", str(out), str(source)], check=True)
    return next(out.glob("interarea-*-py3-none-any.whl"))


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of programs of an environment: the wheel, and the dependencies as links."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False)
    names = {"base": str(folder), "platbase": str(folder)}
    site = Path(sysconfig.get_path("purelib", "venv", vars=names))
    folders = {Path(p).resolve() for p in sys.path if Path(p).name in ("site-packages", "dist-packages")}
    for entry in (e for place in folders for e in place.iterdir()):
        if (
            not entry.name.startswith(LEFT_OUT)
            and entry.suffix != ".pth"
            and not (site / entry.name).exists()
        ):
            (site / entry.name).symlink_to(entry)
    words = ["install", "--quiet", "--no-deps", "--no-index", "--prefix", str(folder), str(wheel)]
    python = folder / "bin" / "python"
    subprocess.run([str(python), "-m", "pip", *words], check=True)
    return folder / "bin"


def call(installed: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run `interarea` of the wheel in `folder`: no compiler in PATH, a cache that is empty at first."""
    variables = {k: v for k, v in os.environ.items() if k not in ("CC", "PYTHONPATH", "INTERAREA_CACHE")}
    environment = {**variables, "PATH": str(installed), "INTERAREA_CACHE": str(folder / "cache")}
    command = [str(installed / "interarea"), *words]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_the_wheel_holds_every_file_of_the_package(wheel: Path, tracked: list[str]) -> None:
    """A folder without __init__.py is packed only if pyproject.toml names it; so the devices were lost."""
    with zipfile.ZipFile(wheel) as archive:
        packed = set(archive.namelist())
    floors = ("models", "fmu_build", "design", "cosim", "interarea")
    expected = [
        n if n.startswith("interarea/") else f"interarea/{n}" for n in tracked if n.split("/")[0] in floors
    ]
    assert len(expected) > 400 and not set(expected) - packed
    binaries = {n for n in packed if n.startswith("interarea/fmu_build/binaries/")}
    kinds = {n.rsplit("/", 1)[1].partition(f"-{host_platform()}-")[0] for n in binaries if "wasm32" not in n}
    assert kinds >= {
        "plant",
        "plant-group",
        "loop",
        "channel",
        "concentrator",
        "detector",
        "pmu",
        "controller",
        "supervisor",
        "kernel",
    }
    assert sum("container-wasm32" in n for n in binaries) > 2


def test_a_first_run_compiles_nothing(installed: Path, tmp_path: Path) -> None:
    done = call(installed, tmp_path, "run", "lost-signal", "--out", "run")
    assert done.returncode == 0, done.stderr
    assert "slower" not in done.stderr  # the kernel steps, not Python
    assert (tmp_path / "run" / "trajectory.parquet").is_file()
    done = call(installed, tmp_path, "container", "lost-signal", "--out", "loop.fmu")
    assert done.returncode == 0 and (tmp_path / "loop.fmu").is_file(), done.stderr
    done = call(installed, tmp_path, "explore", "two-area-thesis", "--out", "page.html")
    assert done.returncode == 0 and (tmp_path / "page.html").stat().st_size < 250_000, done.stderr
    assert not (tmp_path / "cache" / "objects").exists() and not (tmp_path / "cache" / "zig").exists()


def test_what_did_not_come_along_says_how_to_get_a_compiler(installed: Path, tmp_path: Path) -> None:
    done = call(installed, tmp_path, "build", "two-area-thesis", "--platforms", OTHER, "--out", "fmus")
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert "pip install 'interarea[build]'" in line and "CC=gcc" in line
