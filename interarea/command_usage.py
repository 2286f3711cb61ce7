"""Errors in the arguments of a command: one line with command, argument, allowed values and remedy.

A message of typer has four lines, and states neither the value read nor the allowed values.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import typer

from interarea.models.errors import UserError

from .command_help import EXAMPLES

Error: Any = typer.BadParameter.__base__  #: typer's own, or click's where typer is older

#: kind of what a word names -> what raises UserError where it names none, and loads little
_REQUIRED = {
    "case": "models.case.document:case_file",
    "controller": "cosim.scenario.names:require_controller",
    "design": "cosim.scenario.named:design_file",
    "detector": "cosim.scenario.named:require_detector",
    "record": "cosim.records.files.tables:require_record",
    "scenario": "cosim.scenario.named:scenario_file",
    "subject": "cosim.scenario.named:require_subject",
    "text": "cosim.scenario.named:require_text",
}
_NAMES = "interarea.names"  # in what a context knows: kinds and words that must name one
LARGEST = 1e9  #: of the numbers that options take, whatever their unit

#: how typer's messages on a value begin -> what is allowed
_NUMBERS = {"a valid number": "a number", "a valid integer": "a whole number"}


class UsageMistake(UserError):
    """Arguments that a command does not accept."""


def check_words(command: Any, words: Sequence[str]) -> None:
    """Require that no argument is empty, and that no option is in the place of another option's value.

    Raises UsageMistake.
    """
    for before, word in zip(["", *words], words, strict=False):
        if word == "" or (word.startswith("--") and word.endswith("=")):  # as a path: the current folder
            option = word.removesuffix("=") or (before if before.startswith("-") else "an argument")
            raise UsageMistake(f"{command.name}: {option} is empty, allowed: {_expected(command, option)}")
    options = _options(command)
    for before, word in pairwise(words):
        if before == "--":
            break
        taken = options.get(before)
        if taken is not None and not taken.is_flag and word.partition("=")[0] in options:
            raise UsageMistake(
                f"{command.name}: {before} has no value, it is followed by the option {word}, wanted: "
                f"{_expected(command, before)}"
            )


def check_numbers(command: Any, values: dict[str, Any]) -> None:
    """Require that every number of an option is finite and at most `LARGEST` in magnitude.

    Raises UsageMistake.
    """
    for parameter in command.params:
        value = values.get(parameter.name)
        if isinstance(value, float) and not abs(value) <= LARGEST:
            raise UsageMistake(
                f"{command.name}: {_shown(parameter)}: got {value:g}, allowed: a finite number, at most "
                f"{LARGEST:g} in size{_purpose(parameter)}"
            )


def within(
    *, above: float | None = None, least: float | None = None, most: float | None = None, unit: str = ""
) -> Callable[[typer.Context, typer.CallbackParam, Any], Any]:
    """Return the callback of an option that rejects numbers outside a range (UsageMistake) before any work.

    above, least, most : bounds of the range; `above` is exclusive. unit : of all, for the message.
    """
    ends = {"above": above, "at least": least, "at most": most}
    allowed = " and ".join(f"{word} {end:g}" for word, end in ends.items() if end is not None)
    allowed += unit and f", in {unit}"

    def check(context: typer.Context, parameter: typer.CallbackParam, value: Any) -> Any:
        for one in value if isinstance(value, list) else [value]:
            if one is None:
                continue
            low = (above is None or one > above) and (least is None or one >= least)
            if not (low and (most is None or one <= most)):
                raise UsageMistake(
                    f"{context.command.name}: {_shown(parameter)}: got {one:g}, allowed: {allowed}"
                    f"{_purpose(parameter)}"
                )
        return value

    return check


def naming(kind: str) -> Callable[[typer.Context, Any], Any]:
    """Return the callback of a parameter whose values must be known names, which `check_names` verifies.

    kind : of `_REQUIRED`.
    """

    def note(context: typer.Context, value: Any) -> Any:
        words = value if isinstance(value, list) else [value]
        context.meta.setdefault(_NAMES, []).extend((kind, str(one)) for one in words if one is not None)
        return value

    return note


def check_names(context: typer.Context) -> None:
    """Reject unknown names before the code that reads them is loaded. Raises UserError."""
    for kind, word in context.meta.get(_NAMES, ()):
        module, _, function = _REQUIRED[kind].partition(":")
        getattr(import_module(f"interarea.{module}"), function)(word)


ABOVE_0_S = within(above=0.0, unit="s")
LATENCY_S = within(least=0.0, most=10.0, unit="s")  # 100 are meant as ms
CaseName = Annotated[
    str,
    typer.Argument(
        metavar="CASE", help="bundled case or TOML file", show_default=False, callback=naming("case")
    ),
]
Dyr = Annotated[
    Path | None,
    typer.Option("--dyr", metavar="FILE", help="PSS/E dynamic data of a grid", callback=naming("text")),
]


def mistake(error: Any, words: Sequence[str], command: Any = None) -> UsageMistake:
    """Return a usage error of typer as one line.

    words : those after the command's name. command : None of what stands before it.
    """
    if command is None:
        return UsageMistake(_before_a_command(error))
    name = command.name
    if hasattr(error, "possibilities"):
        return UsageMistake(f"{name}: {_no_such_option(error, command, words)}")
    if hasattr(error, "option_name"):
        return UsageMistake(f"{name}: {_without_value(error, command)}")
    if "unexpected extra argument" in error.message:
        return UsageMistake(f"{name}: {_too_many(command, words, error)}")
    parameter = getattr(error, "param", None)
    if hasattr(error, "param_type"):  # one that is missing
        return UsageMistake(
            f"{name}: {_shown(parameter)} is missing, wanted: {_expected(command, parameter)}"
        )
    where = f"{_shown(parameter)}: " if parameter is not None else ""
    return UsageMistake(f"{name}: {where}{_wrong_value(error, words)}")


def _before_a_command(error: Any) -> str:
    """Return the error in the arguments before a command's name, or in the name."""
    if hasattr(error, "possibilities"):
        return (
            f"{error.option_name}: no such option before the name of a command; options of a command follow "
            "its name, as `interarea list --json` (`interarea --help` lists the commands)"
        )
    word = error.message.partition("'")[2].partition("'")[0]
    if word and "ommand" in error.message:
        hint = _nearest(word, EXAMPLES) or "; wanted: the name of one"
        return f"{word}: no such command{hint} (`interarea --help` lists them)"
    return str(error.format_message())


