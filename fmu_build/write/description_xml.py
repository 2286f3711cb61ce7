"""Render a block as modelDescription.xml [FMI2] and as the record `resources/model.bin`."""

from __future__ import annotations

import functools
import hashlib
import math
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version

import numpy as np
import numpy.typing as npt

from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.variables import STEP_PARAMETER, Block, Enumeration, Variable

RECORD_FORMAT = 1  #: read by c/placement.c

#: parameters that the initial unknowns list altogether
MOST_DEPENDENCIES = 2_000_000

_SET_NEVER, _SET_START, _SET_ANY_TIME = 0, 1, 2
_INTEGER_TYPES = {"Integer": 0, "Boolean": 1, "Enumeration": 2}

#: unit -> (SI base unit attributes, display units as name -> factor)
SI_UNITS: dict[str, tuple[dict[str, str], dict[str, float]]] = {
    "1": ({}, {}),
    "pu": ({}, {}),
    "pu/s": ({"s": "-1"}, {}),
    "s": ({"s": "1"}, {"ms": 1000.0}),
    "1/s": ({"s": "-1"}, {}),
    "rad": ({"rad": "1"}, {"deg": 180.0 / math.pi}),
    "rad/s": ({"rad": "1", "s": "-1"}, {"Hz": 1.0 / (2.0 * math.pi)}),
    "rad/s2": ({"rad": "1", "s": "-2"}, {}),
    "Hz": ({"s": "-1"}, {}),
    "Hz/s": ({"s": "-2"}, {}),
    "deg": ({"rad": "1", "factor": repr(math.pi / 180.0)}, {}),
}

_LOG_CATEGORIES = {
    "logEvents": "Time events and outages",
    "logStatusWarning": "Results that need attention",
    "logStatusDiscard": "Steps that could not be computed",
    "logStatusError": "Errors; these are reported even when logging is off",
    "logStatusFatal": "Fatal errors",
    "logAll": "All messages",
}


@functools.cache
def product_version() -> str:
    """Return the version of this distribution, or "0" when it runs uninstalled."""
    try:
        return version("interarea")
    except PackageNotFoundError:
        return "0"


def render(block: Block, sources: Mapping[str, bytes]) -> tuple[str, bytes]:
    """Return the text of modelDescription.xml and the bytes of resources/model.bin.

    Both carry the same GUID, a hash of all they contain and of the C sources,
    so the same block gives the same bytes on every machine.

    Parameters
    ----------
    sources : C files by name, as listed in the description's ``SourceFiles``.

    Raises
    ------
    ValueError : a block whose data uses a name that the builder writes itself.
    """
    entries = record_entries(block)
    c_files = sorted(name for name in sources if name.endswith(".c"))
    blank = _description(block, "", c_files)
    digest = hashlib.sha256(pack_record(entries) + blank.encode("utf-8"))
    for name in sorted(sources):
        digest.update(name.encode() + b"\0" + sources[name])
    h = digest.hexdigest()
    guid = f"{{{h[:8]}-{h[8:12]}-{h[12:16]}-{h[16:20]}-{h[20:32]}}}"
    description = blank.replace(' guid=""', f' guid="{guid}"', 1)
    return description, pack_record({"guid": guid.encode("ascii") + b"\0", **entries})


def record_entries(block: Block) -> dict[str, npt.ArrayLike | bytes]:
    """Return what resources/model.bin holds besides the GUID: tables of the FMI layer, the block's data.

    Raises
    ------
    ValueError : a block whose data uses a name that the builder writes itself.
    """
    return {**_tables(block), **_guarded(block)}


def _guarded(block: Block) -> dict[str, npt.ArrayLike | bytes]:
    own = set(_tables(block)) | {"guid"}
    taken = sorted(own & set(block.data))
    if taken:
        raise ValueError(f"block {block.name}: data entries {taken} are written by the builder; rename them")
    return dict(block.data)


