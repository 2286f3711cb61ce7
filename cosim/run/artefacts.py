"""Files made once and found again: FMUs, linear models, controllers, named by content hash.

A key holds the bytes of the inputs and of the sources that turn them into the
artefact, so a changed case, design or C file gives a new file and an unchanged
one is never computed twice. Files appear by an atomic rename: a killed run
leaves no half-written artefact behind.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache as forever
from importlib.metadata import PackageNotFoundError, version
from importlib.util import resolve_name
from pathlib import Path
from typing import TYPE_CHECKING, Any

import control
import numpy as np

from interarea.design.certificates.closed_loop import certificate
from interarea.design.controllers.bundled import shipped_controller, shipped_names
from interarea.design.linear.linearise import linearise, remove_reference, speeds_in_rad
from interarea.design.modes.modes import modes_of
from interarea.fmu_build.open.cross_check import add_cross_check
from interarea.fmu_build.open.plant import open_plant
from interarea.fmu_build.write.compile import PLATFORMS, host_platform
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.plant import plant_block
from interarea.models.blocks.variables import Block
from interarea.models.case.case import Case

if TYPE_CHECKING:
    from interarea.design.controllers.bank import ControllerBank
    from interarea.design.controllers.controller import Controller

ROOMS = Path(__file__).resolve().parents[2]

#: Controllers that `design_controller` knows, in the order in which the study tells them.
CONTROLLER_NAMES = ("wdc", "cc", "ftc")


def default_cache() -> Path:
    """Return the artefact folder: `$INTERAREA_CACHE`, else `interarea` in the user's cache folder."""
    named = os.environ.get("INTERAREA_CACHE")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "interarea"


def content_hash(*parts: object) -> str:
    """Return 16 hexadecimal digits of SHA-256 over `parts` (bytes, arrays, or anything JSON can hold)."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, bytes):
            raw = part
        elif isinstance(part, np.ndarray):
            raw = str((part.dtype.str, part.shape)).encode() + np.ascontiguousarray(part).tobytes()
        else:
            raw = json.dumps(part, sort_keys=True, default=str).encode()
        digest.update(len(raw).to_bytes(8, "little") + raw)
    return digest.hexdigest()[:16]


def file_hash(path: Path) -> str:
    """Return 16 hexadecimal digits of SHA-256 over the bytes of a file."""
    return content_hash(path.read_bytes())


@forever
def source_hash(room: str, pattern: str = "*.py") -> str:
    """Return the hash of those files of a room (folders below included) that match `pattern`."""
    folder = ROOMS / room
    files = sorted(folder.rglob(pattern))
    return content_hash(*(part for p in files for part in (p.relative_to(folder).as_posix(), p.read_bytes())))


@forever
def code_hash(module: str) -> str:
    """Return the hash of the Python source of a module of this package and of all it imports from it.

    module : full name; a module's own `__name__`, or the `__module__` of what it defines.

    Raises
    ------
    ValueError : no such module; a wrong name must not end in a key that never changes.
    """
    sources: dict[str, bytes] = {}
    todo = [module]
    while todo:
        name = todo.pop()
        path = _source_file(name)
        if path is not None and name not in sources:
            sources[name] = path.read_bytes()
            package = name if path.name == "__init__.py" else name.rpartition(".")[0]
            todo += _imports(package, sources[name])
    if module not in sources:
        raise ValueError(f"{module!r} is no module of this package")
    return content_hash(*(part for name in sorted(sources) for part in (name, sources[name])))


def _source_file(name: str) -> Path | None:
    first, *parts = name.split(".")
    if first != "interarea" or not parts:
        return None
    path = ROOMS.joinpath(*parts)
    files = (path.with_name(f"{path.name}.py"), path / "__init__.py")
    return next((file for file in files if file.is_file()), None)


def _imports(package: str, source: bytes) -> list[str]:
    found = []
    todo: list[Any] = list(ast.parse(source).body)
    while todo:  # statements only: no expression holds an import, and they are most of a tree
        node = todo.pop()
        for block in ("body", "orelse", "finalbody", "handlers", "cases"):
            todo += getattr(node, block, ())
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            name = resolve_name("." * node.level + (node.module or ""), package)
            found += [name, *(f"{name}.{alias.name}" for alias in node.names)]
    return found


@forever
def numerics_versions() -> dict[str, str]:
    """Return the versions of the libraries whose rounding can reach a result."""
    return {name: _version(name) for name in ("numpy", "scipy", "control", "cvxpy", "clarabel", "fmpy")}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def artefact(cache: Path, kind: str, key: str, suffix: str, make: Callable[[Path], object]) -> Path:
    """Return the file `cache/KIND/KEYSUFFIX`, calling `make(temporary path)` when it is not there yet."""
    path = cache / kind / f"{key}{suffix}"
    if path.exists():
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".making-", dir=path.parent) as folder:
        made = Path(folder) / f"{key}{suffix}"
        make(made)
        made.replace(path)
    return path


def cached_json(cache: Path, kind: str, key: str, make: Callable[[], Any]) -> Any:
    """Return the JSON value `cache/KIND/KEY.json`, calling `make()` when it is not there yet."""

    def write(path: Path) -> None:
        path.write_text(json.dumps(make(), allow_nan=False), encoding="utf-8")

    return json.loads(artefact(cache, kind, key, ".json", write).read_text(encoding="utf-8"))


def place(artefact: Path, path: Path) -> Path:
    """Copy an artefact to where the user wants it, as one finished file; return that path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.partial")
    shutil.copyfile(artefact, partial)
    return partial.replace(path)