def _no_such_option(error: Any, command: Any, words: Sequence[str]) -> str:
    word = next((w for w in words if w.startswith(error.option_name)), error.option_name).partition("=")[0]
    hint = _nearest("--" + word.lstrip("-"), [*_options(command), "--help"])
    return f"{word}: no such option{hint} (`interarea {command.name} --help` lists them)"


def _options(command: Any) -> dict[str, Any]:
    """Return the options of a command by each of their names."""
    return {name: p for p in command.params for name in (*p.opts, *p.secondary_opts) if name[0] == "-"}


def _nearest(word: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f"; did you mean {close[0]}?" if close else ""


def _without_value(error: Any, command: Any) -> str:
    if "does not take a value" in error.message:
        return f"{error.option_name} takes no value, wanted: {error.option_name} alone"
    return f"{error.option_name} has no value, wanted: {_expected(command, error.option_name)}"


def _too_many(command: Any, words: Sequence[str], error: Any) -> str:
    extra = error.message.rpartition("(")[2].rstrip(")")
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    allowed = " and ".join(f"one {_shown(p)}" for p in arguments) or "options alone"
    out = next((p for p in command.params if "--out" in p.opts), None)
    hint = f"; give the output as --out {extra.split()[-1]}"
    return f"{extra}: too many arguments, allowed: {allowed}" + (
        hint if out is not None and not any(w.partition("=")[0] == "--out" for w in words) else ""
    )


def _wrong_value(error: Any, words: Sequence[str]) -> str:
    """Return the value read and the allowed values of an option, if its message lacks the former."""
    expected = error.message.removeprefix("Input should be ")
    if expected == error.message or getattr(error, "param", None) is None:
        return str(error.message)
    got = [after for before, after in pairwise(words) if before in error.param.opts]
    got += [w.partition("=")[2] for w in words if w.partition("=")[0] in error.param.opts and "=" in w]
    for said, number in _NUMBERS.items():
        if expected.startswith(said):
            expected = number
    expected = expected.replace("greater than or equal to", "at least")
    return f"got {got[-1] if got else 'another'}, allowed: {expected}{_purpose(error.param)}"


def _shown(parameter: Any) -> str:
    """Return an option with its metavar, or the name of an argument, as in the help."""
    metavar = parameter.metavar or ""
    if parameter.param_type_name == "argument":
        return metavar.strip("{}[].") or parameter.name.upper()
    return f"{parameter.opts[0]} {metavar}".strip()


def _purpose(parameter: Any) -> str:
    return f" ({parameter.help})" if getattr(parameter, "help", None) else ""


def _expected(command: Any, which: Any) -> str:
    """Return the accepted values of a parameter (object or name), and the command's example."""
    parameter = which
    if isinstance(which, str):
        parameter = _options(command).get(which)
    takes = "a name"
    if parameter is not None:
        metavar = (parameter.metavar or "").strip("{}[].") or "a value"
        text = getattr(parameter, "help", None)
        takes = (
            text if text and parameter.param_type_name == "argument" else f"{metavar}{_purpose(parameter)}"
        )
    return f"{takes}, as in `{EXAMPLES[command.name]}`"
