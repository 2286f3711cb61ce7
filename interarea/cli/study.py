"""The command `study`: the whole study of a case, or of anybody's grid."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..command_usage import Dyr, naming, within
from .certificates.wrong_study import OPTIONS, WrongSignalsRequest, study_wrong
from .certificates.wrong_study import STUDY as WRONG_SIGNALS
from .terminal import note, stage_progress

if TYPE_CHECKING:
    from interarea.cosim.grid_study.automatic import GridDesign
    from interarea.cosim.grid_study.choices import Choices
    from interarea.models.case.case import Case

_FILES = (
    *("study.json", "report.html", "explorer.html", "case.toml", "controller.json", "local.json"),
    *("with_stabilizers.toml", "design.toml", "fmus/plant.fmu", "fmus/controller.fmu"),
)
_LEAVE_OUT = "leave it out"
_FIRST = "import the grid first, then --grid CASE.toml"
#: option -> the studies that take it, and what to do with another
_TAKERS = {
    "--mva": (("actuators",), _LEAVE_OUT),
    "--actuator": (("actuators",), _LEAVE_OUT),
    "--grid": (("worth", "inverters", "actuators"), "name one grid alone"),
    **dict.fromkeys(OPTIONS, ((WRONG_SIGNALS,), _LEAVE_OUT)),
}
#: option -> the studies that do not take it, and what to do
_REFUSED = {
    "--dyr": {"worth": _FIRST, "inverters": _FIRST, "actuators": _FIRST}
    | {WRONG_SIGNALS: _LEAVE_OUT, "thesis": _LEAVE_OUT},
    "--minutes": {WRONG_SIGNALS: _LEAVE_OUT, "thesis": _LEAVE_OUT},
}
Minutes = Annotated[
    float | None,
    typer.Option(
        "--minutes",
        metavar="MIN",
        min=0.1,
        help="processor time at most, for a grid 10 unless given; the rest is omitted",
    ),
]
OutFolder = Annotated[
    Path, typer.Option("--out", metavar="DIR", help="folder for the results", show_default=False)
]


def study(
    out: OutFolder,
    name: Annotated[
        str,
        typer.Argument(
            metavar="GRID|STUDY",
            help="bundled study or a study's TOML file; or a grid: case, .raw, .m, or one to download",
        ),
    ] = "thesis",
    dyr: Dyr = None,
    minutes: Minutes = None,
    second_solver: Annotated[
        bool,
        typer.Option(help="of a study: also solve every LMI by cvxpy with Clarabel, in a parallel process"),
    ] = True,
    grid: Annotated[
        list[str] | None,
        typer.Option("--grid", metavar="GRID", help="of worth, inverters or actuators: a grid; repeatable"),
    ] = None,
    actuator: Annotated[
        list[str] | None,
        typer.Option("--actuator", metavar="KIND", help="of actuators: exciter, lcc, svc ..; repeatable"),
    ] = None,
    mva: Annotated[
        float | None,
        typer.Option(
            "--mva",
            metavar="MVA",
            help="of actuators: power of each device (else the smallest of the case)",
            callback=within(above=0.0, unit="MVA"),
        ),
    ] = None,
    controller: Annotated[
        list[str] | None,
        typer.Option(
            "--controller",
            metavar="NAME",
            help="of wrong-signals: a controller; repeatable",
            callback=naming("controller"),
        ),
    ] = None,
    kind: Annotated[
        list[str] | None,
        typer.Option(
            "--kind", metavar="NAME", help="of wrong-signals: such as polarity (else all); repeatable"
        ),
    ] = None,
    disturbance: Annotated[
        list[str] | None,
        typer.Option(
            "--disturbance",
            metavar="NAME",
            help="of wrong-signals: rest, pulse, bus fault, tie trip (else all); repeatable",
        ),
    ] = None,
    points: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=1,
            help="of wrong-signals: operating points, the first is that of the case (else 2)",
        ),
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of the files' names")] = False,
) -> None:
    """Run a whole study, or study a grid: modes, a design for it, faults, report.html, study.json.

    For a grid the exit code is 1 if neither local stabilizers nor a loop meet the requirements; the page has
    the reason.
    The study `worth` determines for named grids whether a wide-area signal pays: worth.html, worth.parquet.
    The study `inverters` replaces 0 to 80 % of the machines' power by inverters: inverters.html.
    The study `actuators` compares the kinds of actuators on one grid: actuators.html.
    The study `wrong-signals` runs controllers with each kind of wrong signal: wrong_signals.html.
    """
    from interarea.cosim.scenario.named import study_file

    from .destination import folder_for
    from .grids import grid_of

    request = WrongSignalsRequest(controller or [], kind or [], disturbance or [], points)
    words = {"--mva": mva, "--actuator": actuator, "--grid": grid, "--dyr": dyr, "--minutes": minutes}
    _check_options(name, [*_as_typed(words), *((typed.split()[0], typed) for typed in request.options)])
    if name == "actuators":
        _study_actuators(out, minutes, grid or [], actuator or [], mva, json_=json_)
        return
    if name in ("worth", "inverters"):
        _study_several(name, out, minutes, grid or [], json_=json_)
        return
    if name == WRONG_SIGNALS:
        request.check_names()
        _show_study(*study_wrong(out, request), json_=json_)
        return
    folder_for(out, files=_FILES)
    choices = _choices_of(name, dyr, minutes)
    grid_dyr = None if choices.dyr is None else Path(choices.dyr)
    if (loaded := grid_of(choices.grid, grid_dyr)) is not None:
        _study_grid(name, choices, *loaded, out, json_=json_)
        return
    study_file(name)  # before what takes seconds to load
    _run_study(name, out, second_solver=second_solver, json_=json_)


def _study_several(name: str, out: Path, minutes: float | None, grids: list[str], *, json_: bool) -> None:
    """Run the study `worth` or `inverters` of named grids."""
    _require_grids(grids)
    from interarea.cosim.grid_study import link_study
    from interarea.cosim.inverter_study import study as inverter_study
    from interarea.fmu_build.write.cache import default_cache

    from .destination import folder_for

    of = link_study if name == "worth" else inverter_study
    run = link_study.study_links if name == "worth" else inverter_study.study_inverters
    folder_for(out, files=of.FILES)
    cases = _named_grids(grids or of.GRIDS)
    minutes = minutes or of.MINUTES
    named = "".join(f" --grid {grid}" for grid in grids)
    command = f"interarea study {name}{named} --out {out} --minutes {minutes:g}"
    with stage_progress(of.stages(list(cases))) as report:
        result = run(cases, out, default_cache(), minutes=minutes, command=command, report=report)
    conclusions = {one["grid"]: one["conclusion"] for one in result["grids"]}
    lines = [
        f"{grid}: {line}"
        for grid, words in conclusions.items()
        for line in ([words] if isinstance(words, str) else words)
    ]
    _show_study({"study": name, "grids": conclusions}, out, of.FILES, lines, json_=json_)


def _study_actuators(
    out: Path,
    minutes: float | None,
    grids: list[str],
    kinds: list[str],
    mva: float | None,
    *,
    json_: bool,
) -> None:
    from interarea.models.errors import UserError

    if len(grids) > 1:
        raise UserError(f"--grid {grids[1]}: the study actuators takes one grid; omit the second")
    _require_grids(grids)
    from interarea.cosim.actuator_study.study import (
        FILES,
        GRID,
        MINUTES,
        STAGES,
        kinds_of,
        study_actuators,
    )
    from interarea.fmu_build.write.cache import default_cache

    from .destination import folder_for

    chosen = kinds_of(kinds)
    folder_for(out, files=FILES)
    name = grids[0] if grids else GRID
    case = _named_grids([name])[name]
    minutes = minutes or MINUTES
    options = [f"--grid {name}" for name in grids] + [f"--actuator {kind}" for kind in kinds]
    options += [] if mva is None else [f"--mva {mva:g}"]
    command = " ".join(["interarea study actuators", *options, f"--out {out} --minutes {minutes:g}"])
    with stage_progress(STAGES) as report:
        result = study_actuators(
            case,
            out,
            default_cache(),
            kinds=chosen,
            mva=mva,
            minutes=minutes,
            command=command,
            report=report,
        )
    summary = {"study": "actuators", "grid": name, "conclusion": result["conclusion"]}
    _show_study(summary, out, FILES, result["conclusion"], json_=json_)


def _as_typed(typed_options: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Yield each option that is given, and it as it is typed; a number is left out."""
    for option, value in typed_options.items():
        for word in value if isinstance(value, list) else [value]:
            if word is not None:
                yield option, option if isinstance(word, float) else f"{option} {word}"


