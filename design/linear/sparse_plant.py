r"""A plant at rest as sparse blocks: its devices and the network between them, no dense state matrix.

Device k (a machine with its controls, an SVC) has states x_k, sees the voltage V of its bus and sends a
current,

.. math:: \dot x_k = A_k x_k + B_k V + \dots, \qquad I_k = C_k x_k + D_k V, \qquad G V = \sum_k C_k x_k,

with voltages and currents as real and imaginary parts and G = Y less all D_k. Without the states this leaves

.. math:: N(s) = G - \sum_k C_k (s - A_k)^{-1} B_k, \qquad
          \det(s - A) = \det N(s) \prod_k \det(s - A_k) / \det G,

two rows a bus on the network's own pattern: its zeros are the modes, and its poles, the eigenvalues of the
A_k, are known. Buses without a device are eliminated once, as far as that fills nothing in.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import splu

from interarea.models.errors import InterareaError
from interarea.models.grid.coupling import NOTHING
from interarea.models.grid.dc_link import INVERTER
from interarea.models.grid.network import assembled
from interarea.models.grid.vsc_link import CONVERTER, FAR

from .modal_devices import Modal, scattered
from .sparse_network import Elimination, Network

Matrix = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.int64]

_LOAD, _DEVICE = 1, 3  #: kinds of ports
_COUPLING = 7  #: column of the port table: 0 where a device at a bus measures only
_PAD = -1.0  #: pole of a place where a device has no state; nothing reaches it


class SparsePlantError(InterareaError, ValueError):
    """The blocks would not describe the plant."""


class Slopes(Protocol):
    """Derivatives of the devices of a plant at rest, the network between them cut."""

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the n states."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""

    @property
    def sources(self) -> int:
        """Number of machines and ports."""

    def slopes(self, vx: Matrix, vu: Matrix, vv: ComplexArray) -> tuple[Matrix, ComplexArray]:
        """Return the moves of dx/dt (n,) and of the sources' currents, for moves of x, u and voltages."""


@dataclass(frozen=True)
class Forced:
    """Complex amplitudes of states (n, k) and of the parts of the buses' voltages (b, 2, k)."""

    states: ComplexArray
    voltages: ComplexArray


