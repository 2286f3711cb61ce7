"""Commands `design` and `certify`: controllers for a family of operating points, losses, latencies."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..command_usage import Dyr, naming
from .certificates.bank import certify_bank
from .certificates.curves import curves_of
from .certificates.wrong_signals import certify_wrong, check_wrong_options
from .study import Minutes, design_for_grid
from .terminal import busy, print_table, show_margins, show_rows, show_worth, stage_progress

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import control

    from interarea.cosim.designs.comparison import Alternative
    from interarea.cosim.designs.design_file import DesignTable
    from interarea.cosim.grid_study.automatic import GridDesign
    from interarea.design.controllers.bank import ControllerBank
    from interarea.design.controllers.controller import Controller
    from interarea.design.robust.operating_points import FamilyCertificate
    from interarea.models.case.case import Case

DesignFile = Annotated[
    str | None,
    typer.Option(
        "--spec",
        metavar="SPEC.toml",
        help="design (file or bundled name) with the conditions; default: the controller's own",
        show_default=False,
        callback=naming("design"),
    ),
]


def design(
    spec: Annotated[
        str,
        typer.Argument(
            metavar="SPEC.toml|GRID",
            help="design file or a bundled name; or a grid (case, .raw, .m) to design for",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option("--out", metavar="FILE.json", help="file for the controller", show_default=False),
    ],
    against: Annotated[
        list[str] | None,
        typer.Option(
            "--against",
            metavar="CONTROLLER",
            help="also compare with this one (repeatable)",
            callback=naming("controller"),
        ),
    ] = None,
    plots: Annotated[
        Path | None, typer.Option("--plots", metavar="DIR", help="draw the alternatives into DIR")
    ] = None,
    worth: Annotated[
        bool,
        typer.Option(help="also design the best controller without remote signals, and compare"),
    ] = True,
    dyr: Dyr = None,
    minutes: Minutes = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of tables")] = False,
) -> None:
    """Design a controller from a design file or a grid; exit code 1 if it misses a requirement.

    The result is compared with the other starts of the search and with the controllers of `--against`. For
    a grid, rules determine loops, operating points and requirements: local stabilizers first, then a
    wide-area loop for the remaining weak modes. The design file, with the reason of each choice, and the
    local stabilizers are written to the folder of the controller.
    """
    from interarea.cosim.scenario.named import design_file
    from interarea.models.case.document import case_names

    from .destination import file_for, folder_for
    from .grids import grid_of

    file_for(out, suffix=".json")
    if (grid := grid_of(spec, dyr)) is not None:
        grid_design, written = design_for_grid(spec, grid[0], out, minutes)
        _show_grid_design(grid_design, grid[1], written, json_=json_)
        return
    if minutes is not None:
        from interarea.models.errors import UserError

        raise UserError(f"--minutes: an option for a grid, not for the design {spec}; leave it out")
    design_file(spec, also=case_names())  # before what takes seconds to load
    from interarea.cosim.designs.comparison import FIGURES, compare, save_comparison
    from interarea.cosim.designs.design_file import DESIGN_STEPS, load_design, run_design
    from interarea.cosim.designs.worth import has_rival, with_rival, with_worth
    from interarea.fmu_build.write.cache import default_cache
    from interarea.models.case.case import load_case

    table, cache = load_design(spec), default_cache()
    case = load_case(table.case)
    if table.bank is not None:
        _design_bank(table, out, json_)
        return
    if plots is not None:
        folder_for(plots, "--plots", files=FIGURES)
    others = {name: _system(name, case) for name in against or ()}
    rival_step = ("own-signal rival",) if worth and has_rival(table) else ()
    with stage_progress((*DESIGN_STEPS, *rival_step, "alternatives")) as report:
        done = run_design(table, cache, progress=report)
        designed = done.controller
        if rival_step:
            designed = with_rival(designed, _rival(table, designed, report))
        designed = with_worth(table, designed, cache)
        out.parent.mkdir(parents=True, exist_ok=True)
        designed.save(out)
        certificate = _certificate_of(designed)
        report("alternatives", 0.0)
        alternatives = compare(table, {designed.name: designed.system, **done.tried, **others}, cache)
        drawn = save_comparison(table, alternatives, cache, plots) if plots is not None else ()
        report("alternatives", 1.0)
    _show_designed(designed, table, alternatives, (out, *drawn), json_=json_)
    if not certificate.passed:
        raise typer.Exit(1)


def _show_designed(
    designed: Controller,
    table: DesignTable,
    alternatives: Sequence[Alternative],
    files: Sequence[Path],
    *,
    json_: bool,
) -> None:
    from interarea.cosim.designs.comparison import HEADER

    if json_:
        document = {
            "controller": designed.name,
            "certificate": designed.certificate,
            "alternatives": [dict(zip(HEADER, a.cells(), strict=True)) for a in alternatives],
            "files": [str(path) for path in files],
        }
        typer.echo(json.dumps(document, indent=2, allow_nan=False))
    else:
        _show(designed.name, _certificate_of(designed), table)
        print_table("alternatives over the family", HEADER, [a.cells() for a in alternatives])
        for path in files:
            typer.echo(path)


def _show_grid_design(
    grid_design: GridDesign, assumptions: list[str], files: list[Path], *, json_: bool
) -> None:
    """Print the results of a design for a grid; exit code 1 if it misses a requirement."""
    from interarea.cosim.grid_study.page import sentence

    reasons = list(grid_design.proposal.reasons)
    if json_:
        document = {
            "controller": grid_design.controller.name,
            "certificate": grid_design.certificate,
            "reasons": reasons,
            "which_to_build": grid_design.sentence,
            "passed": grid_design.passed,
            "assumptions": assumptions,
            "files": [str(path) for path in files],
        }
        typer.echo(json.dumps(document, indent=2, allow_nan=False))
    else:
        for line in (*assumptions, *reasons):
            typer.echo(line)
        _show(
            grid_design.controller.name, _certificate_of(grid_design.controller), grid_design.proposal.table
        )
        typer.echo(sentence(grid_design.sentence))
        for path in files:
            typer.echo(path)
    if not grid_design.passed:
        raise typer.Exit(1)


def _certificate_of(controller: Controller) -> FamilyCertificate:
    """Return the certificate in a controller's record as what it was."""
    from interarea.design.robust.operating_points import FamilyCertificate, FamilyRow

    record = dict(controller.certificate or {})
    del record["passed"]
    rows = tuple(FamilyRow(**row) for row in record.pop("rows"))
    return FamilyCertificate(rows=rows, **record)


