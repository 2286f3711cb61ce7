"""The network as the C plant takes it: branches, shunts and loads, and the form in which it is solved."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..case.case import Case
from .network import branch_stamps, bus_index, load_power, machine_bus_index, shunt_admittance
from .sparse_pattern import SPARSE_PRICE, SparsePattern, sparse_pattern

Form = Literal["dense", "sparse"]


def network_pattern(case: Case, ports: int, form: Form | None = None) -> SparsePattern | None:
    """Return the pattern of the sparse network of `case`; None where the dense one is cheaper.

    ports : elements that are not linear; form : the one to take whatever the cost.
    """
    if form == "dense" or (form is None and ports):
        return None
    machines = machine_bus_index(case)
    active = np.unique(machines)
    if form is None and len(machines) * (len(machines) + ports) <= SPARSE_PRICE * len(active):
        return None  # a solution takes at least one multiplication at each active bus
    pattern = sparse_pattern(len(case.buses), branch_ends(case), active)
    dense = len(machines) * (len(machines) + ports)
    return pattern if form or dense > SPARSE_PRICE * pattern.multiplications else None


def branch_ends(case: Case) -> npt.NDArray[np.int64]:
    """Return the bus positions of each branch, in service or not, (branches, 2)."""
    index = bus_index(case)
    return np.array([(index[b.from_bus], index[b.to_bus]) for b in case.branches], dtype=np.int64).reshape(
        -1, 2
    )


def network_tables(
    case: Case, load_volts: npt.NDArray[np.float64], pattern: SparsePattern | None
) -> dict[str, Any]:
    """Return the arrays of the record that say what the network is made of; load_volts: (loads,)."""
    index = bus_index(case)
    shunts = np.array([shunt_admittance(case, s) for s in case.shunts], dtype=complex)
    at_bus = np.zeros(len(case.buses), dtype=complex)
    for shunt, value in zip(case.shunts, shunts, strict=True):
        if shunt.in_service:
            at_bus[index[shunt.bus]] += value
    stamps = branch_stamps(case.branches)
    loads = np.array([load_power(case, row) * row.in_service for row in case.loads], dtype=complex)
    ends = branch_ends(case)
    return {
        "machine.bus": machine_bus_index(case),
        "branch.from": ends[:, 0],
        "branch.to": ends[:, 1],
        "branch.status": np.array([b.in_service for b in case.branches], dtype=np.int32),
        "branch.table": np.stack([stamps.real, stamps.imag], axis=2).reshape(len(stamps), 8).T,
        "bus.shunt": np.array([at_bus.real, at_bus.imag]),
        "shunt.bus": np.array([index[s.bus] for s in case.shunts], dtype=np.int32),
        "shunt.status": np.array([s.in_service for s in case.shunts], dtype=np.int32),
        "shunt.table": np.array([shunts.real, shunts.imag]),
        "load.bus": np.array([index[row.bus] for row in case.loads], dtype=np.int32),
        "load.table": np.array([loads.real, loads.imag, load_volts], dtype=float),
        "network.pattern": _pattern_array(case, pattern, ends),
    }


def _pattern_array(
    case: Case, pattern: SparsePattern | None, ends: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """The parts that plant/sparse.h names, in its order."""
    if pattern is None:
        return np.zeros(0, dtype=np.int64)
    parts = (
        pattern.row,
        pattern.row[machine_bus_index(case)],
        pattern.lower,
        pattern.needed,
        pattern.upper,
        pattern.lower_column,
        pattern.upper_column,
        pattern.places(ends).ravel(),
    )
    return np.concatenate(parts)
