r"""A first controller by phase compensation for every loop, mode, operating point and condition at once.

With its poles and inputs fixed a controller is linear in its output gains, :math:`K(s) = C H(s)`, and to
first order every eigenvalue of the open loops moves by

.. math:: \Delta\lambda_k = \sum_{ij} (l_k b_i)\, K_{ij}(\lambda_k)\, (c_j r_k),

its residues times the controller. The gains within bounds that do most for the worst of all these
eigenvalues are a linear programme: what lead and lag with the right sign do for one mode and one loop.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from .smoothed_objective import Array, Objective

#: rad/s between which the poles are drawn, within the bounds of the controller's
SLOWEST, FASTEST = 0.6, 12.0
#: open-loop eigenvalues whose v is lower than the worst by more than this are left out
REGARDED = 0.4
#: the guess's gains are lowered by these factors until the objective is least: first order holds so far only
FACTORS = np.geomspace(1.0, 1e-3, 25)


def first_guess(objective: Objective, rng: np.random.Generator, bound: float) -> Array:
    """Return the parameters of a controller with random real poles and the best gains for them.

    bound : of every output gain, pu per rad/s.
    """
    n, p, m = objective.order, objective.n_y, objective.n_u
    slowest = max(SLOWEST, 1.5 * objective.slowest_pole)
    fastest = max(min(FASTEST, objective.fastest_pole / 1.5), 1.1 * slowest)
    A = -np.diag(np.exp(rng.uniform(np.log(slowest), np.log(fastest), n)))
    A, B, C, _ = objective.unpack(objective.pack(A, rng.normal(size=(n, p)), np.ones((m, n))))
    B = B / np.maximum(np.linalg.norm(B, axis=1, keepdims=True), 1e-9)
    rows, columns = np.nonzero(C)
    moves, worst = [], []
    for model in objective.models:
        values, right = np.linalg.eig(model.A)
        left = np.linalg.inv(right)
        v, dv = objective.excess(values)
        for k in np.flatnonzero((v > v.max() - REGARDED) & (values.imag > 0.0)):
            states = np.linalg.solve(values[k] * np.eye(n) - A, B)
            if objective.dc_block:
                states = states + np.linalg.solve(A, B)
            seen, reached = states @ (model.C @ right[:, k]), left[k] @ model.B
            moves.append((dv[k] * reached[rows] * seen[columns]).real)
            worst.append(v[k])
    # least t with v_k + moves_k c <= t
    G = np.column_stack([np.array(moves), -np.ones(len(worst))])
    found = linprog(
        np.append(np.zeros(rows.size), 1.0),
        A_ub=G,
        b_ub=-np.array(worst),
        bounds=[(-bound, bound)] * rows.size + [(None, None)],
    )
    C = np.zeros((m, n))
    C[rows, columns] = found.x[: rows.size]
    tried = [objective.pack(A, B, factor * C) for factor in FACTORS]
    return tried[int(np.argmin([objective.value(theta) for theta in tried]))]
