"""The loop of FMUs against the delay differential equation, as docs/delay_error.md shows it."""

from __future__ import annotations

import importlib.util
import re
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from participants import delayed_reference

DOCS = Path(__file__).resolve().parents[2] / "docs"


@cache
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("delay_error", DOCS / "delay_error.py")
    assert spec is not None and spec.loader is not None
    result = importlib.util.module_from_spec(spec)
    import sys

    sys.modules["delay_error"] = result
    spec.loader.exec_module(result)
    return result


@pytest.mark.slow
def test_two_solvers_of_the_delay_equation_agree() -> None:
    """Collocation against the method of steps with Radau, on the first 1.6 s."""
    doc = script()
    loop = doc.loop_of(doc.two_lags(), True)

    def rate(t: float, x: np.ndarray, past: object) -> np.ndarray:
        pushed = doc.PULSE if doc.PULSE_S[0] <= t < doc.PULSE_S[1] else 0.0
        return loop.A @ x + pushed * loop.b + loop.E @ (loop.C @ past(t - doc.LATENCY_S))  # type: ignore[operator]

    y = doc.solve_dde(loop)
    at = np.array([1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6])
    solve = {"method": "Radau", "rtol": 1e-8, "atol": 1e-14, "jac": loop.A}
    steps = delayed_reference(rate, np.zeros(len(loop.A)), doc.LATENCY_S, doc.PULSE_S, 1.6, **solve)(at)
    dw24 = (y[:, 0] - y[:, 1])[np.round(at / 0.0025).astype(int)]
    assert np.max(np.abs(steps @ (loop.C[0] - loop.C[1]) - dw24)) <= 1e-6 * np.max(np.abs(dw24))


@pytest.mark.slow
@pytest.mark.parametrize("synchronous", [True, False])
def test_cubics_are_within_2e_7_of_the_delay_equation_and_of_third_order(synchronous: bool) -> None:
    doc = script()
    (row,) = doc.errors(doc.two_lags(), synchronous, ["hermite"], (0.02, 0.01, 0.005)).values()
    assert row[1] <= 2e-7
    assert np.log2(row[0] / row[2]) / 2 >= 3.0


def test_the_page_quotes_what_the_targets_ask_for() -> None:
    """Each table of the page has the four ways, and its Hermite row at 10 ms is within 2e-7."""
    text = (DOCS / "delay_error.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| cubic Hermite \|(.*)\|$", text, flags=re.M)
    assert len(rows) == 2
    for row in rows:
        numbers = [float(x) for x in row.split("|")]
        assert numbers[2] <= 2e-7 and numbers[-1] >= 3.0
    assert (DOCS / "delay-error.svg").is_file()
