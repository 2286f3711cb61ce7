"""The second solver: agreement is measured, disagreement is an error, silence is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from interarea.cosim.study.second_solver import compared
from interarea.design.errors import SolverError
from interarea.design.lmi.expressions import Program, trace
from interarea.design.lmi.problem import Problem
from interarea.design.lmi.solve import recorded, solve


def lyapunov() -> Problem:
    """min trace X with A X + X A' + I <= 0: for A = -I the optimum is X = I / 2, trace 1.5."""
    program = Program()
    X = program.symmetric("X", 3)
    program.require("positive", X)
    program.require("Lyapunov", 2.0 * X - np.eye(3))
    program.minimise(trace(X))
    return program.problem()


def test_both_find_the_closed_form() -> None:
    problem = lyapunov()
    with recorded() as record:
        first = solve(problem)
    assert record == [(problem, first)]
    row = compared("x", 1, problem, first)
    assert row["objective"] == pytest.approx([1.5, 1.5], abs=1e-5)
    assert abs(row["difference"]) < 1e-5 and row["status"] == "optimal" and row["unknowns"] == 6
    assert max(row["violation"]) < 1e-6


def test_a_disagreement_is_an_error() -> None:
    problem = lyapunov()
    first = solve(problem)
    with pytest.raises(SolverError, match=r"x, LMI 2: .* 1\.4.*allowed is 0\.001"):
        compared("x", 2, problem, replace(first, objective=1.49))


def test_no_answer_in_time_is_said() -> None:
    problem = lyapunov()
    row = compared("x", 1, problem, solve(problem), time_limit_s=1e-9)
    assert row["status"].startswith("no answer") and row["difference"] is None
    assert row["objective"][1] is None and row["violation"][1] is None


def test_nothing_is_recorded_outside_the_block() -> None:
    with recorded() as record:
        pass
    solve(lyapunov())
    assert record == []
