r"""First guess of a controller: phase compensation for all loops, modes, operating points and conditions.

With its poles and inputs fixed a controller is linear in its output gains, :math:`K(s) = C H(s)`, and to
first order every eigenvalue of the open loops moves by

.. math:: \Delta\lambda_k = \sum_{ij} (l_k b_i)\, K_{ij}(\lambda_k)\, (c_j r_k),

its residues times the controller. A linear programme gives the bounded gains that improve the worst of these
eigenvalues most: a generalisation of lead-lag compensation of one mode by one loop. With its poles and
outputs fixed it is linear in its input gains too. Where a part has more than two signals, a second programme
determines these gains: it finds the sum of signals in which other modes cancel, and of which any one may be
lost; few random sums are near it. The better of the two is the guess.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from .smoothed_objective import Array, Objective

#: rad/s between which the poles are drawn, within the bounds of the controller's
SLOWEST, FASTEST = 0.6, 12.0
#: open-loop eigenvalues whose v is lower than the worst by more than this are left out
REGARDED = 0.4
#: signals of a part whose sums the drawn inputs of its states cover well enough
COVERED = 2
#: the guess's gains are lowered by these factors until the objective is least: first order holds so far only
FACTORS = np.geomspace(1.0, 1e-3, 25)


def first_guess(objective: Objective, rng: np.random.Generator, bound: float) -> Array:
    """Return the parameters of a controller with random real poles and the best gains for them.

    bound : of every gain, pu per rad/s.
    """
    n, p, m = objective.order, objective.n_y, objective.n_u
    slowest = max(SLOWEST, 1.5 * objective.slowest_pole)
    fastest = max(min(FASTEST, objective.fastest_pole / 1.5), 1.1 * slowest)
    poles = np.exp(rng.uniform(np.log(slowest), np.log(fastest), n))
    A, B, C, _ = objective.unpack(objective.pack(-np.diag(poles), rng.normal(size=(n, p)), np.ones((m, n))))
    drawn = B / np.maximum(np.linalg.norm(B, axis=1, keepdims=True), 1e-9)
    moves, worst = _moves(objective, poles)
    outputs, inputs = C != 0.0, B != 0.0
    best = np.zeros_like(C)
    best[outputs] = _best(np.einsum("ksij,sj->kis", moves, drawn)[:, outputs], worst, bound)
    guesses = [objective.pack(A, drawn, factor * best) for factor in FACTORS]
    if inputs.sum(axis=1).max() > COVERED:
        best = np.zeros_like(B)
        best[inputs] = _best(np.einsum("ksij,is,s->ksj", moves, C, poles)[:, inputs], worst, bound)
        # a state's share is as large as its input gain over its pole
        guesses += [objective.pack(A, factor * poles[:, None] * best, C) for factor in FACTORS]
    return guesses[int(np.argmin([objective.value(theta) for theta in guesses]))]


def _moves(objective: Objective, poles: Array) -> tuple[Array, Array]:
    """Return dv (k, states, outputs, inputs) by C_is B_sj to first order, and v (k,) of the open loops."""
    moves, worst = [], []
    for model in objective.models:
        values, right = np.linalg.eig(model.A)
        left = np.linalg.inv(right)
        (v,), (dv,) = objective.excess(values[None], [model])
        # v, then w, of every eigenvalue
        for row in np.flatnonzero((v > v.max() - REGARDED) & (np.tile(values, 2).imag > 0.0)):
            k = row % values.size
            states = 1.0 / (values[k] + poles)
            if objective.dc_block:
                states = states - 1.0 / poles
            residues = np.outer(left[k] @ model.B, model.C @ right[:, k])
            moves.append((dv[row] * states[:, None, None] * residues).real)
            worst.append(v[row])
    return np.array(moves), np.array(worst)


def _best(moves: Array, worst: Array, bound: float) -> Array:
    """Return the gains within `bound` of the least t with worst_k + moves_k gains <= t."""
    count = moves.shape[1]
    result = linprog(
        np.append(np.zeros(count), 1.0),
        A_ub=np.column_stack([moves, -np.ones(len(worst))]),
        b_ub=-worst,
        bounds=[(-bound, bound)] * count + [(None, None)],
    )
    return np.asarray(result.x[:count])
