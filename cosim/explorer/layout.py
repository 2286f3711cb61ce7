"""Where the buses of a grid are drawn: distances on paper like distances along the branches."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse.csgraph import shortest_path

from interarea.models.case.case import Case

_SWEEPS = 400


def bus_positions(case: Case) -> dict[int, tuple[float, float]]:
    """Return where each bus is drawn: x from 0 (first area) to 1, y from 0 (top) in the same unit.

    Stress majorization (Gansner, Koren, North 2004) of the distances along the branches, from classical
    scaling; turned so that the areas lie side by side. The same case gives the same places.
    """
    numbers = [bus.number for bus in case.buses]
    index = {number: k for k, number in enumerate(numbers)}
    n = len(numbers)
    if n == 1:
        return {numbers[0]: (0.5, 0.0)}
    weight = np.full((n, n), np.inf)
    for branch in case.branches:
        i, j = index[branch.from_bus], index[branch.to_bus]
        weight[i, j] = weight[j, i] = 0.8 if branch.kind == "transformer" else 1.0
    distance = shortest_path(np.where(np.isfinite(weight), weight, 0.0), directed=False)
    reach = distance[np.isfinite(distance)].max()
    distances = np.where(np.isfinite(distance), distance, reach + 1.0)
    places = _majorized(_scaled(distances), distances)
    return {
        number: (float(x), float(y)) for number, (x, y) in zip(numbers, _turned(case, places), strict=True)
    }


def _scaled(target: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Classical scaling: the two leading coordinates of the centred squared distances."""
    n = len(target)
    centre = np.eye(n) - 1.0 / n
    values, vectors = np.linalg.eigh(-0.5 * centre @ target**2 @ centre)
    places: npt.NDArray[np.float64] = vectors[:, -2:] * np.sqrt(np.maximum(values[-2:], 1e-9))
    # eigenvectors have no sign; a small fixed asymmetry keeps buses of one distance apart
    places *= np.sign(places[np.argmax(np.abs(places), axis=0), [0, 1]])
    angle = 2.4 * np.arange(n)
    return places[:, ::-1] + 0.02 * np.column_stack([np.cos(angle), np.sin(angle)])


def _majorized(places: npt.NDArray[np.float64], target: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    n = len(places)
    weights = np.divide(1.0, target**2, out=np.zeros_like(target), where=target > 0.0)
    laplacian = np.diag(weights.sum(axis=1)) - weights
    solve = np.linalg.inv(laplacian + 1.0 / n)
    for _ in range(_SWEEPS):
        apart = np.linalg.norm(places[:, None] - places[None], axis=2)
        pull = np.divide(weights * target, apart, out=np.zeros_like(apart), where=apart > 1e-9)
        places = solve @ (np.diag(pull.sum(axis=1)) - pull) @ places
    return places


def _turned(case: Case, places: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Turn the long side to x, the first area to the left, and the buses with machines down."""
    places = places - places.mean(axis=0)
    _, _, axes = np.linalg.svd(places, full_matrices=False)
    places = places @ axes.T
    area = np.array([bus.area for bus in case.buses])
    in_area = area == area.min()
    if places[in_area, 0].mean() > places[:, 0].mean() + 1e-9:
        places[:, 0] *= -1.0
    homes = [k for k, bus in enumerate(case.buses) if bus.number in {m.bus for m in case.machines}]
    if places[homes, 1].mean() < 0.0:
        places[:, 1] *= -1.0
    low, span = places.min(axis=0), np.ptp(places[:, 0]) or 1.0
    return np.asarray((places - low) / span)
