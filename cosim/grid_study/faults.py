"""Faults with and without a controller at each operating point; smaller output limits if some fail."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.cache import cached_json, code_hash, content_hash
from interarea.models.case.case import Case

from ..designs.acceptance import Acceptance, ClearingRow, clearing_times, joined, judge_acceptance
from ..designs.certificate_words import not_covered
from ..designs.design_file import DesignTable, design_record
from ..designs.design_tables import AcceptanceTable
from ..designs.family import family_cases
from .clock import Clock

TIME_OVER = "not judged, time limit reached"  #: ends each violation of a controller that was not run
#: output limits, pu, tried in this order until no fault is unstable only with control: a guard has no effect
#: while its signal is lost, and a smaller output adds less to a first swing
LIMITS_PU = (0.05, 0.02, 0.01)


def judged_with_faults(
    table: DesignTable,
    controller: Controller,
    cache: Path,
    clock: Clock,
    *,
    stage: str = "faults",
    weakest: Mapping[str, float] | None = None,
    progress: Callable[[float], object] = lambda share: None,
) -> Controller:
    """Return a controller with its design's faults in its certificate, at the largest limit that passes.

    Each limit is tried at one point after another, until a fault loses synchronism or does not decay. If
    every limit fails, the one that passed most points is run at all points. Clearing times follow.

    table : the design, whose linear certificate `controller` has in its record. stage : of the clock.
    weakest : operating point -> damping without control; the least damped come first.
    """
    order = sorted(family_cases(table).items(), key=lambda item: (weakest or {}).get(item[0], 1.0))
    faults = _Faults(table, controller, dict(order), cache)
    parts: dict[float, dict[str, Acceptance]] = {}
    for k, limit_pu in enumerate(LIMITS_PU):
        parts[limit_pu] = {}
        for at, point in enumerate(faults.cases):
            progress((k + at / len(faults.cases)) / (len(LIMITS_PU) + 1))
            parts[limit_pu][point] = faults.run(limit_pu, point)
            if parts[limit_pu][point].violations or clock.over(stage):
                break
        if not _violations(parts[limit_pu]) or clock.over(stage):
            break
    limit_pu = max(parts, key=lambda one: (len(parts[one]), -_violations(parts[one])))
    judged, without_time = parts[limit_pu], []
    for at, point in enumerate(faults.cases):
        progress((len(LIMITS_PU) + at / len(faults.cases)) / (len(LIMITS_PU) + 1))
        if point not in judged and clock.over(stage):
            without_time.append(point)
            continue
        if point not in judged:
            judged[point] = faults.run(limit_pu, point)
        if not clock.over(stage):
            judged[point] = replace(judged[point], clearing=faults.clearing(limit_pu, point))
        else:
            clock.leave(f"clearing times of {table.name} at {point}")
    if without_time:
        clock.leave(f"faults of {table.name} at {', '.join(without_time)}")
    progress(1.0)
    return _judged(table, replace(controller, limit_pu=limit_pu), joined(list(judged.values())), without_time)


def falls_short(certificate: Mapping[str, Any], inter_area: float, worst_swing: float) -> tuple[int, float]:
    """Return the number of unstable loops of a certificate, and its margin to two damping ratios.

    The margin is 0 if both are reached, else negative.
    """
    unstable = sum(not row["stable"] for row in certificate["rows"])
    short = min(certificate["inter_area"] - inter_area, certificate["worst_swing"] - worst_swing)
    return unstable, min(short, 0.0)


@dataclass(frozen=True)
class _Faults:
    """The faults of a design at each of its operating points, found again in the cache."""

    table: DesignTable
    controller: Controller
    cases: Mapping[str, Case]
    cache: Path

    def run(self, limit_pu: float, point: str) -> Acceptance:
        """Run every fault at one operating point, without clearing times."""

        def compute(limited: Controller, judged_by: AcceptanceTable) -> dict[str, Any]:
            at = {point: self.cases[point]}
            return asdict(judge_acceptance(limited, at, judged_by, self.cache, clearing=False))

        stored = self._cached("grid-faults", limit_pu, point, compute)
        fields: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in stored.items()}
        return Acceptance(**fields)

    def clearing(self, limit_pu: float, point: str) -> tuple[ClearingRow, ...]:
        """Search the clearing times at one operating point."""

        def compute(limited: Controller, judged_by: AcceptanceTable) -> list[dict[str, Any]]:
            return [
                asdict(r) for r in clearing_times(limited, point, self.cases[point], judged_by, self.cache)
            ]

        return tuple(ClearingRow(**row) for row in self._cached("grid-clearing", limit_pu, point, compute))

    def _cached(
        self, kind: str, limit_pu: float, point: str, compute: Callable[[Controller, AcceptanceTable], Any]
    ) -> Any:
        acceptance = self.table.acceptance
        assert acceptance is not None
        limited = replace(self.controller, limit_pu=limit_pu, design={}, certificate=None)
        key = content_hash(
            self.cases[point].hash,
            point,
            acceptance.model_dump(mode="json"),
            limited.as_dict(),
            code_hash(AcceptanceTable.__module__),
        )
        return cached_json(self.cache, kind, key, lambda: compute(limited, acceptance))


def _violations(parts: Mapping[str, Acceptance]) -> int:
    return sum(len(part.violations) for part in parts.values())


def _judged(table: DesignTable, controller: Controller, faults: Acceptance, missing: list[str]) -> Controller:
    """Return the controller with these faults beside the linear rows of its certificate."""
    linear = dict(controller.certificate or {})
    acceptance = faults.as_dict()
    not_run = [f"non-linear faults at {point}: {TIME_OVER}" for point in missing]
    violations = [*linear["violations"], *faults.violations, *not_run]
    certificate = linear | {
        "acceptance": acceptance,
        "violations": violations,
        "passed": not violations,
        "not_covered": "; ".join([*not_run, not_covered(table, controller.inputs, acceptance)]),
    }
    record = design_record(table.model_copy(update={"limit_pu": controller.limit_pu}))
    return replace(controller, certificate=certificate, design={**controller.design, "specification": record})
