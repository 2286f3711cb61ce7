"""Commands `new`, `show`, `device`: a file to start from, what is bundled, one device by itself."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from interarea.models.errors import UserError, nearest
from interarea.models.files import read_text, write_whole

from ..command_usage import Dyr
from .destination import file_for
from .listing import DESIGNED, bundled_files
from .terminal import FileAsJson, note, tell_file

if TYPE_CHECKING:
    from interarea.models.devices.language.structure import Model
    from interarea.models.devices.response import Response

TEMPLATES = Path(__file__).resolve().parents[1] / "templates"
SCHEMAS = TEMPLATES.with_name("schemas")


def new(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            help="scenario, case, device, controller, design, sweep, study, grid_study, claims or test",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="file to write", show_default=False)],
    grid: Annotated[
        str, typer.Argument(metavar="GRID", help="of a study: its grid", show_default=False)
    ] = "",
    dyr: Dyr = None,
    json_: FileAsJson = False,
) -> None:
    """Write a commented template: scenario, case, device, controller, design, sweep, study, ...

    The template for the study of a grid has every choice, with the defaults determined from the grid.
    """
    there = {file.name.partition(".")[0]: file for file in TEMPLATES.iterdir()}
    if kind not in there:
        raise UserError(f"new {kind}: no such kind of file; {nearest(kind, sorted(there))}")
    source = there[kind]
    suffix = f".{source.name.split('.')[1]}"  # the name of a template of Python ends in .py.txt
    if out.suffix != suffix:
        raise UserError(f"--out {out}: a {kind} is a {suffix} file, allowed: a name with this suffix")
    if file_for(out).exists():
        raise UserError(f"--out {out}: exists already, allowed: a new file")
    if dyr is not None and not grid:
        raise UserError(f"--dyr {dyr}: needs its grid, wanted: `new study GRID --dyr FILE`")
    if grid:
        text = _grid_study(kind, grid, dyr, out)
    else:
        text = source.read_text(encoding="utf-8")
    if suffix == ".toml":  # the line by which editors complete and check
        kind = "grid_study" if grid else kind
        text = f"#:schema {(SCHEMAS / f'{kind}.json').as_uri()}\n{text}"
    write_whole(out, text)
    tell_file(out, json_)


def _grid_study(kind: str, grid: str, dyr: Path | None, out: Path) -> str:
    """Return the file of the study of a grid, files named as seen from where it will be."""
    from .grids import grid_of
    from .terminal import busy

    with busy(f"reading {grid}"):
        loaded = grid_of(grid, dyr) if kind == "study" else None
    if loaded is None:
        raise UserError(f"new {kind} {grid}: not a grid, allowed: `new study` and a case, .raw or .m file")
    from interarea.cosim.grid_study.choices import Choices, choices_text
    from interarea.cosim.grid_study.study import defaults_of
    from interarea.fmu_build.write.cache import default_cache

    with busy(f"modes of {loaded[0].name}"):
        defaults, lines = defaults_of(loaded[0], default_cache())
    named = {"grid": _seen_from(out, grid), "dyr": None if dyr is None else _seen_from(out, str(dyr))}
    choices = Choices.model_validate({**named, **defaults})
    return choices_text(choices, lines)


def _seen_from(out: Path, name: str) -> str:
    """Return a file's name relative to the folder of `out`; any other word as it is."""
    path = Path(name)
    return os.path.relpath(path.resolve(), out.resolve().parent) if path.is_file() else name


def show(
    name: Annotated[str, typer.Argument(metavar="NAME", help="a name that `interarea list` shows")],
    json_: Annotated[bool, typer.Option("--json", help="print kind, file and text as JSON")] = False,
) -> None:
    """Print the file of a bundled case, scenario, controller, design or study, with its source."""
    kind, _, short = name.rpartition("/")
    files = bundled_files()
    result = [(k, rows[short]) for k, rows in files.items() if short in rows and kind in ("", k)]
    if not result and short in DESIGNED:
        typer.echo(
            json.dumps({"kind": "controllers", "about": DESIGNED[short]}) if json_ else DESIGNED[short]
        )
        return
    if not result:
        known = [*DESIGNED, *(n for rows in files.values() for n in rows)]
        raise UserError(f"show {name}: no bundled file has this name; {nearest(name, known)}")
    texts = [{"kind": k, "file": str(file), "text": read_text(file)} for k, file in result]
    if json_:
        typer.echo(json.dumps(texts, indent=2))
        return
    for row in texts:
        note(f"{row['kind']}: {row['file']}")
        typer.echo(row["text"].rstrip())


