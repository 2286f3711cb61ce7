"""Commands `new` and `show`: a commented file to start from, and the text of what is bundled."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from interarea.models.errors import UserError, nearest

from .destination import file_for
from .listing import DESIGNED, bundled_files
from .terminal import note

TEMPLATES = Path(__file__).resolve().parents[1] / "templates"
SCHEMAS = TEMPLATES.with_name("schemas")


def new(
    kind: Annotated[
        str, typer.Argument(metavar="KIND", help="scenario, case, controller, design, sweep or test")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="file to write", show_default=False)],
) -> None:
    """Write a commented file that runs: scenario, case, controller, design, sweep or test."""
    there = {file.name.partition(".")[0]: file for file in TEMPLATES.iterdir()}
    if kind not in there:
        raise UserError(f"new {kind}: no such kind of file; {nearest(kind, sorted(there))}")
    source = there[kind]
    suffix = f".{source.name.split('.')[1]}"  # test.py.txt: no module of the package
    if out.suffix != suffix:
        raise UserError(f"--out {out}: a {kind} is a {suffix} file, allowed: a name that ends so")
    if file_for(out).exists():
        raise UserError(f"--out {out}: is there already, allowed: a new file")
    text = source.read_text(encoding="utf-8")
    if suffix == ".toml":  # the line by which editors complete and check
        text = f"#:schema {(SCHEMAS / f'{kind}.json').as_uri()}\n{text}"
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(text, encoding="utf-8")
    typer.echo(out)


def show(
    name: Annotated[str, typer.Argument(metavar="NAME", help="a name that `interarea list` shows")],
    json_: Annotated[bool, typer.Option("--json", help="print kind, file and text as JSON")] = False,
) -> None:
    """Print a bundled case, scenario, controller, design or study as its file has it, with its source."""
    kind, _, short = name.rpartition("/")
    files = bundled_files()
    found = [(k, rows[short]) for k, rows in files.items() if short in rows and kind in ("", k)]
    if not found and short in DESIGNED:
        typer.echo(
            json.dumps({"kind": "controllers", "about": DESIGNED[short]}) if json_ else DESIGNED[short]
        )
        return
    if not found:
        known = [*DESIGNED, *(n for rows in files.values() for n in rows)]
        raise UserError(f"show {name}: nothing bundled has this name; {nearest(name, known)}")
    texts = [{"kind": k, "file": str(file), "text": file.read_text(encoding="utf-8")} for k, file in found]
    if json_:
        typer.echo(json.dumps(texts, indent=2))
        return
    for row in texts:
        note(f"{row['kind']}: {row['file']}")
        typer.echo(row["text"].rstrip())
