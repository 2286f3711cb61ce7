"""Expressions against matrix arithmetic, regions and norms against closed forms, engines against each."""

from __future__ import annotations

import numpy as np
import pytest

from interarea.design.lmi import regions
from interarea.design.lmi.expressions import Affine, Program, affine, bmat, compile_block, linear, trace
from interarea.design.lmi.problem import BlockLMI, MatrixVariable, Problem
from interarea.design.lmi.solve import elastic, infeasibility, solve, violation

ENGINES = ("structured", "clarabel")


def random_loop(seed: int = 0, n: int = 3) -> tuple[Program, Affine, Affine, dict[str, np.ndarray]]:
    """M and N of an output-feedback problem, and values for its unknowns."""
    rng = np.random.default_rng(seed)
    A, B, C = rng.standard_normal((n, n)), rng.standard_normal((n, 1)), rng.standard_normal((2, n))
    program = Program()
    X, Y = program.symmetric("X", n), program.symmetric("Y", n)
    Ah, Bh, Ch = program.matrix("A^", n, n), program.matrix("B^", n, 2), program.matrix("C^", 1, n)
    M = bmat([[X @ A + Bh @ C, Ah], [A, A @ Y + B @ Ch]])
    N = bmat([[X, np.eye(n)], [np.eye(n), Y]])
    values = {k: rng.standard_normal(s) for k, s in {"A^": (n, n), "B^": (n, 2), "C^": (1, n)}.items()}
    for k in ("X", "Y"):
        V = rng.standard_normal((n, n))
        values[k] = V + V.T
    return program, M, N, values


@pytest.mark.parametrize("name", ["sector", "disk", "shift", "strip"])
def test_compiled_block_equals_the_formula(name: str) -> None:
    _, M, N, values = random_loop()
    expression = {
        "sector": lambda: regions.sector(M, 0.3),
        "disk": lambda: regions.disk(M, N, 7.0),
        "shift": lambda: regions.shift(M, N, 0.4),
        "strip": lambda: regions.strip(M, N, 5.0),
    }[name]()
    block = compile_block(name, expression)
    np.testing.assert_allclose(block.value(values, {}), expression.value(values), atol=1e-12)


def test_a_closed_loop_compiles_to_one_term_per_variable() -> None:
    _, M, _, _ = random_loop()
    block = compile_block("sector", regions.sector(M, 0.3))
    assert sorted(t.variable for t in block.terms) == ["A^", "B^", "C^", "X", "Y"]


def test_transpose_conjugate_scale_and_sum_act_as_on_matrices() -> None:
    _, M, N, values = random_loop(1)
    m, n = M.value(values), N.value(values)
    f = 0.3 + 0.7j
    expression = (f * M).H - 2.0 * N.T + M / 4.0
    np.testing.assert_allclose(expression.value(values), (f * m).conj().T - 2.0 * n.T + m / 4.0, atol=1e-12)


def test_real_form_has_every_eigenvalue_twice() -> None:
    _, M, _, values = random_loop(2)
    block = compile_block("sector", regions.sector(M, 0.3))
    once = np.linalg.eigvalsh(block.value(values, {}))
    twice = np.linalg.eigvalsh(regions.real_form(block).value(values, {}))
    np.testing.assert_allclose(np.sort(np.repeat(once, 2)), twice, atol=1e-10)


def test_complex_sector_agrees_with_the_printed_real_one() -> None:
    _, M, _, values = random_loop(3)
    zeta = 0.3
    s, c = np.sqrt(1 - zeta**2), zeta
    m = M.value(values)
    printed = -np.block([[s * (m + m.T), c * (m - m.T)], [c * (m.T - m), s * (m + m.T)]])
    ours = np.linalg.eigvalsh(regions.sector(M, zeta).value(values))
    np.testing.assert_allclose(np.sort(np.repeat(ours, 2)), np.linalg.eigvalsh(printed), atol=1e-10)


def test_product_of_unknowns_is_refused() -> None:
    program = Program()
    X, Y = program.symmetric("X", 2), program.symmetric("Y", 2)
    with pytest.raises(ValueError, match="bilinear"):
        X @ Y


def test_sign_slip_is_seen() -> None:
    program = Program()
    V = program.matrix("V", 2, 2)
    with pytest.raises(ValueError, match="not Hermitian"):
        program.require("slip", bmat([[np.eye(2), V], [-V.T, np.eye(2)]]))


