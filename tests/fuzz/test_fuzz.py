"""Random call orders and values on every FMI function of every block kind, under ASan and UBSan.

More calls: ``python tests/fuzz/run_fuzz.py --calls 10000000``.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from fmu_blocks import blocks
from fuzz_blocks import fuzz_block
from fuzz_build import Compiler, build_driver, sanitizing_compiler

SOURCES = ("fuzz.c", "fuzz_calls.c", "fuzz_states.c")
CALLS = {
    "controller": 300_000,
    "supervisor": 200_000,
    "channel": 100_000,
    "concentrator": 100_000,
    "detector": 50_000,
    "pmu": 50_000,
    "plant": 40_000,  # twice what finds each seeded mistake below that is found in a plant at all, of 3 seeds
    "loop": 20_000,
}

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def compiler() -> Compiler:
    result = sanitizing_compiler()
    if result is None:
        pytest.skip("no compiler here has the runtime of a sanitizer (tried $CC, gcc, clang, cc, zig)")
    return result


@pytest.mark.parametrize("kind", CALLS)
def test_nothing_is_found(kind: str, compiler: Compiler, cache: Path, tmp_path: Path) -> None:
    driver = build_driver(fuzz_block(kind, cache), SOURCES, compiler, tmp_path)
    said = driver.run(20261121, CALLS[kind])
    counts = {word: int(n) for n, word in re.findall(r"(\d+) (calls|ok|refused|steps|states)", said)}
    assert counts["calls"] >= CALLS[kind]
    # the calls reach deep: most are accepted, many take steps, and enough are refused
    assert counts["ok"] > 0.7 * counts["calls"], said
    assert counts["steps"] > 0.05 * counts["calls"], said
    assert counts["refused"] > 0.02 * counts["calls"], said


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("fmi2_values.c", "references[i] >= c->n_real", "references[i] > c->n_real"),
        ("fmi2_common.c", "MODES_READ & ~MODE_ERROR", "MODES_READ"),
        ("fmi2_state.c", "|| head->model != model_of(c))", ")"),
        ("instance.c", "if (*s == '%') safe[n++] = '%';", ""),
        ("fmi2_cs.c", "else if (!(step <= longest))", "else if (0)"),
        ("fmi2_instantiate.c", "instance_release(&callbacks, c->record_bytes);", ""),
    ],
)
def test_a_seeded_mistake_is_found(
    file: str, old: str, new: str, compiler: Compiler, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The harness is worth its time only if it notices."""
    import fuzz_build

    original = fuzz_build.source_files

    def changed(sources: tuple[Path, ...]) -> dict[str, bytes]:
        files = original(sources)
        assert old.encode() in files[file], f"{file} no longer has {old!r}"
        files[file] = files[file].replace(old.encode(), new.encode())
        return files

    monkeypatch.setattr(fuzz_build, "source_files", changed)
    driver = build_driver(blocks()["decay"], SOURCES, compiler, tmp_path)
    with pytest.raises(AssertionError, match=r"broken|Sanitizer|runtime error|code -"):
        driver.run(1, 100_000)
