"""The page documentation/index.html of an FMU: equations as the C states them, variables, provenance."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import jinja2

from interarea.models.blocks.variables import Block

from .description_xml import SI_UNITS, product_version
from .ports_picture import ports_picture
from .sources import fmi_headers, fmi_sources

_TEMPLATES = Path(__file__).resolve().parent / "templates"
_COMMENT = re.compile(r"^/\*(.*?)\*/", re.DOTALL | re.MULTILINE)
_EQUATION = re.compile(r"^    .*[=<>]", re.MULTILINE)
_CITED = re.compile(r"\b([A-Z][A-Za-z]+(?:19|20)\d\d)\b|\b(FMI2|TR18)\b")
_ENTRY = re.compile(r"@\w+\{(\w+),(.*?)^\}", re.DOTALL | re.MULTILINE)
_FIELD = re.compile(r"(\w+)\s*=\s*\{(.*?)\},?\s*$", re.MULTILINE)


def documentation(block: Block, sources: Mapping[str, bytes], platforms: Iterable[str]) -> str:
    """Return the page of a block.

    The equations are the comments above the C functions that compute them, so they
    cannot differ from what runs; the works they cite are listed from the bibliography.

    Parameters
    ----------
    sources : C files and headers of the binary by name (`compile.source_files`).
    platforms : names of the platforms that binaries are there for.
    """
    equations = equations_of(sources)
    text = " ".join((*equations.values(), *block.documentation.values(), *block.provenance.values()))
    digest = hashlib.sha256()
    for name in sorted(sources):
        digest.update(name.encode() + b"\0" + sources[name])
    return _template().render(
        block=block,
        ports=ports_picture(block),
        equations=equations,
        references=references_in(text),
        sources=sorted(sources),
        sources_hash=digest.hexdigest(),
        platforms=list(platforms),
        units={v.unit: SI_UNITS[v.unit] for v in block.table.reals},
        version=product_version(),
    )


def equations_of(sources: Mapping[str, bytes]) -> dict[str, str]:
    """Return file name -> comments with equations, of the block's own files.

    >>> equations_of({"lag.h": b"/* A lag:\\n *\\n *     T dx/dt = u - x\\n */\\n"})
    {'lag.h': 'A lag:\\n\\n    T dx/dt = u - x'}
    """
    found = {}
    for name in sorted(set(sources) - _layer(), key=lambda n: (not n.endswith("_c.h"), n)):
        comments = [_plain(c) for c in _COMMENT.findall(sources[name].decode("utf-8"))]
        kept = [c for c in comments if _EQUATION.search(c)]
        if kept:
            found[name] = "\n\n".join(kept)
    return found


def references_in(text: str) -> dict[str, str]:
    """Return key -> one-line reference of the works of the bibliography that a text cites."""
    cited = {first or second for first, second in _CITED.findall(text)}
    return {key: line for key, line in _bibliography().items() if key in cited}


@functools.cache
def _layer() -> frozenset[str]:
    """Names of the files that every FMU has: the FMI layer, the standard's headers, block.h and record."""
    files = [*fmi_sources(), *fmi_sources()[0].parent.glob("*.h"), *fmi_headers().glob("*.h")]
    return frozenset({f.name for f in files} | {"block.h", "record.h", "record.c"})


def _plain(comment: str) -> str:
    """Text of a C comment without its stars, as far to the left as it goes."""
    lines = [re.sub(r"^ \* ?", "", line).rstrip() for line in comment.strip().splitlines()]
    return "\n".join(lines).strip("\n ")


@functools.cache
def _bibliography() -> dict[str, str]:
    spec = importlib.util.find_spec("interarea.models")
    assert spec is not None and spec.submodule_search_locations
    file = Path(next(iter(spec.submodule_search_locations))) / "references.bib"
    found = {}
    for key, body in _ENTRY.findall(file.read_text(encoding="utf-8")):
        fields = {k: re.sub(r"[{}]", "", v) for k, v in _FIELD.findall(body)}
        where = next(
            (fields[k] for k in ("journal", "publisher", "school", "institution") if k in fields), ""
        )
        parts = (fields.get("author", ""), fields.get("title", ""), where, fields.get("year", ""))
        found[key] = ". ".join(p for p in parts if p) + "."
    return found


@functools.cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(_TEMPLATES), autoescape=True)
    return environment.get_template("documentation.html")
