"""What a run leaves: the trajectory, the delays it was run with, and what became of its packets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from ..trajectory import Trajectory
from .delay_ledger import DelayLedger, PacketLedger


@dataclass(frozen=True, kw_only=True, repr=False)
class Result:
    """`trajectory`, delay `ledger`, `packets` and the `explanation` of how it was stepped."""

    trajectory: Trajectory
    ledger: DelayLedger
    packets: PacketLedger
    explanation: str

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.trajectory!r})"

    @property
    def data(self) -> pd.DataFrame:
        """A DataFrame: ``time_s``, then ``INSTANCE.VARIABLE``; units in ``data.attrs["units"]``."""
        return self.trajectory.data

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column."""
        return self.trajectory.units

    def __getitem__(self, column: str) -> npt.NDArray[np.float64]:
        """Return one column as an array; the error names the columns there are."""
        return self.trajectory[column]

    def explain(self) -> str:
        """Return how it was stepped: step, order, loops, unconnected inputs, delay and packet ledgers."""
        return f"{self.explanation}\n\n{self.packets}"
