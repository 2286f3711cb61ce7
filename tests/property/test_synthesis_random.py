"""Random plants, badly scaled ones included: every one solved, certified, and at the Riccati optimum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from interarea.design.lmi.solve import solve
from interarea.design.synthesis.generalized_plant import GeneralizedPlant, scaled
from interarea.design.synthesis.hinf import PoleRegion, hinf_region, region_problem


def random_plant(rng: np.random.Generator, *, badly_scaled: bool) -> GeneralizedPlant:
    """One input, two measurements, n = 3..12; about half unstable; states over eight decades."""
    n = int(rng.integers(3, 13))
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() - 0.3 * rng.standard_normal()) * np.eye(n)
    normal = rng.standard_normal
    P = GeneralizedPlant(
        A,
        normal((n, 3)),
        normal((n, 1)),
        normal((2, n)),
        normal((2, n)),
        np.zeros((2, 3)),
        normal((2, 1)),
        normal((2, 3)),
    )
    s = 10.0 ** rng.uniform(-4, 4, n) if badly_scaled else np.ones(n)
    return replace(
        P, A=P.A * s / s[:, None], B1=P.B1 / s[:, None], B2=P.B2 / s[:, None], C1=P.C1 * s, C2=P.C2 * s
    )


FREE = PoleRegion(0.0, None, None)


@pytest.mark.parametrize("count", [6, pytest.param(150, marks=pytest.mark.slow)])
def test_pure_hinf_designs(count: int) -> None:
    """`hinf_region` raises unless its controller passes the check of poles and norm on the closed loop."""
    rng = np.random.default_rng(11)
    solved = agree = 0
    for k in range(count):
        P = random_plant(rng, badly_scaled=bool(k % 2))
        try:
            design = hinf_region(P, FREE)
        except RuntimeError:
            continue
        solved += 1
        lmi = solve(region_problem(scaled(P), FREE, 1e-9)).scalars["gamma"]
        optimum = design.facts["gamma_optimum"]
        assert lmi >= optimum * (1.0 - 1e-6)
        agree += lmi <= optimum * (1.0 + 1e-4)
    assert solved >= 0.98 * count
    assert agree >= 0.95 * count