def _check_options(study: str, typed_options: Iterable[tuple[str, str]]) -> None:
    """Refuse an option of one study that is given to another. typed_options : option, and it as it is typed.

    Raises
    ------
    UserError : the first of them.
    """
    from interarea.models.errors import UserError

    for option, typed in typed_options:
        takers, remedy = _TAKERS.get(option, ((), _LEAVE_OUT))
        if takers and study not in takers:
            allowed = " or ".join(part for part in (", ".join(takers[:-1]), takers[-1]) if part)
            raise UserError(f"{typed}: belongs to the study {allowed}, not to {study}; {remedy}")
        if study in (refused := _REFUSED.get(option, {})):
            raise UserError(f"{typed}: not with the study {study}; {refused[study]}")


def _named_grids(names: Iterable[str]) -> dict[str, Case]:
    """Return the cases that options --grid mean, by these words."""
    from .grids import grid_of

    return {name: loaded[0] for name in names if (loaded := grid_of(name)) is not None}


def _require_grids(names: Iterable[str], where: str = "--grid") -> None:
    """Require that each name means a grid, before what studies them is loaded; where : it is given."""
    from interarea.models.case.document import case_names
    from interarea.models.errors import UserError, nearest

    from .grids import names_grid

    for name in names:
        if not names_grid(name):
            near = f"{nearest(name, case_names())} (or a case file, .raw, .rawx, .m)"
            raise UserError(f"{where} {name}: not a grid; {near}")


