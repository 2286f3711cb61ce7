"""The command `cache`: what is kept of FMUs, linear models and designs; checked, trimmed."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Annotated

import typer

from .terminal import print_table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from interarea.fmu_build.write.cache import Kept

_MB = 1e6


def cache(
    check: Annotated[
        bool, typer.Option("--check", help="remove what is not what was written (SHA-256)")
    ] = False,
    keep_mb: Annotated[
        float | None,
        typer.Option("--keep-mb", metavar="MB", help="remove the longest unused until this much is left"),
    ] = None,
    unused_days: Annotated[
        float | None,
        typer.Option("--unused-days", metavar="DAYS", help="remove what was not used for so long"),
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
) -> None:
    """Show what the cache of FMUs and designs holds; check it, trim it.

    The folder is $INTERAREA_CACHE, else `interarea` in the user's cache folder. What is removed is made again
    when it is needed.
    """
    from interarea.fmu_build.write.cache import artefacts_in, damaged, default_cache, remove
    from interarea.models.files import sweep

    for name, value in (("--keep-mb", keep_mb), ("--unused-days", unused_days)):
        if value is not None and not value >= 0.0:
            raise typer.BadParameter(f"{name} = {value:g}, allowed: 0 or more")
    folder = default_cache()
    going: list[Kept] = damaged(folder) if check else []
    bad, left = len(going), sweep(folder)
    freed = remove(going)
    kept = artefacts_in(folder)
    if unused_days is not None:
        old = [k for k in kept if k.used_s < time.time() - 86400.0 * unused_days]
        freed += remove(old)
        kept = kept[len(old) :]
    if keep_mb is not None:
        count = _too_many(kept, keep_mb * _MB)
        freed += remove(kept[:count])
        kept = kept[count:]
    kinds = {k.kind: [o for o in kept if o.kind == k.kind] for k in kept}
    if json_:
        sizes = {n: {"files": len(o), "bytes": sum(k.size for k in o)} for n, o in sorted(kinds.items())}
        typer.echo(
            json.dumps({"folder": str(folder), "kinds": sizes, "damaged": bad, "freed": freed}, indent=1)
        )
        return
    rows = [
        (n, str(len(o)), f"{sum(k.size for k in o) / _MB:.1f}", f"{(time.time() - o[0].used_s) / 86400:.0f}")
        for n, o in sorted(kinds.items())
    ]
    print_table(str(folder), ("kind", "files", "MB", "longest unused, days"), rows)
    if check:
        print(f"{bad} damaged: removed" if bad else "checked: every file is what was written")
    if left:
        print(f"{left} folders of processes that were killed: removed")
    if freed:
        print(f"{freed / _MB:.1f} MB freed")


def _too_many(kept: Sequence[Kept], most: float) -> int:
    """Return how many of `kept`, from the front, have to go for the others to have at most `most` bytes."""
    left, count = float(sum(k.size for k in kept)), 0
    while count < len(kept) and left > most:
        left -= kept[count].size
        count += 1
    return count
