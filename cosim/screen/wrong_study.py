"""The study `wrong-signals`: several controllers, each with a detector designed for it, on one page."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from interarea.design.controllers.detector_record import DetectorDesign, DetectorDesignError, load_detector
from interarea.fmu_build.write.cache import code_hash
from interarea.models.case.case import Case
from interarea.models.files import write_rows, write_whole
from interarea.models.threads import one_thread

from ..designs.design_tables import FaultPlace
from ..plots.html import page_environment
from ..results.verdict import LOST
from .detector_design import design_detector
from .wrong_runs import LONG_S, START_S, STOP_S, WRONG_S, Judged, signals_of
from .wrong_signals import HEADER, RIGHT, WrongRow, certify_wrong_signals, points_of

#: by default: the default controller, the bank, one of the printed ones, and those of larger sets of signals
CONTROLLERS = ("wide_area", "active", "ftc", "two_actuators", "nets_nyps", "new_england")
FILES = ("wrong_signals.json", "wrong_signals.html", "wrong_signals.parquet", "wrong_signals.csv")

Report = Callable[[str, float], object]


@dataclass(frozen=True)
class Subject:
    """A controller, its name in a scenario, its grid, and the places of the fault and the trip."""

    name: str
    controller: Judged
    case: Case
    place: FaultPlace


def stages(names: Sequence[str]) -> tuple[str, ...]:
    """Return the stages of the study."""
    return tuple(f"{name}, {part}" for name in names for part in ("detector", "runs"))


def study_wrong_signals(
    subjects: Sequence[Subject],
    out: Path,
    cache: Path,
    *,
    kinds: Sequence[str] | None = None,
    disturbances: Sequence[str] | None = None,
    points: int = 2,
    command: str = "",
    report: Report = lambda stage, share: None,
) -> dict[str, Any]:
    """Run every kind of wrong signal on each controller in the folder `out`; return the content of its JSON.

    Detectors and certificates in `out` of the same controller, grid and options are reused. kinds,
    disturbances : as in `certify_wrong_signals`. points : number of operating points.

    Raises
    ------
    ScenarioError : a controller that uses no speed of a machine.
    """
    done: list[dict[str, Any]] = []

    def written() -> dict[str, Any]:
        study = {
            "title": "Effect of a wrong signal, with and without a detector",
            "command": command,
            "controllers": done,
            "times_s": {"disturbance": START_S, "wrong_from": WRONG_S, "stop": STOP_S, "long": LONG_S},
            "versions": {"interarea": version("interarea")},
        }
        _write(study, out)
        return study

    with one_thread():
        for subject, (making, running) in zip(subjects, _pairs(subjects), strict=True):
            report(making, 0.0)
            file, problem = _detector(subject, out, cache, partial(report, making))
            report(making, 1.0)
            question = (kinds, disturbances, points)
            result = _certificate(subject, file, question, out, cache, partial(report, running))
            done.append({**result, **summary_of(result), "no_detector": problem, "fault": str(subject.place)})
            written()
            report(running, 1.0)
    return written()


def _pairs(subjects: Sequence[Subject]) -> list[tuple[str, str]]:
    names = stages([subject.name for subject in subjects])
    return list(zip(names[::2], names[1::2], strict=True))


def _detector(
    subject: Subject, out: Path, cache: Path, progress: Callable[[float], object]
) -> tuple[Path | None, str]:
    """Return the file of the controller's detector, designed where it is not there; else None and why."""
    file = out / f"detector_{subject.name}.json"
    signals = tuple(signals_of(subject.case, subject.controller).all)
    try:
        stored: DetectorDesign | None = load_detector(file)
    except DetectorDesignError:
        stored = None
    if stored is None or (stored.case, stored.controller, stored.signals) != (
        subject.case.name,
        subject.name,
        signals,
    ):
        try:
            designed = design_detector(subject.case, subject.name, signals, cache=cache, progress=progress)
        except DetectorDesignError as error:
            return None, str(error)
        designed.save(file)
    return file, ""


