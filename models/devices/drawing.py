"""A device's block diagram as SVG: one box a line, inputs on the left, feedback below."""

from __future__ import annotations

import html

from .language.device import KINDS, Device, Line
from .language.expression import Node

_WIDTH, _HEIGHT, _GAP_X, _GAP_Y, _EDGE = 190, 62, 60, 34, 24
_NAMES = 70  #: room for the names of the inputs
_LONGEST = 30  #: characters in a box


def _formula(line: Line) -> tuple[str, str]:
    """What stands over and under the line of fractions in a box; under it nothing for plain expressions."""
    node = line.node
    args = [str(a) for a in node.args]
    K = str(line.option("K") or "1")
    match line.element:
        case "lag":
            return K, f"1 + s {args[1]}"
        case "leadlag":
            return f"{'' if K == '1' else K + ' '}(1 + s {args[1]})", f"1 + s {args[2]}"
        case "washout":
            return f"{'' if K == '1' else K + ' '}s {args[1]}", f"1 + s {args[1]}"
        case "rate":
            return f"s {args[1]}", f"1 + s {args[2]}"
        case "integrator":
            T = line.option("T")
            return K, "s" if T is None else f"s {T}"
        case "pi":
            return f"{args[1]} + {args[2]}/s", ""
        case "filter2":
            return f"1 + {args[3]} s + {args[4]} s2", f"1 + {args[1]} s + {args[2]} s2"
    return str(node), ""


def _columns(device: Device) -> dict[str, int]:
    """Column of each signal: one right of the last it comes from; what closes a loop does not count."""
    lines = {line.name: line for line in device.lines}
    column: dict[str, int] = {}

    def place(name: str, above: frozenset[str]) -> int:
        if name not in lines:
            return 0
        if name not in column:
            before = [n for n in _driven(lines[name]).names if n in lines and n not in above | {name}]
            column[name] = 1 + max((place(n, above | {name}) for n in before), default=0)
        return column[name]

    for name in lines:
        place(name, frozenset())
    return column


def _driven(line: Line) -> Node:
    """The line without the limits and the times: what drives it."""
    return line.node.args[0] if line.element else line.node


def diagram_svg(device: Device) -> str:
    """Return the block diagram of `device` as an SVG document; all text of the file is escaped."""
    column = _columns(device)
    signals = {n for line in device.lines for n in line.node.names}
    sources = [n for n in (*KINDS[device.kind].inputs, *device.references) if n in signals]
    place: dict[str, tuple[float, float]] = {}
    rows: dict[int, int] = {}
    for name in [*sources, *(line.name for line in device.lines)]:
        k = column.get(name, 0)
        rows[k] = rows.get(k, 0) + 1
        x = _NAMES - _WIDTH if k == 0 else _NAMES + _GAP_X + (k - 1) * (_WIDTH + _GAP_X)
        place[name] = (_EDGE + x, _EDGE + (rows[k] - 1) * (_HEIGHT + _GAP_Y))
    width = 2 * _EDGE + _NAMES + max(column.values(), default=0) * (_WIDTH + _GAP_X)
    height = 2 * _EDGE + max(rows.values()) * (_HEIGHT + _GAP_Y) + 2 * _GAP_Y
    parts: list[str] = []
    for line in device.lines:
        for name in dict.fromkeys(line.node.names):
            if name in place:
                parts.append(_arrow(place[name], place[line.name], height))
    parts += [_source(name, *place[name]) for name in sources]
    parts += [_box(line, *place[line.name], final=line.name == device.output) for line in device.lines]
    style = (
        "text{font:12px sans-serif}.b{fill:#fff;stroke:#222}.o{stroke-width:2.5}.l{fill:#777;font-size:10px}"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}"><title>{html.escape(f"{device.name}: {device.title}")}</title><style>{style}'
        ".a{fill:none;stroke:#555}.f{stroke:#b33}</style>"
        '<defs><marker id="t" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" '
        'orient="auto"><path d="M0 0L8 4L0 8z" fill="#555"/></marker></defs>' + "".join(parts) + "</svg>\n"
    )


def _arrow(start: tuple[float, float], end: tuple[float, float], height: float) -> str:
    x1, y1, x2, y2 = start[0] + _WIDTH, start[1] + _HEIGHT / 2, end[0], end[1] + _HEIGHT / 2
    if x2 > x1:
        bend = (x2 - x1) / 2
        path, kind = f"M{x1} {y1}C{x1 + bend} {y1} {x2 - bend} {y2} {x2} {y2}", "a"
    else:  # feedback: below all boxes
        low = height - _EDGE
        path = f"M{x1} {y1}C{x1 + 40} {low} {x1 + 20} {low} {x1 - 20} {low}L{x2 + 20} {low}"
        path, kind = f"{path}C{x2 - 20} {low} {x2 - 40} {y2 + 20} {x2} {y2 + 14}", "a f"
    return f'<path class="{kind}" d="{path}" marker-end="url(#t)"/>'


def _short(text: str) -> str:
    return html.escape(text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}...")


def _source(name: str, x: float, y: float) -> str:
    return (
        f'<text x="{x + _WIDTH - 6}" y="{y + _HEIGHT / 2 + 4}" text-anchor="end">{html.escape(name)}</text>'
    )


def _box(line: Line, x: float, y: float, *, final: bool) -> str:
    over, under = _formula(line)
    middle, kind = x + _WIDTH / 2, "b o" if final else "b"
    parts = [f'<rect class="{kind}" x="{x}" y="{y}" width="{_WIDTH}" height="{_HEIGHT}" rx="3"/>']
    parts.append(f"<title>{html.escape(f'{line.name} = {line.node}  {line.comment}')}</title>")
    parts.append(f'<text class="l" x="{x + 4}" y="{y - 4}">{html.escape(line.name)}</text>')
    if under:
        parts.append(f'<text x="{middle}" y="{y + 26}" text-anchor="middle">{_short(over)}</text>')
        parts.append(f'<path class="a" d="M{x + 16} {y + 32}H{x + _WIDTH - 16}"/>')
        parts.append(f'<text x="{middle}" y="{y + 47}" text-anchor="middle">{_short(under)}</text>')
    else:
        parts.append(f'<text x="{middle}" y="{y + 35}" text-anchor="middle">{_short(over)}</text>')
    for key, at_y in (("max", y + 11), ("min", y + _HEIGHT - 4)):
        limit = line.option(key)
        if limit is not None:
            at = f'x="{x + _WIDTH - 4}" y="{at_y}"'
            parts.append(f'<text class="l" {at} text-anchor="end">{_short(str(limit))}</text>')
    return f"<g>{''.join(parts)}</g>"
