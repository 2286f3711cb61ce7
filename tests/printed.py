"""Numbers as printed: their digits are the tolerance, and any widening needs a reason."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

PUBLISHED = Path(__file__).parent / "published"


def approx_printed(text: str, gap: Mapping[str, Any] | None = None) -> Any:
    """Return what equals `text` within half a unit of its last digit, or within `gap["allow"]` with a reason.

    >>> 0.5453 == approx_printed("0.545")
    True
    """
    if not isinstance(text, str):
        raise TypeError(f"a printed number is a string, so that its digits are known; got {text!r}")
    value = Decimal(text)
    exponent = value.as_tuple().exponent
    if not isinstance(exponent, int):
        raise ValueError(f"{text!r} is not a finite number")
    half = 0.5 * 10.0**exponent * (1.0 + 1e-9)
    if gap is None:
        return pytest.approx(float(value), rel=0.0, abs=half)
    if not str(gap.get("because", "")).strip():
        raise ValueError(f"{text!r}: a gap of {gap.get('allow')} without a reason, needed: because = '...'")
    return pytest.approx(float(value), rel=0.0, abs=float(gap["allow"]))


def table(name: str) -> dict[str, Any]:
    """Return the published table `tests/published/NAME.toml`."""
    return tomllib.loads((PUBLISHED / f"{name}.toml").read_text(encoding="utf-8"))


def rows(name: str) -> list[dict[str, Any]]:
    """Return the rows of a published table."""
    return list(table(name)["row"])
