"""What the package raises: one base for all of it, one for what the user can put right."""

from __future__ import annotations

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
