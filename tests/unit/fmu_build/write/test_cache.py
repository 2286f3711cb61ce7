"""The cache of artefacts: keys, files that are made once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from interarea.fmu_build.write import cache as store
from interarea.fmu_build.write.cache import artefact, code_hash, content_hash, place


def test_an_artefact_is_made_once_and_never_half(tmp_path: Path) -> None:
    made = []

    def make(path: Path) -> None:
        made.append(path)
        path.write_text("whole")

    def fail(path: Path) -> None:
        path.write_text("half")
        raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        artefact(tmp_path, "kind", "key", ".txt", fail)
    assert not (tmp_path / "kind" / "key.txt").exists()
    first = artefact(tmp_path, "kind", "key", ".txt", make)
    assert artefact(tmp_path, "kind", "key", ".txt", make) == first and len(made) == 1
    assert place(first, tmp_path / "out" / "copy.txt").read_text() == "whole"
    assert sorted(p.name for p in (tmp_path / "kind").iterdir()) == ["key.txt"]


def test_keys_tell_apart_what_differs() -> None:
    a = np.array([1.0, 2.0])
    assert content_hash(a) != content_hash(a.astype(np.float32))
    assert content_hash(a.reshape(1, 2)) != content_hash(a)
    assert content_hash("ab", "c") != content_hash("a", "bc")
    assert content_hash({"x": 1, "y": 2}) == content_hash({"y": 2, "x": 1})
    assert code_hash("interarea.design.linear.linearise") != code_hash("interarea.design.modes.modes")


def test_a_key_follows_every_form_of_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A form that is overlooked serves stale designs from the cache: each must reach the file it names."""
    files = {
        "design/start.py": "from ..models.sub.deep import value\nfrom . import beside\n",
        "design/beside.py": "def late():\n    import interarea.models.plain\n"
        "    from interarea.models import named\n",
        "models/sub/__init__.py": "",
        "models/sub/deep.py": "from ..above import value\nfrom .near import value\n",
        "models/sub/near.py": "from . import cousin\n",
        **{f"models/{name}.py": "" for name in ("plain", "named", "above", "sub/cousin")},
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.setattr(store, "ROOMS", tmp_path)
    fresh = code_hash.__wrapped__
    before = fresh("interarea.design.start")
    for name, text in files.items():
        (tmp_path / name).write_text(text + "# changed\n", encoding="utf-8")
        assert fresh("interarea.design.start") != before, name
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert fresh("interarea.design.start") == before
    with pytest.raises(ValueError, match="no module of this package"):
        fresh("interarea.design.moved_away")
