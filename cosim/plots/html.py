"""Figures inside HTML pages."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from markupsafe import escape

from .curves import GRID, INK, MUTED, SERIES

THEME = {INK: "var(--ink)", MUTED: "var(--muted)", GRID: "var(--grid)"} | {
    colour: f"var(--s{k})" for k, colour in enumerate(SERIES)
}


def inline_svg(
    path: Path, key: str, title: str | None = None, *, links: Mapping[str, str] | None = None
) -> str:
    """Return an SVG file as an element for a page: ids unique by `key`, colours of the theme.

    title : what a screen reader says of it; default the key.
    links : address in it -> what it opens, which is shown and read there.
    """
    text = path.read_text(encoding="utf-8")
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    prefix = "f" + re.sub(r"\W", "-", key) + "-"
    text = re.sub(r'\bid="', f'id="{prefix}', text)
    text = re.sub(r"url\(#", f"url(#{prefix}", text)
    text = re.sub(r'href="#', f'href="#{prefix}', text)
    for address, words in (links or {}).items():
        there = re.escape(str(escape(address)))
        label = f'<a href="{escape(address)}" aria-label="{escape(words)}"><title>{escape(words)}</title>'
        text = re.sub(rf'<a xlink:href="{there}"[^>]*>', label.replace("\\", r"\\"), text)
    for colour, variable in THEME.items():
        text = re.sub(re.escape(colour), variable, text, flags=re.IGNORECASE)
    head, _, body = text.partition(">")
    width = re.search(r'width="([\d.]+)pt"', head)
    head = re.sub(r'\s(?:width|height)="[^"]*"', "", head)
    style = f' style="max-width:{float(width.group(1)) * 4 / 3:.0f}px"' if width else ""
    role = "group" if links else "img"  # what is inside an image is not read
    return re.sub(
        r"\n\s*", "\n", f'{head} role="{role}" aria-label="{escape(title or f"figure {key}")}"{style}>{body}'
    ).strip()
