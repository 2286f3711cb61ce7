"""Arguments of public functions: one of a wrong type is refused before anything is computed."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, cast

import numpy as np

from .errors import UserError

_Function = TypeVar("_Function", bound=Callable[..., Any])


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool | np.bool_)


def _are_numbers(values: object) -> bool:
    return isinstance(values, tuple | list | np.ndarray) and all(map(_is_number, values))


def _is_all(values: object, kind: type[Any] | UnionType) -> bool:
    several = isinstance(values, Sequence) and not isinstance(values, str)
    return several and all(isinstance(value, kind) for value in values)  # type: ignore[attr-defined]


#: annotation -> whether a value is of that kind, and the kind in words
_KINDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "float": (_is_number, "a number"),
    "int": (lambda v: _is_number(v) and isinstance(v, Integral), "a whole number"),
    "bool": (lambda v: isinstance(v, bool | np.bool_), "True or False"),
    "str": (lambda v: isinstance(v, str), "a text"),
    "Path": (lambda v: isinstance(v, Path), "a path"),
    "tuple[float, float]": (lambda v: _are_numbers(v) and len(v) == 2, "two numbers"),
    "Sequence[float]": (_are_numbers, "a list of numbers"),
    "Sequence[str]": (lambda v: _is_all(v, str), "a list of texts"),
    "Sequence[str | Path]": (lambda v: _is_all(v, str | Path), "a list of paths"),
    "Mapping[str, str]": (
        lambda v: isinstance(v, Mapping) and _is_all([*v, *v.values()], str),
        "a dict of texts",
    ),
    "Mapping[str, Case]": (
        lambda v: isinstance(v, Mapping) and all(hasattr(case, "machines") for case in v.values()),
        "a dict of cases",
    ),
    "Callable[[str], object]": (callable, "a function"),
    "None": (lambda v: v is None, "None"),
}
_APART = re.compile(r" \| (?![^\[]*\])")  #: between the kinds of an annotation, not within brackets
_LONGEST = 60  #: characters of a value in a message


def checked_types(function: _Function) -> _Function:
    """Refuse arguments that are not what the annotations say; those with other kinds than `_KINDS` pass.

    Raises
    ------
    UserError : names function, argument, value and what is allowed.
    """
    names = function.__code__.co_varnames
    kinds = {name: _APART.split(text) for name, text in function.__annotations__.items() if name != "return"}
    kinds = {name: of for name, of in kinds.items() if _KINDS.keys() >= set(of)}
    title = function.__qualname__.removesuffix(".__init__")

    @functools.wraps(function)
    def checked(*values: Any, **named: Any) -> Any:
        for name, value in (*zip(names, values, strict=False), *named.items()):
            if name in kinds and not any(_KINDS[kind][0](value) for kind in kinds[name]):
                text = repr(value)
                got = f"= {text}" if len(text) <= _LONGEST and "\n" not in text else f"is {kind_of(value)}"
                allowed = " or ".join(_KINDS[kind][1] for kind in kinds[name])
                raise UserError(f"{title}: {name} {got}, allowed: {allowed}")
        return function(*values, **named)

    return cast("_Function", checked)


def kind_of(thing: object) -> str:
    """Return what a thing is, with article, for a message.

    >>> kind_of({"A": 1}), kind_of(None)
    ('a dict', 'None')
    """
    if thing is None:
        return "None"
    name = type(thing).__name__
    return f"{'an' if name[0].lower() in 'aeio' or name == 'ndarray' else 'a'} {name}"
