"""Where the names of many arrows go around a compass."""

from __future__ import annotations

import math
from collections.abc import Sequence


def rim_angles(angles: Sequence[float], gap: float) -> list[float]:
    """Return places on the rim, rad, near `angles` and at least `gap` apart, in the same order round.

    Arrows that are too close form a cluster, which is spread evenly about its mean; clusters that then
    touch are joined, until none do.

    >>> [round(a, 6) for a in rim_angles([0.0, 0.0, 2.0], 0.2)]
    [-0.1, 0.1, 2.0]

    Raises
    ------
    ValueError : a gap that leaves no room for all of them.
    """
    if not 0.0 < gap * len(angles) <= 2.0 * math.pi:
        raise ValueError(f"{len(angles)} names {gap:g} rad apart do not fit round a circle of 2 pi")
    order = sorted(range(len(angles)), key=lambda k: angles[k])
    # begin after the widest empty sector, so that no cluster lies across the cut
    turned = [angles[k] for k in order]
    holes = [(turned[(k + 1) % len(turned)] - turned[k]) % (2.0 * math.pi) for k in range(len(turned))]
    cut = max(range(len(holes)), key=holes.__getitem__) + 1 if len(turned) > 1 else 0
    order = order[cut:] + order[:cut]
    line = [angles[k] + (2.0 * math.pi if angles[k] < angles[order[0]] else 0.0) for k in order]
    clusters = [[value] for value in line]
    joined = True
    while joined:
        joined = False
        for k in range(len(clusters) - 1):
            if _ends(clusters[k + 1], gap)[0] - _ends(clusters[k], gap)[1] < gap * (1.0 - 1e-9):
                clusters[k : k + 2] = [clusters[k] + clusters[k + 1]]
                joined = True
                break
    places = [0.0] * len(angles)
    position = 0
    for cluster in clusters:
        first, _ = _ends(cluster, gap)
        for step in range(len(cluster)):
            places[order[position]] = first + step * gap
            position += 1
    return places


def _ends(cluster: Sequence[float], gap: float) -> tuple[float, float]:
    """First and last place of a cluster spread about its mean; one arrow keeps its angle."""
    mean, half = sum(cluster) / len(cluster), gap * (len(cluster) - 1) / 2.0
    return mean - half, mean + half
