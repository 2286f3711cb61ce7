"""What large grids need of memory, against pretended machines to the edge."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from command_line import invoke

from interarea.cosim.run import artefacts
from interarea.models.case.case import load_case
from interarea.models.errors import UserError
from interarea.models.grid import memory
from interarea.models.grid.memory import MIB, available_bytes, require_memory, run_bytes

linux = pytest.mark.skipif(sys.platform != "linux", reason="nothing tells there what memory is available")


def machine(root: Path, **files: str) -> Path:
    """A pretended machine with 4 GiB, and files of its own by their paths."""
    contents = {"proc/meminfo": "MemTotal: 9 kB\nMemAvailable:    4194304 kB\n", **files}
    for name, text in contents.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


@linux
def test_the_machine_says_what_it_has(tmp_path: Path) -> None:
    assert available_bytes(machine(tmp_path)) == 4096 * MIB
    assert available_bytes(tmp_path / "nothing") is None
    assert 0 < available_bytes() < 1 << 50


@linux
@pytest.mark.parametrize(
    ("group", "limit", "usage", "line"),
    [
        ("sys/fs/cgroup/a", "memory.max", "memory.current", "0::/a/b\n"),
        ("sys/fs/cgroup", "memory.max", "memory.current", "0::/not/mounted\n"),
        (
            "sys/fs/cgroup/memory/a",
            "memory.limit_in_bytes",
            "memory.usage_in_bytes",
            "4:cpu:/x\n7:memory:/a\n",
        ),
    ],
)
def test_a_control_group_leaves_its_limit_less_what_it_holds(
    tmp_path: Path, group: str, limit: str, usage: str, line: str
) -> None:
    files = {"proc/self/cgroup": line, f"{group}/{usage}": f"{300 * MIB}\n"}
    files |= {f"{group}/memory.stat": f"anon 1\ninactive_file {50 * MIB}\n", f"{group}/{limit}": "max\n"}
    assert available_bytes(machine(tmp_path, **files)) == 4096 * MIB
    files[f"{group}/{limit}"] = f"{1000 * MIB}\n"
    assert available_bytes(machine(tmp_path, **files)) == 750 * MIB


@linux
def test_the_edge_is_what_there_is(tmp_path: Path) -> None:
    root = machine(tmp_path)
    require_memory(4096 * MIB, "a grid", "take less", root=root)
    says = r"^a grid: needs about 4097 MiB .* allowed: 4096 MiB, .*; take less$"
    with pytest.raises(UserError, match=says):
        require_memory(4097 * MIB, "a grid", "take less", root=root)
    require_memory(1 << 60, "a grid", "take less", root=root / "nothing")


@pytest.mark.parametrize("free_mib", [50, 0])
def test_a_small_machine_is_told_in_one_line_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free_mib: int
) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda _root: free_mib * MIB)
    screen = ["screen", "two-area-thesis", "--out", str(tmp_path / "out")]
    with monkeypatch.context() as built:  # its plant may be new: refused below
        built.setattr(artefacts, "require_memory", lambda *_: None)
        code, _, said = invoke(screen, monkeypatch)
    assert (code, said.count("\n")) == (2, 1)
    assert "workers with up to" in said
    assert f"allowed: {free_mib} MiB" in said
    monkeypatch.setenv("INTERAREA_CACHE", str(tmp_path / "empty"))
    code, _, said = invoke(["run", "fault", "--out", str(tmp_path / "run")], monkeypatch)
    assert (code, said.count("\n")) == (2, 1)
    assert "two-area-thesis: the plant of" in said
    assert not list((tmp_path / "empty").rglob("*.fmu"))


def test_plants_side_by_side_share_what_is_open() -> None:
    case = load_case("nets-nyps")
    one, eight = run_bytes(case), run_bytes(case, 8)
    assert eight - one == 7 * memory.LANE_BUS * len(case.buses)
    assert run_bytes(case, powers=False) < one