def _show_study(
    summary: Mapping[str, object], out: Path, files: Sequence[str], lines: Sequence[str], *, json_: bool
) -> None:
    """Print the files of a bundled study, or its summary and them as JSON; its conclusions on stderr."""
    paths = [str(out / name) for name in files]
    if json_:
        typer.echo(json.dumps({**summary, "files": paths}, indent=2))
    else:
        for path in paths:
            typer.echo(path)
    for line in lines:
        note(line)


def _choices_of(name: str, dyr: Path | None, minutes: float | None) -> Choices:
    """Return the choices of a study's file, its files beside it, or none but the grid; options come first."""
    from interarea.cosim.grid_study.choices import Choices, load_choices
    from interarea.models.errors import UserError

    from .grids import is_grid_study

    file = Path(name)
    if not is_grid_study(file):
        choices = Choices(grid=name, dyr=None if dyr is None else str(dyr))
    else:
        if dyr is not None:
            raise UserError(
                f"--dyr {dyr}: the file of the study {name} names its grid, allowed: dyr in that file"
            )
        choices = load_choices(file)
        there = {
            key: str(file.parent / value)
            for key, value in (("grid", choices.grid), ("dyr", choices.dyr))
            if value is not None and (file.parent / value).is_file()
        }
        choices = choices.model_copy(update=there)
        _require_grids([choices.grid], f"{file}: grid =")
    return choices if minutes is None else choices.model_copy(update={"minutes": minutes})


