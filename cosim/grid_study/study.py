"""The study of a grid: from its data to a page, each part written as soon as it is available."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from interarea.design.controllers.controller import Controller, plain
from interarea.design.delay.signal_conditions import Condition
from interarea.design.modes.loop_points import LoopSet
from interarea.design.robust.operating_points import inter_area_band, judge_family
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash, place
from interarea.models.case.case import Case
from interarea.models.case.write_toml import export_toml
from interarea.models.errors import InterareaError, nearest
from interarea.models.files import write_whole
from interarea.models.threads import one_thread

from ..designs.design_file import DesignTable
from ..designs.family import FamilyPlant
from ..designs.worth import design_rival, has_rival, with_rival, worth
from ..errors import ScenarioError, machine_error
from ..run.artefacts import plant_fmu
from ..run.controllers import controller_fmu
from .automatic import (
    DESIGN_STAGES,
    GridDesign,
    Report,
    design_of_findings,
    findings_of,
    left_out_rows,
)
from .choices import WEAK, Choices
from .clock import Clock
from .page import mode_shapes, write_page
from .proposal import Findings, Proposal
from .weak_modes import in_words, modes_of_grid, weak_modes

STAGES = (*DESIGN_STAGES, "own-signal rival", "latency", "FMUs and page")
#: the grid with its local stabilizers, where a wide-area loop is designed for what they leave
STABILIZED = "with_stabilizers.toml"
#: s, of all signals: curves of damping
LATENCIES_S = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)


def study_grid(
    case: Case,
    out: Path,
    cache: Path,
    *,
    named: str = "",
    assumptions: Sequence[str] = (),
    command: str = "",
    choices: Choices | None = None,
    report: Report = lambda stage, share: None,
) -> dict[str, Any]:
    """Study a grid and write the results into the folder `out`; return the content of study.json.

    named : name of the case in the design file. assumptions : of the import, for the page. command : that
    repeats the study. choices : of the user; default only the grid.

    Writes report.html (from the first second on), study.json, design.toml, controller.json, local.json,
    fmus/, and `STABILIZED` where the wide-area loop is designed for that grid. A missing part has its reason
    under `problem`.

    Raises
    ------
    OSError, or an error caused by one : of the machine (a full disk, no memory). CaseError : no operating
    point. ScenarioError : an actuator that the grid does not have.
    """
    modes, (rival, latency, last) = STAGES[0], STAGES[-3:]
    choices = choices or Choices(grid=case.name)
    clock = Clock(choices.minutes)
    study: dict[str, Any] = {
        "case": case.name,
        "command": command,
        "assumptions": list(assumptions),
        "buses": len(case.buses),
        "machines": len(case.machines),
        "problem": None,
        "choices": choices.model_dump(mode="json"),
        "no_time_for": clock.left_out,
    }
    with one_thread():
        report(modes, 0.0)
        grid = modes_of_grid(case, cache)
        if unknown := [name for name in choices.actuators if name not in grid.plant.inputs]:
            hint = nearest(unknown[0], grid.plant.inputs)
            raise ScenarioError(f"{case.name}: actuators has {unknown[0]!r}, no input of the grid; {hint}")
        shown, shapes = grid.shown, mode_shapes(grid.shown, case)

        def written() -> None:
            write_page(study, shown, shapes, out / "report.html")

        study["modes"] = grid.as_dict()
        written()
        report(modes, 1.0)
        try:
            weak = weak_modes(grid, choices)
            study["loops"] = [_loop_row(one) for one in weak.sets]
            written()

            findings = findings_of(weak, cache, clock, report=report)
            study |= _findings(findings)
            written()
            done = design_of_findings(
                findings, cache, clock, named=named, named_stabilized=STABILIZED, report=report
            )
            if done.stabilized is not None:
                export_toml(done.stabilized, out / STABILIZED)
            table, controller = done.proposal.table, done.controller
            study["certificate"] = controller.certificate
            study |= _findings(done.proposal.findings, done.proposal) | _proposed(done.proposal)
            study["local"] = _local(done, out / "local.json")
            write_whole(out / "design.toml", done.proposal.text().encode())
            written()
            report(rival, 0.0)
            if has_rival(table) and clock.over(rival):
                clock.leave("the comparison controller with own signals only")
            elif has_rival(table):
                controller = with_rival(controller, _rival(table, controller, cache, report))
            report(rival, 1.0)
            study["worth"] = worth(table, controller, cache).as_dict()
            controller.save(out / "controller.json")
            written()
            report(latency, 0.0)
            if clock.over(latency):
                clock.leave("damping over latency")
            else:
                study["latency"] = _over_latency(table, controller, cache)
                written()
            study["left_out"] = left_out_rows(done.proposal, controller, cache, clock, "latency")
            report(latency, 1.0)
            report(last, 0.0)
            place(plant_fmu(table.grid, cache), out / "fmus" / "plant.fmu")
            place(controller_fmu(controller, case.omega_b, cache), out / "fmus" / "controller.fmu")
        except InterareaError as error:
            if machine_error(error) is not None:
                raise
            study["problem"] = str(error)
        study["versions"] = {"interarea": version("interarea")}
        written()
        text = json.dumps(plain(study), indent=1, allow_nan=False)
        write_whole(out / "study.json", f"{text}\n".encode())
        report(last, 1.0)
    return study


def defaults_of(case: Case, cache: Path) -> tuple[dict[str, Any], list[str]]:
    """Return the default requirements of a grid, as keys of `Choices`, and its modes in words.

    Raises CaseError if it has no operating point.
    """
    findings = modes_of_grid(case, cache)
    lines = [f"Study of {case.name}: {len(case.buses)} buses, {len(case.machines)} machines."]
    lines += [f"It is unstable without control: {text}." for text in findings.growing]
    lines += [f"{'Weak' if m.damping_ratio < WEAK else 'Not weak'}: {in_words(m)}." for m in findings.shown]
    try:
        weak = weak_modes(findings)
    except ScenarioError as error:
        return {}, [*lines, str(error)]
    actuators = list(dict.fromkeys(a for one in weak.sets for a in one.actuators))
    lines.append(f"Actuators of the best sets of loops by their residues: {', '.join(actuators)}.")
    return {"inter_area": round(weak.required_damping, 4)}, lines


def _findings(findings: Findings, proposal: Proposal | None = None) -> dict[str, Any]:
    """Return short designs and operating points as JSON values, and which of them a proposal takes."""
    taken = None if proposal is None else proposal.taken.chosen.actuators
    names = set() if proposal is None else {point.name for point in proposal.table.point}
    return {
        "loops": [
            _loop_row(row.chosen, row.damping, row.own, taken=row.chosen.actuators == taken)
            for row in findings.loops
        ],
        "points": [
            {
                "name": row.point.name,
                "least": row.least,
                "moved": row.moved,
                "problem": row.problem,
                "taken": row.point.name in names,
            }
            for row in findings.points
        ],
    }


def _loop_row(
    chosen: LoopSet, damping: float | None = None, own: float | None = None, *, taken: bool = False
) -> dict[str, Any]:
    """Return a set of loops as JSON values; None for results without a short design yet."""
    reached = {"damping": damping, "own": own, "taken": taken}
    return {"actuators": list(chosen.actuators), "why": chosen.reason, **reached}


def _proposed(proposal: Proposal) -> dict[str, Any]:
    table = proposal.table
    return {
        "reasons": list(proposal.reasons),
        "parts": [{"actuator": part.actuator, "signals": list(part.signals)} for part in table.part],
        "asked": {"inter_area": table.ask.inter_area, "worst_swing": table.ask.worst_swing},
    }


def _local(done: GridDesign, file: Path) -> dict[str, Any]:
    """Return local stabilizers beside the wide-area loop as JSON values; write them to `file`."""
    local, installed = done.local, done.proposal.findings.weak.stabilized
    if local is None:
        return {"sentence": done.sentence, "stabilizers": [], "certificate": None, "installed": []}
    local.save(file)
    return {
        "sentence": done.sentence,
        "installed": list(installed),
        "stabilizers": list(local.design["local"]),
        "limit_pu": local.limit_pu,
        "certificate": local.certificate,
    }


def _rival(table: DesignTable, controller: Controller, cache: Path, report: Report) -> Controller:
    name = "own-signal rival"
    key = content_hash(
        table.grid.hash,
        table.model_dump(mode="json"),
        code_hash(worth.__module__),
    )

    def compute() -> dict[str, Any]:
        done = design_rival(
            table, controller, cache, progress=lambda _, share, __: report(name, 0.99 * share)
        )
        return done.as_dict()

    return Controller.from_dict(cached_json(cache, "grid-rival", key, compute))


def _over_latency(table: DesignTable, controller: Controller, cache: Path) -> list[dict[str, Any]]:
    """Return damping over the latency of all signals at the grid as it is, nothing and each signal lost."""
    plant = FamilyPlant.of(table.grid, table.signals, table.actuators, cache)
    conditions = [
        Condition(f"{lost or 'nothing'} {late}", (lost,) if lost else (), dict.fromkeys(table.signals, late))
        for lost in ("", *table.signals)
        for late in LATENCIES_S
    ]
    key = content_hash(table.grid.hash, controller.as_dict(), LATENCIES_S, code_hash(judge_family.__module__))

    def compute() -> list[dict[str, Any]]:
        judged = judge_family(
            {"base": plant.judged},
            controller.system,
            conditions,
            bands_hz={"base": inter_area_band(plant.modes)},
        )
        return [
            {"lost": c.lost[0] if c.lost else "", "latency_s": late, **asdict(row)}
            for c, late, row in zip(
                conditions, LATENCIES_S * (1 + len(table.signals)), judged.rows, strict=True
            )
        ]

    return list(cached_json(cache, "grid-latency", key, compute))
