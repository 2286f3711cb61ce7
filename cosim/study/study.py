"""The whole study in one page: case -> plant FMU -> linear plant -> controllers -> co-simulation -> report.

Every step is one call into the file that does it; every artefact is made once
and found again by the hash of what it came from (`artefacts.py`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from dataclasses import asdict
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
from ..sweep.lane_batches import lanes_here
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
STAGES = (
    "plant",
    "modes and loops",
    "reduction",
    "controllers",
    "latency",
    "methods",
    "co-simulation",
    "packets",
    "survival",
    "figures",
    "second solver",
    "explorer",
    "report",
)


def run_study(
    name: str, out: Path, progress: StageProgress | None = None, *, second_solver: bool = True
) -> dict[str, Any]:
    """Run study `name` (bundled, or a TOML file) into the folder `out`; return what study.json holds.

    second_solver : whether every LMI is solved by Clarabel too.

    Two processes beside compile, try the faults and solve a second time while this one goes on.

    Writes fmus/*.fmu, figures/*.svg, results/*.parquet, report.html, explorer.html and study.json.

    Raises
    ------
    ScenarioError : no such study, or a key of it is wrong. CaseError, BuildError, FmuError,
    InfeasibleDesign, UncertifiedDesign, StepError : as the step that failed says.
    """
    spec = load_study(name)
    specs = design_specs(spec)
    cache = default_cache()
    reported = progress or (lambda _stage, _done: None)

    def stage(label: str) -> Callable[[float], None]:
        reported(label, 0.0)
        return lambda done: reported(label, done)

    with one_thread(), ExitStack() as ending:
        done = stage("plant")
        # processes beside need nothing but what the cache holds by the time they are asked
        beside = ending.enter_context(process_pool(2))
        case = load_case(spec["case"])
        flow = solve_powerflow(case)
        fmus = {"plant": plant_fmu(case, cache), "channel": channel_fmu(cache)}
        beside.submit(_compile, spec["case"], "survival" in spec, cache)  # most of it is the plant's
        done(0.5)
        full = linear_plant(case, cache)
        done(1.0)

        done = stage("modes and loops")
        relative = remove_reference(full)
        relative_modes = modes_of(relative, case.areas)
        loops = rank_loops(relative, relative_modes.inter_area, areas=case.areas)
        plant = speeds_in_rad(relative, case.omega_b)
        done(1.0)

        done = stage("reduction")
        actuator = [loops.selected.actuator]
        reductions = _reductions(spec, plant, actuator)
        done(1.0)

        done = stage("controllers")
        controllers, unreduced = {}, {}
        for k, label in enumerate(spec["controllers"]):
            controllers[label] = design_controller(case, label, cache, specs=specs)
            unreduced[label] = design_controller(case, label, cache, reduce=False, specs=specs)
            fmus[label] = controller_fmu(controllers[label], case.omega_b, cache)
            done((k + 1) / len(spec["controllers"]))

        names = list(controllers)
        waiting = beside.submit(method_record, spec["case"], names, spec["remote"], specs, cache)
        losses = (
            beside.submit(mean_square_record, spec["case"], names, spec["packets"], specs, cache)
            if "packets" in spec
            else None
        )
        folder = ending.enter_context(temporary_folder())
        explorer = folder / "explorer.html"
        page = beside.submit(_explorer, spec["case"], names, specs, explorer, cache)
        faults = survival_started(spec, specs, folder, cache, beside)
        opinion = (
            beside.submit(second_solver_record, spec["case"], names, specs, cache) if second_solver else None
        )

        done = stage("latency")
        delayed, base = spec["latency"]["controller"], specs.get("wdc", WdcSpec())
        assert isinstance(base, WdcSpec)
        key = content_hash(
            fmus["plant"].name,
            fmus[delayed].name,
            dict(spec["latency"]),
            asdict(base),
            code_hash(latency_analysis.__module__),
        )
        delay = cached_json(
            cache,
            "latency",
            key,
            lambda: latency_analysis(plant, controllers[delayed], spec, relative_modes, done),
        )
        delay["synchronous"]["redesigned"] = cached_json(
            cache,
            "latency",
            f"redesigned-{key}",
            lambda: redesigned(
                relative, controllers[delayed], case.omega_b, spec["latency"].get("redesign", ()), base
            ),
        )
        pade = cached_json(
            cache, "latency", f"pade-{key}", lambda: pade_record(plant, controllers[delayed], spec, delay)
        )
        done(1.0)

        done = stage("methods")
        methods = waiting.result()
        done(1.0)

        done = stage("co-simulation")
        runs = run_all(scenario_documents(spec, delay["synchronous"]["margin_s"]), controllers, cache, done)

        done = stage("packets")
        packets = None if losses is None else _packets(spec, losses, controllers, cache, done)

        done = stage("survival")
        survival = survival_record(spec, faults, done)
        done(1.0)

        done = stage("figures")
        parts = StudyParts(
            spec,
            case,
            flow,
            modes_of(full, case.areas),
            plant,
            reductions,
            controllers,
            {label: parts_of_study.system for label, parts_of_study in unreduced.items()},
            delay,
            runs,
        )
        drawn = save_figures(parts, cache, f"figures/{_figure_key(parts)}", done)
        shown = {key: path.with_suffix(".html") for key, path in drawn.items()}

        done = stage("second solver")
        second = None if opinion is None else opinion.result()
        done(1.0)

        done = stage("explorer")
        presets = page.result()
        done(1.0)

        done = stage("report")
        fmus = {label: complete_fmu(path, cache) for label, path in fmus.items()}
        study = rows.study_rows(parts, loops, full.nstates)
        study["modes_without_stabilizers"] = rows.modes_without_stabilizers(case, cache)
        study["packets"] = packets
        study["survival"] = survival
        study["methods"] = methods
        study["pade"] = pade
        study["explorer"] = presets
        study["second_solver"] = second
        study["figures"] = {key: f"figures/{path.name}" for key, path in drawn.items()}
        study["provenance"] = _provenance(name, parts, fmus)
        study["loops"]["coordinate_table"] = lead_by_coordinates(
            relative, loops, relative_modes.inter_area.eigenvalue
        )
        study["figure_list"] = _figure_list(spec, drawn)
        if "claims" in spec:
            study |= _judged(Path(spec["claims"]), study)
        placed = {f"fmus/{label}.fmu": path for label, path in fmus.items()}
        placed |= {f"results/{label}.parquet": run.trajectory for label, run in runs.items()}
        placed |= {study["figures"][key]: path for key, path in drawn.items()}
        _write(study, {**placed, explorer.name: explorer}, shown, out)
        done(1.0)
        return study


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
            lanes_here(cache)
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