@pytest.mark.parametrize(
    ("block", "word"),
    [
        (BlockLMI("b", np.array([[1.0, np.nan], [np.nan, 1.0]]), ()), "finite"),
        (BlockLMI("b", np.array([[1.0, 2.0], [0.0, 1.0]]), ()), "not Hermitian"),
        (BlockLMI("b", np.eye(2), (), {"g": np.eye(2)}), "unknown scalars"),
    ],
)
def test_problem_refuses_bad_data(block: BlockLMI, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        Problem((MatrixVariable("V", 2, 2, True),), (), (block,))


def poles_feasible(A: np.ndarray, make: object, engine: str) -> bool:
    """Whether a Lyapunov matrix proves a region for A."""
    program = Program()
    P = program.symmetric("P", A.shape[0])
    program.require("size", P - np.eye(A.shape[0]))
    program.require("region", make(P @ A, P))  # type: ignore[operator]
    program.minimise(trace(P))
    problem = program.problem()
    solution = solve(problem, engine)
    return solution.status in ("optimal", "almost optimal") and violation(problem, solution) < 1e-7


@pytest.mark.parametrize("engine", ENGINES)
def test_regions_hold_just_inside_and_fail_just_outside(engine: str) -> None:
    w, z = 3.0, 0.2
    height = w * np.sqrt(1 - z**2)
    A = np.array([[0.0, 1.0], [-(w**2), -2 * z * w]])
    for f, expected in ((0.97, True), (1.03, False)):
        makes = (
            lambda M, N, f=f: regions.sector(M, z * f),
            lambda M, N, f=f: regions.shift(M, N, z * w * f),
            lambda M, N, f=f: regions.disk(M, N, w / f),
            lambda M, N, f=f: regions.strip(M, N, height / f),
        )
        assert [poles_feasible(A, make, engine) for make in makes] == [expected] * 4


@pytest.mark.parametrize("engine", ENGINES)
def test_hinf_norm_of_a_resonance(engine: str) -> None:
    """Peak of w^2 / (s^2 + 2 z w s + w^2) is 1 / (2 z sqrt(1 - z^2))."""
    z = 0.1
    A, B, C = np.array([[0.0, 1.0], [-1.0, -2 * z]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    program = Program()
    P, g = program.symmetric("P", 2), program.scalar("g")
    program.require("P", P)
    program.require("norm", regions.hinf(P @ A, P @ B, affine(C), np.zeros((1, 1)), g))
    program.minimise(g)
    solution = solve(program.problem(), engine)
    assert solution.scalars["g"] == pytest.approx(1 / (2 * z * np.sqrt(1 - z**2)), rel=1e-5)


def test_engines_agree_and_multipliers_close_the_gap() -> None:
    program, M, N, _ = random_loop(4, 2)
    program.require("Lyapunov matrix", N)
    program.require("sector", regions.sector(M, 0.3))
    program.require("disk", regions.disk(M, N, 30.0))
    objective = {v.name: np.eye(v.rows) for v in program.problem().variables if v.symmetric}
    problem = Problem(**{**program.problem().__dict__, "objective_matrices": objective})
    one, other = solve(problem, "structured"), solve(problem, "clarabel")
    assert one.objective == pytest.approx(other.objective, rel=1e-4)
    for solution in (one, other):
        assert violation(problem, solution) < 1e-7
        assert solution.multipliers is not None
        gap = 0.0
        for Z, block in zip(solution.multipliers, problem.blocks, strict=True):
            assert np.linalg.eigvalsh(Z)[0] > -1e-6 * np.abs(Z).max()
            gap += np.vdot(Z, block.value(solution.values, solution.scalars)).real
        assert abs(gap) < 1e-4 * (1 + abs(solution.objective))


@pytest.mark.parametrize("engine", ENGINES)
def test_infeasible_problem_is_recognised_with_its_distance(engine: str) -> None:
    """v >= 1 and v <= 0: the elastic problem min t, v >= 1 - t, v <= t has t = 1/2."""
    program = Program()
    V = program.symmetric("V", 1)
    program.require("above", V - np.eye(1))
    program.require("below", -V)
    program.minimise(trace(V))
    problem = program.problem()
    assert solve(problem, engine).status == "infeasible"
    assert infeasibility(problem, engine) == pytest.approx(0.5, abs=1e-5)
    assert elastic(problem).scalars == ("t",)


def test_unknown_engine_is_named() -> None:
    program = Program()
    g = program.scalar("g")
    program.require("g", g * np.eye(1))
    program.minimise(linear(g))
    with pytest.raises(ValueError, match="structured, clarabel"):
        solve(program.problem(), "magic")
