"""The study `inverters`: by share and kind of inverters the modes, clearing times and worth of a link."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from interarea.design.controllers.controller import plain
from interarea.models.case.case import Case
from interarea.models.errors import InterareaError
from interarea.models.files import write_rows, write_whole
from interarea.models.threads import one_thread

from ..errors import machine_error
from ..grid_study.automatic import Report
from ..grid_study.clock import Clock
from .page import write_inverter_page
from .replaced import CONTROLS, KINDS
from .steps import BAND_HZ, BELOW, LATENCY_S, LINK_MS, GridSteps, StepModes, Swing, traced
from .words import conclusion

GRIDS = ("two-area-thesis", "nets-nyps")  #: by default
SHARES = tuple(round(0.1 * k, 1) for k in range(9))
#: in this order the worth of a link is asked for while there is time
LINK_SHARES = (0.0, 0.8, 0.4, 0.6, 0.2, 0.5, 0.7, 0.3, 0.1)
MINUTES = 60.0
FILES = ("inverters.json", "inverters.html", "inverters.parquet", "inverters.csv")
_PARTS = ("modes", "clearing times", "worth of the link")


def stages(grids: Sequence[str]) -> tuple[str, ...]:
    """Return the stages of the study: the modes of all grids first."""
    return (*(f"{part}, {grid}" for part in _PARTS for grid in grids), "page")


def study_inverters(
    grids: Mapping[str, Case],
    out: Path,
    cache: Path,
    *,
    minutes: float = MINUTES,
    command: str = "",
    report: Report = lambda stage, share: None,
) -> dict[str, Any]:
    """Sweep the share of inverters of each grid into the folder `out`; return what inverters.json holds.

    Every step is found again in `cache`, so that a study that was stopped goes on; files are written after
    each stage. Steps for which the time is over are named.

    Raises
    ------
    CaseError : a grid without an operating point. OSError, or what it caused : the machine cannot do it.
    """
    clock = Clock(minutes)
    swept = [_Sweep(name, case, cache, clock) for name, case in grids.items()]

    def written() -> dict[str, Any]:
        study = {
            "title": "How do inverters in place of machines change the swing modes?",
            "command": command,
            "minutes": minutes,
            "band_hz": list(BAND_HZ),
            "below": BELOW,
            "latency_ms": round(1e3 * LATENCY_S),
            "link_ms": LINK_MS,
            "controls": {kind: dict(values) for kind, values in CONTROLS.items()},
            "no_time_for": clock.left_out,
            "grids": [one.as_dict() for one in swept],
            "versions": {"interarea": version("interarea")},
        }
        _write(plain(study), out)
        return study

    with one_thread():
        for part in _PARTS:
            for one in swept:
                stage = f"{part}, {one.name}"
                report(stage, 0.0)
                one.add(part, lambda share, stage=stage: report(stage, share))
                written()
                report(stage, 1.0)
    report("page", 0.0)
    study = written()
    report("page", 1.0)
    return study


class _Sweep:
    """The steps of one grid as they come: (kind, share) -> what is known of it."""

    def __init__(self, name: str, case: Case, cache: Path, clock: Clock) -> None:
        self.name, self.clock = name, clock
        self.steps = GridSteps(case, cache)
        self.cases: dict[tuple[str, float], Case] = {}
        self.modes: dict[tuple[str, float], StepModes] = {}
        self.controlled: dict[tuple[str, float], StepModes] = {}
        self.known: dict[tuple[str, float], dict[str, Any]] = {}

    def add(self, part: str, progress: Any) -> None:
        """Do one of `_PARTS` at every step, while there is time."""
        shares = LINK_SHARES if part == _PARTS[2] else SHARES
        todo = [(kind, share) for share in shares for kind in KINDS]
        left_out = 0
        for k, step in enumerate(todo):
            progress(k / len(todo))
            if self.clock.over("links"):
                left_out += 1
                continue
            known = self.known.setdefault(step, {"problem": ""})
            if known["problem"]:
                continue
            try:
                self._do(part, step, known)
            except InterareaError as error:
                if machine_error(error) is not None:
                    raise
                known["problem"] = f"{part}: {error}"
        if left_out:
            self.clock.leave(f"{self.name}: {part} at {left_out} of {len(todo)} steps")

    def _do(self, part: str, step: tuple[str, float], known: dict[str, Any]) -> None:
        steps = self.steps
        case = self.cases.setdefault(step, steps.at(*step))
        if part == _PARTS[0]:
            known["moved_pu"] = steps.moved_pu(case)
            self.modes[step] = steps.modes(case)
            if steps.controller is not None:
                self.controlled[step] = steps.modes(case, steps.controller)
        elif part == _PARTS[1]:
            known["clearing_cycles"] = steps.clearing(case)
            if steps.controller is not None:
                known["clearing_controlled"] = steps.clearing(case, steps.controller)
        else:
            known["link"] = steps.link(case)

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON values."""
        rows = [row for kind in KINDS for row in self._rows(kind)]
        case = self.steps.case
        return {
            "grid": self.name,
            "buses": len(case.buses),
            "machines": len(case.machines),
            "controller": self.steps.controller_name,
            "fault": str(self.steps.fault),
            "conclusion": conclusion(rows),
            "rows": rows,
        }

    def _rows(self, kind: str) -> list[dict[str, Any]]:
        there = [share for share in SHARES if (kind, share) in self.modes]
        modes = [self.modes[kind, share] for share in there]
        inter_area = dict(zip(there, traced(modes), strict=True)) if modes else {}
        return [
            self._row(kind, share, inter_area.get(share)) for share in SHARES if (kind, share) in self.known
        ]

    def _row(self, kind: str, share: float, inter_area: Swing | None) -> dict[str, Any]:
        known, modes = self.known[kind, share], self.modes.get((kind, share))
        controlled = self.controlled.get((kind, share))
        same = None if controlled is None else controlled.following(inter_area)
        link = known.get("link", {})
        own, afar = link.get("own"), link.get("afar")
        return {
            "grid": self.name,
            "kind": kind,
            "share": share,
            "problem": known["problem"] or ("" if modes is None else modes.problem),
            "moved_pu": known.get("moved_pu"),
            "states": None if modes is None else modes.states,
            "complete": None if modes is None else modes.complete,
            "stable": None if modes is None else not modes.growing,
            "growing": "" if modes is None else modes.growing,
            "inter_area_hz": None if inter_area is None else inter_area.frequency_hz,
            "inter_area_damping": None if inter_area is None else inter_area.damping_ratio,
            **_worst("worst", modes),
            "controlled_complete": None if controlled is None else controlled.complete,
            "controlled_stable": None if controlled is None else not controlled.growing,
            "controlled_damping": None if same is None else same.damping_ratio,
            **_worst("controlled_worst", controlled),
            "clearing_cycles": known.get("clearing_cycles"),
            "clearing_controlled": known.get("clearing_controlled"),
            "link_actuator": link.get("actuator"),
            "link_own": own,
            "link_afar": afar,
            "link_problem": link.get("problem", ""),
            "swings": [
                [one.name, one.frequency_hz, one.damping_ratio] for one in (modes.swings if modes else ())
            ],
        }


