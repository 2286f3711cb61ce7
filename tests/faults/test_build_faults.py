"""A build and a study whose files the machine refuses: whole files or none, and with room the same bits.

A study of two figures and two scenarios is tried at file operations 1, 3, 9, 27 ..; a build with its
compiled library at every one, with a compilation at 1, 37, 73 ..; each of them at all in `make fuzz`.
"""

from __future__ import annotations

import errno
import os
import shutil
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from file_faults import LONG, SHARED, SHARES, Fault, grid
from fmu_runner import decay_block

from interarea.cosim.explorer import page
from interarea.cosim.explorer.subject import subject_of
from interarea.cosim.run.controllers import design_controller
from interarea.cosim.study.spec import design_specs, load_study
from interarea.cosim.study.study import run_study
from interarea.fmu_build.errors import BuildError
from interarea.fmu_build.write.cache import damaged
from interarea.fmu_build.write.package import build_fmu
from interarea.models.case.case import load_case
from interarea.models.case.write_toml import toml_text
from interarea.models.errors import InterareaError


@pytest.fixture(autouse=True)
def _no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda handle: None)


def built(cache: Path, out: Path) -> bytes:
    return build_fmu(decay_block(), out, cache=cache).read_bytes()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache in which the block's library is compiled."""
    cache = tmp_path_factory.mktemp("cache")
    built(cache, cache.with_name("whole.fmu"))
    return cache


@LONG
@pytest.mark.slow
@pytest.mark.parametrize(("folders", "step"), [(("binaries", "zig"), 1), (("zig",), 36)])
def test_a_build(folders: tuple[str, ...], step: int, finished: Path, tmp_path: Path) -> None:
    """With the compiled library in the cache, or what the compiler keeps only."""
    whole, count, reported = finished.with_name("whole.fmu").read_bytes(), 0, 0
    for n in grid(step=step):
        cache, out, fault = tmp_path / f"{n}", tmp_path / f"{n}.fmu", Fault(n, errno.ENOSPC)
        for folder in (f for f in folders if (finished / f).is_dir()):
            shutil.copytree(finished / folder, cache / folder)
        try:
            with fault.injected():
                built(cache, out)
        except OSError as error:
            assert error.errno == errno.ENOSPC
            reported += 1
        except BuildError as error:
            assert "\n" not in str(error) and os.strerror(errno.ENOSPC) in str(error), error
            reported += 1
        if fault.count < n:
            break
        count += 1
        assert not out.exists() or out.read_bytes() == whole, n
        assert not list(tmp_path.glob(".*.partial")), n
        assert built(cache, out) == whole, n
        assert damaged(cache) == [], n
    assert count >= 4 and reported >= count // 2


def small_study(folder: Path) -> str:
    """A study of one controller, two scenarios and two figures."""
    spec = {**load_study("thesis"), "controllers": ["wdc"], "stop_s": 4.0}
    for key in ("packets", "survival", "claims"):
        del spec[key]
    spec["latency"] = {**spec["latency"], "values_s": [0.1], "redesign": []}
    spec["margin"] = {**spec["margin"], "stop_s": 4.0}
    spec["scenario"] = [row for row in spec["scenario"] if row["name"] in ("none-pulse", "wdc-pulse")]
    spec["figure"] = [row for row in spec["figure"] if row["key"] in ("hankel", "5.2")]
    file = folder / "small.toml"
    file.write_text(toml_text(spec), encoding="utf-8")
    return str(file)


def left(out: Path) -> dict[str, bytes]:
    return {p.relative_to(out).as_posix(): p.read_bytes() for p in out.rglob("*") if p.is_file()}


@dataclass(frozen=True)
class Small:
    """A small study: its file, what it writes, and the models of its explorer, of which no file is kept."""

    name: str
    files: dict[str, bytes]
    models: Any


@pytest.fixture(scope="module")
def small(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Small:
    """Return the study after a first run, in which all that it computes came into the cache."""
    folder = tmp_path_factory.mktemp("small")
    name = small_study(folder)
    run_study(name, folder / "first", second_solver=False)
    spec = load_study(name)
    case, specs = load_case(spec["case"]), design_specs(spec)
    own = {c: design_controller(case, c, cache, specs=specs) for c in spec["controllers"]}
    models = page.models_of(subject_of(spec["case"], cache, own))
    return Small(name, left(folder / "first"), models)


@LONG
@SHARED
@pytest.mark.slow
def test_a_study(share: int, small: Small, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it computes is in the cache, as after a study that has failed at its files.

    Its models are kept here: a study's processes are forks of this one.
    """
    name = small.name
    monkeypatch.setattr(page, "models_of", lambda _: small.models)
    fault = Fault(0, 0)
    with fault.injected():
        run_study(name, tmp_path / "whole", second_solver=False)
    whole, tried = left(tmp_path / "whole"), 0
    assert small.files == whole and len(whole) >= 10
    for n in islice(grid(ratio=3.0), share, None, SHARES):
        if n > fault.count:
            break
        out = tmp_path / f"{n}"
        try:
            with Fault(n, errno.ENOSPC).injected():
                run_study(name, out, second_solver=False)
        except OSError as error:
            assert error.errno == errno.ENOSPC
        except InterareaError as error:
            assert "\n" not in str(error) and os.strerror(errno.ENOSPC) in str(error), error
        assert left(out).items() <= whole.items(), n
        run_study(name, out, second_solver=False)
        assert left(out) == whole, n
        tried += 1
    assert tried >= 4


@LONG
@pytest.mark.slow
def test_a_folder_in_the_place_of_each_file_of_a_study(
    small: Small, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page, "models_of", lambda _: small.models)
    names = sorted(small.files)
    assert len(names) >= 10
    for k, blocked in enumerate(names):
        out = tmp_path / f"{k}"
        (out / blocked).mkdir(parents=True)
        with pytest.raises(IsADirectoryError) as refused:
            run_study(small.name, out, second_solver=False)
        assert str(refused.value.filename) == str(out / blocked)
        assert left(out) == {}