def _system(name: str, case: Case) -> control.StateSpace:
    from interarea.design.controllers.bank import ControllerBank
    from interarea.models.errors import UserError
    from interarea.synthesis import load_controller

    with busy(f"reading {name}, designed for {case.name} where it is new"):
        loaded = load_controller(name, case=case)
    if isinstance(loaded, ControllerBank):
        raise UserError(f"--against {name}: is a bank, allowed: one controller")
    return loaded.system


def certify(
    controller: Annotated[
        str,
        typer.Argument(
            metavar="CONTROLLER",
            help="a name that `interarea list` shows, JSON file, or FMU",
            show_default=False,
            callback=naming("controller"),
        ),
    ],
    spec: DesignFile = None,
    case: Annotated[
        str | None,
        typer.Option(
            "--case", metavar="CASE", help="another case than the design's", callback=naming("case")
        ),
    ] = None,
    conditions: Annotated[
        str | None,
        typer.Option(
            "--conditions",
            metavar="CODE,...",
            help="require a stable loop under these on the case as it is, such as N,s100,L:G2_dw; default "
            "for a controller without a design: 0 to 200 ms late, each signal lost",
        ),
    ] = None,
    acceptance: Annotated[
        bool,
        typer.Option(
            "--acceptance", help="also run every fault of the design's acceptance and its clearing times"
        ),
    ] = False,
    worth: Annotated[
        bool,
        typer.Option(
            "--worth",
            help="design the best controller without remote signals again (as long as a design), and "
            "compare; default: the recorded one",
        ),
    ] = False,
    wrong_signals: Annotated[
        bool,
        typer.Option(
            "--wrong-signals",
            help="only non-linear runs of twelve kinds of wrong signals, with and without a detector",
        ),
    ] = False,
    detector: Annotated[
        Path | None,
        typer.Option(
            "--detector",
            metavar="FILE.json",
            help="with --wrong-signals: a designed detector; default: the tests that need no design",
            show_default=False,
            callback=naming("detector"),
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE.json",
            help="file for the controller with conditions and result in its record",
            show_default=False,
        ),
    ] = None,
    page: Annotated[
        Path | None,
        typer.Option(
            "--page",
            metavar="FILE.html",
            help="page with curves of damping over latency and scale; --json then has them too",
            show_default=False,
        ),
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
) -> None:
    """Recompute a controller's certificate on full linear plants, exact latency; exit code 1 if it fails.

    The conditions (operating points, losses, latencies, the fault, requirements) are in the controller's own
    record, so the FMU alone is sufficient. A controller without such a record gets default conditions.
    """
    from interarea.cosim.errors import ScenarioError
    from interarea.design.controllers.bank import ControllerBank

    from .destination import file_for

    if out is not None:
        file_for(out, suffix=".json")
    if page is not None:
        file_for(page, "--page", suffix=".html")
    others = acceptance or worth or any(option is not None for option in (out, page, conditions))
    check_wrong_options(wrong_signals, detector, others=others)
    loaded, table = _judged(controller, case, spec, conditions)
    if acceptance and table.acceptance is None:
        raise ScenarioError(
            f"--acceptance: the design that judges {loaded.name} has no faults; give a design with "
            "faults (--spec)"
        )
    if wrong_signals:
        certify_wrong(loaded, table, detector, json_=json_)
        return
    if isinstance(loaded, ControllerBank):
        certify_bank(loaded, table, json_, out, page, acceptance=acceptance)
        return
    certificate = _certified(loaded, table, out, acceptance=acceptance, worth=worth)
    curves = {} if page is None else curves_of(page, table, loaded.name, loaded.system, certificate.margins)
    if json_:
        typer.echo(json.dumps(certificate.as_dict() | curves, indent=2, allow_nan=False))
    else:
        _show(loaded.name, certificate, table)
        if page is not None:
            typer.echo(page)
        if not acceptance:
            _show_record(controller, loaded, table)
    if not certificate.passed:
        raise typer.Exit(1)


def _show_record(name: str, loaded: Controller, table: DesignTable) -> None:
    from interarea.cosim.designs.certificate_words import bundled_certificate, first_failures

    known = bundled_certificate(name, table.grid.hash) or loaded.certificate
    typer.echo(f"on record: {first_failures(known)}")


def _certified(
    loaded: Controller, table: DesignTable, out: Path | None, *, acceptance: bool, worth: bool
) -> FamilyCertificate:
    """Return the certificate of a single controller; write it into `out` with the controller."""
    from interarea.cosim.designs.design_file import certify as recompute
    from interarea.cosim.designs.design_file import judged_by, steps_of
    from interarea.cosim.designs.worth import certified_worth, with_rival
    from interarea.fmu_build.write.cache import default_cache

    steps = steps_of(table, acceptance=acceptance)
    with stage_progress([*(["own-signal rival"] if worth else []), *steps, "worth of the signals"]) as report:
        if worth:
            loaded = with_rival(loaded, _rival(table, loaded, report))
        certificate = recompute(table, loaded, default_cache(), acceptance=acceptance, progress=report)
        certificate = certified_worth(
            table,
            loaded,
            certificate,
            default_cache(),
            progress=lambda share: report("worth of the signals", share),
        )
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        judged_by(table, loaded, certificate).save(out)
    return certificate


def _judged(
    name: str, case: str | None, spec: str | None, conditions: str | None
) -> tuple[Controller | ControllerBank, DesignTable]:
    """Return the controller that a word of the command line means, and the design that judges it."""
    from interarea.synthesis import judged_and_design

    with busy(f"reading {name}, designed for the case where it is new"):
        return judged_and_design(name, case, spec, tuple(conditions.split(",")) if conditions else ())


def _rival(table: DesignTable, controller: Controller, report: Callable[[str, float], object]) -> Controller:
    """Design the own-signal rival of a controller that the design of `table` fits."""
    from interarea.cosim.designs.worth import design_rival
    from interarea.fmu_build.write.cache import default_cache

    name = "own-signal rival"
    rival = design_rival(
        table, controller, default_cache(), progress=lambda _, share, __: report(name, 0.99 * share)
    )
    report(name, 1.0)
    return rival


def _design_bank(table: DesignTable, out: Path, json_: bool) -> None:
    """Design a bank, write it and show what is proven; exit code 1 where a member misses what was asked."""
    from interarea.cosim.designs.bank_design import bank_steps, run_bank_design
    from interarea.fmu_build.write.cache import default_cache

    with stage_progress(bank_steps(table)) as report:
        bank, missed = run_bank_design(table, default_cache(), progress=report)
    out.parent.mkdir(parents=True, exist_ok=True)
    bank.save(out)
    certify_bank(bank, table, json_, None, None, acceptance=False)
    for line in missed:
        typer.echo(f"violated: {line}", err=json_)
    if missed:
        raise typer.Exit(1)


def _show_conditions(table: DesignTable) -> None:
    single = [condition for condition in table.family() if "+" not in condition.name]
    print_table(
        "conditions; joined by +: both",
        ("condition", "signals"),
        [(condition.name, condition.in_words) for condition in single],
    )


def _show(name: str, certified: FamilyCertificate, table: DesignTable) -> None:
    from interarea.cosim.designs.certificate_words import drive_in_words, in_words
    from interarea.design.certificates.mode_changes import most_taken

    if certified.not_covered:
        typer.echo(f"not covered: {certified.not_covered}")
    show_rows(name, certified.rows)
    _show_conditions(table)
    typer.echo(
        "inter-area: least damped root in the band of the open loop's inter-area modes, of any mode; "
        "above 400 states, and in `interarea run`, the modes themselves, tracked from the open loop"
    )
    typer.echo(
        f"worst swing {certified.worst_swing:.4f}, inter-area {certified.inter_area:.4f}, "
        f"effort {certified.effort:.4f}, fastest pole {certified.fastest_pole:.1f} rad/s"
    )
    if certified.modes is not None:
        typer.echo(f"without loss of a signal: {most_taken(certified.modes)}")
    if certified.margins is not None:
        show_margins(certified.margins)
    for lost, gain in certified.loss_criterion.items():
        typer.echo(f"{lost} lost: loop gain of the rest at real s {gain:.3f} (unstable above 1)")
    if certified.drive is not None:
        typer.echo(drive_in_words(certified.drive, certified.predicted, certified.faults))
    for run in certified.faults:
        message = f"settled in {run['settled_s']:.1f} s" if run["synchronism"] else "SYNCHRONISM LOST"
        typer.echo(f"fault at {run['point']}, {' and '.join(run['lost']) or 'no signal'} lost: {message}")
    if certified.worth is not None:
        show_worth(certified.worth)
    if certified.acceptance is not None:
        typer.echo(in_words(certified.acceptance))
    for violation in certified.violations:
        typer.echo(f"violated: {violation}")
    slips = any(not run["synchronism"] for run in certified.faults)
    unasked = " the requirements of its design; synchronism is not one of them" if slips else ""
    typer.echo(f"passed{unasked}" if certified.passed else "does not pass")
