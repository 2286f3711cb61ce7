"""What a study's controllers do not survive: a fault at every operating point, signals there and lost.

Each operating point is a case of its own, with and without ceilings of the exciters; a setting is a
controller with every signal there, or with the remote or the local one lost. The fault as specified is judged
by the rule of every run (`results.verdict`), in a run as long as the linear loop in which it ends asks for
(`fault_loops`). Synchronism is kept while no two machines are more than pi apart. The critical clearing time
is bisected, all settings of a case side by side in the lanes of the processor, every run with the bits of the
run made alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from interarea.design.certificates.closed_loop import closed_loop_matrix
from interarea.design.controllers.bank import ControllerBank, load_controller
from interarea.design.controllers.bundled import shipped_bank, shipped_banks
from interarea.design.controllers.controller import Controller
from interarea.design.delay.signal_conditions import Condition
from interarea.design.synthesis.study_designs import StudySpec
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash, source_hash
from interarea.models.case.case import Case, load_case
from interarea.models.case.variants import operating_variant
from interarea.models.threads import one_thread

from ..designs.fault_loops import LONG_S, ControllerOrBank, FaultLoops
from ..designs.fault_runs import FaultRuns, Outcome, longest_stable
from ..grid_study.local_stabilizers import Stabilizer, as_controller
from ..run.artefacts import plant_fmu, plant_for_controllers
from ..run.controllers import controller_fmu, design_controller
from .delay import least_swing

NONE = "none"
LOST = ("remote", "local")  #: signals of a study that are lost in turn


@dataclass(frozen=True)
class Setting:
    """One controller (or none) with every signal there, or with one lost: "remote", "local"; "": none."""

    controller: str
    lost: str = ""

    @property
    def signals(self) -> str:
        """What of its signals is there, in words."""
        return f"{self.lost or 'nothing'} lost"


def survival_started(
    spec: Mapping[str, Any],
    specs: Mapping[str, StudySpec],
    folder: Path,
    cache: Path,
    pool: Executor,
) -> list[Future[list[dict[str, Any]]]]:
    """Start the faults of every operating point and ceiling of `spec["survival"]`, if it has that table.

    specs : of the designs. folder : kept until the last one is done; the controllers lie there, since a
    state-space model of python-control cannot be pickled. pool : its processes try the faults.
    """
    if "survival" not in spec:
        return []
    table, case = spec["survival"], load_case(spec["case"])
    chosen: dict[str, ControllerOrBank] = {}
    for name in table["controllers"]:
        bank = name in shipped_banks()
        chosen[name] = shipped_bank(name) if bank else design_controller(case, name, cache, specs=specs)
    chosen |= {row["name"]: local_stabilizer(row, case) for row in table.get("stabilizer", ())}
    files = {name: each.save(folder / f"{name}.json") for name, each in chosen.items()}
    return [
        pool.submit(_rows_of_case, spec, files, point, ceiling, cache)
        for ceiling in table["ceiling"]
        for point in table["point"]
    ]


def local_stabilizer(row: Mapping[str, Any], case: Case) -> Controller:
    """Return the controller that a table of `spec["survival"]["stabilizer"]` stands for."""
    one = Stabilizer(row["machine"], "inter-area", row["K"], row["T1"], row["T2"], row["stages"])
    return as_controller([one], case.omega_b, row["name"], row["limit_pu"])


def survival_record(
    spec: Mapping[str, Any],
    started: Sequence[Future[list[dict[str, Any]]]],
    progress: Callable[[float], None],
) -> dict[str, Any] | None:
    """Return `rows`, the clearing time of the fault as specified, and what was asked.

    started : as `survival_started` gave it; None where that is nothing.

    A row for each operating point, ceiling, controller and loss of `spec["survival"]`: point, ceiling,
    controller, signals; `stable` and `least_damping` of the linear loop (that of the swings; the same with
    every ceiling); `verdict`, `synchronism` and `largest_angle_rad` (None where it is lost) of the fault as
    specified; `critical_cycles`, the longest clearing time that keeps synchronism, in cycles of the case's
    frequency, to the tolerance: 0 where the shortest tried loses it, the longest tried where it never does.
    """
    if not started:
        return None
    table = spec["survival"]
    fault = next(e for e in spec["disturbance"][table["disturbance"]] if e["kind"] == "bus_fault")
    cycles = (fault["end_s"] - fault["start_s"]) * load_case(spec["case"]).frequency_hz
    rows: list[dict[str, Any]] = []
    for k, future in enumerate(started):
        rows += future.result()
        progress((k + 1) / len(started))
    return {
        "clearing_cycles": round(cycles, 3),
        **{key: table[key] for key in ("lost_at_s", "watch_s", "cycles")},
        "stabilizers": list(table.get("stabilizer", ())),
        "rows": rows,
    }


def case_at(case: Case, point: Mapping[str, Any], ceiling: Mapping[str, Any]) -> Case:
    """Return a case at an operating point of a study, with the ceilings of its exciters."""
    if ceiling.get("change"):
        case = case.with_changes(ceiling["change"], name=f"{case.name}-{ceiling['key']}")
    return operating_variant(case, tie_flow_mw=point.get("tie_flow_mw", 0.0), out=tuple(point.get("out", ())))


def _rows_of_case(
    spec: Mapping[str, Any],
    files: Mapping[str, Path],
    point: Mapping[str, Any],
    ceiling: Mapping[str, Any],
    cache: Path,
) -> list[dict[str, Any]]:
    """Return the rows of one operating point with one ceiling."""
    case = case_at(load_case(spec["case"]), point, ceiling)
    controllers = {name: load_controller(path) for name, path in files.items()}
    key = content_hash(
        plant_fmu(case, cache).name,
        *(controller_fmu(c, case.omega_b, cache).name for c in controllers.values()),
        [spec[k] for k in ("survival", "disturbance", "remote", "local", "step_s")],
        code_hash(__name__),
        source_hash("cosim", "*.[ch]"),
    )

    def make() -> list[dict[str, Any]]:
        with one_thread():
            return _make_rows(spec, controllers, case, cache)

    named = {"point": point["name"], "ceiling": ceiling["name"]}
    return [{**named, **row} for row in cached_json(cache, "survival", key, make)]


def settings_of(spec: Mapping[str, Any], controllers: Mapping[str, ControllerOrBank]) -> list[Setting]:
    """Return what is tried: no control, each controller with all signals, and with each of several lost."""
    settings = [Setting(NONE)]
    for name, controller in controllers.items():
        lost = [which for which in LOST if spec[which] in controller.inputs]
        settings += [Setting(name, which) for which in ("", *(lost if len(controller.inputs) > 1 else ()))]
    return settings


def _make_rows(
    spec: Mapping[str, Any], controllers: Mapping[str, ControllerOrBank], case: Case, cache: Path
) -> list[dict[str, Any]]:
    table = spec["survival"]
    settings = settings_of(spec, controllers)
    cycle_s, cycles = 1.0 / case.frequency_hz, table["cycles"]
    with Faults(spec, controllers, case, cache) as faults:
        outcomes = faults.outcomes(settings)

        def are_stable(tried: Mapping[Setting, float]) -> dict[Setting, bool]:
            result = faults.largest_angles({s: n * cycle_s for s, n in tried.items()})
            return {setting: angle < np.pi for setting, angle in result.items()}

        critical = longest_stable(settings, are_stable, cycles["from"], cycles["to"], cycles["tolerance"])
    plant = plant_for_controllers(case, cache)
    rows = []
    for setting in settings:
        poles = np.linalg.eigvals(plant.A)
        if setting.controller != NONE:
            K, lost = faults.acting(setting)
            poles = np.linalg.eigvals(closed_loop_matrix(plant, K.system, lost=lost))
        run = outcomes[setting]
        rows.append(
            {
                "controller": setting.controller,
                "signals": setting.signals,
                "stable": bool(np.max(poles.real) < 0.0),
                "least_damping": least_swing(poles),
                "verdict": "not judged" if run.verdict is None else run.verdict.name,
                "synchronism": run.synchronous,
                "largest_angle_rad": run.angle_rad if run.synchronous else None,
                "critical_cycles": critical[setting],
            }
        )
    return rows


@dataclass(frozen=True)
class _Run:
    """A setting with its scenario, as `FaultRuns` takes it."""

    scenario: Mapping[str, Any]
    controller: ControllerOrBank | None

    @property
    def stop_s(self) -> float:
        return float(self.scenario["stop_s"])

    def document(self) -> dict[str, Any]:
        return dict(self.scenario)


class Faults:
    """The disturbance of the specification in one case, cleared after any time."""

    def __init__(
        self, spec: Mapping[str, Any], controllers: Mapping[str, ControllerOrBank], case: Case, cache: Path
    ) -> None:
        self.spec, self.case, self._cache = spec, case, cache
        self._events = events = spec["disturbance"][spec["survival"]["disturbance"]]
        self.clear_s = float(next(e["end_s"] for e in events if e["kind"] == "bus_fault"))
        self.start_s = float(next(e["start_s"] for e in events if e["kind"] == "bus_fault"))
        self.clearing_s = self.clear_s - self.start_s  #: of the fault as specified
        self.controllers = dict(controllers)
        self._runs = FaultRuns(case, cache)

    def __enter__(self) -> Faults:
        return self

    def __exit__(self, *_: object) -> None:
        self._runs.__exit__()

    def acting(self, setting: Setting) -> tuple[Controller, tuple[str, ...]]:
        """Return the controller that acts in a setting, of a bank its member, and its lost signals."""
        lost = (self.spec[setting.lost],) if setting.lost else ()
        chosen = self.controllers[setting.controller]
        K = chosen.acting(lost) if isinstance(chosen, ControllerBank) else chosen
        return K, tuple(name for name in lost if name in K.inputs)

    def outcomes(self, settings: Sequence[Setting]) -> dict[Setting, Outcome]:
        """Return what the fault as specified came to, run as long as the linear loop it ends in asks for.

        What keeps synchronism and does not decay is run for `LONG_S` before that is said.
        """
        table = self.spec["survival"]
        trips = [e["branch"] for e in self._events if e["kind"] == "branch_trip"]
        loops = {name: FaultLoops(self.case, K, self._cache) for name, K in self.controllers.items()}
        lengths, roots = {}, {}
        for setting in settings:
            loop = loops[next(iter(loops)) if setting.controller == NONE else setting.controller]
            lost = (self.spec[setting.lost],) if setting.lost else ()
            condition = Condition("survival", lost)
            end = loop.end(next(iter(trips), None), condition, controlled=setting.controller != NONE)
            lengths[setting] = end.run_s(self.start_s + table["watch_s"], table["lost_at_s"])
            roots[setting] = end.root

        def of(which: Mapping[Setting, float]) -> dict[Setting, Outcome]:
            runs = [self._run(each, self.clearing_s, ceil(stop_s)) for each, stop_s in which.items()]
            return dict(zip(which, self._runs.outcomes(runs, [roots[s] for s in which]), strict=True))

        runs = of(lengths)
        unclear = [s for s, run in runs.items() if run.synchronous and not run.stable]
        return runs | of({s: LONG_S for s in unclear if lengths[s] < LONG_S})

    def largest_angles(self, clearing_s: Mapping[Setting, float]) -> dict[Setting, float]:
        """Return the largest angle between two machines (rad) in the run of each setting; inf: it failed."""
        runs = [self._run(setting, value) for setting, value in clearing_s.items()]
        return dict(zip(clearing_s, self._runs.largest_angles(runs), strict=True))

    def _run(self, setting: Setting, clearing_s: float, stop_s: float | None = None) -> _Run:
        return _Run(self.document(setting, clearing_s, stop_s), self.controllers.get(setting.controller))

    def document(self, setting: Setting, clearing_s: float, stop_s: float | None = None) -> dict[str, Any]:
        """Return the scenario of a setting; a branch that is out already is not tripped."""
        table, end = self.spec["survival"], self.start_s + clearing_s
        events = []
        for event in self._events:
            if event["kind"] == "branch_trip" and not self.case.branch(event["branch"]).in_service:
                continue
            moved = {k: end for k in ("start_s", "end_s") if event.get(k) == self.clear_s}
            events.append(event | moved)
        stop = self.start_s + table["watch_s"] if stop_s is None else stop_s
        document: dict[str, Any] = {
            "case": self.spec["case"],
            "controller": setting.controller,
            "stop_s": stop,
            "step_s": self.spec["step_s"],
            "event": events,
        }
        if setting.lost:
            outage = [[table["lost_at_s"], stop]]
            channel = {"signal": self.spec[setting.lost], "on_loss": "zero", "outages_s": outage}
            document["channels"] = {setting.lost: channel}
        return document
