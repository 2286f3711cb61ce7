"""A picture of a block's ports: inputs on the left, outputs on the right, as SVG for its documentation."""

from __future__ import annotations

import html
from collections.abc import Iterable

from interarea.models.blocks.variables import Block, Role, Variable

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
    found = []
    for (_, unit), members in kinds.items():
        if len(members) <= _MOST:
            found += [f"{port.name}{unit}" for port in members]
        else:
            found.append(f"{members[0].name} … {members[-1].name}{unit}, {len(members)} ports")
    return found


def _unit(port: Variable) -> str:
    if port.type != "Real":
        return f" ({port.type})"
    return "" if port.unit in ("", "1") else f" ({port.unit})"
