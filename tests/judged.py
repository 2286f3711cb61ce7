"""The verdict on signals whose answer is known: two machines, of whose speeds one is the other's negative."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from interarea.cosim.results.verdict import Motion, Verdict


def judged(
    time_s: np.ndarray,
    swing: np.ndarray,
    *,
    events_s: Sequence[float] = (),
    outages_s: Sequence[float] = (),
    controls: Mapping[str, np.ndarray] | None = None,
    limit_pu: float | None = None,
    angles: np.ndarray | None = None,
    common: np.ndarray | float = 0.0,
    alone: bool = False,
    root: complex | None = None,
    parts: Sequence[int] = (),
) -> Verdict:
    """Return the verdict on a speed difference (pu), in parts that end at the points `parts`.

    alone : one machine, which has the whole swing as its speed. common : added to both speeds.
    """
    speeds = np.array([swing]) if alone else np.array([0.5 * swing, -0.5 * swing]) + common
    shown = np.zeros_like(speeds) if angles is None else angles
    names = ["A", "B"][: len(speeds)]
    rows = [list(range(len(speeds)))]
    motion = Motion(names, rows, events_s, [*events_s, *outages_s], float(time_s[-1]), 2.0 * np.pi * 60.0)
    edges = [0, *parts, len(time_s) - 1]
    for first, last in pairwise(edges):
        part = slice(first, last + 1)
        taken = {name: u[part] for name, u in (controls or {}).items()}
        motion.add(time_s[part], speeds[:, part], shown[:, part], taken)
    return motion.verdict(limit_pu, root)
