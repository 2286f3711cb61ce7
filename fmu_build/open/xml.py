"""Read XML that may be hostile, and hold it against a schema.

A file with a DOCTYPE is refused before any tree is built: no FMI or SSP file
needs one, and every entity expansion and external reference begins with it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.parsers import expat

from ..finding import Report

MOST_BYTES = 256 << 20


class _Refused(Exception):
    pass


def read_xml(file: Path, where: str, report: Report) -> Any | None:
    """Return the root element of `file`, or None with a finding that says why not."""
    size = file.stat().st_size
    if size > MOST_BYTES:
        report.add("XML", where, f"has {size} bytes, at most {MOST_BYTES} are read", "write a smaller file")
        return None
    return parse_xml(file.read_bytes(), where, report)


def parse_xml(content: bytes, where: str, report: Report) -> Any | None:
    """Return the root element of a file's content, or None with a finding that says why not."""
    from lxml import etree

    try:
        _refuse_doctype(content)
    except _Refused:
        report.add("XML", where, "has a DOCTYPE (entities could expand without bound)", "remove the DOCTYPE")
        return None
    except expat.ExpatError as error:
        if error.code == expat.errors.codes[expat.errors.XML_ERROR_NO_MEMORY]:
            raise MemoryError from error
        report.add("XML", where, f"is not well-formed: {error}", "correct the XML")
        return None
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        return etree.fromstring(content, parser)
    except etree.XMLSyntaxError as error:
        report.add("XML", where, f"is not well-formed: {error}", "correct the XML")
        return None


def _refuse_doctype(content: bytes) -> None:
    def refuse(*_: object) -> None:
        raise _Refused

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.Parse(content, True)


def _schema_file(name: str) -> Path:
    """Schema `name`, a path below fmpy's package folder; fmpy ships the standards' files."""
    import fmpy

    return Path(fmpy.__file__).parent / name


@functools.cache
def _schema(name: str) -> Callable[[Any], list[tuple[int, str]]]:
    """Return what tells every violation with its line; XSD 1.1 is beyond lxml."""
    from lxml import etree

    file = _schema_file(name)
    if b'minVersion="1.1"' in file.read_bytes():
        import xmlschema

        newer = xmlschema.XMLSchema11(str(file), allow="local")
        return lambda root: [(e.sourceline or 0, str(e.reason)) for e in newer.iter_errors(root)]
    schema = etree.XMLSchema(etree.parse(str(file)))

    def violations(root: Any) -> list[tuple[int, str]]:
        schema.validate(root)
        return [(e.line, e.message) for e in schema.error_log]

    return violations


def obeys_schema(root: Any, schema: str, where: str, report: Report) -> bool:
    """Return whether `root` is valid; each violation becomes a finding with its line."""
    violations = _schema(schema)(root)
    for line, message in violations:
        report.add(
            f"XSD {Path(schema).name}",
            f"{where}:{line}",
            message,
            "write what the schema allows at this place",
        )
    return not violations
