"""A run between two steps: what is needed to go back to there, or to go on from there in another run."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Saved:
    """A master between two steps: states of all participants and what the master itself remembers."""

    index: int
    states: Mapping[str, object]
    signals: tuple[tuple[object, ...], ...]
    rows: int


@dataclass(frozen=True)
class Fork:
    """A beginning that several masters can share: the state after it, what was recorded and counted."""

    saved: Saved
    ends: array[int]
    times: npt.NDArray[np.float64]
    records: npt.NDArray[np.float64]
    counts: tuple[float, int, int, str]
