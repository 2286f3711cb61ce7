"""How the package is built: by setuptools, and into a wheel go the binaries that it needs no compiler for.

`pip wheel .` compiles the repository's C for every platform (interarea/binaries.py); an editable install
compiles nothing. `-C platforms=linux64,win64` chooses, `-C platforms=none` makes a wheel without binaries.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import (
    build_editable,
    build_sdist,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)
from setuptools.command.build_py import build_py

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
    "prepare_metadata_for_build_wheel",
]
ZIG = "ziglang==0.17.1"  #: one version: a rebuild gives the same bytes
_NEEDED = ("fmpy", "numpy", "pydantic", "scipy")  #: of the dependencies, by interarea/binaries.py
_CHOICE = "INTERAREA_WHEEL_PLATFORMS"  #: from `build_wheel` to `BuildPy`
_Settings = dict[str, Any] | None


def get_requires_for_build_wheel(config_settings: _Settings = None) -> list[str]:
    """PEP 517."""
    needed = build_meta.get_requires_for_build_wheel(config_settings)
    if (config_settings or {}).get("platforms") == "none":
        return needed
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [*needed, ZIG, *(d for d in project["dependencies"] if d.startswith(_NEEDED))]


def build_wheel(
    wheel_directory: str, config_settings: _Settings = None, metadata_directory: str | None = None
) -> str:
    """PEP 517."""
    os.environ[_CHOICE] = (config_settings or {}).get("platforms", "all")
    return build_meta.build_wheel(wheel_directory, config_settings, metadata_directory)


class BuildPy(build_py):
    """Copies the package to where the wheel is packed from, and compiles there what travels in it."""

    def run(self) -> None:
        super().run()
        choice = os.environ.get(_CHOICE, "none")
        if self.editable_mode or choice == "none":
            return
        copy = Path(self.build_lib).absolute()
        command = [sys.executable, "-m", "interarea.binaries", str(copy / "interarea/fmu_build/binaries")]
        command += [] if choice == "all" else ["--platforms", choice]
        with_copy = os.pathsep.join([str(copy), *filter(None, [os.environ.get("PYTHONPATH")])])
        subprocess.run(command, check=True, cwd=copy, env={**os.environ, "PYTHONPATH": with_copy})
