"""The command `cache`: what is kept of FMUs, linear models and designs; checked, trimmed."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Annotated

import typer

from ..command_usage import within
from .terminal import print_table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from interarea.fmu_build.write.cache import Artefact

_MB, _DAY_S = 1e6, 86400.0


def cache(
    check: Annotated[bool, typer.Option("--check", help="remove damaged files (SHA-256)")] = False,
    keep_mb: Annotated[
        float | None,
        typer.Option(
            "--keep-mb",
            metavar="MB",
            help="remove the longest unused files down to this size",
            callback=within(least=0.0, unit="MB"),
        ),
    ] = None,
    unused_days: Annotated[
        float | None,
        typer.Option(
            "--unused-days",
            metavar="DAYS",
            help="remove files unused for longer",
            callback=within(least=0.0, unit="days"),
        ),
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
) -> None:
    """Show, check or trim the cache of FMUs and designs.

    The folder is $INTERAREA_CACHE, else `interarea` in the user's cache folder. A removed file is built again
    when it is needed.
    """
    from interarea.fmu_build.write.cache import artefacts_in, damaged, default_cache, remove
    from interarea.models.files import sweep

    folder = default_cache()
    going: list[Artefact] = damaged(folder) if check else []
    bad, left = len(going), sweep(folder)
    freed = remove(going)
    retained = artefacts_in(folder)
    count = _unused(retained, unused_days)
    count += _too_many(retained[count:], keep_mb)
    freed += remove(retained[:count])
    _show(folder, retained[count:], bad, freed, json_=json_)
    if json_:
        return
    if check:
        print(f"{bad} damaged: removed" if bad else "checked: no file is damaged")
    if left:
        print(f"{left} folders of killed processes: removed")
    if freed:
        print(f"{freed / _MB:.1f} MB freed")


def _show(folder: Path, artefacts: Sequence[Artefact], bad: int, freed: int, *, json_: bool) -> None:
    """Print how much there is of each kind."""
    kinds = {kind: [k for k in artefacts if k.kind == kind] for kind in sorted({k.kind for k in artefacts})}
    sizes = {kind: sum(k.size for k in selected) for kind, selected in kinds.items()}
    if json_:
        about = {kind: {"files": len(selected), "bytes": sizes[kind]} for kind, selected in kinds.items()}
        document = {"folder": str(folder), "kinds": about, "damaged": bad, "freed": freed}
        typer.echo(json.dumps(document, indent=1))
        return
    rows = [
        (
            kind,
            str(len(selected)),
            f"{sizes[kind] / _MB:.1f}",
            f"{(time.time() - selected[0].used_s) / _DAY_S:.0f}",
        )
        for kind, selected in kinds.items()
    ]
    print_table(str(folder), ("kind", "files", "MB", "longest unused, days"), rows)


def _unused(artefacts: Sequence[Artefact], days: float | None) -> int:
    """Return how many of `artefacts`, the longest unused first, were not used for `days`; None: no limit."""
    return 0 if days is None else sum(k.used_s < time.time() - _DAY_S * days for k in artefacts)


def _too_many(artefacts: Sequence[Artefact], most_mb: float | None) -> int:
    """Return how many of `artefacts`, from the front, have to go for the others to have at most `most_mb`."""
    left, count = float(sum(k.size for k in artefacts)), 0
    while most_mb is not None and count < len(artefacts) and left > most_mb * _MB:
        left -= artefacts[count].size
        count += 1
    return count
