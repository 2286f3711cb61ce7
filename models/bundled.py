"""What kind of bundled file has a name: for the line on a name given where another kind is wanted."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
#: kind -> its bundled files, and the command that takes the name
_KINDS = {
    "case": ("models/cases/{}.toml*", "interarea modes {}"),
    "scenario": ("cosim/scenario/bundled/{}.toml", "interarea run {}"),
    "controller": ("design/controllers/{}.json", "interarea compare {}"),
    "design": ("cosim/designs/design_{}.toml", "interarea design {}"),
    "study": ("cosim/study/thesis/study_{}.toml", "interarea study {}"),
}


def bundled_elsewhere(name: str, wanted: str) -> str | None:
    """Return what a name that is no bundled `wanted` is, as the end of a sentence about it; None of no other.

    >>> bundled_elsewhere("two-area-thesis", "scenario")
    'is a bundled case (`interarea modes two-area-thesis`), wanted: a scenario'
    >>> bundled_elsewhere("two-area-theses", "scenario") is None
    True
    """
    if not name.replace("-", "").replace("_", "").isalnum():  # nothing that a pattern or a path means
        return None
    for kind, (files, command) in _KINDS.items():
        if kind != wanted and any(_PACKAGE.glob(files.format(name))):
            return f"is a bundled {kind} (`{command.format(name)}`), wanted: a {wanted}"
    return None
