"""Swing modes of a linear plant, named by their shape and never by their position.

A mode is electromechanical when rotor angles and speeds carry its participation. The machine speeds show the
pattern: area against area is `inter-area`, machines against each other inside area k are `local area k`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig

from interarea.models.errors import UserError

from .growth import Growth, growth_of_spectrum
from .patterns import assigned_names, pattern_energies, pattern_parts

if TYPE_CHECKING:
    import control

    from ..linear.matrices import LinearMatrices

    Linear: TypeAlias = control.StateSpace | LinearMatrices

Matrix = NDArray[np.float64]
ComplexMatrix = NDArray[np.complex128]


class ModeError(UserError):
    """A requested mode is not in the system."""


class Participation(Mapping[str, float]):
    """Participation of each state in a mode: an array with the names of the states."""

    def __init__(self, states: Sequence[str] = (), factors: Matrix | None = None) -> None:
        self._states = states
        self._factors = np.zeros(0) if factors is None else factors

    def __getitem__(self, state: str) -> float:
        try:
            return float(self._factors[self._states.index(state)])
        except ValueError:
            raise KeyError(state) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._states)

    def __len__(self) -> int:
        return len(self._states)

    def most(self, count: int) -> dict[str, float]:
        """Return the `count` dominant states."""
        order = np.argsort(-self._factors, kind="stable")[:count]
        return {self._states[k]: float(self._factors[k]) for k in order}


@dataclass(frozen=True)
class Mode:
    r"""One oscillatory mode, :math:`A v = \lambda v,\ w^T A = \lambda w^T,\ w^T v = 1`.

    Attributes
    ----------
    name : by shape, such as ``inter-area``.
    eigenvalue : lambda, 1/s, the one with positive imaginary part.
    shape : machine -> speed in this mode, the largest being 1 with angle 0.
    participation : state -> \|w_i v_i\| / sum \|w_k v_k\|; sums to 1.
    share : part of the machines' motion that has the named pattern, 0..1.
    right, left : v and w, shape (n,).
    rivals : eigenvalues, 1/s, of modes that fit the name nearly as well.
    """

    name: str
    eigenvalue: complex
    shape: Mapping[str, complex]
    participation: Participation
    share: float
    right: ComplexMatrix
    left: ComplexMatrix
    rivals: tuple[complex, ...] = ()

    def __repr__(self) -> str:
        """Return name, frequency, damping and the machines that swing most, with their phases, in a line."""
        most = sorted(self.shape.items(), key=lambda item: -abs(item[1]))[:4]
        swing = ", ".join(f"{name} {abs(z):.2f} at {np.degrees(np.angle(z)):.0f} deg" for name, z in most)
        caveat = f"; {self.caveat}" if self.caveat else ""
        head = f"{self.name}: {self.frequency_hz:.4f} Hz, damping {self.damping_ratio:.4f}"
        return f"Mode({head}; {swing}{caveat})"

    @property
    def caveat(self) -> str:
        """Reason why the name is uncertain; empty if it is certain."""
        listed = ", ".join(f"{z.real:.4g}{z.imag:+.4g}j" for z in self.rivals)
        return f"{self.name} may also be the mode at {listed}" if listed else ""

    @property
    def frequency_hz(self) -> float:
        """Damped frequency Im(lambda) / 2 pi, Hz."""
        return abs(self.eigenvalue.imag) / (2.0 * np.pi)

    @property
    def damping_ratio(self) -> float:
        r"""-Re(lambda) / \|lambda\|."""
        return damping_ratio(self.eigenvalue)

    def most(self, count: int) -> dict[str, float]:
        """Return the `count` dominant states, by participation."""
        return self.participation.most(count)

    def sensitivity(self, dA: Matrix) -> complex:
        r"""First-order change of the eigenvalue, :math:`d\lambda = w^T\, dA\, v` (1/s), for dA (n, n)."""
        dA = np.asarray(dA)
        n = self.right.size
        if dA.shape != (n, n):
            raise ValueError(f"dA has shape {dA.shape}, mode {self.name!r} has {n} states: need ({n}, {n})")
        return complex(self.left @ dA @ self.right)


@dataclass(frozen=True)
class Modes(Mapping[str, Mode]):
    """The named swing modes of a system, with all its eigenvalues and the verdict on them."""

    by_name: Mapping[str, Mode]
    eigenvalues: ComplexMatrix
    growth: Growth | None = None  #: on all eigenvalues, swing modes or not

    def __getitem__(self, name: str) -> Mode:
        try:
            return self.by_name[name]
        except KeyError:
            known = ", ".join(self.by_name)
            raise ModeError(f"no mode named {name!r}; this system has {known}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self.by_name)

    def __len__(self) -> int:
        return len(self.by_name)

    @property
    def inter_area(self) -> Mode:
        """The inter-area mode; with several, the least damped."""
        result = [m for name, m in self.by_name.items() if name.startswith("inter-area")]
        if not result:
            raise ModeError(
                f"no inter-area mode; this system has {', '.join(self.by_name) or 'no swing mode'}"
            )
        return min(result, key=lambda m: m.damping_ratio)


def damping_ratio(eigenvalue: complex) -> float:
    r"""-Re(lambda) / \|lambda\|; 1 for a decaying and -1 for a growing real mode, 0 at the origin."""
    size = abs(eigenvalue)
    return float(-eigenvalue.real / size) if size > 0.0 else 0.0


def modes_of(
    system: Linear,
    areas: Mapping[str, int],
    *,
    band_hz: tuple[float, float] = (0.05, 4.0),
    least_share: float = 0.25,
) -> Modes:
    r"""Compute and name the N - 1 swing modes of a plant with N machines; a single machine has none.

    Swing modes are among the oscillatory modes of the band in which the machines' angles (states
    ``*.delta*``) and speeds (the states its outputs ``*_dw`` read) take part. With right and left speeds
    v_m and w_m in a mode, their means in the areas of n_k machines and over all, patterns take part by

    .. math:: \Big|\sum_k n_k (\bar w_k - \bar w)(\bar v_k - \bar v)\Big| \;\text{(between areas)}
              \quad\text{and}\quad
              \Big|\sum_{m \in k} (w_m - \bar w_k)(v_m - \bar v_k)\Big| \;\text{(inside area k)},

    relative to all states of the mode, and N - 1 = (areas - 1) + sum (n_k - 1) names are assigned so that the
    total is largest. A controller mode that moves the machines is therefore not taken for a swing mode of the
    closed loop. A mode with less than `least_share` in its pattern is called ``mixed``; if another mode fits
    a name nearly as well, `Mode.caveat` states it. A reduced model has no states that are speeds: there
    shapes alone decide, v for both, on the N - 1 modes whose speeds are largest relative to their decay rate.
    Several modes of one kind are numbered by frequency: ``inter-area 1``, ``local area 2.1``.

    Parameters
    ----------
    system : outputs ``G1_dw`` ... for every machine of `areas`; any unit of speed.
    areas : machine name -> area number.
    band_hz : frequency band of the swing modes.

    Raises
    ------
    ModeError : a speed output is missing, fewer than N - 1 swing modes, or no inter-area mode among them.
    """
    machines = list(areas)
    C = _speed_rows(system, machines)
    A = np.asarray(system.A, dtype=float)
    spectrum = _Spectrum.of(A)
    growth = growth_of_spectrum(A, system.state_labels, spectrum.values, spectrum.left, spectrum.right)
    if len(machines) == 1:
        return Modes({}, spectrum.values, growth)
    swinging = spectrum.swinging(system, C, band_hz)
    if len(swinging) < len(machines) - 1:
        modes = (spectrum.values[i] for i in swinging)
        listed = ", ".join(f"{z.real:.4g}{z.imag:+.4g}j" for z in modes) or "none"
        raise ModeError(
            f"{len(machines)} machines have {len(machines) - 1} swing modes, but {len(swinging)} were found "
            f"between {band_hz[0]:g} and {band_hz[1]:g} Hz ({listed}); a machine missing from `areas`, "
            f"an overdamped mode, or another band; the whole spectrum: {growth.text}"
        )
    area_of = [areas[m] for m in machines]
    states = _speed_states(system, C)
    if states is None:
        swinging = swinging[: len(machines) - 1]
    candidates = sorted(swinging, key=lambda i: spectrum.values[i].imag)
    fits = [spectrum.fit(i, C, states, area_of) for i in candidates]
    named = {}
    for r, (name, part, rivals) in assigned_names(fits, area_of, least_share).items():
        i = candidates[r]
        shape = C @ spectrum.right[:, i]
        shape = shape / shape[np.argmax(np.abs(shape))]
        named[name] = Mode(
            name=name,
            eigenvalue=complex(spectrum.values[i]),
            shape=dict(zip(machines, shape.tolist(), strict=True)),
            participation=Participation(system.state_labels, spectrum.participation[:, i]),
            share=part,
            right=spectrum.right[:, i],
            left=spectrum.left[:, i],
            rivals=tuple(spectrum.values[[candidates[k] for k in rivals]].tolist()),
        )
    if len(set(areas.values())) > 1 and not any(n.startswith("inter-area") for n in named):
        raise ModeError(
            f"no mode in which the areas {sorted(set(areas.values()))} swing against each other; found "
            f"{', '.join(named)}: are the machines assigned to the right areas? The whole spectrum: "
            f"{growth.text}"
        )
    order = sorted(named, key=_name_key)
    return Modes({name: named[name] for name in order}, spectrum.values, growth)


@dataclass(frozen=True)
class _Spectrum:
    """Eigenvalues (n,), left and right eigenvectors with w^T v = 1 and participations (states, modes).

    weight : sum of |w_i v_i| over the states of each mode; not finite or 0 where the mode is defective.
    """

    values: ComplexMatrix
    left: ComplexMatrix
    right: ComplexMatrix
    participation: Matrix
    weight: Matrix

    @classmethod
    def of(cls, A: Matrix) -> _Spectrum:
        values, left, right = eig(A, left=True, right=True)
        scale = np.sum(left.conj() * right, axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            left = left.conj() / scale
        each = np.abs(left * right)
        weight = np.sum(each, axis=0)
        usable = np.isfinite(weight) & (weight > 0.0)
        participation = np.where(usable, each / np.where(usable, weight, 1.0), 0.0)
        return cls(np.asarray(values, dtype=complex), left, right, participation, weight)

    def swinging(self, system: Linear, C: Matrix, band_hz: tuple[float, float]) -> list[int]:
        """The modes of the band with participation of angles and speeds, largest first."""
        low, high = (2.0 * np.pi * f for f in band_hz)
        share = _mechanical_share(system, C, self.participation, self.values, self.right)
        usable = np.flatnonzero(np.isfinite(self.weight) & (self.weight > 0.0))
        inside = [int(i) for i in usable if low <= self.values[i].imag <= high]
        return sorted((i for i in inside if share[i] > 0.05), key=lambda i: -share[i])

    def fit(self, i: int, C: Matrix, states: list[int] | None, area_of: list[int]) -> dict[str, float]:
        """Share of each pattern in mode i: of the participation of all states, or of its shape.

        states : the speeds; None in a reduced model.
        """
        if states is None:
            return pattern_energies(C @ self.right[:, i], area_of)
        coordinate = self.left[states, i] / C[np.arange(len(states)), states]
        parts = pattern_parts(coordinate, C @ self.right[:, i], area_of)
        return {name: part / self.weight[i] for name, part in parts.items()}


def _speed_rows(system: Linear, machines: list[str]) -> Matrix:
    """Rows of C (machines, n) that read the speeds."""
    if not machines:
        raise ModeError("no machine in `areas`: a swing mode needs at least two")
    outputs = list(system.output_labels)
    missing = [m for m in machines if f"{m}_dw" not in outputs]
    if missing:
        raise ModeError(
            f"no output {missing[0]}_dw: mode shapes are read from the machine speeds; "
            f"outputs are {', '.join(outputs)}"
        )
    return np.asarray(system.C, dtype=float)[[outputs.index(f"{m}_dw") for m in machines]]


def _mechanical_share(
    system: Linear,
    C: Matrix,
    participation: Matrix,
    values: ComplexMatrix,
    right: ComplexMatrix,
) -> Matrix:
    """Share (n,) of angles and speeds in each mode; of a reduced model, how well the speeds ring in it."""
    labels = list(system.state_labels)
    mechanical = {i for i, name in enumerate(labels) if ".delta" in name}
    if mechanical:
        rows = C / np.maximum(np.max(np.abs(C), axis=1, keepdims=True), 1e-300)
        mechanical |= {int(i) for row in rows for i in np.flatnonzero(np.abs(row) > 1e-9)}
        return np.asarray(participation[sorted(mechanical)].sum(axis=0))
    # no physical states (a reduced model): speed of the unit eigenvector against its own decay
    ring = np.linalg.norm(C @ right, axis=0) / np.maximum(np.abs(values.real), 1e-9)
    return np.asarray(ring / max(float(np.max(ring)), 1e-300) * 0.9 + 0.1)


def _speed_states(system: Linear, C: Matrix) -> list[int] | None:
    """The state that is each machine's speed; None for a reduced model, where no state is."""
    if not any(".delta" in name for name in system.state_labels):
        return None
    read = [np.flatnonzero(np.abs(row) > 1e-9 * np.max(np.abs(row))) for row in C]
    return [int(r[0]) for r in read] if all(r.size == 1 for r in read) else None


def _name_key(name: str) -> tuple[int, str]:
    """Inter-area first, then the areas, mixed last."""
    return ({"i": 0, "l": 1}.get(name[0], 2), name)