@dataclass(frozen=True)
class SparsePlant:
    """Blocks of a plant with K devices of at most m states and b buses; per unit on the base of the case.

    Attributes
    ----------
    machines : names; their devices come first, then those at buses. bus_names : numbers of the buses.
    states : names (n,); inputs : names.
    place : (K, m) state at each place of a device, n where it has none.
    A : (K, m, m); B : (K, m, 2 ends); C : (K, 2 ends, m), current into the network.
    bus : (K, ends) buses of each device: one, or in a grid with dc links two, of which the second is the
    first again where a device has one.
    Bu : (n, inputs) sparse.
    G : (2 b, 2 b) real sparse, real and imaginary part of each bus in turn.
    ends, stamps : (branches, 2) buses and (branches, 4) admittances of the branches in service.
    branches : their names.
    at_bus : (b,) complex voltages at rest.
    """

    machines: tuple[str, ...]
    bus_names: tuple[str, ...]
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    place: IntArray
    A: Matrix
    B: Matrix
    C: Matrix
    bus: IntArray
    Bu: Any
    G: Any
    ends: IntArray
    stamps: ComplexArray
    branches: tuple[str, ...]
    at_bus: ComplexArray

    @property
    def nstates(self) -> int:
        """The number n of states."""
        return len(self.states)

    @cached_property
    def angle(self) -> IntArray:
        """The states that are rotor angles, (machines,)."""
        at = {name: k for k, name in enumerate(self.states)}
        return np.array([at[f"{m}.delta"] for m in self.machines], dtype=np.int64)

    @cached_property
    def speed(self) -> IntArray:
        """The states that are speeds, (machines,), pu."""
        at = {name: k for k, name in enumerate(self.states)}
        return np.array([at[f"{m}.slip"] for m in self.machines], dtype=np.int64)

    @property
    def device_poles(self) -> ComplexArray:
        """Eigenvalues of all A_k, (n,): the devices at fixed voltage."""
        return self.modal.poles

    @cached_property
    def modal(self) -> Modal:
        """The devices in coordinates of their own modes."""
        return Modal(self.A, self.B, self.C, self.place, self.nstates, self.elimination)

    @cached_property
    def at_rest(self) -> Network:
        """The network with the devices' states held: voltages from currents."""
        return Network(self.elimination, self.elimination.remaining.data)

    @cached_property
    def devices(self) -> tuple[Any, Any, Any]:
        """A (n, n), B (n, rows), C (rows, n) of all devices, sparse; rows of what is left of the network."""
        n, retained, rows = self.nstates, self.elimination.remaining.shape[0], self.elimination.rows
        return (
            scattered(self.A, self.place, self.place, (n, n)),
            scattered(self.B, self.place, rows, (n, retained)),
            scattered(self.C, rows, self.place, (retained, n)),
        )

    def spread(self, x: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the states of each device (K, m, ...) from those of the plant (n, ...)."""
        return np.concatenate([x, np.zeros((1, *x.shape[1:]), dtype=x.dtype)])[self.place]

    def voltages(self, x: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the voltage of each bus, (b, 2, ...): real and imaginary part, for states (n, ...)."""
        V = self.elimination.everywhere(self.at_rest.solve(self.devices[2] @ x))
        return np.asarray(V.reshape(-1, 2, *V.shape[1:]))

    def size_and_angle(self, dV: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Return the moves (b, ...) of each voltage's size (pu) and angle (rad), for dV (b, 2, ...)."""
        re, im = self._times_voltage(self.at_bus.conj(), dV)
        size = np.abs(self.at_bus)[:, None]
        return re / size, im / size**2

    def branch_flows(
        self, dV: npt.NDArray[Any]
    ) -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]:
        """Return the moves of P, Q and size of the current into each branch at its `from` end, pu.

        dV : (b, 2, ...) of each bus voltage's real and imaginary part. Result : (branches, ...) each.
        """
        a, b = self.ends.T
        own, mutual = self.stamps[:, 0], self.stamps[:, 1]
        V, I = self.at_bus[a], own * self.at_bus[a] + mutual * self.at_bus[b]
        dI = np.stack(self._times_voltage(own, dV[a]), axis=1) + np.stack(
            self._times_voltage(mutual, dV[b]), axis=1
        )
        # S = V conj(I): dS = conj(I) dV + V conj(dI)
        p_of_v, q_of_v = self._times_voltage(I.conj(), dV[a])
        p_of_i, q_of_i = self._times_voltage(V.conj(), dI)
        size, _ = self._times_voltage(I.conj(), dI)
        return p_of_v + p_of_i, q_of_v - q_of_i, size / np.maximum(np.abs(I), 1e-9)[:, None]

    @staticmethod
    def _times_voltage(y: ComplexArray, v: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Real and imaginary part of y v, each a complex amplitude: v (k, 2, ...), y (k,)."""
        re, im = v[:, 0], v[:, 1]
        return y.real[:, None] * re - y.imag[:, None] * im, y.real[:, None] * im + y.imag[:, None] * re

    def forced(self, s: complex, moved: npt.NDArray[Any], injected: npt.NDArray[Any]) -> Forced:
        """Return what swings of s (1/s) do that act on the states' derivatives and on the buses.

        moved : (n, k) dx/dt of each of k sources. injected : (b, 2, k) current into each bus, its real and
        imaginary part, pu.
        """
        inner = np.linalg.inv(s * np.eye(self.A.shape[1]) - self.A)
        y = inner @ self.spread(moved)
        rows = np.stack([2 * self.bus, 2 * self.bus + 1], axis=-1).reshape(len(self.bus), -1)
        current = injected.reshape(-1, injected.shape[-1]).astype(complex)
        np.add.at(current, rows, self.C @ y)
        each = rows[:, :, None], rows[:, None, :]
        entries = (-(self.C @ inner @ self.B)).ravel()
        at = tuple(np.broadcast_to(k, (*rows.shape, rows.shape[1])).ravel() for k in each)
        N = sparse.csc_matrix(self.G, dtype=complex) + sparse.csc_matrix((entries, at), shape=self.G.shape)
        V = splu(N).solve(current)
        states = np.zeros((self.nstates + 1, V.shape[1]), dtype=complex)
        states[self.place] = y + inner @ (self.B @ V[rows])
        return Forced(states[:-1], V.reshape(-1, 2, V.shape[1]))

    def times(self, x: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return A x (n, ...) for x (n, ...)."""
        A, B, C = self.devices
        return np.asarray(A @ x + B @ self.at_rest.solve(C @ x))

    def state_matrix(self) -> Matrix:
        """Return the dense A (n, n); for small plants."""
        return np.asarray(self.times(np.eye(self.nstates)))

    @cached_property
    def elimination(self) -> Elimination:
        """Which buses are left of the network, and how."""
        return Elimination(self.G, self.bus, len(self.bus_names))


def sparse_plant(slopes: Slopes, data: Mapping[str, Any], at_bus: ComplexArray) -> SparsePlant:
    """Return the blocks of a plant.

    slopes : its devices' derivatives. data : arrays of its record (`models.blocks.plant.plant_block`).
    at_bus : (b,) complex voltages at rest, pu.

    Raises
    ------
    SparsePlantError : derivatives that are not finite.
    """
    places = _words(data["machine.names"])
    bus = np.asarray(data["machine.bus"], dtype=np.int64)
    n, K = len(slopes.states), len(places)
    of = np.asarray(data["state.machine"], dtype=np.int64)
    local = np.zeros(n, dtype=np.int64)
    for k in range(K):
        own = np.flatnonzero(of == k)
        local[own] = np.arange(len(own))
    m = int(local.max()) + 1
    place = np.full((K, m), n, dtype=np.int64)
    place[of, local] = np.arange(n)
    ports = np.asarray(data["port.table"], dtype=float)
    at_buses, others = _ports_of_devices(ports)
    acts_on = np.asarray(data["input.machine"], dtype=np.int64)
    own = np.concatenate([np.arange(len(bus)), len(bus) + at_buses])
    source = np.tile(own[:, None], 1 + len(others))
    for column, at in enumerate(others, start=1):
        source[len(bus) + ports[at, 1].astype(np.int64), column] = len(bus) + at
    blocks = _device_blocks(slopes, place, local, source, acts_on // K)
    at_port = np.concatenate([bus, ports[:, 3].astype(np.int64)])  # of the ports of devices at buses
    bus = at_port[source]
    buses = _words(data["bus.names"])
    on = np.asarray(data["branch.status"]) > 0
    table = np.asarray(data["branch.table"], dtype=float).reshape(8, -1).T[on].reshape(-1, 4, 2)
    stamps = table[..., 0] + 1j * table[..., 1]
    ends = np.stack([np.asarray(data[f"branch.{e}"], dtype=np.int64) for e in ("from", "to")], axis=1)[on]
    port = ports[:, :2].astype(int)
    loads = np.asarray(data["load.bus"], dtype=np.int64)[port[port[:, 0] == _LOAD, 1]]
    devices = np.unique(source)
    inner = np.concatenate([blocks.D[devices], blocks.D[len(at_port) - len(ports) :][port[:, 0] == _LOAD]])
    return SparsePlant(
        machines=places[: len(data["machine.bus"])],
        bus_names=buses,
        states=slopes.states,
        inputs=slopes.inputs,
        place=place,
        A=blocks.A,
        B=blocks.B,
        C=blocks.C,
        bus=bus,
        Bu=_input_matrix(acts_on, K, of, blocks.moved),
        G=_network(data, ends, stamps, np.concatenate([at_port[devices], loads]), inner),
        ends=ends,
        stamps=stamps,
        branches=tuple(
            name for name, retained in zip(_words(data["branch.names"]), on, strict=True) if retained
        ),
        at_bus=at_bus,
    )


@dataclass(frozen=True)
class _Blocks:
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix  # (sources, 2, 2)
    moved: (
        Matrix  # (1 to 3, n) dx/dt for 1 at every first input of a place, every second one, every third one
    )


def _ports_of_devices(ports: Matrix) -> tuple[IntArray, list[IntArray]]:
    """Where in the table of ports each device at a bus stands, and the further ports that some have.

    Those are the second ends of dc links and, one each, the places that a device only measures.
    """
    devices = ports[:, 0] == _DEVICE
    coupling = ports[:, _COUPLING]
    inverters = devices & ((coupling == INVERTER) | ((coupling == CONVERTER) & (ports[:, FAR] == 1.0)))
    measuring = devices & (coupling == NOTHING)
    others = [np.flatnonzero(inverters)]
    at = np.flatnonzero(measuring)
    which = np.array([np.sum(ports[at[:k], 1] == ports[one, 1]) for k, one in enumerate(at)], dtype=int)
    others += [at[which == k] for k in range(which.max(initial=-1) + 1)]
    return np.flatnonzero(devices & ~inverters & ~measuring), [ones for ones in others if len(ones)]


def _device_blocks(
    slopes: Slopes,
    place: IntArray,
    local: IntArray,
    source: IntArray,
    slot: IntArray,
) -> _Blocks:
    """One derivative for every place of all devices at once: what one does moves no other.

    source : (K, ends) the sources that are each device's currents, of a dc link two, of others one and in a
    grid with links that once more. slot : which of its place each input is, from 0.
    """
    (K, m), n, sources, ends = place.shape, len(slopes.states), slopes.sources, source.shape[1]
    none_x, none_u, none_v = np.zeros(n), np.zeros(len(slopes.inputs)), np.zeros(sources, dtype=complex)
    A, B = np.zeros((K, m, m)), np.zeros((K, m, ends, 2))
    C, D = np.zeros((K, ends, 2, m)), np.zeros((sources, 2, 2))
    there = np.stack([np.full(K, True), *(source[:, k] != source[:, 0] for k in range(1, ends))], axis=1)

    def spread(x: Matrix) -> Matrix:
        return np.append(x, 0.0)[place]

    for j in range(m):
        dx, current = slopes.slopes(np.where(local == j, 1.0, 0.0), none_u, none_v)
        A[:, :, j] = spread(dx)
        own = np.where(there, current[source], 0.0)
        C[:, :, 0, j], C[:, :, 1, j] = own.real, own.imag
    for j, unit in enumerate((1.0, 1.0j)):
        for end in range(ends):
            moved = np.zeros(sources, dtype=complex)
            moved[source[there[:, end], end]] = unit
            dx = spread(slopes.slopes(none_x, none_u, moved)[0])
            B[:, :, end, j] = np.where(there[:, end, None], dx, 0.0)
        current = slopes.slopes(none_x, none_u, np.full(sources, unit))[1]
        D[:, 0, j], D[:, 1, j] = current.real, current.imag
    which = range(int(slot.max(initial=0)) + 1)
    dx = np.array([slopes.slopes(none_x, np.where(slot == k, 1.0, 0.0), none_v)[0] for k in which])
    for M in (A, B, C, D, dx):
        if not np.all(np.isfinite(M)):
            raise SparsePlantError("derivatives of the plant's devices at the equilibrium are not all finite")
    k, i = np.nonzero(place == n)
    A[k, i, i] = _PAD
    return _Blocks(A, B.reshape(K, m, 2 * ends), C.reshape(K, 2 * ends, m), D, dx)


def _input_matrix(acts_on: IntArray, K: int, of: IntArray, dx: Matrix) -> Any:
    """Columns (n, inputs) from what inputs of all places at once do: each acts on one of the K devices.

    acts_on : place of each input, or K or 2 K more where it is the second or third one there.
    """
    Bu = sparse.lil_matrix((len(of), len(acts_on)))
    for j, (slot, at) in enumerate(zip(*divmod(acts_on, K), strict=True)):
        rows = np.flatnonzero((of == at) & (dx[slot] != 0.0))
        Bu[rows, j] = dx[slot, rows]
    return Bu.tocsc()


def _network(
    data: Mapping[str, Any], ends: IntArray, stamps: ComplexArray, at: IntArray, inner: Matrix
) -> Any:
    """G: branches, shunts and loads as impedances, less the 2 x 2 blocks `inner` at buses `at`."""
    shunt = np.asarray(data["bus.shunt"], dtype=float)
    P, Q, volts = np.asarray(data["load.table"], dtype=float)
    b = shunt.shape[1]
    diagonal = shunt[0] + 1j * shunt[1]
    np.add.at(diagonal, np.asarray(data["load.bus"], dtype=np.int64), (P - 1j * Q) / volts**2)
    Y = assembled(ends, stamps, diagonal).tocoo()
    real, imag = Y.data.real, Y.data.imag
    i = np.concatenate([2 * Y.row, 2 * Y.row, 2 * Y.row + 1, 2 * Y.row + 1])
    j = np.concatenate([2 * Y.col, 2 * Y.col + 1, 2 * Y.col, 2 * Y.col + 1])
    G = sparse.csc_matrix((np.concatenate([real, -imag, imag, real]), (i, j)), shape=(2 * b, 2 * b))
    rows = (2 * at[:, None, None] + np.array([[0, 0], [1, 1]])).ravel()
    columns = (2 * at[:, None, None] + np.array([[0, 1], [0, 1]])).ravel()
    return (G - sparse.csc_matrix((inner.ravel(), (rows, columns)), shape=G.shape)).tocsc()


def _words(text: bytes) -> tuple[str, ...]:
    """Names, one a line, a zero at the end."""
    return tuple(text.rstrip(b"\0").decode().split("\n"))
