"""The page documentation/index.html of an FMU: ports, equations as the C states them, variables, sources."""

from __future__ import annotations

import functools
import hashlib
import html
import importlib.util
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import jinja2

from interarea.models.blocks.variables import Block, Role, Variable

from .description_xml import SI_UNITS, product_version
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
    equations = {}
    for name in sorted(set(sources) - _layer(), key=lambda n: (not n.endswith("_c.h"), n)):
        comments = [_plain(c) for c in _COMMENT.findall(sources[name].decode("utf-8"))]
        retained = [c for c in comments if _EQUATION.search(c)]
        if retained:
            equations[name] = "\n\n".join(retained)
    return equations


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
    bibliography = {}
    for key, body in _ENTRY.findall(file.read_text(encoding="utf-8")):
        fields = {k: re.sub(r"[{}]", "", v) for k, v in _FIELD.findall(body)}
        where = next(
            (fields[k] for k in ("journal", "publisher", "school", "institution") if k in fields), ""
        )
        parts = (fields.get("author", ""), fields.get("title", ""), where, fields.get("year", ""))
        bibliography[key] = ". ".join(p for p in parts if p) + "."
    return bibliography


@functools.cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(_TEMPLATES), autoescape=True)
    return environment.get_template("documentation.html")


_MOST = 4  #: ports of one kind that are drawn one by one
_ROW, _CHARACTER, _EDGE = 22, 7.2, 14


def ports_picture(block: Block) -> str:
    """Return the SVG; many ports of one kind (`G1_dw`, `G2_dw`, ...) share a line with their number.

    Colours are the reader's; the list of all ports is the table of variables.
    """
    ports = [_ports(block, "input"), _ports(block, "output")]
    sides = [_lines(side) for side in ports]
    wide = [max((len(text) for text in side), default=0) * _CHARACTER for side in sides]
    left, box = wide[0] + 2 * _EDGE, max(140.0, len(block.name) * 8.4 + 2 * _EDGE)
    height = _ROW * max(len(side) for side in sides) + 2 * _EDGE
    height = max(height, 3 * _ROW)
    parts = [
        f'<rect x="{left:g}" y="1" width="{box:g}" height="{height - 2:g}" rx="6" fill="none" '
        'stroke="currentColor"/>',
        f'<text x="{left + box / 2:g}" y="{height / 2 + 5:g}" text-anchor="middle" font-weight="600">'
        f"{html.escape(block.name)}</text>",
    ]
    for side, (texts, anchor) in enumerate(zip(sides, ("end", "start"), strict=True)):
        edge = left + side * box
        out = edge + (_EDGE if side else -_EDGE)
        first = (height - _ROW * (len(texts) - 1)) / 2
        for k, text in enumerate(texts):
            y = first + _ROW * k
            tip = edge if not side else out
            parts.append(f'<path d="M{min(edge, out):g} {y:g}H{max(edge, out):g}" stroke="currentColor"/>')
            parts.append(f'<path d="M{tip:g} {y:g}l-6 -4v8z" fill="currentColor"/>')
            at = out + (4 if side else -4)
            parts.append(f'<text x="{at:g}" y="{y + 4:g}" text-anchor="{anchor}">{html.escape(text)}</text>')
    width = left + box + wide[1] + 2 * _EDGE
    title = f"{block.name}: {len(ports[0])} inputs, {len(ports[1])} outputs"
    return (
        f'<svg role="img" viewBox="0 0 {width:g} {height:g}" width="{width:g}" style="max-width:100%" '
        f'font-family="monospace" font-size="12" fill="currentColor">'
        f"<title>{html.escape(title)}</title>{''.join(parts)}</svg>"
    )


def _ports(block: Block, role: Role) -> tuple[Variable, ...]:
    return (*block.table.of_role(role), *block.table.of_role(role, integers=True))


def _lines(ports: Iterable[Variable]) -> list[str]:
    """One line for each port, or for each kind of ports where there are many."""
    kinds: dict[tuple[str, str], list[Variable]] = {}
    for port in ports:
        kind = port.name.rpartition("_")[2] if "_" in port.name else port.name.rstrip("0123456789")
        kinds.setdefault((kind, _unit(port)), []).append(port)
    rows = []
    for (_, unit), members in kinds.items():
        if len(members) <= _MOST:
            rows += [f"{port.name}{unit}" for port in members]
        else:
            rows.append(f"{members[0].name} … {members[-1].name}{unit}, {len(members)} ports")
    return rows


def _unit(port: Variable) -> str:
    if port.type != "Real":
        return f" ({port.type})"
    return "" if port.unit in ("", "1") else f" ({port.unit})"
