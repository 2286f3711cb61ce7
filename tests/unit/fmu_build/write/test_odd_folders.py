"""A cache may lie below a folder with any name."""

from __future__ import annotations

from pathlib import Path

import pytest

from interarea.cosim.run.artefacts import pmu_fmu


@pytest.mark.slow
@pytest.mark.parametrize("name", ["new\nline", "it's $HOME", "-dash", "back\\slash"])
def test_a_cache_in_a_folder_with_an_odd_name_has_the_same_bytes(name: str, tmp_path: Path) -> None:
    (tmp_path / name).mkdir()
    odd = pmu_fmu(tmp_path / name).read_bytes()
    assert odd == pmu_fmu(tmp_path / "plain").read_bytes()
