"""The cache of artefacts: keys, files that are made once."""

from __future__ import annotations

import ast
import hashlib
import logging
import os
from collections.abc import Callable
from importlib.util import resolve_name
from pathlib import Path

import numpy as np
import pytest
from fmu_runner import decay_block

from interarea.fmu_build.write import cache as store
from interarea.fmu_build.write.cache import (
    artefact,
    artefacts_in,
    code_hash,
    content_hash,
    damaged,
    is_whole,
    keep,
    place,
)
from interarea.fmu_build.write.package import block_fmu
from interarea.models.devices.header import devices_file


def test_an_artefact_is_made_once_and_never_half(tmp_path: Path) -> None:
    builds = []

    def make(path: Path) -> None:
        builds.append(path)
        path.write_text("whole")

    def fail(path: Path) -> None:
        path.write_text("half")
        raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        artefact(tmp_path, "kind", "key", ".txt", fail)
    assert not (tmp_path / "kind" / "key.txt").exists()
    first = artefact(tmp_path, "kind", "key", ".txt", make)
    assert artefact(tmp_path, "kind", "key", ".txt", make) == first and len(builds) == 1
    assert place(first, tmp_path / "out" / "copy.txt").read_text() == "whole"
    assert sorted(p.name for p in (tmp_path / "kind").iterdir()) == ["key.txt", "key.txt.sha256"]


def test_keys_tell_apart_what_differs() -> None:
    a = np.array([1.0, 2.0])
    assert content_hash(a) != content_hash(a.astype(np.float32))
    assert content_hash(a.reshape(1, 2)) != content_hash(a)
    assert content_hash("ab", "c") != content_hash("a", "bc")
    assert content_hash({"x": 1, "y": 2}) == content_hash({"y": 2, "x": 1})
    assert code_hash("interarea.design.linear.linearise") != code_hash("interarea.design.modes.modes")


def test_a_key_follows_the_device_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """C and records are made of them: a plant of old ones does not start in a library of new ones."""
    for name, text in {
        "models/devices/library.py": "",
        "models/devices/exciters/sexs.toml": "old",
        "design/start.py": "from interarea.models.devices import library\n",
        "design/beside.py": "",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.setattr(store, "ROOMS", tmp_path)
    monkeypatch.setattr(store, "_source", store._source.__wrapped__)
    monkeypatch.setattr(store, "source_hash", store.source_hash.__wrapped__)
    fresh, names = code_hash.__wrapped__, ("interarea.design.start", "interarea.design.beside")
    before = [fresh(name) for name in names]
    (tmp_path / "models/devices/exciters/sexs.toml").write_text("new", encoding="utf-8")
    assert [fresh(name) == key for name, key in zip(names, before, strict=True)] == [False, True]


def test_a_key_follows_every_form_of_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A form that is overlooked serves stale designs from the cache: each must reach the file it names."""
    files = {
        "design/start.py": "from ..models.sub.deep import value\nfrom . import beside\n",
        "design/beside.py": "def late():\n    import os, interarea.models.plain as plain\n"
        "    from interarea.models import (  # two\n        sub as other,  # (one)\n        named,\n    )\n",
        "models/sub/__init__.py": "",
        "models/sub/deep.py": "from ..above import value\nfrom .near import value\n",
        "models/sub/near.py": "from . import cousin\n",
        **{f"models/{name}.py": "" for name in ("plain", "named", "above", "sub/cousin")},
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.setattr(store, "ROOMS", tmp_path)
    monkeypatch.setattr(store, "_source", store._source.__wrapped__)
    fresh = code_hash.__wrapped__
    before = fresh("interarea.design.start")
    for name, text in files.items():
        (tmp_path / name).write_text(text + "# changed\n", encoding="utf-8")
        assert fresh("interarea.design.start") != before, name
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert fresh("interarea.design.start") == before
    with pytest.raises(ValueError, match="no module of this package"):
        fresh("interarea.design.moved_away")


@pytest.mark.slow
def test_a_key_follows_what_the_language_itself_takes_for_imports() -> None:
    """The lines that are read as imports, against Python's own tree of every module of the package."""
    for room in ("models", "fmu_build", "design", "cosim"):
        for file in (store.ROOMS / room).rglob("*.py"):
            package = ".".join(("interarea", *file.relative_to(store.ROOMS).parent.parts))
            imported = set()
            for node in ast.walk(ast.parse(file.read_bytes())):
                if isinstance(node, ast.Import):
                    imported |= {alias.name for alias in node.names}
                elif isinstance(node, ast.ImportFrom):
                    origin = resolve_name("." * node.level + (node.module or ""), package)
                    imported |= {origin, *(f"{origin}.{alias.name}" for alias in node.names)}
            assert imported <= set(store._imports(package, file.read_bytes())), file


def _flipped(path: Path) -> None:
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 1
    path.write_bytes(raw)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "one bit": _flipped,
    "cut short": lambda p: p.write_bytes(p.read_bytes()[:-1]),
    "empty": lambda p: p.write_bytes(b""),
    "zeros": lambda p: p.write_bytes(bytes(p.stat().st_size)),
    "more": lambda p: p.write_bytes(p.read_bytes() + b"x"),
}


