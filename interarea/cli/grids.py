"""Commands `import` and `export`: a grid of PSS/E or MATPOWER, or a variant of a case, as a case file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..command_usage import CaseName, Dyr, naming

if TYPE_CHECKING:
    from interarea.models.case.case import Case

_GRIDS = (
    ".raw (PSS/E version 23 to 36), .rawx or .m (MATPOWER), plain, .gz, .xz or .bz2; or wecc-179, npcc, "
    "nordic-44: downloaded from the wheel of andes, whose licence (GPL) does not allow bundling"
)


def import_grid(
    grid: Annotated[str, typer.Argument(metavar="GRID", help=_GRIDS)],
    out: Annotated[Path, typer.Option("--out", metavar="CASE.toml", help="case file", show_default=False)],
    dyr: Dyr = None,
    P_exponent: Annotated[
        float | None,
        typer.Option("--p-exponent", help="voltage exponent of P of loads (else 2)", show_default=False),
    ] = None,
    Q_exponent: Annotated[
        float | None,
        typer.Option("--q-exponent", help="voltage exponent of Q of loads (else 2)", show_default=False),
    ] = None,
    frequency: Annotated[
        float | None,
        typer.Option("--frequency", metavar="HZ", help="if the file has none (else 60)", show_default=False),
    ] = None,
    strict: Annotated[bool, typer.Option("--strict", help="an assumption is an error")] = False,
    island: Annotated[
        str | None, typer.Option("--island", metavar="BUS|all", help="island to keep (else the largest)")
    ] = None,
    converters: Annotated[
        str,
        typer.Option(
            "--converters",
            metavar="model|current",
            help="model converters, or use currents for them and units without data",
        ),
    ] = "model",
    dc_lines: Annotated[
        str, typer.Option("--dc-lines", metavar="model|power", help="model dc lines, or use constant powers")
    ] = "model",
    coordinates: Annotated[
        Path | None,
        typer.Option(
            "--coordinates", metavar="CSV", help="bus, latitude, longitude", callback=naming("text")
        ),
    ] = None,
    release_limits: Annotated[
        bool, typer.Option("--release-limits", help="widen limits beyond which controls would start")
    ] = False,
    device: Annotated[
        list[str] | None,
        typer.Option("--device", metavar="FILE.toml", help="user-defined device, for records of its name"),
    ] = None,
    leave_out: Annotated[
        str, typer.Option("--leave-out", metavar="MODEL,...", help="models of the DYR to ignore")
    ] = "",
    replace: Annotated[
        list[str] | None,
        typer.Option("--replace", metavar="MODEL=MODEL", help="read records of a model as another's"),
    ] = None,
    json_: Annotated[
        bool, typer.Option("--json", help="print what was read, assumed and dropped as JSON")
    ] = False,
) -> None:
    """Read a grid, solve its power flow, write a case file; print what was read, assumed and dropped."""
    from interarea.models.importers.published import require_grid

    from .destination import file_for
    from .terminal import busy

    file_for(out, suffix=".toml")
    require_grid(grid)  # before what takes a second to load
    from interarea.cosim.run.artefacts import growth_at_rest
    from interarea.fmu_build.write.cache import default_cache
    from interarea.models.case.write_toml import export_toml
    from interarea.models.importers.file import import_grid as read_grid
    from interarea.models.importers.imported import ImportOptions

    options = ImportOptions(
        frequency_hz=frequency,
        P_exponent=P_exponent,
        Q_exponent=Q_exponent,
        strict=strict,
        island=int(island) if island is not None and island.isdecimal() else island,
        converters=converters,
        dc_lines=dc_lines,
        coordinates=coordinates,
        release_limits=release_limits,
        devices=device or (),
        leave_out=[name for name in leave_out.split(",") if name.strip()],
        replace=_pairs(replace or []),
    )
    imported = read_grid(grid, dyr, options)
    out.parent.mkdir(parents=True, exist_ok=True)
    export_toml(imported.case, out)
    with busy(f"eigenvalues of {imported.case.name}"):
        growth = growth_at_rest(imported.case, default_cache())
    if json_:
        verdict = {"growth": None if growth is None else growth.as_dict()}
        typer.echo(json.dumps({"file": str(out), **verdict, **imported.report.as_dict()}, indent=2))
        return
    typer.echo(out)
    typer.echo(imported.report.text(), err=True)
    if growth is not None:
        typer.echo(f"at the equilibrium: {growth.text}", err=True)


def _pairs(texts: list[str]) -> dict[str, str]:
    """The models of options MODEL=MODEL."""
    from interarea.models.errors import CaseError

    pairs = [text.split("=") for text in texts]
    for text, parts in zip(texts, pairs, strict=True):
        if len(parts) != 2 or not all(part.strip() for part in parts):
            raise CaseError(f"--replace {text!r}, allowed: MODEL=MODEL, such as WSIEG1=IEEEG1")
    return {parts[0]: parts[1] for parts in pairs}


def export(
    case: CaseName,
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help=".toml, .raw (PSS/E 33) or .m (MATPOWER)", show_default=False
        ),
    ],
    tie_flow: Annotated[
        float, typer.Option("--tie-flow", metavar="MW", help="load moved across the tie")
    ] = 0.0,
    circuit_out: Annotated[
        list[str] | None, typer.Option("--circuit-out", metavar="BRANCH", help="branch out of service")
    ] = None,
    load_scale: Annotated[float, typer.Option("--load-scale", metavar="FACTOR", help="on every load")] = 1.0,
    json_: Annotated[
        bool, typer.Option("--json", help="print the files and the omitted content as JSON")
    ] = False,
) -> None:
    """Write a case, at any operating point, as one file; list what its format cannot represent."""
    from interarea.models.case.case import load_case
    from interarea.models.case.variants import operating_variant
    from interarea.models.case.write_toml import export_toml
    from interarea.models.errors import CaseError
    from interarea.models.exporters.dyr import dyr_of
    from interarea.models.exporters.matpower import matpower_of
    from interarea.models.exporters.raw import raw_of
    from interarea.models.files import together, write_whole
    from interarea.models.grid.powerflow import solve_powerflow

    from .destination import file_for

    file_for(out)
    loaded = load_case(case)
    if tie_flow or circuit_out or load_scale != 1.0:
        loaded = operating_variant(loaded, tie_flow_mw=tie_flow, out=circuit_out or (), load_scale=load_scale)
    flow = solve_powerflow(loaded)
    suffix = out.suffix.lower()
    if suffix not in (".toml", ".raw", ".m"):
        raise CaseError(f"--out {out}: suffix {out.suffix!r}, allowed: .toml, .raw (PSS/E 33), .m (MATPOWER)")
    out.parent.mkdir(parents=True, exist_ok=True)
    if suffix == ".toml":
        export_toml(loaded, out)
        _tell({out: ()}, json_)
        return
    written = [(out, raw_of(loaded, flow) if suffix == ".raw" else matpower_of(loaded, flow))]
    if suffix == ".raw" and any(m.model != "power_flow" for m in loaded.machines):
        written.append((out.with_suffix(".dyr"), dyr_of(loaded)))
    with together():
        for path, content in written:
            write_whole(path, content.text)
    _tell({path: content.losses for path, content in written}, json_)


def grid_of(name: str, dyr: Path | None = None) -> tuple[Case, list[str]] | None:
    """Return the grid that a word of the command line means, and what was assumed; None where it means none.

    A bundled case, a TOML file with buses, a grid file of another program, or a grid that is downloaded.

    Raises
    ------
    CaseError : a grid that cannot be read or whose controls cannot rest, or `dyr` for one that takes none.
    """
    from interarea.models.errors import CaseError

    if not names_grid(name, dyr):
        return None
    if _is_case(name):
        from interarea.models.case.case import load_case

        return load_case(name), []
    from interarea.models.importers.file import import_grid as read_grid

    imported = read_grid(name, dyr=dyr)
    if imported.unrest:
        source = name if dyr is None else f"{name} --dyr {dyr}"
        raise CaseError(
            f"{name}: {len(imported.unrest)} controls have no equilibrium (first: {imported.unrest[0]}); "
            f"`interarea import {source} --release-limits --out grid.toml` widens their limits, then give "
            "grid.toml instead"
        )
    return imported.case, imported.report.text().splitlines()


def names_grid(name: str, dyr: Path | None = None) -> bool:
    """Whether a word of the command line means a grid, told before what reads one is loaded.

    Raises
    ------
    CaseError : a grid file that is not there, or `dyr` for a grid that takes none.
    """
    from interarea.models.errors import CaseError
    from interarea.models.importers.published import PUBLISHED, require_grid

    if _is_case(name):
        if dyr is not None:
            raise CaseError(f"--dyr {dyr}: needs a RAW file, not the case {name}")
        return True
    suffixes = {suffix.lower() for suffix in Path(name).suffixes}
    if name not in PUBLISHED and not suffixes & {".raw", ".rawx", ".m"}:
        if dyr is not None:
            raise CaseError(f"--dyr {dyr}: needs a RAW file, not {name}")
        return False
    require_grid(name)
    return True


def _is_case(name: str) -> bool:
    """Whether a word is a bundled case or a TOML file with a grid; other mistakes are for its own reader."""
    from interarea.models.case.document import case_names

    return name in case_names() or bool({"buses", "base"} & _keys_of(Path(name)))


def is_grid_study(path: Path) -> bool:
    """Whether a TOML file holds the study of a grid: by keys of no other file, `grid` may be missing."""
    return bool({"grid", "minutes", "latencies_ms", "given_away", "most_actuators"} & _keys_of(path))


def _keys_of(path: Path) -> set[str]:
    from interarea.models.documents import DocumentError, parse_toml, read_document

    if path.suffix != ".toml" or not path.is_file():
        return set()
    try:
        return set(parse_toml(read_document(path, "a case file")))
    except DocumentError:
        return set()


def _tell(written: Mapping[Path, Sequence[str]], as_json: bool) -> None:
    """Print the files that were written, and what each of them cannot represent."""
    if as_json:
        files = [{"file": str(path), "not_in_it": list(losses)} for path, losses in written.items()]
        typer.echo(json.dumps({"files": files}, indent=2))
        return
    for path, losses in written.items():
        typer.echo(path)
        for loss in losses:
            typer.echo(f"not in {path.name}: {loss}", err=True)
