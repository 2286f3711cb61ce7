"""Plants stepped side by side against twins stepped alone, at random, under ASan and UBSan."""

from __future__ import annotations

import re
from pathlib import Path

import fuzz_build
import pytest
from fuzz_blocks import fuzz_block
from fuzz_build import Driver, build_driver, plain_compiler, sanitizing_compiler

from interarea.fmu_build.write.lane_library import group_sources

ROUNDS = 300  #: 15 times what finds each seeded mistake below, at each of 8 seeds and 3 numbers of lanes

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def driver(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Driver:
    compiler = sanitizing_compiler()
    if compiler is None:
        pytest.skip("no compiler here has the runtime of a sanitizer (tried $CC, gcc, clang, cc, zig)")
    block, folder = fuzz_block("plant", cache), tmp_path_factory.mktemp("group")
    return build_driver(block, ("group_steps.c",), compiler, folder, of_binary=group_sources())


@pytest.mark.parametrize("lanes", [2, 4, 8])
def test_twins_stay_twins(lanes: int, driver: Driver) -> None:
    said = driver.run(20261121 + lanes, ROUNDS, lanes)
    if "lanes at most" in said:
        pytest.skip(f"this processor has {said.strip()}")
    counts = {word: int(n) for n, word in re.findall(r"(\d+) (steps|failed|lines)", said)}
    # most steps go well, some fail, and many events and refusals were told
    assert counts["steps"] > 5 * ROUNDS, said
    assert 0.01 * counts["steps"] < counts["failed"] < 0.5 * counts["steps"], said
    assert counts["lines"] > 0.05 * counts["steps"], said


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("g->owner[k] == c && g->written[k] == c->memory_written", "g->owner[k] == c"),
        ("c->run->derivatives_fresh = STALE;", ""),
        ("step_consume_inputs(c, lane->step);", ""),
    ],
)
def test_a_seeded_mistake_is_found(
    old: str, new: str, tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The comparison is worth its time only if it notices."""
    original = fuzz_build.gather_sources

    def changed(sources: tuple[Path, ...]) -> dict[str, bytes]:
        files = original(sources)
        assert files["fmu_group.c"].count(old.encode()) >= 1
        files["fmu_group.c"] = files["fmu_group.c"].replace(old.encode(), new.encode())
        return files

    monkeypatch.setattr(fuzz_build, "gather_sources", changed)
    driver = build_driver(
        fuzz_block("plant", cache),
        ("group_steps.c",),
        plain_compiler(),
        tmp_path,
        of_binary=group_sources(),
    )
    with pytest.raises(AssertionError, match="broken"):
        driver.run(1, ROUNDS, 2)
