"""Patterns of swing modes: the share of each pattern in a mode, and the assignment of names to modes.

The patterns are the areas against each other and, inside area k, its machines against each other.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching  # scipy.optimize takes .2 s to load

ComplexMatrix = NDArray[np.complex128]
_AS_WELL = 0.75  #: a fit this near to the best one is as good


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


def pattern_parts(left: ComplexMatrix, right: ComplexMatrix, area_of: list[int]) -> dict[str, float]:
    """Participation of each pattern in a mode, from its speeds (machines,) left and right.

    The participation of a state is |w_i v_i|, that of a pattern |w^T P v| with the projector P on it: between
    areas, or inside area k. Motion that a controller only drives is in v alone, motion that only drives it in
    w alone.
    """
    a = np.asarray(area_of)
    mean_left, mean_right = left.mean(), right.mean()
    parts: dict[str, complex] = {"inter-area": 0.0}
    for k in sorted(set(area_of)):
        w, v = left[a == k], right[a == k]
        parts["inter-area"] += w.size * (w.mean() - mean_left) * (v.mean() - mean_right)
        parts[f"local area {k}"] = np.sum((w - w.mean()) * (v - v.mean()))
    return {name: float(abs(x)) for name, x in parts.items()}


def assigned_names(
    fits: list[dict[str, float]], area_of: list[int], least_share: float
) -> dict[int, tuple[str, float, list[int]]]:
    """Assign the names for the best total fit.

    fits : share of each pattern in each mode, by frequency. Returns, for the named modes: name, share of the
    named pattern among all, and the other modes that fit the name.
    """
    kinds = ["inter-area"] * (len(set(area_of)) - 1)
    for k in sorted(set(area_of)):
        kinds += [f"local area {k}"] * (area_of.count(k) - 1)
    gain = np.array([[fit[kind] for kind in kinds] for fit in fits])
    kind_of = {r: kinds[c] for r, c in _best_pairs(gain)}
    share = {r: fits[r][kind] / max(sum(fits[r].values()), 1e-300) for r, kind in kind_of.items()}
    final = {r: kind if share[r] >= least_share else "mixed" for r, kind in kind_of.items()}
    result = {}
    for r, kind in final.items():
        same = [other for other in final if final[other] == kind]
        separator = " " if kind in ("inter-area", "mixed") else "."
        name = kind if len(same) == 1 else f"{kind}{separator}{same.index(r) + 1}"
        result[r] = (name, share[r], [k for k in range(len(fits)) if _fits_as_well(k, r, kind_of, fits)])
    return result


def _best_pairs(gain: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Return the pairs (row, column), as many as there can be, with the largest sum of gains."""
    if not gain.size:
        return []
    cost = gain.max() + 1.0 - gain  # above zero, where a sparse matrix would have no entry
    rows, columns = min_weight_full_bipartite_matching(csr_array(cost))
    return list(zip(rows.tolist(), columns.tolist(), strict=True))


def _fits_as_well(k: int, r: int, kind_of: Mapping[int, str], fits: list[dict[str, float]]) -> bool:
    """Whether mode k could have the name that mode r has: without one of its own, or by an exchange."""
    kind, other = kind_of[r], kind_of.get(k)
    if other == kind:
        return False
    if other is None:
        return fits[k][kind] >= _AS_WELL * fits[r][kind]
    return fits[k][kind] + fits[r][other] >= _AS_WELL * (fits[r][kind] + fits[k][other])