def block_fmu(block: Block, cache: Path, *, platforms: Sequence[str] | None = None) -> Path:
    """Build the FMU of a block once; the key is everything the block holds and the FMU builder's sources.

    platforms : see `build_fmu`.
    """
    variables = [repr(v) for v in block.table]
    data = [part for name, value in block.data.items() for part in (name, _raw(value))]
    key = content_hash(
        block.kind,
        block.name,
        block.description,
        [block.step_s, block.stop_s, block.longest_step_s, block.model_exchange],
        dict(block.documentation),
        dict(block.provenance),
        variables,
        *data,
        *(p.read_bytes() for p in block.sources),
        source_hash("models", "*.h"),
        source_hash("fmu_build/write"),
        source_hash("fmu_build", "*.[ch]"),
        os.environ.get("CC", ""),
        *([] if platforms is None else [list(platforms)]),
    )

    def make(path: Path) -> None:
        build_fmu(block, path, platforms=platforms, cache=cache)

    return artefact(cache, block.kind, f"{block.name}-{key}", ".fmu", make)


def complete_fmu(fmu: Path, cache: Path) -> Path:
    """Return a copy of one of our FMUs with cross-check files, or the FMU itself if it cannot run here."""
    with zipfile.ZipFile(fmu) as archive:
        here = f"binaries/{PLATFORMS[host_platform()].folder}/"
        if not any(name.startswith(here) for name in archive.namelist()):
            return fmu
    key = content_hash(file_hash(fmu), code_hash(add_cross_check.__module__))
    return artefact(cache, "complete", f"{fmu.stem}-{key}", ".fmu", lambda p: add_cross_check(fmu, p))


def _raw(value: object) -> bytes | np.ndarray[Any, Any]:
    return value if isinstance(value, bytes) else np.asarray(value)


def plant_fmu(case: Case, cache: Path) -> Path:
    """Return the plant FMU of a case, built when its data or its C sources are new."""
    return block_fmu(plant_block(case), cache)


def concentrator_fmu(signals: int, cache: Path) -> Path:
    """Return the FMU of a concentrator of so many signals."""
    from interarea.models.blocks.concentrator import concentrator_block

    return block_fmu(concentrator_block(signals), cache)


def channel_fmu(cache: Path) -> Path:
    """Return the FMU of one channel; latency, outages and the rule on loss are its parameters."""
    from interarea.models.blocks.channel import channel_block

    return block_fmu(channel_block(), cache)


