"""The network in the layout of the C plant: branches, shunts and loads, and the form of its solution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..case.case import Case
from ..case.schema import Machine
from .bus_devices import DEVICE, LOAD, MACHINE, port_loads
from .coupling import device_port_buses
from .network import branch_stamps, bus_index, load_power, machine_bus_index, shunt_admittance
from .sparse_pattern import SPARSE_PRICE, IntArray, SparsePattern, sparse_pattern

#: a product over the machines; factors for every evaluation; factors for voltages and a product for rates
Form = Literal["dense", "sparse", "reduced"]
SMALLEST_PU = 1e-4  #: least reactance beside an air gap that is a node of its own

FEW_PRICE = 8  #: of p ports by themselves p^2 in entries of the factors, as in plant/numbers/layout.h


@dataclass(frozen=True)
class NetworkNodes:
    """Nodes of the sparse network: the buses, then the air gap of each machine with a port."""

    count: int
    ends: IntArray  #: (branches, 2) of branches, then from air gap to bus
    machine: IntArray  #: (machines,) node where the EMF acts
    port: IntArray  #: (ports,)


def network_nodes(case: Case, ports: npt.NDArray[np.float64]) -> NetworkNodes:
    """Return the nodes of `case` with the ports of its table, (ports, rows)."""
    buses, machine = len(case.buses), np.array(machine_bus_index(case), dtype=np.int64)
    index = bus_index(case)
    load = np.array([index[row.bus] for row in case.loads], dtype=np.int64)
    gaps: list[tuple[int, int]] = []
    port: list[int] = []
    for kind, device, _, bus in ports[:, :4].astype(int):
        at_bus = int(load[device]) if kind == LOAD else int(bus) if kind == DEVICE else None
        port.append(buses + len(gaps) if at_bus is None else at_bus)
        if at_bus is None:
            gaps.append((buses + len(gaps), int(machine[device])))
            machine[device] = gaps[-1][0]
    ends = np.concatenate([branch_ends(case), np.array(gaps, dtype=np.int64).reshape(-1, 2)])
    return NetworkNodes(buses + len(gaps), ends, machine, np.array(port, dtype=np.int64))


def network_pattern(
    case: Case, ports: npt.NDArray[np.float64], form: Form | None = None
) -> SparsePattern | None:
    """Return the pattern of the sparse network of `case`; None if the dense one is cheaper.

    ports : table of the ports; form : prescribed form, whatever its cost.
    """
    m, n = len(case.machines), len(ports)
    nodes = network_nodes(case, ports)
    # complex multiplications of a right-hand side: products for currents and ports, or a solution; each
    # iteration, of which there are some three for two evaluations, takes another. Without ports a sparse
    # network takes the product as well (is_reduced), and what is dear is the dense one's events
    dense, price = m * (m + n) + n * m + 1.5 * n * n, 3 * SPARSE_PRICE if n else 1.25
    active = np.unique(np.concatenate([nodes.machine, nodes.port]))
    if form == "dense" or (form is None and dense <= price * len(active)):
        return None  # a solution takes at least one multiplication at each active node
    if any(_has_no_gap(case.machines[int(k)]) for kind, k in ports[:, :2] if kind == MACHINE):
        return None
    pattern = sparse_pattern(nodes.count, nodes.ends, active)
    return pattern if form or dense > price * pattern.multiplications else None


def has_many_ports(case: Case, form: Form | None = None) -> bool:
    """Whether loads and devices of `case` are ports on a sparse network, too many to be solved by themselves.

    Such plants do not go side by side (`Plan.few` of the C plant). Ports of machines would only be more.
    form : prescribed form of the network, whatever its cost.
    """
    index = bus_index(case)
    ports = [[LOAD, k, 0, 0] for k in port_loads(case)]
    ports += [[DEVICE, 0, 0, index[bus]] for bus in device_port_buses(case)]
    if not ports:
        return False
    pattern = network_pattern(case, np.array(ports, dtype=float), form)
    return pattern is not None and FEW_PRICE * len(ports) ** 2 > pattern.fill


def is_reduced(pattern: SparsePattern, machines: int, ports: int, form: Form | None = None) -> bool:
    """Whether derivatives use machine currents from a dense product, computed from the pattern's solutions.

    form : prescribed form, whatever its cost; with iterating ports a product is not sufficient.
    """
    cheap = machines**2 <= SPARSE_PRICE * pattern.multiplications
    return ports == 0 and (form == "reduced" or (form is None and cheap))


def _has_no_gap(machine: Machine) -> bool:
    """Whether no reactance separates the air gap from the EMF or from the terminals."""
    return machine.number("Xd2") - machine.number("Xl") < SMALLEST_PU or machine.number("Xl") < SMALLEST_PU


def branch_ends(case: Case) -> IntArray:
    """Return the bus positions of each branch, in service or not, (branches, 2)."""
    index = bus_index(case)
    return np.array([(index[b.from_bus], index[b.to_bus]) for b in case.branches], dtype=np.int64).reshape(
        -1, 2
    )


def network_tables(
    case: Case,
    load_volts: npt.NDArray[np.float64],
    ports: npt.NDArray[np.float64],
    pattern: SparsePattern | None,
) -> dict[str, Any]:
    """Return the arrays of the record that define the network; load_volts: (loads,)."""
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
        "network.pattern": _pattern_array(case, ports, pattern),
    }


def _pattern_array(case: Case, ports: npt.NDArray[np.float64], pattern: SparsePattern | None) -> IntArray:
    """The parts that plant/network/sparse.h names, in its order."""
    if pattern is None:
        return np.zeros(0, dtype=np.int64)
    nodes, branches = network_nodes(case, ports), len(case.branches)
    places = pattern.places(nodes.ends)
    parts = (
        pattern.row[: len(case.buses)],
        pattern.row[nodes.machine],
        pattern.lower,
        pattern.needed,
        pattern.upper,
        pattern.lower_column,
        pattern.upper_column,
        places[:branches].ravel(),
        pattern.row[nodes.port],
        places[branches:].ravel(),
    )
    return np.concatenate(parts)
