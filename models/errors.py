"""What the package raises: one base for all of it, one for what the user can put right; words of messages."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError

_LONGEST = 900  #: characters of a message; what a wrong file holds may be as long as it likes


class InterareaError(Exception):
    """Anything this package raises on purpose."""


class UserError(InterareaError, ValueError):
    """Something given is wrong (case, scenario, sweep, graph, controller, place for results): one line.

    The line says what, where, what was found and what is allowed, whatever the wrong file has in it.
    """

    def __init__(self, text: str) -> None:
        line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
        if len(line) > _LONGEST:
            line = f"{line[: _LONGEST // 2]} ... {line[5 - _LONGEST // 2 :]}"
        super().__init__(line)


class CaseError(UserError):
    """A case, or what is asked of it, is wrong: one line with file, key, value and what is allowed."""


def nearest(name: object, known: Iterable[object]) -> str:
    """Return the part of an error that names what is close to `name`, else all that is known.

    >>> nearest("kundur", ["kundur-manual", "new-england"])
    'did you mean kundur-manual?'
    """
    names = [str(k) for k in known]
    close = difflib.get_close_matches(str(name), names, n=3, cutoff=0.5)
    if close:
        return f"did you mean {' or '.join(close)}?"
    return (
        f"allowed: {', '.join(names[:20])}{', ...' if len(names) > 20 else ''}" if names else "there is none"
    )


def reason(error: Exception) -> str:
    """Return why a file cannot be read, without the number and the path that Python adds.

    >>> reason(FileNotFoundError(2, "No such file or directory", "grid.raw"))
    'no such file or directory'
    """
    text = error.strerror if isinstance(error, OSError) else None
    return f"{text[0].lower()}{text[1:]}" if text else str(error)


def one_line(error: ValidationError, path_of: Callable[[tuple[int | str, ...]], list[str]]) -> str:
    """Return the first failure of a pydantic `error` in one line; `path_of` turns its location into words."""
    first = error.errors()[0]
    key = ".".join(path_of(first["loc"]))
    message = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    context = first.get("ctx", {})
    if first["type"] == "value_error":
        return f"{key}: {message}" if key else message
    if first["type"] == "control":  # a device's row: the message begins with the key in it
        return f"{key}{message}"
    if first["type"] == "missing":
        return f"{key} is missing{more}"
    if first["type"] == "extra_forbidden":
        return f"{key} = {first['input']!r}: no such key here{more}"
    if first["type"] == "union_tag_not_found":
        return f"{key}.kind is missing{more}"
    if first["type"] == "union_tag_invalid":
        return f"{key}.kind = {context['tag']!r}, allowed: {context['expected_tags']}{more}"
    return f"{key} = {first['input']!r}, allowed: {message}{more}"
