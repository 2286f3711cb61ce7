"""A sweep with all it needs from elsewhere: cases, designed controllers, versions. Complete on any machine.

The controllers are those of the unchanged case: a sweep asks how a given controller holds where it was not
designed for, so nothing is designed anew for a changed operating point.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from interarea.design.controllers.bank import ControllerBank, load_controller
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.write.cache import (
    artefact,
    code_hash,
    content_hash,
    file_hash,
    is_whole,
    numerics_versions,
    source_hash,
)
from interarea.models.case.case import Case, case_of, load_case
from interarea.models.files import temporary_folder

from ..errors import ScenarioError, SweepError
from ..results.ringdown import Swing
from ..run.controllers import ControllerLike, controller_of
from ..run.swing_signal import swing_of
from ..scenario.scenario import load_scenario
from .point import check_paths, check_values
from .spec import LARGEST, Sweep, sweep_of

FORMAT = 2  #: of the result folder


def code_version() -> str:
    """Return the hash of all code that a run's numbers come from, and of the libraries' versions."""
    return content_hash(
        code_hash("interarea.cosim.sweep.runner"),
        source_hash("models", "*.[ch]"),
        source_hash("fmu_build", "*.[ch]"),
        source_hash("cosim", "*.[ch]"),
        numerics_versions(),
    )


@dataclass(frozen=True)
class SweepPlan:
    """`cases`: name -> document; `controllers`: "CASE/NAME" -> what a controller file holds; `fmus`: of the
    user's own, instance -> content hash of its file, which is in the cache (`own_fmu`); `swings`: case -> the
    `Swing` that its runs are judged by, at any operating point."""

    sweep: Sweep
    cases: Mapping[str, Mapping[str, Any]]
    controllers: Mapping[str, Mapping[str, Any]]
    modes: tuple[str, ...]
    version: str
    fmus: Mapping[str, str] = field(default_factory=dict)
    swings: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def case(self, name: str) -> Case:
        """Return a case of the sweep."""
        return case_of(self.cases[name], where=name)

    @property
    def has_dc_links(self) -> bool:
        """Whether a case has line-commutated dc links."""
        return any(case.get("hvdcs") for case in self.cases.values())

    def swing(self, case: str) -> Swing:
        """Return what the runs of a case are judged by."""
        return Swing(*self.swings[case])

    def controller(self, case: str, name: str) -> Controller | ControllerBank | None:
        """Return a controller of the sweep; None where the scenario has none."""
        if name == "none":
            return None
        with temporary_folder() as folder:
            path = folder / "controller.json"
            path.write_text(json.dumps(self.controllers[f"{case}/{name}"]), encoding="utf-8")
            return load_controller(path)

    def document(self) -> dict[str, Any]:
        """Return the plan as plain types, for `plan_of_document`."""
        return {
            "format": FORMAT,
            "version": self.version,
            "sweep": self.sweep.document(),
            "cases": dict(self.cases),
            "controllers": dict(self.controllers),
            "modes": list(self.modes),
            "fmus": dict(self.fmus),
            "swings": {name: list(swing) for name, swing in self.swings.items()},
        }

    @cached_property
    def hash(self) -> str:
        """Content hash of the specification (not of the version)."""
        return content_hash({k: v for k, v in self.document().items() if k != "version"})


def plan_sweep(
    sweep: Sweep,
    cache: Path,
    *,
    large: bool = False,
    controllers: Mapping[str, ControllerLike] | None = None,
    loaded: Mapping[str, Case] | None = None,
) -> SweepPlan:
    """Load the cases, design the controllers, try the values; nothing is written but into `cache`.

    large : confirm more than `LARGEST` runs. controllers : user-defined, by the name that the scenario or
        a parameter on `controller` has for them. loaded : cases that need not be read, by the same rule.

    Raises
    ------
    SweepError : no runs, too many, a path that leads nowhere, values that do not fit.
    """
    _check_size(sweep, large)
    names = _listed(sweep, "case") or [str(sweep.base.case)]
    folder = sweep.base.folder
    paths = {n: load_scenario({"case": n, "stop_s": 1.0, "folder": folder}).case_path for n in names}
    known = loaded or {}
    cases = {n: known[n] if n in known else load_case(path) for n, path in paths.items()}
    result = _controllers_of(sweep, cases, controllers or {}, cache)
    check_paths(sweep, cases[names[0]], _parameters_of(result, cases))
    check_values(sweep, cases[names[0]])
    areas = sorted({area for case in cases.values() for area in case.areas.values()})
    return SweepPlan(
        sweep,
        {n: json.loads(json.dumps(c.document())) for n, c in cases.items()},
        {key: _content(controller) for key, controller in result.items()},
        ("inter-area", *(f"local area {a}" for a in areas)),
        code_version(),
        {
            name: _stored_fmu(folder / fmu.file, cache, sweep.base.strict)
            for name, fmu in sweep.base.fmus.items()
        },
        {name: astuple(swing_of(case, cache, sweep.base.swing)) for name, case in cases.items()},
    )


def _check_size(sweep: Sweep, large: bool) -> None:
    size = sweep.size
    if not size:
        empty = next(name for name, n in sweep.axes if n == 0)
        raise SweepError(f"{sweep.name}: 0 runs, since parameters.{empty} has no values")
    if size > LARGEST and not large:
        axes = " x ".join(f"{n} ({name or 'samples'})" for name, n in sweep.axes)
        raise SweepError(
            f"{sweep.name}: {size:,} runs = {axes}; more than {LARGEST:,} must be confirmed with --large"
        )


def _controllers_of(
    sweep: Sweep, cases: Mapping[str, Case], own: Mapping[str, ControllerLike], cache: Path
) -> dict[str, Controller | ControllerBank]:
    """Return "CASE/NAME" -> each controller that a run may have, designed for the case as its file has it."""
    controllers: dict[str, Controller | ControllerBank] = {}
    for name in _listed(sweep, "controller") or [sweep.base.controller]:
        for key, case in cases.items():
            try:
                result = controller_of(own.get(name, name), case, cache, folder=sweep.base.folder)
            except ScenarioError as error:
                raise ScenarioError(f"{sweep.name}: {error}") from None
            if result is not None:
                controllers[f"{key}/{name}"] = result
    return controllers


def _parameters_of(result: Mapping[str, Controller | ControllerBank], cases: Mapping[str, Case]) -> set[str]:
    """Return the names of the parameters that the controllers' FMUs have."""
    parameters: set[str] = set()
    for key, controller in result.items():
        table = controller.block(cases[case_in(key, cases)].omega_b).table
        parameters |= {v.name for v in table if v.role == "parameter"}
    return parameters


