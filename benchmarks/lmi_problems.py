"""Mixed sensitivity with pole region as an LMI `Problem`, on a reproducible family of plants.

    minimise gamma + 1e-3/n tr(X + Y)
    subject to  N = [[X, I], [I, Y]] > 0,  H-infinity norm of w -> z below gamma,
                sector of damping ratio .20 (complex Hermitian, 2n), disk |s| < 300 (real, 4n)

with output feedback in the variables X, Y (symmetric), Ah, Bh, Ch of Scherer, Gahinet and Chilali.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from interarea.design.problem import BlockLMI, MatrixVariable, Problem, Term

Matrix = npt.NDArray[np.float64]

#: Orders of the family that the benchmark solves.
ORDERS = (6, 8, 11, 14, 16, 20, 30)


@dataclass(frozen=True)
class GeneralizedPlant:
    """dx = A x + B1 w + B2 u, z = C1 x + D11 w + D12 u, y = C2 x + D21 w."""

    A: Matrix
    B1: Matrix
    B2: Matrix
    C1: Matrix
    C2: Matrix
    D11: Matrix
    D12: Matrix
    D21: Matrix

    @property
    def order(self) -> int:
        return int(self.A.shape[0])


def sensitivity_plant(order: int, seed: int = 0) -> GeneralizedPlant:
    """Return a lightly damped plant with the weight of mixed sensitivity, `order` states in all.

    Two or three swing modes between .4 and 1.6 Hz with damping ratios .03-.12; the other poles
    are real, as of exciters and filters. One input, one output; w enters at the output, z is
    the output behind W1 = 10 / (s + 10) and .1 of the input.
    """
    rng = np.random.default_rng(1000 * order + seed)
    n_plant = order - 1
    modes = min(2 if order < 11 else 3, n_plant // 2)
    A = np.diag(-rng.uniform(1.0, 20.0, n_plant))
    frequencies = 2 * np.pi * np.linspace(0.4, 1.6, modes) * rng.uniform(0.9, 1.1, modes)
    for k, w in enumerate(frequencies):
        zeta = rng.uniform(0.03, 0.12)
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[-zeta * w, w], [-w, -zeta * w]]
    T = np.linalg.qr(rng.standard_normal((n_plant, n_plant)))[0]
    A = T @ A @ T.T
    B = T @ rng.uniform(0.5, 1.5, (n_plant, 1)) * np.sqrt(2.0 / n_plant)
    C = rng.uniform(0.5, 1.5, (1, n_plant)) @ T.T * np.sqrt(2.0 / n_plant)
    corner = 10.0
    full = np.block([[A, np.zeros((n_plant, 1))], [corner * C, -corner * np.ones((1, 1))]])
    return GeneralizedPlant(
        A=full,
        B1=np.vstack([np.zeros((n_plant, 1)), [[corner]]]),
        B2=np.vstack([B, [[0.0]]]),
        C1=np.vstack([np.append(np.zeros(n_plant), 1.0), np.zeros(order)]),
        C2=np.hstack([C, [[0.0]]]),
        D11=np.zeros((2, 1)),
        D12=np.array([[0.0], [0.1]]),
        D21=np.ones((1, 1)),
    )


def output_feedback_problem(
    plant: GeneralizedPlant,
    *,
    damping_ratio: float | None = 0.20,
    radius: float | None = 300.0,
    weight: float = 1e-3,
) -> Problem:
    """Return the synthesis LMIs of a plant; `damping_ratio` or `radius` None leaves that region out."""
    A, B1, B2, C1, C2 = plant.A, plant.B1, plant.B2, plant.C1, plant.C2
    n, n_w, n_u, n_z, n_y = plant.order, B1.shape[1], B2.shape[1], C1.shape[0], C2.shape[0]
    O = np.zeros((n, n))
    E1, E2 = np.vstack([np.eye(n), O]), np.vstack([O, np.eye(n)])
    N = BlockLMI(
        "N", np.block([[O, np.eye(n)], [np.eye(n), O]]), (Term("X", E1 / 2, E1.T), Term("Y", E2 / 2, E2.T))
    )
    blocks = [N]

    size = 2 * n + n_w + n_z
    e1, e2 = np.eye(size)[:, :n], np.eye(size)[:, n : 2 * n]
    constant = np.zeros((size, size))
    constant[:n, n : 2 * n] = 0.0
    constant[n : 2 * n, :n] = -A
    constant[n : 2 * n, 2 * n : 2 * n + n_w] = -B1
    constant[2 * n + n_w :, :n] = -C1
    constant[2 * n + n_w :, 2 * n : 2 * n + n_w] = -plant.D11
    constant = constant + constant.T
    blocks.append(
        BlockLMI(
            "H-infinity",
            constant,
            (
                Term("X", -e1, np.hstack([A, O, B1, np.zeros((n, n_z))])),
                Term("Bh", -e1, np.hstack([C2, np.zeros((n_y, n)), plant.D21, np.zeros((n_y, n_z))])),
                Term("Ah", -e1, e2.T),
                Term("Y", -np.vstack([np.zeros((n, n)), A, np.zeros((n_w, n)), C1]), e2.T),
                Term("Ch", -np.vstack([np.zeros((n, n_u)), B2, np.zeros((n_w, n_u)), plant.D12]), e2.T),
            ),
            {"gamma": np.diag(np.r_[np.zeros(2 * n), np.ones(n_w + n_z)])},
        )
    )

    if damping_ratio is not None:
        f = np.sqrt(1.0 - damping_ratio**2) + 1j * damping_ratio
        K = np.block([[O, O], [A, O]]).astype(complex)
        blocks.append(
            BlockLMI(
                "sector",
                -(f * K + (f * K).conj().T),
                (
                    Term("X", -f * E1, np.hstack([A, O])),
                    Term("Bh", -f * E1, np.hstack([C2, np.zeros((n_y, n))])),
                    Term("Ah", -f * E1, E2.T),
                    Term("Y", -f * np.vstack([O, A]), E2.T),
                    Term("Ch", -f * np.vstack([np.zeros((n, n_u)), B2]), E2.T),
                ),
            )
        )

    if radius is not None:
        F = [np.eye(4 * n)[:, k * n : (k + 1) * n] for k in range(4)]
        half = radius / 2.0
        K4 = np.zeros((4 * n, 4 * n))
        K4[:n, n : 2 * n] = radius * np.eye(n)
        K4[2 * n : 3 * n, 3 * n :] = radius * np.eye(n)
        K4[n : 2 * n, 2 * n : 3 * n] = -A
        blocks.append(
            BlockLMI(
                "disk",
                K4 + K4.T,
                (
                    Term("X", F[0], np.hstack([half * np.eye(n), O, -A, O])),
                    Term("X", half * F[2], F[2].T),
                    Term("Y", F[1] * half, F[1].T),
                    Term("Y", np.vstack([O, -A, O, half * np.eye(n)]), F[3].T),
                    Term("Ah", -F[0], F[3].T),
                    Term("Bh", -F[0], C2 @ F[2].T),
                    Term("Ch", -F[1] @ B2, F[3].T),
                ),
            )
        )
    return Problem(
        variables=(
            MatrixVariable("X", n, n, True),
            MatrixVariable("Y", n, n, True),
            MatrixVariable("Ah", n, n, False),
            MatrixVariable("Bh", n, n_y, False),
            MatrixVariable("Ch", n_u, n, False),
        ),
        scalars=("gamma",),
        blocks=tuple(blocks),
        objective_matrices={"X": weight / n * np.eye(n), "Y": weight / n * np.eye(n)},
        objective_scalars={"gamma": 1.0},
    )
