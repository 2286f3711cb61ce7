"""The whole study in one page: case -> plant FMU -> linear plant -> controllers -> co-simulation -> report.

Every step is one call into the file that does it; every artefact is made once
and found again by the hash of what it came from (`artefacts.py`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import control

from interarea.design.controllers.controller import Controller
from interarea.design.linear.linearise import remove_reference, select, speeds_in_rad
from interarea.design.modes.loop_selection import lead_by_coordinates, rank_loops
from interarea.design.modes.modes import modes_of
from interarea.design.reduction.balanced import Reduction, balanced_truncation
from interarea.design.synthesis.study_designs import StudySpec, WdcSpec
from interarea.fmu_build.errors import BuildError
from interarea.fmu_build.open.cross_check import complete_fmu
from interarea.fmu_build.write.cache import (
    cached_json,
    code_hash,
    content_hash,
    default_cache,
    numerics_versions,
    place,
)
from interarea.models.case.case import load_case
from interarea.models.files import temporary_folder, together, write_whole
from interarea.models.grid.powerflow import solve_powerflow
from interarea.models.processes import process_pool
from interarea.models.threads import one_thread

from ..explorer.page import write_linked_explorer
from ..explorer.wasm import container_wasm
from ..run.artefacts import channel_fmu, linear_plant, plant_fmu
from ..run.controllers import controller_fmu, design_controller
from ..sweep.lane_batches import host_lanes
from . import rows
from .delay import latency_analysis, pade_record, redesigned
from .figures import StudyParts, data_of, difference_of, save_figures
from .methods import method_record
from .packet_loss import mean_latency_s, mean_square_record, monte_carlo_rows
from .printed import printed_rows
from .report import write_report
from .runs import run_all, scenario_documents
from .second_solver import second_solver_record
from .spec import design_specs, load_study
from .survival import survival_record, survival_started

#: Called with a stage's name and how much of it is done, 0..1.
StageProgress = Callable[[str, float], None]
Done = Callable[[float], None]


class _Study:
    """A study in progress: each stage is a method, called with what reports how much of it is done, 0..1.

    beside : processes that compile, try the faults and solve a second time while this one goes on.
    """

    def __init__(self, name: str, beside: Executor, folder: Path, second_solver: bool) -> None:
        self.name, self.beside, self.folder = name, beside, folder
        self.spec = load_study(name)
        self.specs = design_specs(self.spec)
        self.cache = default_cache()
        self.solved_again = second_solver
        self.case = load_case(self.spec["case"])
        self.explorer = folder / "explorer.html"
        self.controllers: dict[str, Controller] = {}
        self.unreduced: dict[str, Controller] = {}

    def plant(self, done: Done) -> None:
        case, cache = self.case, self.cache
        self.flow = solve_powerflow(case)
        self.fmus = {"plant": plant_fmu(case, cache), "channel": channel_fmu(cache)}
        # processes beside need nothing but what the cache holds by the time they are asked
        survival = "survival" in self.spec
        self.beside.submit(_compile, self.spec["case"], survival, cache)  # most of it is the plant's
        done(0.5)
        self.full = linear_plant(case, cache)

    def modes_and_loops(self, _: Done) -> None:
        self.relative = remove_reference(self.full)
        self.modes = modes_of(self.relative, self.case.areas)
        self.loops = rank_loops(self.relative, self.modes.inter_area, areas=self.case.areas)
        self.in_rad = speeds_in_rad(self.relative, self.case.omega_b)

    def reduction(self, _: Done) -> None:
        self.reductions = _reductions(self.spec, self.in_rad, [self.loops.selected.actuator])

    def design(self, done: Done) -> None:
        """Design the controllers, then start what the other processes are to do."""
        case, cache, specs = self.case, self.cache, self.specs
        for k, label in enumerate(self.spec["controllers"]):
            self.controllers[label] = design_controller(case, label, cache, specs=specs)
            self.unreduced[label] = design_controller(case, label, cache, reduce=False, specs=specs)
            self.fmus[label] = controller_fmu(self.controllers[label], case.omega_b, cache)
            done((k + 1) / len(self.spec["controllers"]))
        self._start_beside()

    def _start_beside(self) -> None:
        spec, specs, cache, submit = self.spec, self.specs, self.cache, self.beside.submit
        name, labels = spec["case"], list(self.controllers)
        packets = spec.get("packets")
        self.methods_beside = submit(method_record, name, labels, spec["remote"], specs, cache)
        self.losses = packets and submit(mean_square_record, name, labels, packets, specs, cache)
        self.page = submit(_explorer, name, labels, specs, self.explorer, cache)
        self.faults = survival_started(spec, specs, self.folder, cache, self.beside)
        again = self.solved_again
        self.opinion = submit(second_solver_record, name, labels, specs, cache) if again else None

    def latency(self, done: Done) -> None:
        spec, cache = self.spec, self.cache
        delayed, base = spec["latency"]["controller"], self.specs.get("wdc", WdcSpec())
        assert isinstance(base, WdcSpec)
        controller, latency_spec = self.controllers[delayed], dict(spec["latency"])
        code = code_hash(latency_analysis.__module__)
        key = content_hash(self.fmus["plant"].name, self.fmus[delayed].name, latency_spec, asdict(base), code)

        def analysed() -> dict[str, Any]:
            return latency_analysis(self.in_rad, controller, spec, self.modes, done)

        def designed_again() -> Any:
            return redesigned(
                self.relative, controller, self.case.omega_b, latency_spec.get("redesign", ()), base
            )

        def approximated() -> Any:
            return pade_record(self.in_rad, controller, spec, self.delay)

        self.delay = cached_json(cache, "latency", key, analysed)
        again = cached_json(cache, "latency", f"redesigned-{key}", designed_again)
        self.delay["synchronous"]["redesigned"] = again
        self.pade = cached_json(cache, "latency", f"pade-{key}", approximated)

    def methods(self, _: Done) -> None:
        self.method_rows = self.methods_beside.result()

    def co_simulation(self, done: Done) -> None:
        documents = scenario_documents(self.spec, self.delay["synchronous"]["margin_s"])
        self.runs = run_all(documents, self.controllers, self.cache, done)

    def packets(self, done: Done) -> None:
        losses = self.losses
        self.packet_rows = losses and _packets(self.spec, losses, self.controllers, self.cache, done)

    def survival(self, done: Done) -> None:
        self.survived = survival_record(self.spec, self.faults, done)

    def figures(self, done: Done) -> None:
        self.parts = StudyParts(
            self.spec,
            self.case,
            self.flow,
            modes_of(self.full, self.case.areas),
            self.in_rad,
            self.reductions,
            self.controllers,
            {label: controller.system for label, controller in self.unreduced.items()},
            self.delay,
            self.runs,
        )
        self.drawn = save_figures(self.parts, self.cache, f"figures/{_figure_key(self.parts)}", done)

    def second_solver(self, _: Done) -> None:
        self.second = None if self.opinion is None else self.opinion.result()

    def link_explorer(self, _: Done) -> None:
        self.presets = self.page.result()

    def report(self, _: Done) -> None:
        fmus = {label: complete_fmu(path, self.cache) for label, path in self.fmus.items()}
        study = self.rows = rows.study_rows(self.parts, self.loops, self.full.nstates)
        study["modes_without_stabilizers"] = rows.modes_without_stabilizers(self.case, self.cache)
        study["packets"] = self.packet_rows
        study["survival"] = self.survived
        study["methods"] = self.method_rows
        study["pade"] = self.pade
        study["explorer"] = self.presets
        study["second_solver"] = self.second
        study["figures"] = {key: f"figures/{path.name}" for key, path in self.drawn.items()}
        study["provenance"] = _provenance(self.name, self.parts, fmus)
        study["loops"]["coordinate_table"] = lead_by_coordinates(
            self.relative, self.loops, self.modes.inter_area.eigenvalue
        )
        study["figure_list"] = _figure_list(self.spec, self.drawn)
        if "claims" in self.spec:
            study |= _judged(Path(self.spec["claims"]), study)
        self.placed = {f"fmus/{label}.fmu": path for label, path in fmus.items()}
        self.placed |= {f"results/{label}.parquet": run.trajectory for label, run in self.runs.items()}
        self.placed |= {study["figures"][key]: path for key, path in self.drawn.items()}
        self.placed[self.explorer.name] = self.explorer


#: In the order in which they run, by the names under which their progress is reported.
_STAGES: dict[str, Callable[[_Study, Done], None]] = {
    "plant": _Study.plant,
    "modes and loops": _Study.modes_and_loops,
    "reduction": _Study.reduction,
    "controllers": _Study.design,
    "latency": _Study.latency,
    "methods": _Study.methods,
    "co-simulation": _Study.co_simulation,
    "packets": _Study.packets,
    "survival": _Study.survival,
    "figures": _Study.figures,
    "second solver": _Study.second_solver,
    "explorer": _Study.link_explorer,
    "report": _Study.report,
}
STAGES = tuple(_STAGES)


def run_study(
    name: str, out: Path, progress: StageProgress | None = None, *, second_solver: bool = True
) -> dict[str, Any]:
    """Run study `name` (bundled, or a TOML file) into the folder `out`; return what study.json holds.

    second_solver : whether every LMI is solved by Clarabel too.

    Writes fmus/*.fmu, figures/*.svg, results/*.parquet, report.html, explorer.html and study.json.

    Raises
    ------
    ScenarioError : no such study, or a key of it is wrong. CaseError, BuildError, FmuError,
    InfeasibleDesign, UncertifiedDesign, StepError : as the step that failed says.
    """
    reported = progress or (lambda _stage, _done: None)
    with one_thread(), process_pool(2) as beside, temporary_folder() as folder:
        study = _Study(name, beside, folder, second_solver)
        for label, stage in _STAGES.items():
            reported(label, 0.0)
            stage(study, partial(reported, label))
            reported(label, 1.0)
        shown = {key: path.with_suffix(".html") for key, path in study.drawn.items()}
        _write(study.rows, study.placed, shown, out)
        return study.rows


def _write(
    study: Mapping[str, Any], placed: Mapping[str, Path], shown: Mapping[str, Path], out: Path
) -> None:
    """Write all files of a study, or after an error none. placed : name below `out` -> the file."""
    with together():
        for name, file in placed.items():
            place(file, out / name)
        write_report(study, shown, out / "report.html")
        write_whole(out / "study.json", json.dumps(study, indent=1, allow_nan=False) + "\n")


def _compile(case_name: str, lanes: bool, cache: Path) -> None:
    """Compile what later stages use; whoever uses it says what cannot be had."""
    with suppress(BuildError):
        if lanes:
            host_lanes(cache)
        container_wasm(cache, case=load_case(case_name))


def _explorer(
    case_name: str, names: Sequence[str], specs: Mapping[str, StudySpec], page: Path, cache: Path
) -> list[dict[str, str]]:
    """Write the explorer with the study's controllers, found in `cache`; return its presets' addresses."""
    case = load_case(case_name)
    own = {name: design_controller(case, name, cache, specs=specs) for name in names}
    return write_linked_explorer(case_name, page, cache=cache, own=own)


def _reductions(
    spec: Mapping[str, Any], plant: control.StateSpace, actuator: list[str]
) -> dict[str, Reduction]:
    """The reduced plants that the study asks for, seen through the difference or through both signals."""
    outputs: dict[str, Any] = {"difference": difference_of(spec), "signals": [spec["remote"], spec["local"]]}
    return {
        order: balanced_truncation(select(plant, actuator, outputs[seen]), int(order))
        for order, seen in spec["reduction"].items()
    }


def _provenance(name: str, parts: StudyParts, fmus: Mapping[str, Path]) -> dict[str, Any]:
    """Where the numbers come from: the command, the case, what was published, the FMUs, the versions."""
    return {
        "command": f"interarea study {name} --out DIR",
        "case_hash": parts.case.hash,
        "case_source": parts.case.source,
        "published": parts.spec["published"],
        "fmus": {f"{label}.fmu": rows.sha256(path) for label, path in fmus.items()},
        "versions": {"interarea": version("interarea"), **numerics_versions()},
    }


def _figure_list(spec: Mapping[str, Any], figures: Mapping[str, Path]) -> list[dict[str, Any]]:
    drawn = [row for row in spec["figure"] if row["key"] in figures]
    return [
        {**{key: row[key] for key in ("key", "section", "title")}, "data": data_of(row, spec)}
        for row in drawn
    ]


def _judged(claims: Path, study: Mapping[str, Any]) -> dict[str, Any]:
    """What the publication prints beside what was found, and the verdict on each of its statements."""
    printed = printed_rows(claims, study)
    verdicts = {f"{row['where']}: {row['says']}": row["verdict"] for row in printed["verdicts"]}
    return {"printed": printed, "statements": verdicts}


def _packets(
    spec: Mapping[str, Any],
    mean_square: Future[list[dict[str, Any]]],
    controllers: Mapping[str, Controller],
    cache: Path,
    progress: Callable[[float], None],
) -> dict[str, Any]:
    """Return what packet loss and random latency do: second moments and Monte Carlo, as in study.json."""
    table = spec["packets"]
    runs = monte_carlo_rows(spec, controllers, cache, lambda x: progress(0.7 * x))
    rows = mean_square.result()
    progress(1.0)
    return {
        "mean_square": rows,
        "monte_carlo": runs,
        "mean_latency_s": mean_latency_s(table["jitter"]),
        **{key: table[key] for key in ("interval_s", "latency_s", "loss_rates", "bursts", "jitter")},
    }


def _figure_key(parts: StudyParts) -> str:
    """Return the hash of all that the figures show and of the code that draws them."""
    systems = [*parts.full_controllers.values(), *(c.system for c in parts.controllers.values()), parts.plant]
    matrices = [getattr(system, m) for system in systems for m in "ABCD"]
    runs = [str(run.trajectory) for run in parts.runs.values()]
    code = code_hash(save_figures.__module__)
    return content_hash(
        parts.spec, parts.case.hash, runs, parts.delay, code, version("matplotlib"), *matrices
    )
