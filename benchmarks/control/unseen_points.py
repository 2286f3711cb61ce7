"""What the shipped robust controllers hold at operating points and with parameters that no design saw.

Run `python benchmarks/control/unseen_points.py [--parameters | --pairs] [--faults] [NAME...]`: full plants,
exact latency, conditions of the design. With `--parameters` the changes of `changes_of` to the case in place
of the operating points: exciter gain, inertia, loads, tie reactance, a stabilizer out, governors out. With
`--pairs` the twenty worst double outages among the branches that are out one by one otherwise: those whose
weakest inter-area mode has the least damping without control, where the grid stays whole. With
`--faults` the non-linear faults of its acceptance there, at places where no design had one too.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import control
import numpy as np

from interarea.cosim.designs.acceptance import judge_acceptance
from interarea.cosim.designs.design_file import load_design
from interarea.cosim.designs.design_tables import FaultPlace
from interarea.cosim.designs.family import DENSE_STATES, named_modes
from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.design.certificates.large_loop import LargePlant
from interarea.design.controllers.bundled import shipped_controller, shipped_names
from interarea.design.controllers.controller import Controller
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.design.linear.sparse_plant import SparsePlant
from interarea.design.modes.modes import Mode, ModeError
from interarea.design.robust.operating_points import JudgedPlant, inter_area_band, judge_family
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import Case, CaseError
from interarea.models.case.named_changes import changes_of
from interarea.models.case.variants import operating_variant
from interarea.models.grid.powerflow import PowerFlowError

Change = Mapping[str, Any]
PARAMETERS, PAIRS = "--parameters", "--pairs"
WORST_PAIRS = 20


def out(*branches: str) -> dict[str, Change]:
    """Each of these branches out of service by itself."""
    return {f"{branch} out": {"out": [branch]} for branch in branches}


POINTS: Mapping[str, Mapping[str, Change]] = {
    "two-area-thesis": {
        "load +5 %": {"load_scale": 1.05},
        "load -10 %": {"load_scale": 0.90},
        "tie +50": {"tie_flow_mw": 50.0},
        "tie -350": {"tie_flow_mw": -350.0},
        "tie -100, 8-9 out": {"tie_flow_mw": -100.0, "out": ["8-9 a"]},
        "7-8 out": {"out": ["7-8 b"]},
        "tie -300, 7-8 out": {"tie_flow_mw": -300.0, "out": ["7-8 a"]},
        "load -5 %, tie +50": {"load_scale": 0.95, "tie_flow_mw": 50.0},
        "tie -100": {"tie_flow_mw": -100.0},
        "load +4 %": {"load_scale": 1.04},
        "load -7 %": {"load_scale": 0.93},
        "tie +50, 8-9 out": {"tie_flow_mw": 50.0, "out": ["8-9 a"]},
    },
    "new-england": {  # every branch that may be missing: without the others a machine stands alone
        **out("1-2", "1-39", "2-3", "2-25", "3-4", "3-18", "4-5", "4-14", "5-8", "6-5", "6-7", "6-11", "7-8"),
        **out("8-9", "9-39", "10-11", "10-13", "12-11", "12-13", "13-14", "14-15", "15-16", "16-17", "16-21"),
        **out("16-24", "17-18", "17-27", "21-22", "22-23", "23-24", "25-26", "26-27", "26-28", "26-29"),
        **out("28-29"),
        "load -10 %": {"load_scale": 0.90},
        "load -5 %": {"load_scale": 0.95},
        "load +3 %": {"load_scale": 1.03},
    },
    "nets-nyps": {
        **out("1-2", "1-27", "2-25", "3-18", "16-17", "17-27", "25-26", "30-31", "31-38", "33-38"),
        **out("34-36", "38-46", "21-22", "32-33", "9-30 a", "4-14", "10-11"),
        "load -10 %": {"load_scale": 0.90},
        "load -5 %": {"load_scale": 0.95},
        "load +2 %": {"load_scale": 1.02},
    },
    "wecc-240": {
        **out("1004-7002", "1201-2901", "1401-2400", "2401-2603", "4201-5001", "6102-6403"),
        "load -5 %": {"load_scale": 0.95},
        "load -2 %": {"load_scale": 0.98},
    },
}


#: faults that no design saw, beside those of its acceptance
PLACES: Mapping[str, Sequence[FaultPlace]] = {
    "two-area-thesis": [
        FaultPlace(bus=6),
        FaultPlace(bus=10),
        FaultPlace(bus=7, trip="7-8 b"),
        FaultPlace(bus=9, trip="8-9 b"),
    ],
}


def speeds(plant: SparsePlant) -> control.StateSpace:
    """Return a plant of sparse blocks as matrices, all speeds as outputs (pu), no reference angle."""
    C = np.eye(plant.nstates)[plant.speed]
    whole = control.ss(
        plant.state_matrix(),
        plant.Bu.toarray(),
        C,
        np.zeros((len(C), len(plant.inputs))),
        states=list(plant.states),
        inputs=list(plant.inputs),
        outputs=[f"{machine}_dw" for machine in plant.machines],
    )
    return remove_reference(whole)


def judged(case: Case, cache: Path) -> tuple[JudgedPlant, Mapping[str, Mode]]:
    """Return the full plant of `case` as a certificate takes it, and its modes by name."""
    blocks = sparse_linear_plant(case, cache)
    if blocks.nstates > DENSE_STATES:
        large = LargePlant(blocks, case.areas, case.omega_b)
        return large, {mode.name: mode for mode in large.inter_area}
    plant = speeds(blocks)
    return speeds_in_rad(plant, case.omega_b), named_modes(plant, case) or {}


def unseen(name: str, kind: str, cache: Path) -> dict[str, Case]:
    """Return the operating points of `POINTS`, or of another kind, that the design `name` has not got."""
    table = load_design(name)
    if kind == PAIRS:
        single = [c["out"][0] for c in POINTS[table.grid.name].values() if len(c.get("out", ())) == 1]
        return _worst(_whole(table.grid, itertools.combinations(single, 2)), cache)
    if kind == PARAMETERS:
        known = {text for point in table.point for text in point.vary}
        texts = [text for text in changes_of(table.grid) if text not in known]
        return {text: operating_variant(table.grid, vary=[text]) for text in texts}
    seen = {tuple(point.out) for point in table.point if point.out}
    return {
        point: operating_variant(table.grid, **change)
        for point, change in POINTS[table.grid.name].items()
        if not (tuple(change.get("out", ())) in seen and len(change) == 1)
    }


def _whole(case: Case, pairs: Iterable[tuple[str, str]]) -> Iterator[tuple[str, Case]]:
    """Yield the name and case of each pair of outages that leaves the grid in one piece."""
    for pair in pairs:
        try:
            yield f"{' and '.join(pair)} out", operating_variant(case, out=pair)
        except CaseError:  # in pieces
            continue


def _worst(cases: Iterable[tuple[str, Case]], cache: Path) -> dict[str, Case]:
    """Return those of the least damped inter-area modes without control."""
    ranked: list[tuple[float, str, Case]] = []
    for name, case in cases:
        try:
            _, modes = judged(case, cache)
        except (PowerFlowError, ModeError):
            continue
        between = (mode.damping_ratio for mode in modes.values() if mode.name.startswith("inter-area"))
        ranked.append((min(between, default=1.0), name, case))
    return {name: case for _, name, case in sorted(ranked, key=lambda row: row[0])[:WORST_PAIRS]}


def answered(controller: Controller) -> control.StateSpace:
    """Return the linear part of `controller` without an input that only its guard looks at."""
    system, guard = controller.system, controller.guard
    inputs = [k for k, name in enumerate(system.input_labels) if guard is None or name != guard.follows]
    return control.ss(
        system.A,
        system.B[:, inputs],
        system.C,
        system.D[:, inputs],
        inputs=[system.input_labels[k] for k in inputs],
        outputs=system.output_labels,
    )


def small_signal(name: str, cache: Path, kind: str) -> None:
    """Print a line for each operating point, and how many conditions are unstable."""
    controller, table = shipped_controller(name), load_design(name)
    wrong = {condition.name for condition in table.family() if condition.kind == "scaled"}
    total = gone = scaled = unstable_alone = below = 0
    for point, case in unseen(name, kind, cache).items():
        try:
            plant, modes = judged(case, cache)
        except (PowerFlowError, ModeError) as error:
            print(f"{name:14} {point:20} not judged: {error}", flush=True)
            continue
        verdict = judge_family(
            {point: plant},
            answered(controller),
            table.family(),
            bands_hz={point: inter_area_band(modes)},
        )
        unstable = [row.condition for row in verdict.rows if not row.stable]
        of_scaled = sum(condition in wrong for condition in unstable)
        alone = min((mode.damping_ratio for mode in modes.values()), default=1.0)
        total, gone, scaled = total + len(verdict.rows), gone + len(unstable), scaled + of_scaled
        unstable_alone, below = unstable_alone + (alone <= 0.0), below + (verdict.worst_swing < alone)
        print(
            f"{name:14} {point:20} worst {verdict.worst_swing:.3f} ({alone:.3f} without) "
            f"inter-area {verdict.inter_area:.3f} unstable {len(unstable)} of {len(verdict.rows)}, "
            f"{of_scaled} of them with a scaled signal",
            flush=True,
        )
    print(
        f"{name:14} in all: unstable {gone} of {total} conditions, {scaled} of them with a scaled signal; "
        f"worst swing below that without control at {below} points; {unstable_alone} points unstable without "
        "control"
    )


def faults(name: str, cache: Path, kind: str) -> None:
    """Print a line for each operating point, and what of all faults is lost and gained."""
    controller, table = shipped_controller(name), load_design(name)
    if table.acceptance is None:
        print(f"{name:14} its design names no faults")
        return
    count = lost = gained = 0
    for point, case in unseen(name, kind, cache).items():
        there = {branch.name for branch in case.branches}
        places = [*table.acceptance.fault, *PLACES.get(table.grid.name, ())]
        places = [place for place in places if place.trip is None or place.trip in there]
        acceptance = table.acceptance.model_copy(update={"fault": tuple(places), "points": ()})
        verdict = judge_acceptance(controller, {point: case}, acceptance, cache, clearing=False)
        count, lost, gained = count + verdict.cases, lost + len(verdict.lost), gained + len(verdict.gained)
        print(
            f"{name:14} {point:20} {verdict.cases} faults, {len(verdict.lost)} lost, "
            f"{len(verdict.gained)} gained",
            *(f"    lost: {each}" for each in verdict.lost),
            sep="\n",
            flush=True,
        )
    print(f"{name:14} in all: {count} faults, {lost} lost, {gained} gained")


def main(arguments: list[str]) -> None:
    """Print what each shipped controller that is named holds, or all of them."""
    names = [name for name in arguments if not name.startswith("--")]
    kind = next((word for word in (PARAMETERS, PAIRS) if word in arguments), "")
    for name in names or shipped_names():
        judge = faults if "--faults" in arguments else small_signal
        judge(name, default_cache(), kind)


if __name__ == "__main__":
    main(sys.argv[1:])
