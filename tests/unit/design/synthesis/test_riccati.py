"""The Riccati equations against a closed form, their own closed loop, and the LMIs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from interarea.design.errors import InfeasibleDesign
from interarea.design.linear.norms import hinf_of
from interarea.design.lmi.solve import solve
from interarea.design.synthesis.generalized_plant import GeneralizedPlant, scaled
from interarea.design.synthesis.hinf import PoleRegion, hinf_region, region_problem
from interarea.design.synthesis.riccati import hinf_riccati

FREE = PoleRegion(0.0, None, None)


def least_by_lmi(P: GeneralizedPlant) -> float:
    """The least norm by semidefinite programming, the traces weighed with 1e-9."""
    return solve(region_problem(scaled(P), FREE, 1e-9)).scalars["gamma"]


def scalar_plant(a: float) -> GeneralizedPlant:
    """x' = a x + w1 + u, z = (x, u), y = x + w2."""
    one, zero = np.ones((1, 1)), np.zeros((1, 1))
    return GeneralizedPlant(
        A=a * one,
        B1=np.hstack([one, zero]),
        B2=one,
        C1=np.vstack([one, zero]),
        C2=one,
        D11=np.zeros((2, 2)),
        D12=np.vstack([zero, one]),
        D21=np.hstack([zero, one]),
    )


def random_plant(seed: int, *, d11: bool = False) -> GeneralizedPlant:
    """A plant with one input, two measurements; unstable about half the time."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 9))
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() - 0.3 * rng.standard_normal()) * np.eye(n)
    return GeneralizedPlant(
        A=A,
        B1=rng.standard_normal((n, 3)),
        B2=rng.standard_normal((n, 1)),
        C1=rng.standard_normal((2, n)),
        C2=rng.standard_normal((2, n)),
        D11=0.3 * d11 * rng.standard_normal((2, 3)),
        D12=rng.standard_normal((2, 1)),
        D21=rng.standard_normal((2, 3)),
    )


@pytest.mark.parametrize("a", [-1.0, 0.0, 1.0])
def test_scalar_optimum(a: float) -> None:
    """X = Y = gamma at the optimum of the two scalar Riccati equations: gamma = a + sqrt(a^2 + 2)."""
    exact = a + np.sqrt(a**2 + 2.0)
    assert hinf_riccati(scalar_plant(a)).gamma == pytest.approx(exact, rel=1e-6)
    assert least_by_lmi(scalar_plant(a)) == pytest.approx(exact, rel=1e-5)


@pytest.mark.parametrize("seed", range(6))
def test_central_controller_attains_its_level(seed: int) -> None:
    P = random_plant(seed, d11=True)
    K = hinf_riccati(P, tolerance=1e-3)
    A = np.block([[P.A + P.B2 @ K.D @ P.C2, P.B2 @ K.C], [K.B @ P.C2, K.A]])
    B = np.vstack([P.B1 + P.B2 @ K.D @ P.D21, K.B @ P.D21])
    C = np.hstack([P.C1 + P.D12 @ K.D @ P.C2, P.D12 @ K.C])
    assert hinf_of(A, B, C, P.D11 + P.D12 @ K.D @ P.D21).value <= K.gamma * (1 + 1e-5)


@pytest.mark.parametrize("seed", range(10, 20))
def test_lmi_and_riccati_agree(seed: int) -> None:
    """Two ways to the same optimum; the LMI's may not be below it, and its controller passes its check."""
    P = random_plant(seed)
    design = hinf_region(P, FREE)
    optimum, lmi = design.facts["gamma_optimum"], least_by_lmi(P)
    assert lmi == pytest.approx(optimum, rel=1e-4)
    assert lmi >= optimum * (1 - 1e-6)
    assert design.engine == "Riccati equations" and design.solves == 0
    assert optimum * (1 - 1e-6) <= design.norm_of["normal"] <= design.gamma * (1 + 1e-6)
    assert design.gamma <= optimum * (1 + 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10, 14))
def test_the_weight_of_the_traces_leaves_the_norm_alone(seed: int) -> None:
    """A disk of 1e4 rad/s holds every pole: by LMIs, within 3e-4 of the optimum without it."""
    P = random_plant(seed)
    design = hinf_region(P, PoleRegion(0.0, None, 1e4))
    assert design.engine == "structured"
    assert 1 - 1e-6 <= design.facts["gamma_optimum"] / hinf_riccati(P).gamma <= 1 + 3e-4


def test_a_singular_problem_goes_to_the_lmis() -> None:
    design = hinf_region(replace(scalar_plant(-1.0), D12=np.zeros((2, 1))), FREE)
    assert design.engine == "structured"


def test_feedthrough_that_asks_for_one_of_the_controller_goes_to_the_lmis() -> None:
    """The central controller has D_K not zero, which the loop here forbids: the LMIs have the larger norm."""
    P = random_plant(3, d11=True)
    design = hinf_region(P, FREE)
    assert design.engine == "structured" and not design.controller.D.any()
    assert design.facts["gamma_optimum"] >= hinf_riccati(P).gamma * (1 - 1e-6)


@pytest.mark.parametrize("cap", [1.0, 3.0])
def test_the_cap_holds_without_a_region_too(cap: float) -> None:
    """The optimum of a = 1 is 1 + sqrt(3)."""
    if cap > 1.0 + np.sqrt(3.0):
        assert hinf_region(scalar_plant(1.0), FREE, gamma_cap=cap).norm_of["normal"] <= cap
        return
    with pytest.raises(InfeasibleDesign, match=r"the least norm .* is 2\.732, allowed is 1"):
        hinf_region(scalar_plant(1.0), FREE, gamma_cap=cap)


def test_singular_problem_is_regularised_and_says_so() -> None:
    P = replace(scalar_plant(-1.0), D12=np.zeros((2, 1)), D21=np.zeros((1, 2)))
    design = hinf_riccati(P)
    assert "D12" in design.note and "D21" in design.note
    assert design.gamma > 0.0


def test_unstabilizable_plant_is_refused() -> None:
    with pytest.raises(ValueError, match="stabilizable"):
        hinf_riccati(replace(scalar_plant(1.0), B2=np.zeros((1, 1))))
