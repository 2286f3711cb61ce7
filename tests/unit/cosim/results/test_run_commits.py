"""The commits kept beside a run: whose they are, and how often git is asked."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from interarea.cosim.results import record

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="needs git")


def _checkout(folder: Path) -> str:
    """Make a folder a checkout of one commit; return its name."""
    folder.mkdir(parents=True, exist_ok=True)
    git = ["git", "-C", str(folder), "-c", "user.name=n", "-c", "user.email=e@example.org"]
    subprocess.run([*git, "init", "-q"], check=True)
    subprocess.run([*git, "commit", "-q", "--allow-empty", "-m", folder.name], check=True)
    done = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True)
    return done.stdout.strip()


def test_git_is_asked_once_of_one_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of the package has its commit; a checkout inside or beside it has its own."""
    package = tmp_path / "package"
    commits = {
        folder: _checkout(folder) for folder in (package, package / "own" / "inner", tmp_path / "beside")
    }
    for folder in (package / "scenarios", package / "own" / "inner" / "deep", tmp_path / "none"):
        folder.mkdir()
    requests: list[Path] = []
    commit = record._commit
    monkeypatch.setattr(record, "_PACKAGE", package)
    monkeypatch.setattr(record, "_commit", lambda folder: requests.append(folder) or commit(folder))
    for folder, whose, times in (
        (package, package, 1),
        (package / "scenarios", package, 1),
        (package / "own" / "inner" / "deep", package / "own" / "inner", 2),
        (tmp_path / "beside", tmp_path / "beside", 2),
        (tmp_path / "none", None, 2),
    ):
        requests.clear()
        assert record._commits(folder) == {"interarea": commits[package], "scenario": commits.get(whose)}, (
            folder
        )
        assert len(requests) == times, folder
