"""File formats: JSON Schemas and reference pages, generated from the models that check the files."""

from __future__ import annotations

import inspect
import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, TypeAdapter

from interarea.models.documents import is_time

SCHEMAS = Path(__file__).parent / "schemas"
TEMPLATES = Path(__file__).parent / "templates"
#: unit of a key by its end
UNITS = {
    "_s": "s",
    "_per_s": "1/s",
    "_pu_per_s": "pu/s",
    "_s_per_s": "s/s",
    "_hz": "Hz",
    "_pu": "pu",
    "_mw": "MW",
    "_mva": "MVA",
    "_mvar": "Mvar",
    "_deg": "deg",
    "_rad_s": "rad/s",
    "_kv": "kV",
}
#: fields that are no keys of the file
_INNER = {"scenario": ("folder", "rounded"), "case": ("sources",)}


def kinds() -> dict[str, str]:
    """Return the kinds of files with a description of each."""
    return {
        "scenario": "a scenario: grid, controller, channels, events and their times (TOML)",
        "case": "a case: a grid with its machines, controls and loads (TOML); tables of rows are keyed by id",
        "events": "events: the `[[event]]` tables of a scenario or case",
        "design": "a design: operating points, losses, latencies and requirements (TOML)",
        "controller": "a controller as it is stored, u = +K y (JSON)",
        "device": "a device: an exciter, stabilizer, governor or compensator (TOML) that a case names",
        "sweep": "a sweep: one scenario, many values (TOML)",
        "study": "a study: one case through designs, runs, figures and a report (TOML)",
        "grid_study": "the study of a grid: requirements and choices; rules determine the others (TOML)",
        "claims": "the claims of a publication, for verdicts by a study's numbers (TOML)",
    }