def _tables(block: Block) -> dict[str, npt.ArrayLike | bytes]:
    """Entries of the record that the FMI layer reads."""
    table = block.table
    reals, integers = table.reals, table.integers
    step = [table.value_reference(STEP_PARAMETER)] if STEP_PARAMETER in table else []
    chosen: dict[str, npt.ArrayLike | bytes] = {}
    if step:
        chosen["internal_step.parameter"] = np.array(step, dtype=np.int32)
    return chosen | {
        "format": np.array([RECORD_FORMAT], dtype=np.int32),
        "layout": table.layout(),
        "internal_step": np.array([block.longest_step_s], dtype=np.float64),
        "start.real": table.start_reals(),
        "min.real": np.array([_bound(v, v.min, -np.inf) for v in reals], dtype=np.float64),
        "max.real": np.array([_bound(v, v.max, np.inf) for v in reals], dtype=np.float64),
        "flags.real": np.array([_flag(v) for v in reals], dtype=np.int32),
        "nominal.x": np.array(
            [1.0 if v.nominal is None else v.nominal for v in table.of_role("state")], dtype=np.float64
        ),
        "start.integer": table.start_integers(),
        "min.integer": np.array([integer_range(v)[0] for v in integers], dtype=np.int32),
        "max.integer": np.array([integer_range(v)[1] for v in integers], dtype=np.int32),
        "flags.integer": np.array([_flag(v) for v in integers], dtype=np.int32),
        "type.integer": np.array([_INTEGER_TYPES[v.type] for v in integers], dtype=np.int32),
        "names.real": b"".join(v.name.encode("utf-8") + b"\0" for v in reals),
        "names.integer": b"".join(v.name.encode("utf-8") + b"\0" for v in integers),
    }


def _bound(v: Variable, value: float | None, free: float) -> float:
    """Range that the binary enforces: that of parameters; an input may pass its usual range."""
    return free if value is None or v.role != "parameter" else float(value)


def _flag(v: Variable) -> int:
    if v.role == "input" or (v.role == "parameter" and v.tunable):
        return _SET_ANY_TIME
    return _SET_START if v.role in ("state", "parameter") else _SET_NEVER


def integer_range(v: Variable) -> tuple[int, int]:
    if v.enumeration is not None:
        values = [item[1] for item in v.enumeration.items]
        return min(values), max(values)
    low = -(2**31) if v.min is None else int(v.min)
    high = 2**31 - 1 if v.max is None else int(v.max)
    return low, high


def _description(block: Block, guid: str, c_files: list[str]) -> str:
    """Text of modelDescription.xml."""
    capabilities = {
        "modelIdentifier": block.name,
        "canGetAndSetFMUstate": True,
        "canSerializeFMUstate": True,
        "providesDirectionalDerivative": True,
    }
    files = [
        "    <SourceFiles>",
        *(f"      <File{attributes({'name': f})}/>" for f in c_files),
        "    </SourceFiles>",
    ]
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        "<fmiModelDescription"
        + attributes(
            {
                "fmiVersion": "2.0",
                "modelName": block.name,
                "guid": guid,
                "description": block.description,
                "author": "The interarea developers",
                "version": product_version(),
                "copyright": "Copyright (c) The interarea developers",
                "license": "BSD-3-Clause; see documentation/licenses",
                "generationTool": f"interarea {product_version()}",
                "variableNamingConvention": "structured",
                "numberOfEventIndicators": block.event_indicators,
            }
        )
        + ">",
    ]
    if block.model_exchange:
        exchange = {**capabilities, "completedIntegratorStepNotNeeded": True}
        lines += [f"  <ModelExchange{attributes(exchange)}>", *files, "  </ModelExchange>"]
    co_simulation = {
        **capabilities,
        "canHandleVariableCommunicationStepSize": True,
        "canInterpolateInputs": True,
        "maxOutputDerivativeOrder": 1,
    }
    lines += [f"  <CoSimulation{attributes(co_simulation)}>", *files, "  </CoSimulation>"]
    lines += _units(block) + _types(block)
    lines.append("  <LogCategories>")
    lines += [
        f"    <Category{attributes({'name': k, 'description': d})}/>" for k, d in _LOG_CATEGORIES.items()
    ]
    lines.append("  </LogCategories>")
    experiment = {"startTime": 0.0, "stopTime": block.stop_s, "tolerance": 1e-6, "stepSize": block.step_s}
    lines.append(f"  <DefaultExperiment{attributes(experiment)}/>")
    lines += _variables(block) + _structure(block)
    lines.append("</fmiModelDescription>")
    return "\n".join(lines) + "\n"


def _units(block: Block) -> list[str]:
    used = {v.unit for v in block.table.reals}
    lines = ["  <UnitDefinitions>"]
    for unit, (base, display) in SI_UNITS.items():
        if unit not in used:
            continue
        lines.append(f"    <Unit{attributes({'name': unit})}>")
        lines.append(f"      <BaseUnit{attributes(base)}/>")
        lines += [f"      <DisplayUnit{attributes({'name': n, 'factor': f})}/>" for n, f in display.items()]
        lines.append("    </Unit>")
    return [*lines, "  </UnitDefinitions>"] if len(lines) > 1 else []


