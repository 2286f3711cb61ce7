"""Documents of the user's, TOML and JSON: read strictly, so that what is no number is never taken for one.

A byte-order mark is read over. Refused by place and value: numbers that arithmetic would overflow on,
integers beyond 64 bits, NaN and infinity in JSON, a JSON key given twice, tables without end.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from typing import Any

from .errors import UserError

LARGEST = 1e30  #: size of a number; a limit that is absent counts as this
_LARGEST_INTEGER = 2**63 - 1
_SHOWN = 40  #: characters of a number in a message


class DocumentError(UserError):
    """A text that is no TOML or JSON, or that has a number which none can be."""


def parse_toml(content: bytes | str) -> dict[str, Any]:
    """Return the tables of a text.

    >>> parse_toml("stop_s = 1e308")
    Traceback (most recent call last):
    interarea.models.documents.DocumentError: stop_s = 1e+308, allowed: numbers up to 1e+30

    Raises
    ------
    DocumentError : not TOML, not UTF-8, nested too deeply, a number that is too large.
    """
    return _parsed(content, "TOML", tomllib.loads)  # type: ignore[no-any-return]


def parse_json(content: bytes | str) -> Any:
    """Return what a JSON text holds.

    Raises
    ------
    DocumentError : not JSON, not UTF-8, nested too deeply, a number that is too large or none.
    """
    return _parsed(content, "JSON", _strict_json)


def _parsed(content: bytes | str, language: str, read: Callable[[str], Any]) -> Any:
    try:
        text = content if isinstance(content, str) else content.decode("utf-8-sig")
        found = read(text.removeprefix("\ufeff"))
        _check_numbers(found, "")
    except RecursionError:
        raise DocumentError(f"not valid {language}: nested too deeply") from None
    except DocumentError:
        raise
    except ValueError as error:  # that of the language, of UTF-8, of an integer of thousands of digits
        hint = " (an id given twice?)" if "overwrite" in str(error) or "declare" in str(error) else ""
        raise DocumentError(f"not valid {language}: {error}{hint}") from None
    return found


def _strict_json(text: str) -> Any:
    return json.loads(text, parse_constant=_no_constant, object_pairs_hook=_unique)


def _no_constant(word: str) -> float:
    raise DocumentError(f"not valid JSON: {word} is no number")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in found if keys.count(key) > 1)
        raise DocumentError(f"not valid JSON: the key {twice!r} is given twice")
    return found


def _check_numbers(value: Any, where: str) -> None:
    if isinstance(value, dict):
        for key, item in value.items():
            _check_numbers(item, f"{where}.{key}" if where else str(key))
    elif isinstance(value, list):
        for k, item in enumerate(value, start=1):
            _check_numbers(item, f"{where} {k}")
    elif isinstance(value, int) and not abs(value) <= _LARGEST_INTEGER:
        digits = str(abs(value))
        text = digits if len(digits) <= _SHOWN else f"{digits[:_SHOWN]}... ({len(digits)} digits)"
        raise DocumentError(f"{where} = {text}, allowed: integers of 64 bits")
    elif isinstance(value, float) and LARGEST < abs(value) < float("inf"):
        raise DocumentError(f"{where} = {value:g}, allowed: numbers up to {LARGEST:g}")
