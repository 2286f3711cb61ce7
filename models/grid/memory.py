"""Memory required by large grids, compared with the available memory before any is allocated.

The amounts below are measured by `benchmarks/grids/plant_memory.py` and `bench_large.py` on grids of 2000 to
82 000 buses. They are not a bound: a grid with more controls on a machine or more outputs needs more.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from ..case.case import Case
from ..errors import UserError

MIB = 1 << 20
PROCESS = 75 * MIB  #: the interpreter with its libraries
#: bytes of power flow, start, ordering, tables and description; a power lists all states that it depends on
BUILD_BUS, BUILD_MACHINE, BUILD_POWER = 3_200, 128_000, 40
OPEN_MACHINE, OPEN_POWER = 300_000, 113  #: bytes of case and open FMU, most of them its description
LANE_BUS = 300  #: bytes of each instance: factors, states, the stages of a step


def build_bytes(case: Case, *, powers: bool = True) -> int:
    """Return an estimate of the largest memory of a process that builds the plant of `case`, bytes.

    powers : whether each machine's power is an output.
    """
    buses, machines = len(case.buses), len(case.machines)
    powered = BUILD_POWER * machines**2 if powers else 0
    return PROCESS + BUILD_BUS * buses + BUILD_MACHINE * machines + powered


def run_bytes(case: Case, plants: int = 1, *, powers: bool = True) -> int:
    """Return an estimate of the memory of a process with so many plants of `case` from one FMU, bytes.

    powers : whether each machine's power is an output.
    """
    machines = len(case.machines)
    opened = OPEN_MACHINE * machines + (OPEN_POWER * machines**2 if powers else 0)
    return PROCESS + opened + plants * LANE_BUS * len(case.buses)


def require_memory(needed: int, what: str, instead: str, *, root: Path = Path("/")) -> None:
    """Reject a task that needs more memory than available; if that is unknown, nothing is rejected.

    what : the task and its place. instead : the remedy. root : of the file system with the machine's data.

    Raises
    ------
    UserError : needed and available memory, and what to do.
    """
    available = available_bytes(root)
    if available is not None and not needed <= available:
        raise UserError(
            f"{what}: needs about {needed / MIB:.0f} MiB of memory, allowed: {available / MIB:.0f} MiB, "
            f"which this machine has available; {instead}"
        )


def available_bytes(root: Path = Path("/")) -> int | None:
    """Return the memory left for this process, by the machine and its control groups; None: unknown."""
    if not sys.platform.startswith("linux"):
        return None
    match = re.search(r"^MemAvailable:\s+(\d+) kB", _text(root / "proc/meminfo"), re.MULTILINE)
    rest = [int(match[1]) * 1024] if match else []
    for line in _text(root / "proc/self/cgroup").splitlines():
        _, controllers, place = line.split(":", 2)
        if not controllers:
            names, top = ("memory.max", "memory.current"), root / "sys/fs/cgroup"
        elif "memory" in controllers.split(","):
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes")
            top = root / "sys/fs/cgroup/memory"
        else:
            continue
        group = top / place.lstrip("/")
        # in a container the group's own folder may be mounted as the root
        rest += [r for g in (group, *group.parents) if g.is_relative_to(top) for r in _left(g, *names)]
    return min(rest, default=None)


def _left(group: Path, limit: str, usage: str) -> list[int]:
    """Return what a control group leaves, with the file cache it can drop; empty: it has no limit."""
    most, used = _text(group / limit).strip(), _text(group / usage).strip()
    if not (most.isdecimal() and used.isdecimal()):
        return []
    dropped = re.search(r"^(?:total_)?inactive_file (\d+)", _text(group / "memory.stat"), re.MULTILINE)
    return [max(0, int(most) - int(used) + (int(dropped[1]) if dropped else 0))]


def _text(path: Path) -> str:
    try:
        return path.read_text("ascii", "replace")
    except OSError:
        return ""
