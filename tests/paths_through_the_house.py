"""How many files a value meets on its way, and the imports between them.

    python tests/paths_through_the_house.py [scenario | sweep | fmu ...] [--list]

A file is met when a function of it runs on the way (not when it is merely loaded). An arrow is an import of
one met file by another, wherever in the file it stands. The way is gone twice and counted the second time:
what is made once (FMUs, designs, the kernel's binary) lies in the cache then.
"""

from __future__ import annotations

import ast
import sys
import tempfile
from collections.abc import Callable
from importlib.util import resolve_name
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

_FUNCTION = 0x1  # CO_OPTIMIZED: a function's body, not that of a module or class
PULSE = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}
SCENARIO: dict[str, Any] = {
    "case": "two-area-thesis",
    "controller": "wdc",
    "stop_s": 5.0,
    "channels": {
        "remote": {"signal": "G2_dw", "latency_s": 0.1},
        "local": {"signal": "G4_dw", "latency_s": 0.1},
    },
    "event": [PULSE],
}
SWEEP: dict[str, Any] = {
    "scenario": SCENARIO,
    "parameters": {
        "latency": {"path": "channels.*.latency_s", "values": [0.05, 0.1]},
        "size": {"path": "event.1.size_pu", "values": [0.02, 0.05]},
        "load": {"path": "case.load_scale", "values": [1.0, 1.01]},
    },
}


def met_by(action: Callable[[], object]) -> set[Path]:
    """Return our Python files of which a function runs while `way` is gone."""
    collected: set[CodeType] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            collected.add(frame.f_code)

    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(None)
    files = {Path(code.co_filename) for code in collected if code.co_flags & _FUNCTION}
    return {f for f in files if f.exists() and module_of(f) is not None}


def module_of(file: Path) -> str | None:
    """Return the module of one of our files, None for others."""
    for name, module in sys.modules.items():
        if name.startswith("interarea.") and getattr(module, "__file__", None) == str(file):
            return name
    return None


def python_arrows(files: set[Path]) -> set[tuple[str, str]]:
    """Return the imports between files: (module, module)."""
    modules = {str(module_of(f)): f for f in files}
    arrows = set()
    for name, file in modules.items():
        package = name if file.name == "__init__.py" else name.rpartition(".")[0]
        for target in _imports(package, file.read_text(encoding="utf-8")):
            if target in modules and target != name:
                arrows.add((name, target))
    return arrows


def _imports(package: str, source: str) -> set[str]:
    collected: set[str] = set()
    todo: list[Any] = [ast.parse(source)]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.Import):
            collected |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), package)
            collected |= {base, *(f"{base}.{a.name}" for a in node.names)}
        todo += ast.iter_child_nodes(node)
    return collected


def _scenario() -> tuple[Callable[[], object], Callable[[], object]]:
    from interarea.cosim.run.run import run_scenario

    return (lambda: run_scenario(SCENARIO)), _nothing


def _sweep() -> tuple[Callable[[], object], Callable[[], object]]:
    from interarea.cosim.sweep.plan import plan_sweep
    from interarea.cosim.sweep.runner import Runner
    from interarea.cosim.sweep.spec import load_sweep
    from interarea.cosim.sweep.store import SweepStore
    from interarea.fmu_build.write.cache import default_cache

    def go() -> None:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            plan = plan_sweep(load_sweep(SWEEP), default_cache())
            (folder / "scratch").mkdir()
            with (
                SweepStore(folder / "out", plan) as store,
                Runner(plan, default_cache(), folder / "scratch") as runner,
            ):
                store.append(list(runner.outcomes(list(store.todo()))))
                store.finish()

    return go, _nothing


def _fmu() -> tuple[Callable[[], object], Callable[[], object]]:
    from interarea.fmu_build.write.package import build_fmu
    from interarea.models.blocks.plant import plant_block
    from interarea.models.case.case import load_case

    def go() -> None:
        with tempfile.TemporaryDirectory() as name:
            build_fmu(plant_block(load_case("two-area-thesis")), Path(name) / "plant.fmu")

    return go, _nothing


def _nothing() -> None:
    pass


def count(name: str) -> tuple[set[Path], set[tuple[str, str]]]:
    """Return the Python files of a way and the imports between them."""
    go, _ = {"scenario": _scenario, "sweep": _sweep, "fmu": _fmu}[name]()
    go()
    files = met_by(go)
    return files, python_arrows(files)


def main(arguments: list[str]) -> None:
    """Print the counts of the ways asked for."""
    for name in [a for a in arguments if not a.startswith("-")] or ["scenario", "sweep", "fmu"]:
        files, arrows = count(name)
        print(f"{name}: {len(files)} Python files, {len(arrows)} imports between them")
        if "--list" in arguments:
            for module in sorted(str(module_of(f)) for f in files):
                print("   ", module)


if __name__ == "__main__":
    main(sys.argv[1:])
