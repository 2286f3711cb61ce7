"""A certificate's result for losses, latencies and faults in one line, and the list of what it does not
cover."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from interarea.design.delay.signal_conditions import Condition
from interarea.models.case.case import load_case

from ..scenario.names import CONTROLLER_NAMES

if TYPE_CHECKING:
    from .design_tables import AcceptanceTable, PointTable


class Judging(Protocol):
    """The properties of a design that determine what a certificate covers."""

    @property
    def acceptance(self) -> AcceptanceTable | None: ...
    @property
    def point(self) -> Sequence[PointTable]: ...
    def family(self) -> Sequence[Condition]: ...


def not_covered(table: Judging, signals: Sequence[str], acceptance: Mapping[str, Any] | None) -> str:
    """Return in words what a certificate by the design `table` does not cover.

    signals : of the controller. acceptance : its record (`Acceptance.as_dict`); None: it was not run.
    """
    parts, requested = _faults_left_out(table, acceptance), table.acceptance
    alone = {condition.lost for condition in table.family() if len(condition.lost) == 1}
    exempt = () if requested is None else requested.never_lost
    missing = [s for s in signals if s in exempt or (acceptance is None and (s,) not in alone)]
    if missing:
        parts.append(f"the loss of {', of '.join(missing)}")
    if not any(len(condition.lost) > 1 for condition in table.family()) and len(signals) > 1:
        parts.append("two signals lost at once")
    if len(table.point) == 1:
        parts.append("other operating points")
    return "; ".join([*parts, _wrong(table)])


def bank_not_covered(table: Judging, acceptance: Mapping[str, Any] | None) -> str:
    """Return in words what the switching certificate of a bank, and its faults by `table`, do not cover."""
    linear = ["late signals and other operating points in the proof of switching"]
    return "; ".join([*_faults_left_out(table, acceptance), *linear, _wrong(table)])


def _wrong(table: Judging) -> str:
    codes = () if table.acceptance is None else table.acceptance.wrong
    other = f" otherwise than by {', '.join(codes)}" if codes else ""
    return f"a signal that is wrong{other} while marked as valid"


def _faults_left_out(table: Judging, acceptance: Mapping[str, Any] | None) -> list[str]:
    if table.acceptance is None:
        return ["non-linear faults (the design defines none)"]
    if acceptance is None:
        return ["non-linear faults (--acceptance runs them)"]
    left_out = []
    if table.acceptance.points:
        others = [p.name for p in table.point if p.name not in table.acceptance.points]
        left_out.append(f"non-linear faults at {', '.join(others)}")
    if acceptance["unsolved"]:
        places = ", ".join(acceptance["unsolved"])
        left_out.append(
            f"linear loops after faults whose power flow has no solution ({places}: with the branch)"
        )
    return left_out


def drive_in_words(drive: float, predicted: str, faults: Sequence[Mapping[str, Any]]) -> str:
    """Return the drive after a fault in a line, with its prediction unless a run contradicts it.

    >>> drive_in_words(0.01, "kept", [{"synchronism": True}])
    'drive after the fault 0.010 pu: synchronism kept (predicted)'
    >>> drive_in_words(0.01, "kept", [{"synchronism": True}, {"synchronism": False}])
    'drive after the fault 0.010 pu'
    """
    came = "kept" if all(run["synchronism"] for run in faults) else "lost"
    refuted = predicted in ("kept", "lost") and predicted != came
    return f"drive after the fault {drive:.3f} pu" + (
        "" if refuted else f": synchronism {predicted} (predicted)"
    )


def in_words(result: Mapping[str, Any] | None) -> str:
    """Return the acceptance of a certificate in one line: counts, and the first failure.

    result : of `Acceptance.as_dict`; None: not run.
    """
    if result is None:
        return "non-linear faults: not computed"
    lost = f"{len(result['lost'])} of {result['cases']} lose synchronism only with the controller"
    text = f"non-linear faults: {lost}"
    if result["lost"]:
        text += f" (first: {result['lost'][0]})"
    text += f", {len(result['gained'])} only without it"
    if "standing" not in result:
        text += "; decay not evaluated"
    elif result["standing"]:
        text += f"; {len(result['standing'])} do not decay (first: {result['standing'][0]})"
    if result.get("unstable"):
        text += f"; {len(result['unstable'])} of {result['loops']} linear loops after the faults are "
        text += f"unstable (first: {result['unstable'][0]})"
    if result.get("commutation"):
        text += f"; {len(result['commutation'])} with a dc link that fails to commutate, which the model "
        text += f"does not have (first: {result['commutation'][0]})"
    if result["clearing_mean_change_cycles"] is not None:
        text += (
            f"; clearing times {result['clearing_mean_change_cycles']:+.1f} cycles on average, "
            f"{result['clearing_worst_change_cycles']:+.1f} at worst"
        )
    return text


def first_failures(certificate: Mapping[str, Any] | None) -> str:
    """Return in a line the first conditions in which a controller fails by its certificate for a family.

    Linear: the first operating point and condition that is unstable; then its acceptance, as `in_words`.
    """
    rows = (certificate or {}).get("rows", ())
    unstable = [row for row in rows if not row["stable"]]
    text = in_words((certificate or {}).get("acceptance"))
    if not unstable:
        return text
    first = f"{unstable[0]['point']}, {unstable[0]['condition']}"
    return f"unstable in {len(unstable)} of {len(rows)} linear conditions (first: {first}); {text}"


def bundled_certificate(name: str, case_hash: str) -> dict[str, Any] | None:
    """Return the record of a study controller at two points of `robust_latency`; None for any other.

    Found by ``benchmarks/control/study_certificates.py`` for the case of that design: nothing is known of
    another.
    """
    path = Path(__file__).parent / f"certificate_{name}.json"
    if name not in CONTROLLER_NAMES or not path.exists() or case_hash != load_case("two-area-thesis").hash:
        return None
    return dict(json.loads(path.read_text(encoding="utf-8")))
