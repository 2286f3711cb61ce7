"""Bundled files by kind and name, and what kind has a name that is given where another is wanted."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
_BANK = "bank_"  # before the name of a bank of controllers in that of its file
#: kind -> its bundled files, and the command that takes the name
_KINDS = {
    "case": ("models/cases/*.toml*", "interarea modes {}"),
    "scenario": ("cosim/scenario/bundled/*.toml", "interarea run {}"),
    "controller": ("design/controllers/*.json", "interarea compare {}"),
    "design": ("cosim/designs/design_*.toml", "interarea design {}"),
    "study": ("cosim/study/thesis/study_*.toml", "interarea study {}"),
}


def bundled(kind: str) -> dict[str, Path]:
    """Return name -> file of what is bundled of a kind, banks among the controllers, sorted by file.

    >>> list(bundled("study"))
    ['thesis']
    """
    pattern = _KINDS[kind][0]
    prefix = _BANK if kind == "controller" else pattern.rpartition("/")[2].partition("*")[0]
    files = sorted(_PACKAGE.glob(pattern))
    return {path.name.partition(".")[0].removeprefix(prefix): path for path in files}


def bundled_elsewhere(name: str, expected: str) -> str | None:
    """Return what a name that is no bundled `expected` file is, as the end of a sentence; None: nothing else.

    >>> bundled_elsewhere("two-area-thesis", "scenario")
    'is a bundled case (`interarea modes two-area-thesis`), wanted: a scenario'
    >>> bundled_elsewhere("two-area-theses", "scenario") is None
    True
    """
    for kind, (_, command) in _KINDS.items():
        if kind != expected and name in bundled(kind):
            return f"is a bundled {kind} (`{command.format(name)}`), wanted: a {expected}"
    return None


def meant(name: str, kind: str) -> str:
    """Return what a name that is neither file nor bundled may mean, as the end of a sentence, or "".

    >>> meant("lost-signal.toml", "scenario")
    '; the bundled scenario is lost-signal, without .toml'
    """
    path = Path(name)
    if path.suffix == ".toml" and path.stem in bundled(kind):
        return f"; the bundled {kind} is {path.stem}, without .toml"
    if (whole := path.with_name(f"{path.name}.toml")).is_file():
        return f"; did you mean {whole}?"
    return ""
