"""Which plants H-infinity design takes, which it refuses, and the least norm, over plants of 2 to 20 states.

The aircraft follow AC1 [Hung1982], AC4 and AC11 [Sobel1985] of the COMPleib collection; their digits were not
compared with the print. No expectation is taken from there: the optimum is computed here by another path.
Weights are those of the standard problem: noise on every state and measurement, cost of both.
"""

from __future__ import annotations

import numpy as np
import pytest
from independent.game_riccati import optimum

from interarea.design.errors import InfeasibleDesign
from interarea.design.synthesis.check import modal_parts, modal_shares
from interarea.design.synthesis.generalized_plant import GeneralizedPlant
from interarea.design.synthesis.hinf import PoleRegion, hinf_region

Plant = tuple[np.ndarray, np.ndarray, np.ndarray]
FREE = PoleRegion(0.0, None, None)


def standard(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> GeneralizedPlant:
    """w = (state noise, measurement noise), z = (states, controls)."""
    n, m, p = len(A), B.shape[1], len(C)
    return GeneralizedPlant(
        A=A,
        B1=np.hstack([np.eye(n), np.zeros((n, p))]),
        B2=B,
        C1=np.vstack([np.eye(n), np.zeros((m, n))]),
        C2=C,
        D11=np.zeros((n + m, n + p)),
        D12=np.vstack([np.zeros((n, m)), np.eye(m)]),
        D21=np.hstack([np.zeros((p, n)), np.eye(p)]),
    )


AIRCRAFT: dict[str, Plant] = {
    "AC1": (
        np.array(
            [
                [0.0, 0.0, 1.132, 0.0, -1.0],
                [0.0, -0.0538, -0.1712, 0.0, 0.0705],
                [0.0, 0.0, 0.0, 1.0, 0.0],
                [0.0, 0.0485, 0.0, -0.8556, -1.013],
                [0.0, -0.2909, 0.0, 1.0532, -0.6859],
            ]
        ),
        np.array(
            [[0.0, 0.0, 0.0], [-0.12, 1.0, 0.0], [0.0, 0.0, 0.0], [4.419, 0.0, -1.665], [1.575, 0.0, -0.0732]]
        ),
        np.eye(3, 5),
    ),
    "AC4": (
        np.array([[-0.876, 1.0, -0.1209], [8.9117, 0.0, -130.75], [0.0, 0.0, -150.0]]),
        np.array([[0.0], [0.0], [150.0]]),
        -np.eye(2, 3),
    ),
    "AC11": (
        np.array(
            [
                [-1.341, 0.9933, 0.0, -0.1689, -0.2518],
                [43.223, -0.8693, 0.0, -17.251, -1.5766],
                [1.341, 0.0067, 0.0, 0.1689, 0.2518],
                [0.0, 0.0, 0.0, -20.0, 0.0],
                [0.0, 0.0, 0.0, 0.0, -20.0],
            ]
        ),
        np.vstack([np.zeros((3, 2)), 20.0 * np.eye(2)]),
        np.array([[0.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, 0.0]]),
    ),
}


def chain(n: int, pole: float = 0.0) -> Plant:
    """n equal poles in a row: one defective eigenvalue of multiplicity n."""
    return pole * np.eye(n) + np.eye(n, k=1), np.eye(n)[:, -1:], np.eye(1, n)


def beside(one: Plant, other: Plant) -> Plant:
    """Two plants that share nothing."""
    blocks = []
    for a, b in zip(one, other, strict=True):
        M = np.zeros((a.shape[0] + b.shape[0], a.shape[1] + b.shape[1]))
        M[: a.shape[0], : a.shape[1]], M[a.shape[0] :, a.shape[1] :] = a, b
        blocks.append(M)
    return blocks[0], blocks[1], blocks[2]


def random_plant(seed: int) -> Plant:
    """2 to 20 states, half of the plants unstable, in states that are mixed at random."""
    rng = np.random.default_rng(seed)
    n = 2 + seed % 19
    A = rng.standard_normal((n, n))
    A += (0.2 * rng.standard_normal() - np.linalg.eigvals(A).real.max()) * np.eye(n)
    return A, rng.standard_normal((n, 1 + seed % 2)), rng.standard_normal((1 + seed % 3, n))


def mixed(plant: Plant, seed: int) -> Plant:
    """The same plant in other states."""
    T = np.linalg.qr(np.random.default_rng(seed).standard_normal(plant[0].shape))[0]
    return T.T @ plant[0] @ T, T.T @ plant[1], plant[2] @ T


#: all can be stabilised
TAKEN: dict[str, Plant] = {
    **AIRCRAFT,
    "integrator": chain(1),
    "double integrator": chain(2),
    "triple integrator": chain(3),
    "two double integrators": beside(chain(2), chain(2)),
    "two double integrators, mixed": mixed(beside(chain(2), chain(2)), 1),
    "equal unstable poles": chain(3, 0.5),
    "equal stable poles beside an integrator": mixed(beside(chain(3, -1.0), chain(1)), 2),
    **{f"random {seed}": random_plant(seed) for seed in range(17)},
}


def hidden(plant: Plant, pole: float, seed: int, *, seen: bool) -> Plant:
    """The plant with one more state, which the input does not reach or (`seen` false) no output shows."""
    A, B, C = plant
    rng = np.random.default_rng(seed)
    n, m, p = len(A), B.shape[1], len(C)
    bigger = np.zeros((n + 1, n + 1))
    bigger[:n, :n], bigger[n, n] = A, pole
    if seen:
        bigger[:n, n] = rng.standard_normal(n)
    else:
        bigger[n, :n] = rng.standard_normal(n)
    into = np.vstack([B, (not seen) * rng.standard_normal((1, m))])
    return mixed((bigger, into, np.hstack([C, seen * rng.standard_normal((p, 1))])), seed)


#: an eigenvalue at 0 or to the right of it stays where it is
REFUSED: dict[str, Plant] = {
    **{f"not reached {s}": hidden(random_plant(s), 0.3, s, seen=True) for s in (1, 4, 7, 12)},
    **{f"not seen {s}": hidden(random_plant(s), 0.3, s, seen=False) for s in (2, 5, 9, 14)},
    "integrator not reached": hidden(AIRCRAFT["AC4"], 0.0, 3, seen=True),
    "integrator not seen, beside others": hidden(AIRCRAFT["AC1"], 0.0, 4, seen=False),
}


@pytest.mark.parametrize("name", TAKEN)
def test_the_least_norm_is_that_of_another_solver(name: str) -> None:
    P = standard(*TAKEN[name])
    design = hinf_region(P, FREE)
    least = optimum(P.A, P.B1, P.B2, P.C1, P.C2)
    assert design.facts["gamma_optimum"] == pytest.approx(least, rel=1e-6)
    assert least * (1.0 - 1e-6) <= design.norm_of["normal"] <= least * (1.0 + 1e-3)
    assert design.poles_of["normal"].real.max() < 0.0


@pytest.mark.parametrize("name", REFUSED)
def test_a_mode_that_stays_is_refused(name: str) -> None:
    with pytest.raises(InfeasibleDesign, match="cannot be moved") as error:
        hinf_region(standard(*REFUSED[name]), FREE)
    assert error.value.constraint == "controllability"


def test_reach_does_not_depend_on_units_of_states_inputs_or_outputs() -> None:
    A, B, C = AIRCRAFT["AC11"]
    s = np.array([1e4, 1e-3, 1.0, 1e2, 1e-4])
    for mode in np.linalg.eigvals(A):
        plain = modal_parts(A, B, C, complex(mode))
        other = modal_parts(A * s / s[:, None], 1e-6 * B / s[:, None], 1e5 * C * s, complex(mode))
        assert min(plain) > 0.01 and min(other) > 1e-3


def test_an_integrator_does_not_hide_the_other_modes() -> None:
    """The gain of a mode at 0 has no bound; as a share of it every other mode was without reach."""
    values, shares = modal_shares(*AIRCRAFT["AC11"])
    assert np.all(shares[np.abs(values) > 1e-6] > 1e-6)
