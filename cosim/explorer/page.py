"""The page: one HTML file with data, WebAssembly, worker, drawing and style in it."""

from __future__ import annotations

import base64
import html
import json
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.description_xml import product_version
from interarea.models.errors import InterareaError
from interarea.models.files import write_whole

from ..errors import machine_error
from ..scenario.scenario import Scenario
from .address import link_of
from .content import content_of
from .models import GUID, models_of
from .picture import picture_of
from .presets import presets_of
from .subject import Subject, subject_of
from .wasm import container_wasm

_WEB = Path(__file__).resolve().parent / "web"
_SHARED = ("settings.js", "verdict.js")  #: by page and worker
_WORKER = ("eigenvalues.js", "judge.js", "worker.js")
_AFTER = re.compile(r"\s+/\*[^*]*\*/$")  #: a comment behind code
_TIGHT = re.compile(r"([:;,{}])\s+|\s+(?=\{)")  #: spaces and ends of lines that a style sheet does without
_OPERATOR = re.compile(r" (=>|[=!]==|&&|\|\|) ")  #: what no text of the scripts holds
_SPACED = re.compile(r" (=) |(,) ")  #: in lines without text and patterns; no text has two lines
_TEXT = frozenset("'\"`/")
_KEYWORD = re.compile(r"^(if|for|while) \(")
_BRACE = re.compile(r"(\)|=>) \{$")  #: what opens a block at the end of a line
_OPEN = re.compile(r"([{,])\n")  #: behind what no statement ends with
_STRICT = "'use strict';"
_PAGE = ("link.js", "plots.js", "diagram.js", "controls.js", "page.js")


def write_explorer(source: str | Path | Scenario, path: str | Path, *, cache: Path) -> Path:
    """Write the page of a scenario or case as one file that needs nothing besides it; return its path.

    source : a `Scenario`, or the bundled name or file of a scenario or case.
    cache : folder of FMUs and designs.

    Raises
    ------
    ScenarioError : a scenario that one container cannot hold; the part is named.
    CaseError, BuildError : as in building its FMUs.
    """
    return write_whole(Path(path), explorer_page(subject_of(source, cache)).encode("utf-8"))


def write_where_held(scenario: Callable[[], Scenario], path: Path, cache: Path) -> tuple[Subject | None, str]:
    """Write the page of a scenario; return what it is about and "", or None and why no page holds it.

    Raises
    ------
    DestinationError, BuildError : an error of the machine.
    """
    try:
        subject = subject_of(scenario(), cache)
        write_whole(path, explorer_page(subject).encode("utf-8"))
    except InterareaError as error:
        if machine_error(error) is not None:
            raise
        return None, str(error)
    return subject, ""


def write_linked_explorer(
    source: str | Path | Scenario, path: Path, *, cache: Path, own: Mapping[str, Controller]
) -> list[dict[str, str]]:
    """Write the page; return label and address, relative to its folder, of each preset.

    own : controllers in place of those of these names.
    """
    subject = subject_of(source, cache, own)
    data, parts = page_data(subject)
    write_whole(path, explorer_page(subject, data, parts).encode("utf-8"))
    return [{"label": p["label"], "href": path.name + link_of(p["state"])} for p in data["presets"]]


def explorer_page(
    subject: Subject, data: dict[str, Any] | None = None, parts: list[bytes] | None = None
) -> str:
    """Return the page's text; `data` and `parts`: of `page_data`, where it was called before."""
    if data is None or parts is None:
        data, parts = page_data(subject)
    worker = _script(_WORKER)
    blob = as_text(packed(data, [worker.encode(), container_wasm(subject.cache, case=subject.case), *parts]))
    name = subject.scenario.title or subject.case.title or subject.case.name
    text = _compact(_read("page.html"))
    fields = {
        "title": html.escape(f"{name} – interarea explorer"),
        "style": _TIGHT.sub(r"\1", _compact(_read("style.css"))).replace(";}", "}"),
        "picture": picture_of(subject),
        "blob": blob,
        "shared": _script(_SHARED),
        "script": _script(_PAGE),
    }
    for key, value in fields.items():
        text = text.replace("{{" + key + "}}", value)
    return text


def page_data(subject: Subject) -> tuple[dict[str, Any], list[bytes]]:
    """Return what the page knows, as JSON values, and the records of its models."""
    models, parts = models_of(subject)
    data = content_of(subject)
    data |= {"guid": GUID, "models": models, "product": product_version()}
    return data | {"presets": presets_of(subject, data)}, parts


def packed(data: dict[str, Any], parts: list[bytes]) -> bytes:
    """Return data and parts as one gzip stream, which `unpack` of page.js reads.

    u32 number of pieces, u32 length of each, then the pieces: data as JSON, and the parts.
    """
    pieces = [json.dumps(data, separators=(",", ":"), allow_nan=False).encode("utf-8"), *parts]
    lengths = b"".join(len(p).to_bytes(4, "little") for p in pieces)
    # gzip; short blocks suit pieces of unlike kinds: 1.3 kB less than by the default of 8
    stream = zlib.compressobj(9, zlib.DEFLATED, 16 + zlib.MAX_WBITS, memLevel=5)
    return stream.compress(len(pieces).to_bytes(4, "little") + lengths + b"".join(pieces)) + stream.flush()


def as_text(data: bytes) -> str:
    """Return bytes as digits of base 85 that mean nothing in HTML; `bytesOf` of page.js reads them."""
    return base64.b85encode(data).decode("ascii").translate(str.maketrans("<&", ",."))


def _read(name: str) -> str:
    return (_WEB / name).read_text(encoding="utf-8")


def _script(names: Sequence[str]) -> str:
    """Return files as one script, which is strict once."""
    first, *others = (_compact(_read(name)) for name in names)
    whole = "\n".join([first, *(text.removeprefix(f"{_STRICT}\n") for text in others)])
    return _OPEN.sub(r"\1", whole)


def _compact(text: str) -> str:
    """Without indents, blank lines, comments on their own and at ends of lines: what no browser needs."""
    lines: list[str] = []
    comment = False
    for line in (raw.strip() for raw in text.splitlines()):
        if comment or line.startswith("/*"):
            comment = "*/" not in line
        elif line:
            line = _KEYWORD.sub(r"\1(", _BRACE.sub(r"\1{", _AFTER.sub("", line)))
            line = _OPERATOR.sub(r"\1", line)
            lines.append(_SPACED.sub(r"\1\2", line) if _TEXT.isdisjoint(line) else line)
    return "\n".join(lines)