def _certificate(
    subject: Subject,
    detector: Path | None,
    selection: tuple[Sequence[str] | None, Sequence[str] | None, int],
    out: Path,
    cache: Path,
    progress: Callable[[float], object],
) -> dict[str, Any]:
    """Return the certificate as JSON values, from `out` where that holds it for the same question."""
    file = out / f"certificate_{subject.name}.json"
    compared: tuple[str, ...] = ()
    sources = [
        json.dumps(subject.controller.as_dict(), sort_keys=True),
        subject.case.hash,
        str(subject.place),
        json.dumps(selection),
        code_hash(WrongRow.__module__),
    ]
    if detector is not None:
        compared = load_detector(detector).signals
        sources.append(detector.read_text(encoding="utf-8"))
    key = hashlib.sha256("\n".join([*sources, version("interarea")]).encode()).hexdigest()
    if file.is_file():
        stored: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        if stored.get("key") == key:
            return stored
    certificate = certify_wrong_signals(
        subject.case,
        subject.controller,
        subject.place,
        cache,
        detector={} if detector is None else {"file": str(detector.absolute())},
        compared=compared,
        kinds=selection[0],
        disturbances=selection[1],
        points=points_of(subject.case, selection[2]),
        progress=progress,
    )
    document = certificate.as_dict() | {"key": key, "detector": {} if detector is None else detector.name}
    write_whole(file, (json.dumps(document, indent=1, allow_nan=False) + "\n").encode())
    return json.loads(json.dumps(document))  # type: ignore[no-any-return]


def summary_of(certificate: Mapping[str, Any]) -> dict[str, Any]:
    """Return counts of a certificate's runs with one wrong signal, and its conclusion in words."""
    rows = runs_of(certificate)
    wrong, right = ([row for row in rows if (row.kind == RIGHT) is clean] for clean in (False, True))
    counts: dict[str, Any] = {"runs_of_each": sum(not row.detector for row in wrong)}
    counts |= {"disturbances": _each(rows, "disturbance"), "points": _each(rows, "point")}
    for name, with_it in (("alone", False), ("watched", True)):
        counts[name] = _ends([row for row in wrong if row.detector is with_it])
    counts["false_alarms"] = sum(bool(row.others) or row.stopped_s is not None for row in right)
    counts["clean_runs"] = sum(row.detector for row in right)
    stable = all(one["stable"] for one in certificate["out"])
    left = min((one["inter_area"] for one in certificate["out"]), default=None)
    counts["least_left"] = left if stable else None
    counts["conclusion"] = _conclusion(certificate, counts)
    return counts


def _each(rows: Sequence[WrongRow], what: str) -> list[str]:
    return list(dict.fromkeys(getattr(row, what) for row in rows))


def _ends(rows: Sequence[WrongRow]) -> dict[str, int]:
    lost = sum(row.verdict == LOST for row in rows)
    swinging = sum(not row.stable for row in rows) - lost
    return {"lost": lost, "swinging": swinging, "worse": sum(row.worse for row in rows)}


def runs_of(certificate: Mapping[str, Any]) -> list[WrongRow]:
    """Return the runs of a certificate that was read from JSON."""
    return [WrongRow(**{**row, "others": tuple(row["others"])}) for row in certificate["rows"]]


def _conclusion(certificate: Mapping[str, Any], counts: Mapping[str, Any]) -> str:
    alone, watched, runs = counts["alone"], counts["watched"], counts["runs_of_each"]
    words = f"of {runs} runs with one wrong signal "
    words += f"{alone['lost']} lose synchronism and {alone['swinging']} keep swinging without a detector, "
    words += f"{watched['lost']} and {watched['swinging']} with a detector"
    every, right = certificate["isolated"], certificate["rightly"]
    words += f", in {certificate['stops']} of these runs all signals were isolated"
    words += f"; of {every} isolated signals {right} were the wrong one"
    if counts["least_left"] is None:
        return f"{words}; with one of its signals isolated the linear loop is unstable"
    return (
        f"{words}; with one signal isolated the least inter-area damping ratio is {counts['least_left']:.3f}"
    )


def _write(study: Mapping[str, Any], out: Path) -> None:
    """Write page, JSON and tables."""
    write_whole(out / FILES[0], (json.dumps(study, indent=1, allow_nan=False) + "\n").encode())
    text = page_environment(Path(__file__).parent).get_template("wrong_signals.html.j2")
    write_whole(out / FILES[1], text.render(study=study, header=HEADER).encode())
    write_rows(wrong_rows(study), out / FILES[2], out / FILES[3])


def wrong_rows(study: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the runs of all controllers as a flat table; names are joined by blanks."""
    return [
        {
            "controller": one["controller"],
            "case": one["case"],
            **asdict(row),
            "others": " ".join(row.others),
            "worse_than_no_control": row.worse,
        }
        for one in study["controllers"]
        for row in runs_of(one)
    ]
