"""What `study wrong-signals` does: controllers whose signals are wrong, each with a detector made for it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..terminal import busy, stage_progress

STUDY = "wrong-signals"
OPTIONS = ("--controller", "--kind", "--disturbance", "--points")  #: that only this study takes


@dataclass(frozen=True)
class WrongSignalsRequest:
    """The options that only this study takes; nothing named: all. points : operating points; None: two."""

    controllers: Sequence[str]
    kinds: Sequence[str]
    disturbances: Sequence[str]
    points: int | None

    @property
    def options(self) -> Iterator[str]:
        """Yield them as they are typed."""
        yield from (f"--controller {name}" for name in self.controllers)
        yield from (f'--kind "{kind}"' for kind in self.kinds)
        yield from (f'--disturbance "{name}"' for name in self.disturbances)
        if self.points is not None:
            yield f"--points {self.points}"

    def check_names(self) -> None:
        """Raise UserError for a kind or a disturbance that there is not."""
        from interarea.models.errors import UserError, nearest

        if not (self.kinds or self.disturbances):
            return
        from interarea.cosim.scenario.signal_faults import wrong_kinds
        from interarea.cosim.screen.wrong_runs import DISTURBANCES

        every = tuple(wrong_kinds(60.0, 0.5))
        for option, values, allowed in (
            ("--kind", self.kinds, every),
            ("--disturbance", self.disturbances, DISTURBANCES),
        ):
            for name in values:
                if name not in allowed:
                    raise UserError(f"{option} {name}: no such one; {nearest(name, allowed)}")


def study_wrong(
    out: Path, request: WrongSignalsRequest
) -> tuple[dict[str, Any], Path, Sequence[str], list[str]]:
    """Run the study into a folder; return summary, folder, names of its files, and a conclusion a line."""
    from interarea.cosim.designs.design_file import load_design
    from interarea.cosim.screen.wrong_runs import fault_place
    from interarea.cosim.screen.wrong_study import (
        CONTROLLERS,
        FILES,
        Subject,
        stages,
        study_wrong_signals,
    )
    from interarea.fmu_build.write.cache import default_cache
    from interarea.synthesis import judged_and_design

    from ..destination import folder_for

    folder_for(out, files=FILES)
    names = list(dict.fromkeys(request.controllers or CONTROLLERS))
    subjects = []
    with busy("reading the controllers, designed for the case where they are new"):
        for name in names:
            loaded, table = judged_and_design(name, None, None)
            has_fault = table.fault is not None or table.acceptance is not None
            # a controller of the printed study has no design file: the default's faults, on the same grid
            place = fault_place(table if has_fault else load_design(CONTROLLERS[0]))
            subjects.append(Subject(name, loaded, table.grid, place))
    with stage_progress(stages(names)) as report:
        result = study_wrong_signals(
            subjects,
            out,
            default_cache(),
            kinds=request.kinds or None,
            disturbances=request.disturbances or None,
            points=2 if request.points is None else request.points,
            command=" ".join([f"interarea study {STUDY}", *request.options, f"--out {out}"]),
            report=report,
        )
    conclusions = {one["controller"]: one["conclusion"] for one in result["controllers"]}
    lines = [f"{controller}: {conclusion}" for controller, conclusion in conclusions.items()]
    return {"study": STUDY, "controllers": conclusions}, out, FILES, lines