def active_bank(case: Case, cache: Path) -> ControllerBank:
    """Return the bank of controllers with its switching certificate, designed when it is new."""
    from interarea.design.controllers.bank import ControllerBank

    key = content_hash(
        file_hash(plant_fmu(case, cache)),
        code_hash("interarea.design.certificates.bank_design"),
        numerics_versions(),
    )

    def make(path: Path) -> Path:
        from interarea.design.certificates.bank_design import design_active

        relative = remove_reference(linear_plant(case, cache))
        return design_active(relative, omega_b=case.omega_b).save(path)

    return ControllerBank.load(artefact(cache, "controllers", f"active-{key}", ".json", make))


def controller_fmu(controller: Controller | ControllerBank, omega_b: float, cache: Path) -> Path:
    """Return the FMU of a controller: pu in, pu out; `omega_b` in rad/s."""
    return block_fmu(controller.block(omega_b), cache)


def linear_plant(case: Case, cache: Path) -> control.StateSpace:
    """Return the plant FMU linearised at its operating point, reference angle included.

    Inputs `G1_vs`.. in pu, outputs as the FMU gives them (speeds in pu); all states in s.
    """
    fmu = plant_fmu(case, cache)
    key = content_hash(fmu.name, code_hash(linearise.__module__), numerics_versions())

    def make(path: Path) -> None:
        with open_plant(fmu) as plant:
            _save_linear(linearise(plant), path)

    path = artefact(cache, "linear", key, ".npz", make)
    with np.load(path) as z:
        return control.ss(
            *(z[m] for m in "ABCD"),
            states=[str(s) for s in z["states"]],
            inputs=[str(s) for s in z["inputs"]],
            outputs=[str(s) for s in z["outputs"]],
            name=case.name.replace(".", "_"),  # python-control refuses a dot
        )


def _save_linear(system: control.StateSpace, path: Path) -> None:
    arrays: dict[str, Any] = {m: getattr(system, m) for m in "ABCD"}
    arrays |= {"states": system.state_labels, "inputs": system.input_labels, "outputs": system.output_labels}
    with path.open("wb") as out:
        np.savez(out, **arrays)


def design_controller(case: Case, name: str, cache: Path, *, reduce: bool = True) -> Controller:
    """Return controller `name` (wdc | cc | ftc) of a case, designed and certified when it is new.

    The conventional controller (cc) is the one with the normal damping of the fault-tolerant one (ftc), so
    that the two compare. reduce : False keeps the order that synthesis gave.

    Raises
    ------
    ValueError : an unknown name. InfeasibleDesign, UncertifiedDesign : as the design says.
    """
    if name in shipped_names():
        return shipped_controller(name)
    if name not in CONTROLLER_NAMES:
        known = (*CONTROLLER_NAMES, *shipped_names())
        raise ValueError(f"controller {name!r} is not known, allowed: {', '.join(known)}")
    key = content_hash(
        [name, reduce],
        file_hash(plant_fmu(case, cache)),
        code_hash("interarea.design.synthesis.study_designs"),
        code_hash(certificate.__module__),
        numerics_versions(),
    )
    path = artefact(
        cache, "controllers", f"{name}-{key}", ".json", lambda p: _design(case, name, cache, reduce).save(p)
    )
    from interarea.design.controllers.controller import Controller

    return Controller.load(path)


def _design(case: Case, name: str, cache: Path, reduce: bool) -> Controller:
    from interarea.design.synthesis import study_designs as designs

    relative = remove_reference(linear_plant(case, cache))
    order = {} if reduce else {"order": relative.nstates}
    if name == "wdc":
        made = designs.design_wdc(relative, replace(designs.WdcSpec(), **order), omega_b=case.omega_b)
    elif name == "ftc":
        made = designs.design_ftc(relative, replace(designs.FtcSpec(), **order), omega_b=case.omega_b)
    else:
        spec = replace(designs.CcSpec(), **order)
        reference = design_controller(case, "ftc", cache)
        made = designs.design_cc_like(reference, relative, spec, omega_b=case.omega_b)
    if not reduce:
        return made
    plant = speeds_in_rad(relative, case.omega_b)
    return replace(made, certificate=certificate(plant, made, modes_of(relative, case.areas)))