def case_in(key: str, cases: Iterable[str]) -> str:
    """Return which of `cases` the "CASE/NAME" of a controller begins with; both may be paths."""
    return max((name for name in cases if key.startswith(f"{name}/")), key=len)


def own_fmu(cache: Path, key: str) -> Path:
    """Return where in the cache the user's FMU with content hash `key` is.

    Raises
    ------
    SweepError : it is damaged, or gone.
    """
    path = cache / "own" / f"{key}.fmu"
    if not is_whole(path):
        raise SweepError(f"{path}: the copy of an FMU is damaged; run the same command again")
    return path


def _stored_fmu(path: Path, cache: Path, strict: bool) -> str:
    """Copy an FMU of the user's into the cache, from where it goes to all workers; return its hash.

    Raises
    ------
    GraphError : no such file, or no FMU that the master can step.
    """
    file = FmuFile(path)
    if strict:
        file.require_conforming()
    file.close()
    key = file_hash(path)
    artefact(cache, "own", key, ".fmu", lambda place: shutil.copyfile(path, place))
    return key


def plan_of_document(document: Mapping[str, Any]) -> SweepPlan:
    """Return the plan that `SweepPlan.document` wrote."""
    return SweepPlan(
        sweep_of(document["sweep"], "sweep", Path()),
        document["cases"],
        document["controllers"],
        tuple(document["modes"]),
        document["version"],
        document["fmus"],
        document.get("swings", {}),
    )


def _listed(sweep: Sweep, root: str) -> list[str]:
    """Return the names a parameter on `case` or `controller` takes."""
    for name, p in sweep.parameters.items():
        if (root,) in sweep.paths(name):
            drawn = p.random.choose if p.random is not None else None
            values = p.values if p.values is not None else drawn
            if values is None or not all(isinstance(v, str) for v in values):
                raise SweepError(
                    f'{sweep.name}: parameters.{name}: {root} needs names, allowed: values = ["..."]'
                )
            return [str(v) for v in values]
    return []


def _content(controller: Controller | ControllerBank) -> dict[str, Any]:
    with temporary_folder() as folder:
        path = controller.save(folder / "controller.json")
        return json.loads(path.read_text(encoding="utf-8"))  # type: ignore[no-any-return]