@pytest.mark.parametrize("what", ["a.json", "a.json.sha256"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_made_again(
    damage: str, what: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Whatever happened to the file or to its proof: the same bytes come back, with one line."""

    def get() -> Path:
        return artefact(tmp_path, "kind", "a", ".json", lambda p: p.write_text("[1.25, 2.5]"))

    get()
    before = {p: p.read_bytes() for p in (tmp_path / "kind").iterdir()}
    DAMAGES[damage](tmp_path / "kind" / what)
    assert [k.path.name for k in damaged(tmp_path)] == ["a.json"]
    with caplog.at_level(logging.WARNING, "interarea"):
        get()
        get()
    assert {p: p.read_bytes() for p in (tmp_path / "kind").iterdir()} == before and len(before) == 2
    assert [r.getMessage().count("is made again") for r in caplog.records] == [1]


@pytest.mark.slow
def test_a_damaged_fmu_and_its_damaged_binary_come_back(
    cache: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    block_fmu(decay_block(), cache)
    (tmp_path / "zig").symlink_to(cache / "zig")
    fmu = block_fmu(decay_block(), tmp_path)
    files = [k.path for k in artefacts_in(tmp_path) if k.kind != "zig"]
    before = {p: p.read_bytes() for p in files}
    for path in files:
        _flipped(path)
    with caplog.at_level(logging.WARNING, "interarea"):
        assert block_fmu(decay_block(), tmp_path) == fmu
    assert {p: p.read_bytes() for p in files} == before
    assert {p.parent.name for p in files} == {"decay", "binaries", "objects"}
    assert [r.getMessage().count("is made again") for r in caplog.records] == [1] * len(files)


def test_the_proof_is_what_sha256sum_writes(tmp_path: Path) -> None:
    path = keep(tmp_path / "kind" / "a.bin", b"content")
    proof = path.with_name("a.bin.sha256").read_text()
    assert proof == f"{hashlib.sha256(b'content').hexdigest()}  a.bin\n" and is_whole(path)


def test_the_cache_shows_checks_and_trims(interarea, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setenv("INTERAREA_CACHE", str(tmp_path))
    assert interarea("cache")[0] == 0  # empty
    now = 1.0e9
    for k, name in enumerate(("old", "middle", "new")):
        path = keep(tmp_path / "linear" / f"{name}.npz", bytes(1_000_000))
        os.utime(path.with_name(f"{path.name}.sha256"), (now + k, now + k))
    code, out, _ = interarea("cache")
    assert code == 0 and "linear" in out and "3.0" in out
    _flipped(tmp_path / "linear" / "middle.npz")
    code, out, _ = interarea("cache", "--check")
    assert code == 0 and "1 damaged: removed" in out and "1.0 MB freed" in out
    assert sorted(p.name for p in (tmp_path / "linear").iterdir()) == [
        *("new.npz", "new.npz.sha256", "old.npz", "old.npz.sha256")
    ]
    assert "no file is damaged" in interarea("cache", "--check")[1]
    assert interarea("cache", "--keep-mb", "1.5")[0] == 0
    assert sorted(p.name for p in (tmp_path / "linear").iterdir()) == ["new.npz", "new.npz.sha256"]
    assert interarea("cache", "--unused-days", "1")[0] == 0
    assert list((tmp_path / "linear").iterdir()) == []
    header = devices_file()  # named by its content, not proved by a file beside it
    assert interarea("cache", "--check")[0] == 0 and header.is_file()
    header.write_bytes(header.read_bytes()[:-1])
    assert "1 damaged: removed" in interarea("cache", "--check")[1] and not header.exists()
    for wrong in ("-1", "nan"):
        assert interarea("cache", "--keep-mb", wrong)[0] == 2
