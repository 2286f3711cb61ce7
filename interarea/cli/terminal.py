"""What the command line shows: tables on stdout, progress on stderr, one line for a user's mistake."""

from __future__ import annotations

import codecs
import io
import json
import logging
import os
import shutil
import sys
import textwrap
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from interarea.models.errors import InterareaError, UserError

from ..command_usage import LARGEST

if TYPE_CHECKING:
    from interarea.design.robust.operating_points import FamilyRow
    from interarea.progress import Report

DEBUG_VARIABLE = "INTERAREA_DEBUG"

_PLAIN = {"±": "+-", "°": " deg", "−": "-", "–": "-", "→": "->", "Δ": "d", "ω": "w", "ζ": "zeta", "✓": "ok"}


def steady_streams() -> None:
    """Let stdout and stderr take every character and every caller.

    What the encoding of a terminal does not have is written in plain letters; a stream that is closed is
    replaced by one that swallows.
    """
    _levels.clear()
    _warned.clear()
    _log.removeHandler(_remarks)
    _log.setLevel(logging.NOTSET)
    codecs.register_error("interarea", _in_plain_letters)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115  until the end
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="interarea")


def _in_plain_letters(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lost = error.object[error.start : error.end]
    return "".join(_PLAIN.get(c) or c.encode("ascii", "backslashreplace").decode() for c in lost), error.end


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows of text under a title; numbers are expected to be formatted."""
    bold, plain = ("\033[1m", "\033[0m") if sys.stdout.isatty() else ("", "")
    widths = [max(map(len, column)) for column in zip(columns, *rows, strict=True)]
    room = shutil.get_terminal_size().columns if sys.stdout.isatty() else 160
    last = max(room - sum(width + 2 for width in widths[:-1]), 20)
    print(f"{bold}{title}{plain}")
    for k, row in enumerate((columns, *rows)):
        head = "  ".join(text.ljust(width) for text, width in zip(row[:-1], widths[:-1], strict=True))
        indent = "\n" + " " * (len(head) + 2)
        tail = indent.join(textwrap.wrap(row[-1], last) or [""])
        line = f"{head}  {tail}" if head else tail
        print(f"{bold}{line}{plain}" if k == 0 else line.rstrip())


#: of a command whose result is a file
FileAsJson = Annotated[bool, typer.Option("--json", help="print JSON instead of the file's name")]


def tell_file(path: Path, as_json: bool) -> None:
    """Print which file was written."""
    print(json.dumps({"file": str(path)}, indent=2) if as_json else path)


_levels: set[str] = set()  # quiet, verbose: as this call of the command asks


def set_level(name: str) -> Callable[[bool], None]:
    """Return what the option `--quiet` or `--verbose` does when it is given."""

    def set_to(value: bool) -> None:
        if value:
            _levels.add(name)
        if "verbose" in _levels:  # what the floors log: the cache's finds, processes
            _log.addHandler(_remarks)
            _log.setLevel(logging.INFO)

    return set_to


class _Remarks(logging.Handler):
    """What is logged, as remarks on stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        note(record.getMessage())


_log, _remarks = logging.getLogger("interarea"), _Remarks()


def quiet() -> bool:
    """Whether this call of the command was given `--quiet`."""
    return "quiet" in _levels


_warned: set[str] = set()  # by this call of the command


def say_warning(
    message: Warning | str,
    category: type[Warning] = UserWarning,
    filename: str = "",
    lineno: int = 0,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Print a warning in one line, once, unless `--quiet`: what `warnings.showwarning` does here."""
    text = " ".join(str(message).split())
    if text not in _warned:
        _warned.add(text)
        note(f"interarea: warning: {text}")


def note(text: object) -> None:
    """Print a remark on stderr, unless `--quiet`."""
    if not quiet():
        print(text, file=sys.stderr)


def _nobody(text: object) -> None:
    pass


def two_numbers(text: str, option: str, expected: str, error: type[Exception]) -> tuple[float, float]:
    """Return the numbers of an option `LOW:HIGH`; raise `error`, which says what is `expected`."""
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise error(f"{option} {text!r}, wanted {expected}") from None
    if not max(abs(low), abs(high)) <= LARGEST:
        raise error(f"{option} {text!r}, allowed: finite numbers, at most {LARGEST:g} in size")
    return low, high


@contextmanager
def busy(what: str) -> Iterator[None]:
    """Show on stderr that something is under way: on a terminal, else with `--verbose` a line."""
    if quiet() or not sys.stderr.isatty():
        reported = note if "verbose" in _levels else _nobody
        begin_s = time.monotonic()
        reported(what)
        yield
        reported(f"{what}: done in {time.monotonic() - begin_s:.1f} s")
        return
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield


@contextmanager
def stage_progress(stages: Sequence[str]) -> Iterator[Report]:
    """Show on stderr how far each stage is: bars on a terminal, else lines; nothing with `--quiet`."""
    from interarea.progress import lines, silent, terminal_bars

    if quiet():
        yield silent
    elif sys.stderr.isatty():
        with terminal_bars(stages) as report:
            yield report
    else:
        yield lines(stages, note, timed="verbose" in _levels)


@contextmanager
def steps(names: Sequence[str]) -> Iterator[Callable[[str], None]]:
    """Show work that goes from step to step: what is called with a step ends the one before it."""
    with stage_progress(names) as report:
        begun: list[str] = []

        def tell(name: str) -> None:
            if begun:
                report(begun[-1], 1.0)
            begun.append(name)
            report(name, 0.0)

        yield tell
        if begun:
            report(begun[-1], 1.0)


def complain(error: BaseException) -> int:
    """Print an error on stderr, a line for each mistake; return the exit code: 2 for a user's, 1 for ours.

    A mistake is any error class of this package, or a file that cannot be read or written. With
    `INTERAREA_DEBUG` set the traceback is shown too.
    """
    if os.environ.get(DEBUG_VARIABLE) or "verbose" in _levels:
        traceback.print_exception(error)
    if isinstance(error, UserError):
        for mistake in error.args:
            print(f"interarea: {mistake}", file=sys.stderr)
        return 2
    line = " ".join(str(error).split())
    if isinstance(error, InterareaError):
        print(f"interarea: {line}", file=sys.stderr)
        return 2
    if isinstance(error, OSError):
        reason = error.strerror or line
        where = f"{error.filename}: " if error.filename else ""
        print(f"interarea: {where}{reason}{_of_the_cache(error)}", file=sys.stderr)
        return 2
    if isinstance(error, MemoryError):
        print(f"interarea: not enough memory{line and f': {line}'}", file=sys.stderr)
        return 2
    kind = type(error).__name__
    print(
        f"interarea: internal error, please report it: {kind}: {line} "
        f"(set {DEBUG_VARIABLE}=1 for the traceback)",
        file=sys.stderr,
    )
    return 1


def _of_the_cache(error: OSError) -> str:
    """Return what to do when the file at fault is in the artefact cache."""
    from interarea.fmu_build.write.cache import default_cache

    if error.filename is None or not Path(str(error.filename)).is_relative_to(default_cache()):
        return ""
    return " (the cache of FMUs and designs; set INTERAREA_CACHE to a writable folder)"


def show_rows(name: str, rows: Sequence[FamilyRow]) -> None:
    """Print what a controller holds at each operating point under each condition."""
    print_table(
        f"{name}: full plants, linearised and without limits, exact latency",
        ("operating point", "condition", "stable", "worst swing", "inter-area", "rightmost (1/s)"),
        [
            (
                row.point,
                row.condition,
                "yes" if row.stable else "NO",
                f"{row.worst_swing:.3f}",
                f"{row.inter_area:.3f}",
                f"{row.rightmost:.3f}",
            )
            for row in rows
        ],
    )


def show_worth(result: Mapping[str, Any]) -> None:
    """Print what the signals of a controller are worth, as `SignalWorth.as_dict` gives it."""
    from interarea.cosim.designs.worth import HEADER, table_rows

    if result["afar"]:
        print_table(
            "worth of the signals, nothing lost (`without`: at the first point, at once)",
            HEADER,
            table_rows(result),
        )
    typer.echo(result["sentence"])


def show_margins(margins: Sequence[Mapping[str, Any]]) -> None:
    """Print how much later, larger or smaller each signal may come, in two lines."""
    from interarea.design.certificates.signal_margins import in_words

    for line in in_words(margins):
        typer.echo(line)
