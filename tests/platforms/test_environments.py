"""The two ends of what pyproject.toml allows: the lowest versions of every dependency, and the newest.

Each in an environment of its own, filled by pip; skipped where no registry answers.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
REQUIREMENTS = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["build"]]
#: what a first day does; each ends with exit code 0
COMMANDS = (
    "run lost-signal --out run",
    "modes two-area-thesis --shapes",
    "certify robust --conditions N,s100,L:G2_dw",
    "explore two-area-thesis --out page.html",
    "meter run/trajectory.parquet --band 0.1:2",
    "check loop.ssp",
)
pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]


def requirements(end: str) -> list[str]:
    """Return what pip is asked for; ">=" of the lowest end becomes "==", which pads with zeros."""
    return [name.replace(">=", "==") for name in REQUIREMENTS] if end == "lowest" else REQUIREMENTS


def test_every_dependency_has_a_lower_bound() -> None:
    assert all(re.fullmatch(r"[a-z0-9-]+>=[0-9.]+", name) for name in REQUIREMENTS)


@pytest.mark.parametrize("end", ["lowest", "newest"])
def test_a_first_day_at_both_ends(end: str, cache: Path, tmp_path: Path) -> None:
    """What this environment's compiler made of the C is not made again by the same version; all else is."""
    venv.create(tmp_path / "environment", with_pip=False)
    python = tmp_path / "environment" / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    # by this environment's pip; only what is imported is compiled to bytecode
    pip = [sys.executable, "-m", "pip", "--python", str(python), "--quiet", "install", "--no-compile"]
    install = [*pip, "--only-binary", ":all:", *requirements(end)]
    done = subprocess.run(install, capture_output=True, text=True, check=False)
    answered = "No matching distribution" in done.stderr and "Retrying" not in done.stderr
    if done.returncode != 0 and not answered:
        pytest.skip(f"no registry: {done.stderr[-200:]}")
    assert done.returncode == 0, done.stderr  # a bound that cannot be had is a wrong bound
    (cache / "binaries").mkdir(parents=True, exist_ok=True)
    shutil.copytree(cache / "binaries", tmp_path / "cache" / "binaries")  # named by their compiler's version
    environment = os.environ | {"PYTHONPATH": str(ROOT), "INTERAREA_CACHE": str(tmp_path / "cache")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # seven commands would compile all of it seven times
    for line in ("ssp lost-signal --out loop.ssp", *COMMANDS):
        words = [str(python), "-W", "error::DeprecationWarning:interarea", "-m", "interarea", *line.split()]
        done = subprocess.run(
            words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{line}: {done.stderr}"
        assert "Warning" not in done.stderr, f"{line}: {done.stderr}"
