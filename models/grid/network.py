"""The network as admittances: stamps of branches and shunts, the bus matrix, Kron reduction.

Per unit on the base of the case; bus order is the order of `case.buses`, machine order that of
`case.machines`. Currents into the network are positive: ``I = Y V``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse

from ..case.case import Case
from ..case.schema import Branch, Load, Shunt

ComplexArray = npt.NDArray[np.complex128]


def bus_index(case: Case) -> dict[int, int]:
    """Return the position of each bus number in the admittance matrix."""
    return {bus.number: k for k, bus in enumerate(case.buses)}


def machine_bus_index(case: Case) -> npt.NDArray[np.int32]:
    """Return the bus position of each machine, (machines,)."""
    index = bus_index(case)
    return np.array([index[m.bus] for m in case.machines], dtype=np.int32)


def branch_stamp(branch: Branch) -> ComplexArray:
    r"""Return the (2, 2) admittance of a branch between its `from` and `to` ends.

    With series admittance :math:`y = 1/(r + jx)` and tap :math:`t = tap\,e^{j\,shift}` at the `from` side,

    .. math:: \begin{bmatrix} (y + jb/2)/|t|^2 & -y/t^* \\ -y/t & y + jb/2 \end{bmatrix} .

    >>> from interarea.models.case.schema import Branch
    >>> line = Branch(name="1-2", from_bus=1, to_bus=2, x=0.5)
    >>> [complex(branch_stamp(line)[0, k]).imag for k in (0, 1)]
    [-2.0, 2.0]
    """
    stamp: ComplexArray = branch_stamps([branch])[0].reshape(2, 2)
    return stamp


def branch_stamps(branches: Sequence[Branch]) -> ComplexArray:
    """Return the stamps of many branches, (branches, 4): from-from, from-to, to-from, to-to."""
    if not branches:
        return np.zeros((0, 4), dtype=complex)
    rows = np.array([(b.r, b.x, b.b, b.tap, b.shift_deg) for b in branches], dtype=float)
    return series_stamps(*rows.T)


def series_stamps(r: Any, x: Any, b: Any, tap: Any, shift_deg: Any) -> ComplexArray:
    """Return the stamps of branches given by arrays of their values, (branches, 4)."""
    y = 1.0 / (r + 1j * x)
    turn = tap * np.exp(1j * np.deg2rad(shift_deg))
    end = y + 0.5j * b
    return np.stack([end / np.abs(turn) ** 2, -y / np.conj(turn), -y / turn, end], axis=1)


def shunt_admittance(case: Case, shunt: Shunt) -> complex:
    """Return the admittance to ground of `shunt`, pu; a capacitor has a positive imaginary part."""
    return complex(shunt.P_mw, shunt.Q_mvar) / case.base_mva


def load_power(case: Case, load: Load) -> complex:
    """Return P + jQ of `load` at the operating point, pu on the base of the case."""
    return complex(load.P_mw, load.Q_mvar) / case.base_mva


def sparse_admittance(case: Case, *, without: Iterable[str] = (), shunts: bool = True) -> Any:
    """Return the bus admittance matrix as a sparse CSR matrix, (buses, buses); see `admittance_matrix`."""
    left_out = {case.branch(name).name for name in without}
    index = bus_index(case)
    branches = [b for b in case.branches if b.in_service and b.name not in left_out]
    ends = np.array([(index[b.from_bus], index[b.to_bus]) for b in branches], dtype=int).reshape(-1, 2)
    diagonal = np.zeros(len(index), dtype=complex)
    for shunt in case.shunts if shunts else ():
        if shunt.in_service:
            diagonal[index[shunt.bus]] += shunt_admittance(case, shunt)
    return assembled(ends, branch_stamps(branches), diagonal)


def assembled(ends: npt.NDArray[np.int_], stamps: ComplexArray, diagonal: ComplexArray) -> Any:
    """Return the sparse admittance matrix of branches at `ends` (branches, 2) and shunts on the diagonal."""
    n = len(diagonal)
    rows = np.concatenate([ends[:, [0, 0, 1, 1]].ravel(), np.arange(n)])
    columns = np.concatenate([ends[:, [0, 1, 0, 1]].ravel(), np.arange(n)])
    values = np.concatenate([stamps.ravel(), diagonal])
    return sparse.coo_matrix((values, (rows, columns)), shape=(n, n)).tocsr()


def admittance_matrix(case: Case, *, without: Iterable[str] = (), shunts: bool = True) -> ComplexArray:
    """Return the bus admittance matrix, (buses, buses): branches and shunts in service.

    `without`: names of branches omitted in addition to those out of service.

    Raises
    ------
    CaseError : a name in `without` that is not a branch.
    """
    dense: ComplexArray = sparse_admittance(case, without=without, shunts=shunts).toarray()
    return dense


def machine_norton_admittance(case: Case) -> ComplexArray:
    """Return 1/(Ra + j X) of each machine on the base of the case, X = Xd2, or Xd1; (machines,)."""
    impedances = [
        complex(m.Ra, m.number("Xd1" if m.has_constant_emf else "Xd2")) * case.base_mva / m.base_mva
        for m in case.machines
    ]
    return np.array([1.0 / z for z in impedances], dtype=complex)