def device(
    file: Annotated[str, typer.Argument(metavar="DEVICE", help="device file, or a bundled device")],
    assignments: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="a parameter of the device")
    ] = None,
    at: Annotated[
        list[str] | None, typer.Option("--at", metavar="SIGNAL=VALUE", help="an input, e.g. vt=1.02")
    ] = None,
    base_mva: Annotated[float, typer.Option("--base", metavar="MVA", help="base of its machine")] = 100.0,
    stop_s: Annotated[float, typer.Option("--stop", metavar="S", help="length of the step response")] = 10.0,
    draw: Annotated[
        Path | None, typer.Option("--draw", metavar="FILE.svg", help="write the block diagram")
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="print JSON instead of text")] = False,
) -> None:
    """Show one device: diagram, equilibrium at an operating point, poles, step response."""
    if draw is not None and (file_for(draw, "--draw").suffix != ".svg"):
        raise UserError(f"--draw {draw}: the diagram is SVG, allowed: a name that ends in .svg")
    model = _model(file)
    from interarea.models.devices.drawing import diagram_svg
    from interarea.models.devices.response import missing, response_of

    parameters = _assigned("--set", assignments or [], "KA=200")
    point = _assigned("--at", at or [], "vt=1.02")
    lacking = missing(model, parameters)
    drawn = [] if draw is None else [str(write_whole(draw, diagram_svg(model.device)))]
    if lacking:
        if not json_:
            typer.echo(_described(model))
        for name in drawn:
            typer.echo(name, err=json_)
        lack = f"{model.device.name}: no value for {', '.join(lacking)}; give --set {lacking[0]}=..."
        if parameters or point or json_:
            raise UserError(lack)
        note(f"diagram only: {lack}")  # nothing was asked for that needs values
        return
    response = response_of(model, parameters, point, base_mva=base_mva, stop_s=stop_s)
    if json_:
        typer.echo(json.dumps(_document(model, response, drawn), indent=2, allow_nan=False))
        return
    typer.echo(_described(model))
    _tell(model, response)
    for name in drawn:
        typer.echo(name)


def _model(file: str) -> Model:
    """The device of a file, or of the package by its name."""
    from interarea.models.devices.language.read import device_text
    from interarea.models.devices.library import library, own_model

    if file.endswith(".toml"):
        return own_model(device_text(file), file)
    if file.lower() not in library():
        raise UserError(f"device {file}: no such file or device; {nearest(file.lower(), library())}")
    return library()[file.lower()]


def _described(model: Model) -> str:
    from interarea.models.devices.document import diagram_text

    device = model.device
    return f"{device.name}: {device.title} ({device.kind})\n{diagram_text(device)}"


def _document(model: Model, response: Response, drawn: list[str]) -> dict[str, Any]:
    """What `device` prints as JSON."""
    rest, device = response.rest, model.device
    return {
        "device": device.name,
        "title": device.title,
        "kind": device.kind,
        "states": dict(zip(rest.instance.state_names, rest.states, strict=True)),
        "references": _references(model, response),
        "signals": dict(rest.signals),
        "steps": list(rest.steps),
        "poles": [[float(p.real), float(p.imag)] for p in response.poles],
        "step": {"of": response.step[0], "size": response.step[1]},
        "times_s": response.times.tolist(),
        "output": response.output.tolist(),
        "files": drawn,
    }


def _references(model: Model, response: Response) -> dict[str, float]:
    return {name: response.rest.instance.values[name] for name in model.device.references}


def _tell(model: Model, response: Response) -> None:
    """Print rest, poles and step response in words."""
    rest = response.rest
    typer.echo("\nat rest")
    for name, value in (dict(rest.signals) | _references(model, response)).items():
        typer.echo(f"  {name} = {value:.6g}")
    for margin in rest.margins:
        typer.echo(f"  {margin.signal} within {margin.low:.4g} .. {margin.high:.4g}: {margin.least:.4g} away")
    poles = ", ".join(f"{p.real:.4g}{p.imag:+.4g}j" if p.imag else f"{p.real:.4g}" for p in response.poles)
    typer.echo(f"poles, inputs held (1/s): {poles or 'none'}")
    typer.echo(f"{model.device.output} after {response.step[0]} {response.step[1]:+g}")
    for k in range(0, len(response.times), 20):
        typer.echo(f"  {response.times[k]:8.3f} s  {response.output[k]:+.6g}")


def _assigned(option: str, texts: list[str], example: str) -> dict[str, float]:
    """Return NAME=VALUE texts as numbers by name."""
    assigned = {}
    for text in texts:
        name, sign, value = text.partition("=")
        try:
            assigned[name.strip()] = float(value)
        except ValueError:
            sign = ""
        if not sign or not math.isfinite(assigned[name.strip()]):
            raise UserError(f"{option} {text}: allowed: a name, =, a number, as {example}")
    return assigned
