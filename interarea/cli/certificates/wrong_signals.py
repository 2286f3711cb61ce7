"""What `certify --wrong-signals` does: a loop whose signals are wrong while their flags are up."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ..terminal import print_table, stage_progress

if TYPE_CHECKING:
    from interarea.cosim.designs.design_file import DesignTable
    from interarea.cosim.designs.design_tables import FaultPlace
    from interarea.cosim.screen.wrong_signals import WrongCertificate
    from interarea.design.controllers.bank import ControllerBank
    from interarea.design.controllers.controller import Controller

STEP = "wrong signals"
_SHOWN = 20  # violations on the terminal; JSON has all


def check_wrong_options(wrong_signals: bool, detector: Path | None, *, others: bool) -> None:
    """Refuse options that do not go together; others : whether one of the plain certificate is given."""
    from interarea.models.errors import UserError

    if detector is not None and not wrong_signals:
        raise UserError("--detector needs --wrong-signals, allowed: both or none")
    if wrong_signals and others:
        raise UserError(
            "--wrong-signals: --acceptance, --worth, --conditions, --out and --page belong to the plain "
            "certificate, allowed: one call for each"
        )


def certify_wrong(
    loaded: Controller | ControllerBank, table: DesignTable, detector: Path | None, *, json_: bool
) -> None:
    """Run a loop with every kind of wrong signal, print what came of it; exit code 1 where it fails."""
    from interarea.cosim.screen.wrong_runs import fault_place
    from interarea.cosim.screen.wrong_signals import certify_wrong_signals
    from interarea.design.controllers.detector_record import load_detector
    from interarea.fmu_build.write.cache import default_cache

    place = fault_place(table)
    compared = () if detector is None else load_detector(detector).signals
    keys = {} if detector is None else {"file": str(detector.absolute())}
    with stage_progress([STEP]) as report:
        certificate = certify_wrong_signals(
            table.grid,
            loaded,
            place,
            default_cache(),
            detector=keys,
            compared=compared,
            progress=lambda share: report(STEP, share),
        )
    if json_:
        typer.echo(json.dumps(certificate.as_dict(), indent=2, allow_nan=False))
    else:
        _show(certificate, place)
    if not certificate.passed:
        raise typer.Exit(1)


def _show(certificate: WrongCertificate, place: FaultPlace) -> None:
    from interarea.cosim.screen.wrong_runs import LONG_S, STOP_S, WRONG_S
    from interarea.cosim.screen.wrong_signals import HEADER

    late = ", ".join(f"{s} {1e3 * t:g} ms" for s, t in certificate.signals.items())
    witnesses = (
        f"; used for comparison only: {', '.join(certificate.witnesses)}" if certificate.witnesses else ""
    )
    print_table(
        f"{certificate.controller} on {certificate.case}, wrong from {WRONG_S:g} s ({late}{witnesses})",
        HEADER,
        certificate.table(),
    )
    disturbances = ", ".join(dict.fromkeys(r.disturbance for r in certificate.rows))
    points = " and ".join(dict.fromkeys(r.point for r in certificate.rows))
    horizon = f"verdicts after {STOP_S:g} s, after {LONG_S:g} s if a run has not settled"
    typer.echo(f"each at {points} with {disturbances}; fault at {place}; {horizon}")
    print_table(
        "linear loop with a signal isolated",
        ("operating point", "signal", "stable", "worst swing", "inter-area"),
        [
            (o.point, o.signal, "yes" if o.stable else "NO", f"{o.worst_swing:.3f}", f"{o.inter_area:.3f}")
            for o in certificate.out
        ],
    )
    every, right = certificate.isolations
    typer.echo(
        f"isolated: {every} signals, of which {right} were wrong; all signals isolated in "
        f"{certificate.stops} runs"
    )
    for line in certificate.violations[:_SHOWN]:
        typer.echo(f"violated: {line}")
    if len(certificate.violations) > _SHOWN:
        typer.echo(f"violated: {len(certificate.violations) - _SHOWN} more (--json has all)")
    typer.echo("passed" if certificate.passed else "does not pass")
