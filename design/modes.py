"""Swing modes of a linear plant, named by their shape and never by their position.

A mode is electromechanical when rotor angles and speeds carry its participation. Who swings
against whom is read from the machine speeds: area against area is `inter-area`, machines
against each other inside area k are `local area k`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import control
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig
from scipy.optimize import linear_sum_assignment

Matrix = NDArray[np.float64]
ComplexMatrix = NDArray[np.complex128]


class ModeError(ValueError):
    """A mode that was asked for is not in the system."""


@dataclass(frozen=True)
class Mode:
    r"""One oscillatory mode, :math:`A v = \lambda v,\ w^T A = \lambda w^T,\ w^T v = 1`.

    Attributes
    ----------
    name : by shape, such as ``inter-area``.
    eigenvalue : lambda, 1/s, the one with positive imaginary part.
    shape : machine -> speed in this mode, the largest being 1 with angle 0.
    participation : state -> \|w_i v_i\| / sum \|w_k v_k\|; sums to 1.
    share : part of the shape's energy that has the named pattern, 0..1.
    right, left : v and w, shape (n,).
    """

    name: str
    eigenvalue: complex
    shape: Mapping[str, complex]
    participation: Mapping[str, float]
    share: float
    right: ComplexMatrix
    left: ComplexMatrix

    @property
    def frequency_hz(self) -> float:
        """Damped frequency Im(lambda) / 2 pi, Hz."""
        return abs(self.eigenvalue.imag) / (2.0 * np.pi)

    @property
    def damping_ratio(self) -> float:
        r"""-Re(lambda) / \|lambda\|."""
        return damping_ratio(self.eigenvalue)

    def sensitivity(self, dA: Matrix) -> complex:
        r"""First-order move of the eigenvalue, :math:`d\lambda = w^T\, dA\, v` (1/s), for dA (n, n)."""
        dA = np.asarray(dA)
        n = self.right.size
        if dA.shape != (n, n):
            raise ValueError(f"dA has shape {dA.shape}, mode {self.name!r} has {n} states: need ({n}, {n})")
        return complex(self.left @ dA @ self.right)


@dataclass(frozen=True)
class Modes(Mapping[str, Mode]):
    """The named swing modes of a system, with all its eigenvalues."""

    by_name: Mapping[str, Mode]
    eigenvalues: ComplexMatrix

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
        found = [m for name, m in self.by_name.items() if name.startswith("inter-area")]
        if not found:
            raise ModeError(f"no inter-area mode; this system has {', '.join(self.by_name)}")
        return min(found, key=lambda m: m.damping_ratio)


def damping_ratio(eigenvalue: complex) -> float:
    r"""-Re(lambda) / \|lambda\|; 1 for a decaying and -1 for a growing real mode, 0 at the origin."""
    size = abs(eigenvalue)
    return float(-eigenvalue.real / size) if size > 0.0 else 0.0


def modes_of(
    system: control.StateSpace,
    areas: Mapping[str, int],
    *,
    band_hz: tuple[float, float] = (0.05, 4.0),
    least_share: float = 0.25,
) -> Modes:
    r"""Find and name the N - 1 swing modes of a plant with N machines.

    Electromechanical share of a mode: participation of the machines' angles (states ``*.delta*``) and
    speeds (the states its outputs ``*_dw`` read). The N - 1 oscillatory modes of the band with the
    largest share are the swing modes. With speeds s_m in a mode, area means a_k of n_k machines
    and overall mean a, the shape's energy splits into

    .. math:: \sum_k n_k |a_k - a|^2 \;\text{(between areas)} \quad\text{and}\quad
              \sum_{m \in k} |s_m - a_k|^2 \;\text{(inside area k)},

    and N - 1 = (areas - 1) + sum (n_k - 1) names are given out so that the total energy in the
    named patterns is largest. A mode with less than `least_share` in its pattern is
    called ``mixed``. Several modes of one kind are numbered by frequency: ``inter-area 1``,
    ``local area 2.1``.

    Parameters
    ----------
    system : outputs ``G1_dw`` ... for every machine of `areas`; any unit of speed.
    areas : machine name -> area number.
    band_hz : where swing modes are looked for.

    Raises
    ------
    ModeError : a speed output is missing, fewer swing modes than machines ask for, or no
        inter-area mode among them.
    """
    machines = list(areas)
    if len(machines) < 2:
        raise ModeError(f"{len(machines)} machine(s) in `areas`: a swing mode needs at least two")
    C = _speed_rows(system, machines)
    A = np.asarray(system.A, dtype=float)
    values, left, right = eig(A, left=True, right=True)
    scale = np.sum(left.conj() * right, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        left = left.conj() / scale
    weight = np.abs(left * right)
    total = np.sum(weight, axis=0)
    usable = np.isfinite(total) & (total > 0.0)
    participation = np.where(usable, weight / np.where(usable, total, 1.0), 0.0)

    low, high = (2.0 * np.pi * f for f in band_hz)
    candidates = [i for i in np.flatnonzero(usable) if low <= values[i].imag <= high]
    share = _mechanical_share(system, C, participation, values, right)
    candidates = sorted(candidates, key=lambda i: -share[i])[: len(machines) - 1]
    if len(candidates) < len(machines) - 1 or not all(share[i] > 0.05 for i in candidates):
        found = [i for i in candidates if share[i] > 0.05]
        listed = ", ".join(f"{values[i].real:.4g}{values[i].imag:+.4g}j" for i in found) or "none"
        raise ModeError(
            f"{len(machines)} machines have {len(machines) - 1} swing modes, but {len(found)} were found "
            f"between {band_hz[0]:g} and {band_hz[1]:g} Hz ({listed}); a machine missing from `areas`, "
            "an overdamped mode, or another band"
        )
    candidates.sort(key=lambda i: values[i].imag)
    shapes = [C @ right[:, i] for i in candidates]
    shapes = [s / s[np.argmax(np.abs(s))] for s in shapes]
    names, shares = _name_by_shape(shapes, [areas[m] for m in machines], least_share)
    labels = list(system.state_labels)
    found_modes = {
        name: Mode(
            name=name,
            eigenvalue=complex(values[i]),
            shape=dict(zip(machines, (complex(z) for z in shape), strict=True)),
            participation=dict(zip(labels, participation[:, i].tolist(), strict=True)),
            share=part,
            right=right[:, i],
            left=left[:, i],
        )
        for name, part, i, shape in zip(names, shares, candidates, shapes, strict=True)
    }
    if len(set(areas.values())) > 1 and not any(n.startswith("inter-area") for n in names):
        raise ModeError(
            f"no mode in which the areas {sorted(set(areas.values()))} swing against each other; found "
            f"{', '.join(names)}: are the machines assigned to the right areas?"
        )
    order = sorted(found_modes, key=_name_key)
    return Modes({name: found_modes[name] for name in order}, np.asarray(values, dtype=complex))


def _speed_rows(system: control.StateSpace, machines: list[str]) -> Matrix:
    """Rows of C (machines, n) that read the speeds."""
    outputs = list(system.output_labels)
    missing = [m for m in machines if f"{m}_dw" not in outputs]
    if missing:
        raise ModeError(
            f"no output {missing[0]}_dw: mode shapes are read from the machine speeds; "
            f"outputs are {', '.join(outputs)}"
        )
    return np.asarray(system.C, dtype=float)[[outputs.index(f"{m}_dw") for m in machines]]


def _mechanical_share(
    system: control.StateSpace, C: Matrix, participation: Matrix, values: ComplexMatrix, right: ComplexMatrix
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


def pattern_energies(shape: ComplexMatrix, area_of: list[int]) -> dict[str, float]:
    """Split the energy of a mode shape (machines,) into between areas and inside each area; sums to 1."""
    s = np.asarray(shape, dtype=complex)
    a = np.asarray(area_of)
    mean = s.mean()
    energies = {"inter-area": 0.0}
    for k in sorted(set(area_of)):
        inside = s[a == k]
        energies["inter-area"] += inside.size * abs(inside.mean() - mean) ** 2
        energies[f"local area {k}"] = float(np.sum(np.abs(inside - inside.mean()) ** 2))
    total = sum(energies.values())
    return {name: float(e / total) if total > 0.0 else 0.0 for name, e in energies.items()}


def _name_by_shape(
    shapes: list[ComplexMatrix], area_of: list[int], least_share: float
) -> tuple[list[str], list[float]]:
    """Give each shape (sorted by frequency) a name; the names together fit the shapes best."""
    kinds = ["inter-area"] * (len(set(area_of)) - 1)
    for k in sorted(set(area_of)):
        kinds += [f"local area {k}"] * (area_of.count(k) - 1)
    energies = [pattern_energies(s, area_of) for s in shapes]
    gain = np.array([[e[kind] for kind in kinds] for e in energies])
    rows, cols = linear_sum_assignment(-gain)
    kind_of = {int(r): kinds[c] for r, c in zip(rows, cols, strict=True)}
    share = [float(energies[r][kind_of[r]]) for r in range(len(shapes))]
    final = [kind_of[r] if share[r] >= least_share else "mixed" for r in range(len(shapes))]
    names = []
    for r, kind in enumerate(final):
        same = [i for i, other in enumerate(final) if other == kind]
        if len(same) == 1:
            names.append(kind)
        else:
            separator = " " if kind in ("inter-area", "mixed") else "."
            names.append(f"{kind}{separator}{same.index(r) + 1}")
    return names, share


def _name_key(name: str) -> tuple[int, str]:
    """Inter-area first, then the areas, mixed last."""
    return ({"i": 0, "l": 1}.get(name[0], 2), name)
