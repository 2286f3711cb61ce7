"""The co-simulations of a study: which there are, each run once for the same FMUs, in two processes."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import closing
from dataclasses import dataclass
from functools import cache as once
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.cache import (
    artefact,
    code_hash,
    content_hash,
    file_hash,
    is_whole,
    source_hash,
)
from interarea.models.case.case import load_case
from interarea.models.files import temporary_folder
from interarea.models.processes import process_pool
from interarea.models.threads import one_thread

from ..master.kernel.build import kernel_or_reason
from ..results.metrics import ring_down, uniform
from ..results.ringdown import disturbance_end_s
from ..results.run import Run
from ..run.artefacts import channel_fmu, plant_fmu
from ..run.controllers import controller_fmu
from ..run.instance import Fmus
from ..run.run import system_of
from ..scenario.scenario import load_scenario
from ..trajectory import Trajectory
from .tables import latency_name

Array = npt.NDArray[np.float64]
Document = dict[str, Any]

#: study.json's names of the two wirings -> how scenario names spell them.
WIRINGS = {"synchronous": "synchronous", "non_synchronous": "non-synchronous"}
_RUN_FILES = ("trajectory.parquet", "metrics.json")  # of a run, in its folder in the cache
TOGETHER = 4  #: runs that one process takes at a time and opens FMUs for once
LATE_S = 4.0  #: after the last disturbance, when only what swings longest is left
DEFAULT_LIMIT = 0.15  #: of the controllers' output, pu
MARGIN_GRID_S = 1e-4  #: latencies beside the margin are rounded to this


@dataclass(frozen=True)
class StudyRun:
    """One co-simulated scenario: what it was, its numbers, its trajectory on disk."""

    name: str
    title: str
    document: Mapping[str, Any]
    metrics: Mapping[str, Any]
    trajectory: Path

    @property
    def curves(self) -> Trajectory:
        """The trajectory, read from disk."""
        return Trajectory.read_parquet(self.trajectory)


def scenario_documents(spec: Mapping[str, Any], margin_s: float | None) -> dict[str, Document]:
    """Return every scenario of a study, in the form of a scenario file, by name.

    spec : the study's TOML. margin_s : exact latency margin of the synchronous wiring; with one, two runs on
    either side of it are added.
    """
    documents = {}
    for row in spec["scenario"]:
        remote: Document = {}
        if "lost_at_s" in row:
            remote |= {"on_loss": "zero", "outages_s": [[row["lost_at_s"], spec["stop_s"]]]}
        documents[row["name"]] = document_of(
            spec, row["title"], row["controller"], row["disturbance"], remote, {}
        )
    latency = spec["latency"]
    for wiring in WIRINGS.values():
        for value in latency["values_s"]:
            at = {"latency_s": value}
            documents[latency_name(latency["controller"], wiring, value)] = document_of(
                spec,
                f"{latency['controller'].upper()}, {wiring} feedback, {round(1e3 * value)} ms, Vref pulse",
                latency["controller"],
                latency["disturbance"],
                at,
                at if wiring == "synchronous" else {},
            )
    if margin_s is not None:
        documents |= _beside_margin(spec, margin_s)
    return documents


def document_of(
    spec: Mapping[str, Any], title: str, controller: str, disturbance: str, remote: Document, local: Document
) -> Document:
    """Return one scenario of a study; `remote` and `local`: what its channels do."""
    document: Document = {
        "title": title,
        "case": spec["case"],
        "controller": controller,
        "stop_s": spec["stop_s"],
        "step_s": spec["step_s"],
        "event": spec["disturbance"][disturbance],
    }
    if controller != "none":
        document["channels"] = {
            "remote": {"signal": spec["remote"], **remote},
            "local": {"signal": spec["local"], **local},
        }
    return document


def _beside_margin(spec: Mapping[str, Any], margin_s: float) -> dict[str, Document]:
    margin = spec["margin"]
    documents = {}
    for side, factor in (("below", 1.0 - margin["distance"]), ("above", 1.0 + margin["distance"])):
        at = {"latency_s": round(round(factor * margin_s / MARGIN_GRID_S) * MARGIN_GRID_S, 6)}
        title = (
            f"{margin['controller'].upper()}, synchronous, {100 * margin['distance']:.0f} % {side} the margin"
        )
        document = document_of(spec, title, margin["controller"], spec["latency"]["disturbance"], at, at)
        documents[f"{margin['controller']}-margin-{side}"] = document | {
            "stop_s": margin["stop_s"],
            "event": margin["events"],
        }
    return documents


def run_all(
    documents: Mapping[str, Document],
    controllers: Mapping[str, Controller],
    cache: Path,
    progress: Callable[[float], None],
    *,
    processes: int = 2,
) -> dict[str, StudyRun]:
    """Run every scenario that is new, in `processes` processes; the others come from `cache`.

    controllers : those that the scenarios name, as this study designed them.
    """
    folders = run_folders(documents, controllers, cache)
    missing = [name for name, folder in folders.items() if not all(is_whole(folder / f) for f in _RUN_FILES)]
    done = len(documents) - len(missing)
    progress(done / len(documents))
    with temporary_folder() as own:
        # a state-space model of python-control cannot be pickled
        files = {name: controllers[name].save(Path(own) / f"{name}.json") for name in controllers}
        identical = sorted(missing, key=lambda name: str(documents[name]["controller"]))
        provided = [(documents[n], files.get(documents[n]["controller"]), folders[n]) for n in identical]
        parts = [provided[k : k + TOGETHER] for k in range(0, len(provided), TOGETHER)]
        if len(parts) > 1 and processes > 1:
            kernel_or_reason()  # compiled once, not by each process
            with process_pool(processes) as pool:
                waiting = {pool.submit(_run_into, part, cache): len(part) for part in parts}
                for future in as_completed(waiting):
                    future.result()
                    done += waiting[future]
                    progress(done / len(documents))
        else:
            for part in parts:
                _run_into(part, cache)
                done += len(part)
                progress(done / len(documents))
    return {
        name: StudyRun(
            name,
            documents[name]["title"],
            documents[name],
            json.loads((folder / _RUN_FILES[1]).read_text(encoding="utf-8")),
            folder / _RUN_FILES[0],
        )
        for name, folder in folders.items()
    }


def run_folders(
    documents: Mapping[str, Document], controllers: Mapping[str, Controller], cache: Path
) -> dict[str, Path]:
    """Return where the results of each scenario are kept: named by all that they come from."""

    @once
    def sources_of(case_name: str, controller_name: str) -> list[object]:
        case = load_case(case_name)
        parts: list[object] = [case.swing, file_hash(plant_fmu(case, cache))]
        if controller_name in controllers:
            controller = controllers[controller_name]
            parts += [
                file_hash(controller_fmu(controller, case.omega_b, cache)),
                file_hash(channel_fmu(cache)),
            ]
        return [*parts, code_hash(__name__), source_hash("cosim", "*.[ch]")]

    return {
        name: cache / "runs" / content_hash(document, *sources_of(document["case"], document["controller"]))
        for name, document in documents.items()
    }


def _run_into(provided: Sequence[tuple[Document, Path | None, Path]], cache: Path) -> None:
    """Run scenarios with their controllers and keep their results in their folders; FMUs are opened once."""
    with one_thread(), closing(Fmus(cache)) as fmus:
        controllers = {file: Controller.load(file) for _, file, _ in provided if file is not None}
        for document, file, folder in provided:
            own = None if file is None else controllers[file]
            run = system_of(load_scenario(document), controller=own, cache=cache, fmus=fmus).warned().run()
            assert isinstance(run, Run)
            artefact(folder.parent, folder.name, "trajectory", ".parquet", run.trajectory.write_parquet)
            numbers = run.metrics.as_dict() | {"late_damping": _late_damping(run)}
            text = json.dumps(numbers, indent=1, default=str)
            artefact(folder.parent, folder.name, "metrics", ".json", partial(_write, text))


def _write(text: str, path: Path) -> None:
    path.write_text(text, encoding="utf-8")


def _late_damping(run: Run) -> float | None:
    """Return the damping ratio of what swings longest: the swing signal's strongest mode from 4 s after
    the last disturbance on; None when a control has been at its limit, or nothing is left.
    """
    curves, scenario = run.trajectory, run.scenario
    largest = max((float(np.max(np.abs(curves[c]))) for c in curves.reals_of("controller")), default=0.0)
    signal = run.swing.of(curves)
    start = round(disturbance_end_s(scenario) + LATE_S, 6)
    if largest >= 0.999 * DEFAULT_LIMIT or start + 3.0 > scenario.stop_s:
        return None
    grid, values = uniform(curves.time_s, [signal], start, min(start + 8.0, scenario.stop_s), 0.05)
    swings = [m for m in ring_down(grid, values).modes if 0.1 <= m.frequency_hz <= 2.5]
    return swings[0].damping_ratio if swings else None
