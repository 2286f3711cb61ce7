r"""Eigenvalues at 0 that a plant has by the way it is built: none of them grows or swings.

All rotors turned together move nothing where no bus is infinite, and all speeds raised together turn them for
ever where no torque depends on speed. The others are integrators: device k has a row w with
:math:`w A_k = 0`, so that :math:`w x_k` is the integral of what :math:`w B_k` makes of its bus's voltage.
Where the sum of such rows over a bus vanishes, a combination of states stays as it is,

.. math:: \sum_k w_k B_k = 0 \;\Rightarrow\; \frac{d}{dt} \sum_k w_k x_k = 0,

one eigenvalue 0 for each: n exciters that hold the voltage of one bus by integral action can trade output
n - 1 ways, n governors that integrate the speed can trade power, and an integrator without an input rests.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse

from .matrices import ZERO_EIGENVALUE
from .resolvent import Loop, Shifted
from .sparse_plant import SparsePlant

Matrix = npt.NDArray[np.float64]

_PUSHES = (1e-3, 1e-4)  # 1/s: a speed that comes back more slowly than 1.25 times the lower one does not
_SLOW = 1e-3  # 1/s: devices without a pole nearer to 0 have no such row
_RANK = 1e-9  # of the largest singular value of a device's matrix with rows and columns of like size
_NOTHING = 1e-9  # of the terms of a sum that vanishes


@dataclass(frozen=True)
class ZeroEigenvalues:
    """Eigenvalues 0 of a plant.

    Attributes
    ----------
    rotation : turning all rotors together moves nothing.
    common_speed : nor does anything bring a common speed back, which turns them.
    shared_bus : bus -> machines whose exciters integrate its voltage, and how many ways they trade output.
    governors : machines whose governors integrate the speed; all but one of the ways is beside the rotation.
    infinite : machines that are infinite buses: angle and speed of each stay, whatever the others do.
    resting : states that nothing moves, such as the integrator of a control that is switched off.
    rows : (k, n) sparse, w A = 0 for each integrator or group of them.
    """

    rotation: bool
    common_speed: bool
    shared_bus: Mapping[str, tuple[tuple[str, ...], int]]
    governors: tuple[str, ...]
    resting: tuple[str, ...]
    rows: Any
    infinite: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Number of these zero eigenvalues; governors that integrate include that of the rotation."""
        turning = int(self.rotation and not self.governors)
        return turning + int(self.common_speed) + int(self.rows.shape[0]) + len(self.infinite)

    def as_dict(self) -> dict[str, Any]:
        """Return the record as JSON values."""
        shared = {bus: {"machines": list(m), "times": n} for bus, (m, n) in self.shared_bus.items()}
        return {
            "times": self.count,
            "rotation": self.rotation,
            "common_speed": self.common_speed,
            "shared_bus": shared,
            "governors": list(self.governors),
            "infinite": list(self.infinite),
            "resting": list(self.resting),
        }

    @property
    def remarks(self) -> tuple[str, ...]:
        """Each kind, as a sentence."""
        message = []
        if self.rotation:
            message.append(
                "rotation: a common rotation of all rotors changes no flow; its eigenvalue 0 is not an "
                "instability"
            )
        if self.common_speed:
            message.append("common speed: no torque restores it; its eigenvalue 0 is not an instability")
        if self.shared_bus:
            paths = [f"{n} at bus {bus} ({_few(names)})" for bus, (names, n) in self.shared_bus.items()]
            total = sum(n for _, n in self.shared_bus.values())
            message.append(
                "shared buses: exciters that integrate the voltage of one bus can exchange output; "
                f"{_times(total)} eigenvalue 0 from this, not an instability: {_few(paths, 4)}"
            )
        if len(self.governors) > 1:
            message.append(
                f"governors that integrate the speed ({_few(self.governors)}) can exchange power; "
                f"{_times(len(self.governors) - 1)} eigenvalue 0 from this, not an instability"
            )
        if self.infinite:
            message.append(
                f"infinite buses ({_few(self.infinite)}): angle and speed of each are constant, "
                f"{_times(2 * len(self.infinite))} eigenvalue 0, not an instability"
            )
        if self.resting:
            message.append(
                f"{len(self.resting)} constant state(s) ({_few(self.resting)}): eigenvalue 0, "
                "not an instability"
            )
        return tuple(message)


