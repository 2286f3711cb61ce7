"""The stabilised Runge-Kutta method of drawn runs, from the numbers in C: its order and what it damps."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import interarea.cosim.explorer.wasm as wasm

Matrix = npt.NDArray[np.float64]


def method(name: str) -> tuple[Matrix, Matrix]:
    """Return A and b of a method of `drawn_step.h`."""
    text = wasm.DRAWN_STEP.read_text(encoding="ascii")
    match = re.search(name + r" = \{\s*(\d+),\s*(\{\{.*?\}\}),\s*(\{.*?\})\s*\};", text, re.DOTALL)
    assert match is not None
    stages = int(match.group(1))

    def numbers(part: str) -> list[float]:
        pairs = [x.strip().partition(" / ") for x in part.split(",")]
        return [float(over) / float(under or 1.0) for over, _, under in pairs]

    A = np.zeros((stages, stages))
    for i, row in enumerate(re.findall(r"\{([^{}]*)\}", match.group(2))):
        A[i + 1, : i + 1] = numbers(row)
    return A, np.array(numbers(match.group(3).strip("{}")))


def growth(A: Matrix, b: Matrix, z: complex) -> float:
    one = np.ones(len(b))
    return float(abs(1.0 + z * b @ np.linalg.solve(np.eye(len(b)) - z * A, one)))


@pytest.mark.parametrize(("name", "stages"), [("DRAWN_CLASSICAL", 4), ("DRAWN_STABLE", 7)])
def test_the_eight_conditions_of_order_four_hold(name: str, stages: int) -> None:
    A, b = method(name)
    assert len(b) == stages
    c = A.sum(axis=1)
    conditions = {
        1: b.sum(),
        2: b @ c,
        3: b @ c**2,
        6: b @ A @ c,
        4: b @ c**3,
        8: (b * c) @ A @ c,
        12: b @ A @ c**2,
        24: b @ A @ A @ c,
    }
    assert {n: pytest.approx(1.0 / n, abs=1e-15) for n in conditions} == conditions


def test_decays_up_to_twelve_over_the_step_are_damped() -> None:
    A, b = method("DRAWN_STABLE")
    assert max(growth(A, b, -x) for x in np.linspace(0.6, 12.0, 2000)) < 0.5490
    assert growth(*method("DRAWN_CLASSICAL"), -2.79) > 1.0
    # swings and decaying ones, as far as a loop has any at that step
    angles, sizes = np.linspace(np.pi / 2, np.pi, 60), np.linspace(0.05, 2.0, 40)
    assert max(growth(A, b, r * np.exp(1j * a)) for r in sizes for a in angles) < 1.0


def test_the_steps_of_a_page_stay_within_what_is_damped() -> None:
    source = Path(wasm.__file__).with_name("content.py").read_text(encoding="utf-8")
    reach = re.search(r"_COARSE, _DRAWN, _COARSEST_S = ([\d.]+), ([\d.]+)", source)
    assert reach is not None
    classical, stable = float(reach.group(1)), float(reach.group(2))
    assert growth(*method("DRAWN_CLASSICAL"), -classical) < 0.9
    assert growth(*method("DRAWN_STABLE"), -1.04 * stable) < 0.56
