"""Mixed sensitivity with pole region as an LMI `Problem`, on a reproducible family of plants.

    minimise gamma + 1e-3/n tr(X + Y)
    subject to  N = [[X, I], [I, Y]] > 0,  H-infinity norm of w -> z below gamma,
                sector of damping ratio .20 (complex Hermitian, 2n), disk |s| < 300 (real, 4n)

with output feedback in the variables X, Y (symmetric), Ah, Bh, Ch of Scherer, Gahinet and Chilali.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy.linalg

from interarea.design.lmi.problem import BlockLMI, MatrixVariable, Problem, Term

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


def random_plant(seed: int) -> GeneralizedPlant:
    """Return a random plant of 3 to 12 states, every third one possibly far from stable.

    One or two inputs and outputs, D12 and D21 of full rank; every second plant has states scaled
    by up to 1e2 either way.
    """
    rng = np.random.default_rng(seed)
    n, n_u, n_y = (int(rng.integers(low, high)) for low, high in ((3, 13), (1, 3), (1, 3)))
    n_w, n_z = n_y + int(rng.integers(0, 2)), n_u + int(rng.integers(0, 2))
    A = rng.standard_normal((n, n))
    if seed % 3:
        A = A - (np.linalg.eigvals(A).real.max() + rng.uniform(-0.3, 0.5)) * np.eye(n)
    B1, B2 = rng.standard_normal((n, n_w)), rng.standard_normal((n, n_u))
    C1, C2 = rng.standard_normal((n_z, n)), rng.standard_normal((n_y, n))
    D12 = np.vstack([rng.standard_normal((n_z - n_u, n_u)), np.eye(n_u)])
    D21 = np.hstack([rng.standard_normal((n_y, n_w - n_y)), np.eye(n_y)])
    if seed % 2:
        t = 10.0 ** rng.uniform(-2, 2, n)
        A, B1, B2 = A * t[:, None] / t, B1 * t[:, None], B2 * t[:, None]
        C1, C2 = C1 / t, C2 / t
    return GeneralizedPlant(A, B1, B2, C1, C2, np.zeros((n_z, n_w)), D12, D21)


def osborne(plant: GeneralizedPlant) -> GeneralizedPlant:
    """Return the plant in states scaled by powers of two so that rows and columns of [A B; C 0] balance."""
    B, C = np.hstack([plant.B1, plant.B2]), np.vstack([plant.C1, plant.C2])
    s = np.ones(plant.order)
    for _ in range(30):
        for i in range(plant.order):
            A = plant.A * s / s[:, None]
            row = np.hypot(np.linalg.norm(np.delete(A[i], i)), np.linalg.norm(B[i] / s[i]))
            column = np.hypot(np.linalg.norm(np.delete(A[:, i], i)), np.linalg.norm(C[:, i] * s[i]))
            if row > 0.0 and column > 0.0:
                s[i] *= 2.0 ** np.round(0.5 * np.log2(row / column))
    return replace(
        plant,
        A=plant.A * s / s[:, None],
        B1=plant.B1 / s[:, None],
        B2=plant.B2 / s[:, None],
        C1=plant.C1 * s,
        C2=plant.C2 * s,
    )


def _stabilizing(A: Matrix, W: Matrix, Q: Matrix) -> Matrix | None:
    """Return X with A'X + XA + XWX + Q = 0 and A + WX stable, or None."""
    n = len(A)
    H = np.block([[A, W], [-Q, -A.T]])
    H, factors = scipy.linalg.matrix_balance(H, permute=False, separate=True)
    poles = np.linalg.eigvals(H)
    if not np.all(np.isfinite(poles)) or np.abs(poles.real).min() < 1e-11 * np.abs(poles).max():
        return None
    try:
        _, U, stable = scipy.linalg.schur(H, sort="lhp")
    except np.linalg.LinAlgError:
        return None
    U = factors[0][:, None] * U
    if stable != n or np.linalg.cond(U[:n, :n]) > 1e15:
        return None
    X = np.linalg.solve(U[:n, :n].T, U[n:, :n].T)
    return (X + X.T) / 2


def riccati_level(plant: GeneralizedPlant, tolerance: float = 1e-8) -> float:
    """Return the optimal H-infinity norm by bisection on the two Riccati equations (D11 = 0)."""
    A, B1, B2, C1, C2 = plant.A, plant.B1, plant.B2, plant.C1, plant.C2
    R, Rt = np.linalg.inv(plant.D12.T @ plant.D12), np.linalg.inv(plant.D21 @ plant.D21.T)
    Ax, Ay = A - B2 @ R @ plant.D12.T @ C1, A - B1 @ plant.D21.T @ Rt @ C2
    Qx = C1.T @ (np.eye(len(C1)) - plant.D12 @ R @ plant.D12.T) @ C1
    Qy = B1 @ (np.eye(B1.shape[1]) - plant.D21.T @ Rt @ plant.D21) @ B1.T

    def reached(gamma: float) -> bool:
        X = _stabilizing(Ax, B1 @ B1.T / gamma**2 - B2 @ R @ B2.T, Qx)
        Y = _stabilizing(Ay.T, C1.T @ C1 / gamma**2 - C2.T @ Rt @ C2, Qy)
        if X is None or Y is None:
            return False
        least = min(
            np.linalg.eigvalsh(X)[0] / (1 + abs(X).max()), np.linalg.eigvalsh(Y)[0] / (1 + abs(Y).max())
        )
        return bool(least > -1e-9 and np.abs(np.linalg.eigvals(X @ Y)).max() < gamma**2)

    low, high = 1e-6, 1.0
    while not reached(high):
        low, high = high, 2.0 * high
        if high > 1e9:
            raise ValueError("Riccati level: no level below 1e9 is reached; the plant is not stabilizable")
    while high - low > tolerance * high:
        middle = (low + high) / 2.0
        low, high = (low, middle) if reached(middle) else (middle, high)
    return high