def _few(names: tuple[str, ...] | list[str], most: int = 3) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def zero_eigenvalues_of(plant: SparsePlant, loop: Loop | None = None) -> ZeroEigenvalues:
    """Return the eigenvalues 0 that a plant has by the way it is built.

    loop : the plant with a controller around it, which may bring a common speed back; machine speeds show
        none of the others.
    """
    of, local, seen = _integrators(plant)
    place = plant.place[of]
    angle = np.array([np.flatnonzero(p == a)[0] for p, a in zip(place, plant.angle[of], strict=True)], int)
    rotated = local[np.arange(len(of)), angle]
    kinds = _kinds(local, seen, rotated)
    selected = place < plant.nstates
    at = np.nonzero(selected)[0], place[selected]
    rows = sparse.csr_matrix((local[selected], at), shape=(len(of), plant.nstates))
    most = place[np.arange(len(of)), np.argmax(np.abs(local), axis=1)] if len(of) else of
    infinite = (kinds == "rests") & (most == plant.speed[of] if len(of) else False)
    # they hold angles and speeds of all others
    rotation, common_speed = (False, False) if infinite.any() else _together(plant, loop)
    resting = tuple(plant.states[int(k)] for k in most[(kinds == "rests") & ~infinite])
    retained, shared = [rows[kinds != "voltage"]], {}
    for bus in np.unique(plant.bus[of[kinds == "voltage"], 0]):
        own = np.flatnonzero((kinds == "voltage") & (plant.bus[of, 0] == bus))
        U, values, _ = np.linalg.svd(seen[own])
        rank = int(np.sum(values > _NOTHING * values[0]))
        if len(own) > rank:
            names = tuple(plant.machines[k] for k in of[own])
            shared[plant.bus_names[bus]] = names, len(own) - rank
            retained.append(sparse.csr_matrix(U[:, rank:].T) @ rows[own])
    return ZeroEigenvalues(
        rotation=rotation,
        common_speed=common_speed,
        shared_bus=shared,
        governors=tuple(plant.machines[k] for k in of[kinds == "speed"]),
        resting=resting,
        rows=sparse.vstack(retained).tocsr(),
        infinite=tuple(plant.machines[k] for k in of[infinite]),
    )


def _together(plant: SparsePlant, loop: Loop | None) -> tuple[bool, bool]:
    """Whether all angles together move nothing, and whether nothing brings a common speed back."""
    angles, speeds = np.zeros(plant.nstates), np.zeros(plant.nstates if loop is None else loop.nstates)
    speeds[plant.speed] = 1.0
    angles[[name.endswith((".delta", ".theta")) for name in plant.states]] = 1.0  # of voltage sources too
    if not float(np.max(np.abs(plant.times(angles)))) <= ZERO_EIGENVALUE:
        return False, False
    # a push on all speeds: what is left of it after 1/s rises as 1/s only if nothing brings it back
    pushed = (Shifted(plant, s) if loop is None else loop.shifted(s) for s in _PUSHES)
    far, near = (abs(at.solve(speeds)[plant.speed].mean()) for at in pushed)
    return True, bool(near > 5.0 * far)


def _integrators(plant: SparsePlant) -> tuple[npt.NDArray[np.intp], Matrix, Matrix]:
    """Rows w of devices with w A_k = 0: device of each (r,), w (r, m) and w B_k (r, 2), both of size 1."""
    plant_rows = plant.place < plant.nstates
    slow = np.flatnonzero(np.abs(plant.device_poles) < _SLOW)
    of, rows, seen = [], [], []
    machines = plant.place[: len(plant.machines)]
    for k in np.flatnonzero(np.isin(machines, slow).any(axis=1)):
        own = plant_rows[k]
        A, B = plant.A[k][np.ix_(own, own)], plant.B[k][own]
        across = _sizes(np.hstack([A, B]).T)
        down = _sizes(A / across[:, None])
        U, values, _ = np.linalg.svd(A / across[:, None] / down)
        null = U[:, values <= _RANK * values[0]].T
        both = null @ (B / across[:, None])
        turn, size, _ = np.linalg.svd(both)  # rows that see nothing apart from those that see the voltage
        null, both = turn.T @ null, turn.T @ both
        for j in range(len(null)):
            w = np.zeros(plant.place.shape[1])
            w[own] = null[j] / across
            scale = np.linalg.norm(both[j])
            sees = j < len(size) and size[j] > _NOTHING
            of.append(k)
            rows.append(w / (scale if sees else np.linalg.norm(w)))
            seen.append(both[j] / scale if sees else np.zeros(2))
    m = plant.place.shape[1]
    return np.array(of, dtype=int), np.reshape(rows, (len(of), m)), np.reshape(seen, (len(of), 2))


def _sizes(M: Matrix) -> Matrix:
    """Largest entry of each column, 1 where all are 0."""
    size = np.abs(M).max(axis=0)
    return np.where(size > 0.0, size, 1.0)


def _kinds(rows: Matrix, seen: Matrix, rotated: Matrix) -> npt.NDArray[np.str_]:
    """What each row integrates: `voltage`, `speed` or nothing."""
    size = np.abs(rows).max(axis=1, initial=0.0)
    kinds = np.where(np.abs(rotated) > _NOTHING * size, "speed", "rests")
    return np.where(np.any(seen != 0.0, axis=1), "voltage", kinds)