def _types(block: Block) -> list[str]:
    types: dict[str, Enumeration] = {}
    for v in block.table.integers:
        if v.enumeration is not None:
            types[v.enumeration.name] = v.enumeration
    if not types:
        return []
    lines = ["  <TypeDefinitions>"]
    for name, enumeration in types.items():
        lines.append(f"    <SimpleType{attributes({'name': name})}>")
        lines.append("      <Enumeration>")
        lines += [
            f"        <Item{attributes({'name': item, 'value': value, 'description': text})}/>"
            for item, value, text in enumeration.items
        ]
        lines += ["      </Enumeration>", "    </SimpleType>"]
    return [*lines, "  </TypeDefinitions>"]


def _variables(block: Block) -> list[str]:
    table = block.table
    index = {v.name: k for k, v in enumerate(table, start=1)}
    lines = ["  <ModelVariables>"]
    for k, v in enumerate(table, start=1):
        scalar: dict[str, object] = {
            "name": v.name,
            "valueReference": table.value_reference(v.name),
            "description": v.description,
            "causality": v.role if v.role in ("input", "output", "parameter") else "local",
            "variability": _variability(v),
        }
        if v.role != "input":
            scalar["initial"] = "exact" if v.role in ("state", "parameter") else "calculated"
        typed = _typed(v)
        if v.derivative_of is not None:
            typed["derivative"] = index[v.derivative_of]
        lines.append(f"    <!-- {k} -->")
        lines.append(f"    <ScalarVariable{attributes(scalar)}>")
        lines.append(f"      <{v.type}{attributes(typed)}/>")
        lines.append("    </ScalarVariable>")
    return [*lines, "  </ModelVariables>"]


def _typed(v: Variable) -> dict[str, object]:
    """What the element of a variable's type says: unit, range and start."""
    typed: dict[str, object] = {}
    if v.enumeration is not None:
        typed["declaredType"] = v.enumeration.name
    if v.type == "Real":
        typed |= {"unit": v.unit, "displayUnit": v.display_unit}
    if v.type in ("Real", "Integer"):
        number = float if v.type == "Real" else int
        typed["min"] = None if v.min is None else number(v.min)
        typed["max"] = None if v.max is None else number(v.max)
    if v.type == "Real":
        typed["nominal"] = None if v.nominal is None else float(v.nominal)
    if v.role in ("state", "parameter", "input"):
        typed["start"] = _start(v)
    return typed


def _variability(v: Variable) -> str:
    if v.role == "parameter":
        return "tunable" if v.tunable else "fixed"
    return "continuous" if v.type == "Real" else "discrete"


def _start(v: Variable) -> object:
    if v.type == "Real":
        return float(v.start if v.start is not None else 0.0)
    return bool(v.start) if v.type == "Boolean" else int(v.start or 0)


def _structure(block: Block) -> list[str]:
    """ModelStructure; initial unknowns also depend on every parameter.

    On a large grid they are not listed one by one: without a list FMI takes everything.
    """
    table = block.table
    index = {v.name: k for k, v in enumerate(table, start=1)}
    parameters = [index[v.name] for v in table if v.role == "parameter"]
    outputs = [v for v in table if v.role == "output"]
    derivatives = [v for v in table if v.role == "derivative"]

    def unknown(v: Variable, extra: Iterable[int], listed: bool) -> str:
        depends = None
        if listed and v.depends_on is not None:
            depends = " ".join(str(k) for k in sorted({*(index[n] for n in v.depends_on), *extra}))
        return f"      <Unknown{attributes({'index': index[v.name], 'dependencies': depends})}/>"

    lines = ["  <ModelStructure>"]
    for heading, unknowns, extra in (
        ("Outputs", outputs, []),
        ("Derivatives", derivatives, []),
        ("InitialUnknowns", sorted([*outputs, *derivatives], key=lambda v: index[v.name]), parameters),
    ):
        if unknowns:
            listed = len(unknowns) * len(extra) <= MOST_DEPENDENCIES
            lines += [f"    <{heading}>", *(unknown(v, extra, listed) for v in unknowns), f"    </{heading}>"]
    return [*lines, "  </ModelStructure>"]


_QUOTED = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"})


def attributes(values: Mapping[str, object]) -> str:
    """Return the XML attributes of the values that are not None, each after a space.

    Quoted as `xml.sax.saxutils.quoteattr` does it, which loads what speaks to web servers, .04 s of a run.

    >>> attributes({"name": "a<b", "unit": None, "start": 0.1, "fixed": True})
    ' name="a&lt;b" start="0.1" fixed="true"'
    """
    return "".join(f" {name}={_quoted(_text(v))}" for name, v in values.items() if v is not None)


def _quoted(text: str) -> str:
    quoted = text.translate(_QUOTED)
    return f"'{quoted}'" if '"' in text and "'" not in text else '"' + quoted.replace('"', "&quot;") + '"'


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)