def schema(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file."""
    raw = _raw(kind)
    properties = raw.get("properties", {})
    for key in _INNER.get(kind, ()):
        properties.pop(key, None)
    if kind == "case":
        from interarea.models.case.document import ROW_TABLES

        for table, own in ROW_TABLES.items():
            row = properties[table]["items"]
            fields = raw["$defs"][row["$ref"].rpartition("/")[2]]
            del fields["properties"][own]  # the key of the row is its id
            fields["required"].remove(own)
            beside = {"source": {"type": "string"}, "defaults": {"type": "object"}}
            properties[table] = {"type": "object", "properties": beside, "additionalProperties": _loose(row)}
        properties["change"] = {"type": "object", "description": "a variant: differences from `base`"}
        names = {"type": "array", "items": {"type": "string", "pattern": r"\.toml$"}}
        texts = {"type": "object", "additionalProperties": {"type": "string"}}
        properties["devices"] = {"anyOf": [names, texts]}
        properties["base"] = {"type": "string", "description": "a variant: the case that it changes"}
        raw["required"] = ["name"]
    if kind in ("scenario", "case"):
        events = _raw("events")
        raw.setdefault("$defs", {}).update(events.pop("$defs", {}))
        text = "faults, trips, pulses and steps, a table each; all are in docs/formats/events.md"
        properties["event"] = {"type": "array", "items": events, "description": text}
    if kind == "sweep":
        text = "the scenario that is varied: bundled name, a file beside this one, or its keys"
        properties["scenario"] = {"anyOf": [{"type": "string"}, {"type": "object"}], "description": text}
        del properties["base"]
        raw["required"] = ["scenario"]
        for name in [n for n in raw.get("$defs", {}) if n not in _used(raw)]:
            del raw["$defs"][name]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **raw, "title": f"interarea {kind}"}


#: a time in periods of the case's frequency
_CYCLES = {"type": "string", "pattern": "cycle|start|s$"}
#: forms of a value that a table of keys leaves out
_UNSAID = (_CYCLES, {"type": "null"})


def _allow_cycles(result: dict[str, Any]) -> None:
    """Let every time be words such as "8 cycles" or "100 ms", and the loss of a channel be a number."""
    for part in (result, *result.get("$defs", {}).values()):
        properties = part.get("properties", {})
        for key, rule in properties.items():
            if is_time(key) and "$ref" not in rule:
                about = {k: rule[k] for k in ("default", "description", "examples", "title") if k in rule}
                plain = {k: v for k, v in rule.items() if k not in about}
                forms = plain.pop("anyOf", None) or [plain]
                properties[key] = {"anyOf": [*forms, _CYCLES], **about}
        if "anyOf" in properties.get("loss", {}):
            share = {"type": "number", "minimum": 0, "maximum": 1}
            properties["loss"]["anyOf"] = [share, *properties["loss"]["anyOf"]]


def _loose(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the schema of a row: its whole form, "none", or a part that `defaults` complete."""
    return {"anyOf": [dict(row), {"const": "none"}, {"type": "object"}]}


def _used(result: Mapping[str, Any]) -> set[str]:
    text = json.dumps(result["properties"])
    names: set[str] = set()
    while more := set(re.findall(r'"#/\$defs/(\w+)"', text)) - names:
        names |= more
        text = json.dumps([result["$defs"][name] for name in more])
    return names


def _raw(kind: str) -> dict[str, Any]:
    if kind == "events":
        from interarea.models.case.events import Event

        json_schema = TypeAdapter(Event).json_schema()
    elif kind == "controller":
        return _controller_schema()
    elif kind == "device":
        from interarea.models.devices.schema import device_schema

        return device_schema()
    else:
        json_schema = _model(kind).model_json_schema(by_alias=True)
    if kind in ("scenario", "events", "study"):
        _allow_cycles(json_schema)
    return json_schema


def _model(kind: str) -> type[BaseModel]:
    if kind == "scenario":
        from interarea.cosim.scenario.scenario import Scenario

        return Scenario
    if kind == "case":
        from interarea.models.case.tables import CaseTables

        return CaseTables
    if kind == "design":
        from interarea.cosim.designs.design_file import DesignTable

        return DesignTable
    if kind == "grid_study":
        from interarea.cosim.grid_study.choices import Choices

        return Choices
    if kind in ("study", "claims"):
        from interarea.cosim.study.tables import ClaimsTable, StudyTable

        return StudyTable if kind == "study" else ClaimsTable
    from interarea.cosim.sweep.spec import Sweep

    return Sweep


def _controller_schema() -> dict[str, Any]:
    matrix = {"type": "array", "items": {"type": "array", "items": {"type": "number"}}}
    names = {"type": "array", "items": {"type": "string"}, "minItems": 1}
    text: dict[str, tuple[dict[str, Any], str]] = {
        "schema": ({"const": 1}, "version of the form"),
        "name": ({"type": "string", "pattern": r"^[A-Za-z_]\w*$"}, "a C identifier"),
        "convention": ({"type": "string"}, "for the reader: u = +K y, speeds in rad/s, actuators in pu"),
        "inputs": (names, "signals; *_dw in rad/s"),
        "outputs": (names, "actuators, pu"),
        "limit_pu": ({"type": "number", "exclusiveMinimum": 0, "default": 0.15}, "bound of every output"),
        **dict.fromkeys("ABCD", (matrix, "matrix of dx/dt = A x + B y, u = C x + D y; rows")),
        "design": ({"type": "object"}, "the design method; {} if unknown"),
        "certificate": ({"type": ["object", "null"]}, "results on the full plant"),
        "guard": ({"type": ["object", "null"], "default": None}, "limits of the output during a first swing"),
    }
    return {
        "type": "object",
        "properties": {key: {**rule, "description": words} for key, (rule, words) in text.items()},
        "required": ["name", "inputs", "outputs", "A", "B", "C", "D"],
    }


def page(kind: str) -> str:
    """Return the reference page of a kind of file: a table of keys for each of its tables."""
    result = schema(kind)
    comments, examples = _comments(kind), _examples(kind, result)
    lines = [
        f"# Every key of {'events' if kind == 'events' else f'a {kind}'.replace('_', ' ')}",
        "",
        f"For those who write {kinds()[kind]}. After this page you know every key with its unit, range, "
        "default and an example. `docs/formats/make.py` generates it from the models that check the files.",
        "",
    ]
    if kind in ("scenario", "events", "study"):
        lines += [
            'A time may be in seconds or words: `"100 ms"`, `"8 cycles"` of the case\'s frequency, '
            '`"1.0 s + 8 cycles"`, and in an event `"start + 8 cycles"`.',
            "",
        ]
    if "properties" in result:
        lines += _table("top level", result, comments, examples)
    elsewhere = _raw("events")["$defs"] if kind in ("scenario", "case", "study") else {}
    for name, part in sorted(result.get("$defs", {}).items()):
        if "properties" in part and name not in elsewhere:
            lines += _table(name, part, comments, examples)
    if kind == "device":
        from interarea.models.devices.schema import diagram_words

        lines += diagram_words()
    start = "" if kind == "events" else f" `interarea new {kind}` writes a template."
    if kind == "grid_study":
        start = " `interarea new study GRID` writes one with the defaults for a grid."
    lines += [f"Next: [the commands that use it](../generated/commands.md).{start}"]
    return "\n".join(lines).rstrip() + "\n"


def _table(
    name: str,
    part: Mapping[str, Any],
    comments: Mapping[str, str],
    examples: Mapping[str, Mapping[str, str]],
) -> Iterator[str]:
    yield f"## {name}"
    yield ""
    about = " ".join(str(part.get("description", "")).split("\n\n")[0].split())
    if about and name != "top level":
        yield from (about, "")
    yield "| key | type | unit | default | example | meaning |"
    yield "|---|---|---|---|---|---|"
    required = part.get("required", ())
    for key, rule in part["properties"].items():
        unit = next(
            (u for end, u in sorted(UNITS.items(), key=lambda p: -len(p[0])) if key.endswith(end)), ""
        )
        default = "needed" if key in required else _value(rule.get("default"))
        words = rule.get("description") or comments.get(f"{name}.{key}", "")
        if not words and "const" in rule:
            words = "the kind"
        own_examples = rule.get("examples") or ([rule["const"]] if "const" in rule else [])
        provided = [f"`{json.dumps(value)}`" for value in own_examples]
        example = examples.get(name, {}).get(key) or next(iter(provided), "")
        cells = (f"`{key}`", _holds(rule), unit, default, example, " ".join(str(words).split()))
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
    yield ""


def _value(value: Any) -> str:
    if value in (None, "", (), [], {}):
        return ""
    text = json.dumps(value)
    return f"`{text}`" if len(text) < 50 else "see there"


def _holds(rule: Mapping[str, Any]) -> str:
    if "$ref" in rule:
        return f"table {rule['$ref'].rpartition('/')[2]}"
    for form in ("anyOf", "oneOf"):
        if form in rule:
            parts = [_holds(r) for r in rule[form] if r not in _UNSAID]
            return " or ".join(dict.fromkeys(parts))
    if "const" in rule:
        return f"`{json.dumps(rule['const'])}`"
    if "enum" in rule:
        return " or ".join(f"`{json.dumps(v)}`" for v in rule["enum"])
    kind = rule.get("type", "any")
    if kind == "array":
        if "prefixItems" in rule:
            return f"[{', '.join(_holds(r) for r in rule['prefixItems'])}]"
        return f"list of {_holds(rule.get('items', {}))}"
    if kind == "object" and isinstance(rule.get("additionalProperties"), dict):
        return f"table of {_holds(rule['additionalProperties'])}"
    return f"{kind}{_span(rule)}" if isinstance(kind, str) else " or ".join(kind)


def _span(rule: Mapping[str, Any]) -> str:
    """The bounds of a number in words."""
    words = {"minimum": "from", "exclusiveMinimum": "above", "maximum": "to", "exclusiveMaximum": "below"}
    return "".join(f" {word} {rule[bound]:g}" for bound, word in words.items() if bound in rule)


def _example_files(kind: str) -> list[Mapping[str, Any]]:
    """Return the contents of the files of a kind that come along, the template first."""
    from interarea.cosim.designs import design_file
    from interarea.cosim.scenario.scenario import BUNDLED as scenarios
    from interarea.cosim.study.spec import SPECIFICATIONS
    from interarea.models import devices
    from interarea.models.case.document import BUNDLED as cases

    designs = Path(design_file.__file__).parent
    if kind == "controller":
        return [json.loads((TEMPLATES / "controller.json").read_text(encoding="utf-8"))]
    folders = {"scenario": scenarios, "events": scenarios, "case": cases, "design": designs}
    folders |= {"study": SPECIFICATIONS, "claims": SPECIFICATIONS}
    folders["device"] = Path(devices.__file__).parent
    name = "scenario" if kind == "events" else kind
    example_files = [
        TEMPLATES / f"{name}.toml",
        *(sorted(folders[kind].rglob("*.toml")) if kind in folders else ()),
    ]
    example_files.append(TEMPLATES / f"all_{name}.toml")
    return [tomllib.loads(file.read_text(encoding="utf-8")) for file in example_files if file.is_file()]


def _examples(kind: str, result: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Return table -> key -> the first short value that a bundled file gives it."""
    examples: dict[str, dict[str, str]] = {}
    defs = result.get("$defs", {})

    def visit(name: str, rule: Mapping[str, Any], data: Any) -> None:
        if "$ref" in rule:
            name = rule["$ref"].rpartition("/")[2]
            rule = defs[name]
        for form in ("anyOf", "oneOf"):
            for one in rule.get(form, ()):
                visit(name, one, data)
        if isinstance(data, list):
            for item in data:
                visit(name, rule.get("items", {}), item)
        if not isinstance(data, Mapping):
            return
        known = rule.get("properties", {})
        kinds = known.get("kind", {})
        if "const" in kinds and data.get("kind") != kinds["const"]:
            return
        for key, value in data.items():
            if key in known:
                text = json.dumps(value, ensure_ascii=False)
                if len(text) <= 60 and value not in ({}, [], ""):
                    examples.setdefault(name, {}).setdefault(key, f"`{text}`")
                visit(f"{name}.{key}", known[key], value)
            elif isinstance(rule.get("additionalProperties"), Mapping):
                visit(name, rule["additionalProperties"], value)

    for data in _example_files(kind):
        visit("top level", {"$ref": f"#/$defs/{kind}"} if kind in defs else result, data)
        if kind == "events":
            for event in data.get("event", ()):
                visit("", result, event)
    return examples


def _comments(kind: str) -> dict[str, str]:
    """Return what the `#:` comments beside the fields say, by model.field."""
    if kind in ("controller", "device"):
        return {}
    comments: dict[str, str] = {}
    for model in _models(kind):
        inherited = [c for c in model.__mro__ if c not in (BaseModel, object)]
        for owner in reversed(inherited):
            for name, words in _field_comments(owner):
                alias = getattr(getattr(model, "model_fields", {}).get(name), "alias", None)
                comments[f"{model.__name__}.{alias or name}"] = words
                if kind != "events" and model is _model(kind):
                    comments[f"top level.{name}"] = words
    return comments


def _field_comments(model: type) -> Iterator[tuple[str, str]]:
    """Yield the fields of a class with the `#:` comment that stands behind or above each."""
    before = ""
    for line in inspect.getsource(model).splitlines():
        field = re.match(r"    (\w+): .*?(?:#: (.*))?$", line)
        comment = re.match(r"    #: (.*)$", line)
        if comment:
            before = f"{before} {comment[1]}".strip()
        elif field:
            if field[2] or before:
                yield field[1], field[2] or before
            before = ""


def _models(kind: str) -> list[type]:
    """Return the models that a kind of file is checked by, the whole first; dataclasses are some, too."""
    from interarea.models.case.events import Event

    todo: list[Any] = [*([] if kind == "events" else [_model(kind)]), *get_args(Event)]
    models: list[type] = []
    while todo:
        one = todo.pop(0)
        if isinstance(one, type) and (issubclass(one, BaseModel) or is_dataclass(one)):
            if one not in models:
                models.append(one)
                todo += [f.annotation for f in getattr(one, "model_fields", {}).values()]
        else:
            todo += [a for a in get_args(one) if not isinstance(a, str)]
    return models


def write(pages: Path) -> list[Path]:
    """Write the reference pages into a folder and the schemas beside this module; return all files."""
    files = []
    for kind in kinds():
        for file, text in (
            (pages / f"{kind}.md", page(kind)),
            (SCHEMAS / f"{kind}.json", json.dumps(schema(kind), separators=(",", ":")) + "\n"),
        ):
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
            files.append(file)
    return files
