"""Commands `import` and `export`: a grid of PSS/E or MATPOWER, or a variant of a case, as a case file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def import_grid(
    grid: Annotated[Path, typer.Argument(metavar="GRID", help="PSS/E .raw (version 33) or MATPOWER .m")],
    out: Annotated[Path, typer.Option("--out", metavar="CASE.toml", help="case file", show_default=False)],
    dyr: Annotated[Path | None, typer.Option("--dyr", metavar="FILE", help="PSS/E dynamic data")] = None,
    P_exponent: Annotated[float, typer.Option("--p-exponent", help="loads: P against voltage (RAW)")] = 2.0,
    Q_exponent: Annotated[float, typer.Option("--q-exponent", help="loads: Q against voltage (RAW)")] = 2.0,
    frequency: Annotated[
        float, typer.Option("--frequency", metavar="HZ", help="MATPOWER does not say it")
    ] = 60.0,
) -> None:
    """Read a grid, solve its power flow and write it as a case file; what is not supported is named."""
    from interarea.models.case.case import CaseError
    from interarea.models.case.write_toml import export_toml
    from interarea.models.grid.powerflow import solve_powerflow
    from interarea.models.importers.matpower import import_matpower
    from interarea.models.importers.psse import import_psse

    from .destination import file_for

    file_for(out)
    if not grid.exists():
        raise CaseError(f"{grid}: no such file, wanted: .raw (PSS/E version 33) or .m (MATPOWER)")
    if grid.is_dir():
        raise CaseError(f"{grid}: is a folder, wanted: .raw (PSS/E version 33) or .m (MATPOWER)")
    if grid.suffix.lower() == ".m":
        if dyr is not None:
            raise CaseError(f"{dyr}: dynamic data goes with a RAW file, not with MATPOWER")
        case = import_matpower(grid, frequency_hz=frequency)
    elif grid.suffix.lower() == ".raw":
        case = import_psse(grid, dyr, P_exponent=P_exponent, Q_exponent=Q_exponent)
    else:
        raise CaseError(f"{grid}: suffix {grid.suffix!r}, allowed: .raw (PSS/E version 33), .m (MATPOWER)")
    flow = solve_powerflow(case)
    out.parent.mkdir(parents=True, exist_ok=True)
    export_toml(case, out)
    typer.echo(out)
    typer.echo(
        f"{len(case.buses)} buses, {len(case.branches)} branches, {len(case.machines)} machines; power flow: "
        f"voltages {flow.magnitudes.min():.4f} to {flow.magnitudes.max():.4f} pu",
        err=True,
    )


def export(
    case: Annotated[str, typer.Argument(metavar="CASE", help="bundled case or TOML file")],
    out: Annotated[Path, typer.Option("--out", metavar="CASE.toml", help="case file", show_default=False)],
    tie_flow: Annotated[
        float, typer.Option("--tie-flow", metavar="MW", help="load moved across the tie")
    ] = 0.0,
    circuit_out: Annotated[
        list[str] | None, typer.Option("--circuit-out", metavar="BRANCH", help="branch out of service")
    ] = None,
    load_scale: Annotated[float, typer.Option("--load-scale", metavar="FACTOR", help="on every load")] = 1.0,
) -> None:
    """Write a case, or it at another operating point, as one self-contained case file."""
    from interarea.models.case.case import load_case
    from interarea.models.case.variants import operating_variant
    from interarea.models.case.write_toml import export_toml
    from interarea.models.grid.powerflow import solve_powerflow

    from .destination import file_for

    file_for(out)
    loaded = load_case(case)
    if tie_flow or circuit_out or load_scale != 1.0:
        loaded = operating_variant(loaded, tie_flow_mw=tie_flow, out=circuit_out or (), load_scale=load_scale)
    solve_powerflow(loaded)
    out.parent.mkdir(parents=True, exist_ok=True)
    export_toml(loaded, out)
    typer.echo(out)