def _worst(name: str, modes: StepModes | None) -> dict[str, Any]:
    """Return the least damped swing as three values of a row."""
    worst = None if modes is None else modes.worst
    return {
        f"{name}_name": None if worst is None else worst.name,
        f"{name}_hz": None if worst is None else worst.frequency_hz,
        f"{name}_damping": None if worst is None else worst.damping_ratio,
    }


def _write(study: Mapping[str, Any], out: Path) -> None:
    """Write page, JSON and tables."""
    text = json.dumps(study, indent=1, allow_nan=False)
    write_whole(out / FILES[0], f"{text}\n".encode())
    write_inverter_page(study, out / FILES[1])
    write_rows(inverter_rows(study), out / FILES[2], out / FILES[3], _schema())


def _schema() -> Any:
    import pyarrow as pa

    texts = ("grid", "kind", "problem", "growing", "worst_name", "controlled_worst_name", "link_actuator")
    flags = ("complete", "stable", "controlled_complete", "controlled_stable")
    numbers = (
        *("share", "moved_pu", "inter_area_hz", "inter_area_damping", "worst_hz", "worst_damping"),
        *("controlled_damping", "controlled_worst_hz", "controlled_worst_damping"),
        *("clearing_cycles", "clearing_controlled", "link_own", "link_afar"),
    )
    return pa.schema(
        [
            *((name, pa.string()) for name in (*texts, "link_problem")),
            *((name, pa.bool_()) for name in flags),
            ("states", pa.int64()),
            *((name, pa.float64()) for name in numbers),
        ]
    )


def inverter_rows(study: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of all grids as a flat table, the list of swings apart."""
    return [
        {key: value for key, value in row.items() if key != "swings"}
        for grid in study["grids"]
        for row in grid["rows"]
    ]
