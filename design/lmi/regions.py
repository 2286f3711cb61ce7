r"""Regions for closed-loop poles and bounds on closed-loop norms, as matrix inequalities.

With the change of variables of [Scherer1997] the closed loop appears only as

    M = Pi' P A_cl Pi,   N = Pi' P Pi,   Bw = Pi' P B_cl,   Cz = C_cl Pi,   D = D_cl,

so each specification is one expression in M, N, Bw, Cz, D that must be >= 0.
The same functions serve analysis: with Pi = I take M = P A, N = P, Bw = P B,
Cz = C. Pole regions follow [Chilali1996]; every function returns the
expression to hand to `Program.require`. Sectors and strips are complex
Hermitian of the size of M, half that of the real form, with the same
eigenvalues (once instead of twice); `real_form` doubles any of them.
"""

from __future__ import annotations

import numpy as np

from .expressions import Affine, Scalar, affine, bmat
from .problem import BlockLMI, Matrix, Term


def sector(M: Affine, damping_ratio: float) -> Affine:
    r"""Poles at least as damped as `damping_ratio`: the sector of half-angle t, cos t = zeta.

    .. math:: -(f M + \bar f M^T) \succeq 0, \qquad f = \sin t + j \cos t

    which has the eigenvalues of the real form
    ``[[sin t (M + M'), cos t (M - M')], [cos t (M' - M), sin t (M + M')]] < 0``.

    Raises
    ------
    ValueError
        If not 0 <= damping_ratio < 1.
    """
    if not 0.0 <= damping_ratio < 1.0:
        raise ValueError(f"sector: damping_ratio is {damping_ratio}, allowed: 0 <= zeta < 1")
    f = complex(np.sqrt(1.0 - damping_ratio**2), damping_ratio)
    if damping_ratio == 0.0:
        return -(M + M.T)
    return -(f * M + f.conjugate() * M.T)


def shift(M: Affine, N: Affine, rate: float) -> Affine:
    """Poles left of -rate (1/s): ``-(M + M' + 2 rate N) >= 0``."""
    if not np.isfinite(rate):
        raise ValueError(f"shift: rate is {rate}, wanted a finite number in 1/s")
    return -(M + M.T + 2.0 * rate * N)


def disk(M: Affine, N: Affine, radius: float) -> Affine:
    """Poles inside |s| < radius (rad/s): ``[[r N, -M], [-M', r N]] >= 0``."""
    if not radius > 0.0:
        raise ValueError(f"disk: radius is {radius}, wanted a positive number in rad/s")
    return bmat([[radius * N, -M], [-M.T, radius * N]])


def strip(M: Affine, N: Affine, frequency: float) -> Affine:
    """Poles with |Im s| < frequency (rad/s): ``2 w N + j (M - M') >= 0``."""
    if not frequency > 0.0:
        raise ValueError(f"strip: frequency is {frequency}, wanted a positive number in rad/s")
    return 2.0 * frequency * N + 1j * (M - M.T)


def hinf(M: Affine, Bw: Affine, Cz: Affine, D: Affine | Matrix, gamma: Scalar | float) -> Affine:
    r"""Largest gain from w to z below gamma (bounded real lemma).

    .. math::
        -\begin{bmatrix} M + M^T & B_w & C_z^T \\ B_w^T & -\gamma I & D^T \\ C_z & D & -\gamma I \end{bmatrix}
        \succeq 0
    """
    D = affine(D)
    outputs, inputs = D.shape
    return bmat(
        [
            [-(M + M.T), -Bw, -Cz.T],
            [-Bw.T, _times_identity(gamma, inputs), -D.T],
            [-Cz, -D, _times_identity(gamma, outputs)],
        ]
    )


def below(V: Affine, bound: float) -> Affine:
    """V <= bound I, written ``I - V / bound >= 0`` so that its size does not depend on the bound."""
    if not bound > 0.0:
        raise ValueError(f"below: bound is {bound}, wanted a positive number")
    return np.eye(V.shape[0]) - V / bound


def real_form(block: BlockLMI) -> BlockLMI:
    """Return a block of twice the size with real data: P + jQ >= 0 as ``[[P, -Q], [Q, P]] >= 0``."""
    if not block.is_complex:
        return block

    def doubled(a: Matrix) -> Matrix:
        return np.block([[a.real, -a.imag], [a.imag, a.real]])

    terms = []
    n = block.size
    for t in block.terms:
        zero_left, zero_right = np.zeros((n, t.left.shape[1])), np.zeros((t.right.shape[0], n))
        L, R = t.left, t.right
        # (Lr + jLi) V (Rr + jRi) doubled = [Lr; Li] V [Rr, -Ri] + [-Li; Lr] V [Ri, Rr]
        left = np.vstack([L.real, L.imag]) if np.iscomplexobj(L) else np.vstack([L, zero_left])
        rotated = np.vstack([-L.imag, L.real]) if np.iscomplexobj(L) else np.vstack([zero_left, L])
        right = np.hstack([R.real, -R.imag]) if np.iscomplexobj(R) else np.hstack([R, zero_right])
        other = np.hstack([R.imag, R.real]) if np.iscomplexobj(R) else np.hstack([zero_right, R])
        terms += [Term(t.variable, left, right), Term(t.variable, rotated, other)]
    return BlockLMI(
        block.name, doubled(block.constant), tuple(terms), {g: doubled(D) for g, D in block.scalars.items()}
    )


def _times_identity(gamma: Scalar | float, size: int) -> Affine:
    return gamma * np.eye(size) if isinstance(gamma, Scalar) else affine(gamma * np.eye(size))
