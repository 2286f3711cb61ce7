"""What the package raises: one base for all of it, one for what the user can put right; words of messages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_LONGEST = 900  #: characters of a message; what a wrong file holds may be as long as it likes


class InterareaError(Exception):
    """Anything this package raises on purpose."""


class UserError(InterareaError, ValueError):
    """Something given is wrong (case, scenario, sweep, graph, controller, place for results).

    A line for each mistake says what, where, what was found and what is allowed, whatever the wrong file has
    in it; `args` are these lines.
    """

    def __init__(self, *mistakes: str) -> None:
        super().__init__(*(_printable(text) for text in mistakes))

    def __str__(self) -> str:
        return "\n".join(self.args)


def _printable(text: str) -> str:
    whole = "; ".join(text.split("\n"))  # of several mistakes told as one
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in whole)
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} ... {line[5 - _LONGEST // 2 :]}"


class Collected:
    """The mistakes of several steps, each of which may end by one: ``with collected: ...``, then `end`."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._errors: list[UserError] = []

    def __enter__(self) -> Collected:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> bool:
        if isinstance(error, UserError):
            self._errors.append(error)
            self.lines += [line for line in error.args if line not in self.lines]
        return isinstance(error, UserError)

    def end(self, kind: type[UserError]) -> None:
        """Raise the only error there is, or one of all their lines; nothing where there is none."""
        if len(self._errors) == 1 and list(self._errors[0].args) == self.lines:
            raise self._errors[0]
        if self.lines:
            raise kind(*self.lines)


class CaseError(UserError):
    """A case, or what is asked of it, is wrong: one line with file, key, value and what is allowed."""


def nearest(name: object, known: Iterable[object]) -> str:
    """Return the part of an error that names what is close to `name`, else all that is known.

    >>> nearest("kundur", ["kundur-manual", "new-england"])
    'did you mean kundur-manual?'
    """
    names = list(dict.fromkeys(str(k) for k in known))
    close = [n for n in names if n.casefold() == str(name).casefold()]
    close = close or difflib.get_close_matches(str(name), names, n=3, cutoff=0.5)
    if close:
        return f"did you mean {' or '.join(close)}?"
    return (
        f"allowed: {', '.join(names[:20])}{', ...' if len(names) > 20 else ''}" if names else "there are none"
    )


def reason(error: Exception) -> str:
    """Return why a file cannot be read, without the number and the path that Python adds.

    >>> reason(FileNotFoundError(2, "No such file or directory", "grid.raw"))
    'no such file or directory'
    """
    text = error.strerror if isinstance(error, OSError) else None
    return f"{text[0].lower()}{text[1:]}" if text else str(error)


class DeviceError(CaseError):
    """A device file, or a record that fills it, is wrong: one line with place, value and what is allowed."""


class BeyondLimit(DeviceError):
    """A signal that would rest beyond a limit of its device.

    signal, value : what would rest where. limit : the limit as the diagram has it. above : whether it is an
    upper one.
    """

    def __init__(self, text: str, *, signal: str, value: float, limit: str, above: bool) -> None:
        super().__init__(text)
        self.signal, self.value, self.limit, self.above = signal, value, limit, above