def _study_grid(
    name: str, choices: Choices, case: Case, assumptions: list[str], out: Path, *, json_: bool
) -> None:
    from interarea.cosim.grid_study.page import headline
    from interarea.cosim.grid_study.study import STAGES, study_grid
    from interarea.fmu_build.write.cache import default_cache
    from interarea.models.case.document import case_names
    from interarea.models.case.write_toml import export_toml

    named = choices.grid
    if named not in case_names():
        out.mkdir(parents=True, exist_ok=True)
        export_toml(case, out / "case.toml")
        named = "case.toml"
    dyr = f" --dyr {choices.dyr}" if choices.dyr is not None and name == choices.grid else ""
    command = f"interarea study {name}{dyr} --out {out} --minutes {choices.minutes:g}"
    with stage_progress(STAGES) as report:
        result = study_grid(
            case,
            out,
            default_cache(),
            named=named,
            assumptions=assumptions,
            command=command,
            choices=choices,
            report=report,
        )
    files = [str(out / name) for name in ("study.json", "report.html")]
    held = [result.get("certificate"), (result.get("local") or {}).get("certificate")]
    passed = result["problem"] is None and any(one["passed"] for one in held if one is not None)
    if json_:
        typer.echo(json.dumps({"grid": name, "passed": passed, "files": files}, indent=2))
    else:
        for file in files:
            typer.echo(file)
    for line in headline(result):
        note(line)
    if not passed:
        raise typer.Exit(1)


def design_for_grid(name: str, case: Case, out: Path, minutes: float | None) -> tuple[GridDesign, list[Path]]:
    """Make the design of a grid; write controllers, design file and grids that it names; return the files."""
    from interarea.cosim.grid_study.automatic import DESIGN_STAGES, design_grid
    from interarea.cosim.grid_study.choices import MINUTES
    from interarea.cosim.grid_study.clock import Clock
    from interarea.fmu_build.write.cache import default_cache
    from interarea.models.case.document import case_names
    from interarea.models.case.write_toml import export_toml
    from interarea.models.files import together, write_whole

    from .destination import file_for

    design, imported, stabilized, local = (
        file_for(out.with_suffix(suffix))
        for suffix in (".design.toml", ".case.toml", ".stabilizers.toml", ".local.json")
    )
    named = name if name in case_names() else imported.name
    with stage_progress(DESIGN_STAGES) as report:
        clock = Clock(minutes or MINUTES)
        done = design_grid(
            case,
            default_cache(),
            clock,
            name=_identifier(out.stem),
            named=named,
            named_stabilized=stabilized.name,
            report=report,
        )
    grids = {imported: case if named != name else None, stabilized: done.stabilized}
    controllers = {out: done.controller, local: done.local}
    with together():
        for file, controller in controllers.items():
            if controller is not None:
                controller.save(file)
        write_whole(design, done.proposal.text())
        for file, grid in grids.items():
            if grid is not None:
                export_toml(grid, file)
    contents = {**controllers, design: done.proposal, **grids}
    return done, [file for file, content in contents.items() if content is not None]


def _identifier(text: str) -> str:
    """Return a controller's name made of a file's.

    >>> _identifier("2 my-grid")
    '_2_my_grid'
    """
    name = re.sub("[^A-Za-z0-9_]+", "_", text)
    return name if name.isidentifier() else f"_{name}"


def _run_study(name: str, out: Path, *, second_solver: bool, json_: bool) -> None:
    from interarea.cosim.designs.certificate_words import bundled_certificate, first_failures
    from interarea.cosim.scenario.names import CONTROLLER_NAMES
    from interarea.cosim.study.study import STAGES, run_study

    with stage_progress(STAGES) as progress:
        summary = run_study(name, out, progress, second_solver=second_solver)
    verdicts = [row["verdict"] for row in summary.get("printed", {}).get("verdicts", [])]
    count = {k: verdicts.count(k) for k in ("agrees", "partly", "differs")}
    files = [str(out / name) for name in ("study.json", "report.html")]
    if json_:
        typer.echo(json.dumps({"study": name, "statements": count, "files": files}, indent=2))
    else:
        for file in files:
            typer.echo(file)
    note(f"printed statements: {', '.join(f'{number} {verdict}' for verdict, number in count.items())}")
    for controller in CONTROLLER_NAMES:
        known = bundled_certificate(controller, summary["provenance"]["case_hash"])
        note(f"{controller}: {first_failures(known)}")
