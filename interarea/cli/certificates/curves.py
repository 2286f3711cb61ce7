"""What `certify --page` does: curves of damping over latency and scale."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..terminal import stage_progress

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import control

    from interarea.cosim.designs.design_file import DesignTable

STEP = "curves over latency and scale"


def curves_of(
    page: Path,
    table: DesignTable,
    name: str,
    system: control.StateSpace,
    margins: Sequence[Mapping[str, Any]] | None,
) -> dict[str, Any]:
    """Compute the curves of a controller, write their page, and return them for JSON.

    margins : of the certificate.
    """
    from dataclasses import asdict

    from interarea.cosim.maps.tolerance import damping_curves, write_tolerance
    from interarea.fmu_build.write.cache import default_cache

    with stage_progress([STEP]) as report:
        rows, there = damping_curves(
            table, system, default_cache(), progress=lambda share: report(STEP, share)
        )
    page.parent.mkdir(parents=True, exist_ok=True)
    command = shlex.join(["interarea", *sys.argv[1:]])
    write_tolerance(page, name, table, rows, there, margins or (), command)
    return {"curves": [asdict(row) for row in rows]}
