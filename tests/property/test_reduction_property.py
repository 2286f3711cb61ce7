"""Laws of reduction on random systems, badly scaled ones included."""

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interarea.design.linear.norms import frequency_response, hinf_norm, hinf_of
from interarea.design.reduction.balanced import balanced_truncation, hankel_reduction, singular_perturbation
from interarea.design.reduction.gramians import difference, matrices


@st.composite
def systems(draw: st.DrawFn) -> control.StateSpace:
    """Stable systems of 2 to 8 states, 1 to 3 inputs and outputs, states scaled over six decades."""
    n, m, p = draw(st.integers(2, 8)), draw(st.integers(1, 3)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    A = rng.normal(size=(n, n)) * 3.0
    A -= (np.max(np.linalg.eigvals(A).real) + 10.0 ** rng.uniform(-1.5, 1)) * np.eye(n)
    d = 10.0 ** rng.uniform(-3, 3, n)
    return control.ss(
        A * d / d[:, None],
        rng.normal(size=(n, m)) / d[:, None],
        rng.normal(size=(p, n)) * d,
        rng.normal(size=(p, m)),
    )


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(systems(), st.data())
def test_errors_lie_between_sigma_and_bound(system: control.StateSpace, data: st.DataObject) -> None:
    order = data.draw(st.integers(0, system.nstates - 1))
    hankel = hankel_reduction(system, order)
    sigma = hankel.hankel_values[order]
    slack = 1e-8 * hankel.hankel_values[0]
    for r in (
        balanced_truncation(system, order),
        singular_perturbation(system, order),
        hankel,
        hankel_reduction(system, order, feedthrough="optimal"),
    ):
        assert r.bound is not None
        assert sigma - slack <= r.error <= r.bound * (1 + 1e-6) + slack
    assert abs(hankel.hankel_error - sigma) <= 1e-6 * sigma + slack * 1e-2


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(systems())
def test_full_order_changes_nothing(system: control.StateSpace) -> None:
    same = balanced_truncation(system, system.nstates)
    assert (
        hinf_of(*difference(matrices(system), matrices(same.system))).value <= 1e-8 * hinf_norm(system).value
    )


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(systems())
def test_no_gain_exceeds_the_norm(system: control.StateSpace) -> None:
    peak = hinf_norm(system).value
    omega = np.concatenate([[0.0], np.geomspace(1e-3, 1e4, 800)])
    gains = np.linalg.norm(frequency_response(*matrices(system), omega), 2, axis=(1, 2))
    assert np.max(gains) <= peak * (1 + 1e-7)
    assert peak <= np.max(gains) * 1.5  # the norm is a gain, not just a bound (grid of 2 % spacing)
