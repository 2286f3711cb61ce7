"""What `certify` prints of a bank of controllers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ..terminal import busy, show_margins, show_rows, show_worth, stage_progress
from .curves import curves_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from interarea.cosim.designs.design_file import DesignTable
    from interarea.design.certificates.switching import SwitchingCertificate
    from interarea.design.controllers.bank import ControllerBank


def certify_bank(
    bank: ControllerBank,
    table: DesignTable,
    json_: bool,
    out: Path | None,
    page: Path | None,
    *,
    acceptance: bool,
) -> None:
    """Print what is proven for every sequence of losses and, if asked for, what faults came to.

    Margins and the curves of `page` are of the member that acts while all signals are there.

    Exit code 1 where faults hold without the bank and not with it.
    """
    from interarea.cosim.designs.acceptance import judge_acceptance
    from interarea.cosim.designs.bank_design import bank_margins, bank_worth, judge_bank, judged_bank
    from interarea.cosim.designs.bank_design import certify_bank as prove
    from interarea.cosim.designs.design_file import CERTIFICATE_STEPS
    from interarea.cosim.designs.family import family_cases
    from interarea.cosim.run.artefacts import plant_for_controllers
    from interarea.fmu_build.write.cache import default_cache

    case, cache = table.grid, default_cache()
    with busy(f"certifying {bank.name}"):
        result = prove(plant_for_controllers(case, cache), bank)
        rows = judge_bank(table, bank, cache)
        worth = bank_worth(table, bank, cache, clearing=acceptance)
        margins = bank_margins(table, bank, cache)
    judged = None
    if acceptance and table.acceptance is not None:
        with stage_progress([CERTIFICATE_STEPS[-1]]) as report:
            judged = judge_acceptance(
                bank,
                family_cases(table),
                table.acceptance,
                cache,
                progress=lambda share: report(CERTIFICATE_STEPS[-1], share),
            )
    faults = None if judged is None else judged.as_dict()
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        judged_bank(table, bank, result, worth, margins, faults).save(out)
    curves = {} if page is None else curves_of(page, table, bank.name, bank.acting(()).system, margins)
    if not json_:
        show_rows(bank.name, rows)
        show_margins(margins)
        show_worth(worth.as_dict())
        if page is not None:
            typer.echo(page)
    _show_bank(bank, table, result, faults, json_, {"worth": worth.as_dict(), "margins": margins, **curves})
    unstable = [row for row in rows if not row.stable]
    for row in unstable:
        typer.echo(f"violated: {row.point}, {row.condition}: unstable", err=json_)
    if unstable or (judged is not None and judged.violations):
        raise typer.Exit(1)


def _show_bank(
    bank: ControllerBank,
    table: DesignTable,
    result: SwitchingCertificate,
    faults: Mapping[str, Any] | None,
    json_: bool,
    more: Mapping[str, Any],
) -> None:
    from interarea.cosim.designs.certificate_words import bank_not_covered, in_words

    missing = bank_not_covered(table, faults)
    if json_:
        record = {
            **result.as_dict(),
            "acceptance": faults,
            **more,
            "not_covered": missing,
        }
        typer.echo(json.dumps(record, indent=2))
        return
    typer.echo(f"not covered: {missing}")
    typer.echo(
        f"{bank.name} on {table.grid.name}: {result.kind}, {len(result.loops)} loops (active member: "
        "signals that arrive)"
    )
    for loop in result.loops:
        typer.echo(f"  {loop}")
    if result.dwell_s > 0.0:
        typer.echo(f"stable when changes of the signals are at least {result.dwell_s:.3g} s apart")
    else:
        typer.echo(
            f"every sequence of losses and returns decays at {result.decay_rate:.4f} 1/s or faster "
            f"(slowest single loop: {result.slowest:.4f} 1/s)"
        )
    typer.echo("a signal is lost if its channel marks it as lost; a stuck or wrong signal is not detected")
    known = (bank.certificate or {}).get("acceptance")
    typer.echo(in_words(faults) if faults is not None else f"on record: {in_words(known)}")
