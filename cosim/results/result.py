"""What a run leaves: the trajectory, the delays it was run with, and what became of its packets."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from interarea.models.files import together, write_whole

from ..trajectory import Trajectory
from .delay_ledger import DelayLedger, PacketLedger
from .record import record_of, write_json, write_record
from .trajectory_files import TrajectoryFiles

if TYPE_CHECKING:
    import pandas as pd

    from ..scenario.scenario import Scenario


@dataclass(frozen=True, kw_only=True, repr=False)
class Result:
    """`trajectory`, delay `ledger`, `packets` and the `explanation` of how it was stepped.

    fmu_log : every message that an FMU logged: instance, time, status, text.
    warnings : a line on each thing that is harmless but wrong, or probably unintended.
    """

    trajectory: Trajectory
    ledger: DelayLedger
    packets: PacketLedger
    explanation: str
    scenario: Scenario | None = None  #: that was run, None of a system put together in Python
    warnings: tuple[str, ...] = ()
    fmu_log: tuple[str, ...] = ()

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

    @cached_property
    def made_from(self) -> dict[str, Any]:
        """What the numbers depend on, as run.json has it (`record_of`); empty without a scenario."""
        return {} if self.scenario is None else record_of(self.scenario, getattr(self, "case", None))

    def to_frame(self) -> pd.DataFrame:
        """Return the signals over time: index ``time_s``, columns ``INSTANCE.VARIABLE``."""
        return self.data.set_index("time_s")

    def save(self, folder: str | Path, *, record: Sequence[str] = (), every: int = 1) -> list[Path]:
        """Write trajectory.csv, trajectory.parquet, ledger.json into a folder; return the files.

        Of a scenario scenario.toml too, resolved, and run.json: versions, seeds, commit. Where an FMU logged
        something fmu_log.txt.

        record, every : columns and points of the trajectory, as the keys of a scenario.
        All of them are written, or after an error none.

        Raises
        ------
        DestinationError : a file that cannot be written. ScenarioError : a column that is not there.
        """
        with together():
            with TrajectoryFiles(Path(folder), record, every) as files:
                files.add(self.trajectory)
            return [*files.files, *self.save_beside(Path(folder))]

    def save_beside(self, folder: Path, explorer: str = "") -> list[Path]:
        """Write what `save` does beside the trajectory; `explorer` as `Run.save`."""
        ledgers = {
            "step_s": self.ledger.step_s,
            "inputs": self.ledger.inputs,
            "delays": self.ledger.as_rows(),
            "rounded": list(self.ledger.rounded),
            "warnings": list(self.warnings),
            "packets": {name: dict(row) for name, row in self.packets.rows.items()},
        }
        files = [folder / "ledger.json"]
        write_json(ledgers, files[0])
        log = folder / "fmu_log.txt"
        if self.fmu_log:
            files.append(write_whole(log, "".join(f"{line}\n" for line in self.fmu_log)))
        else:
            log.unlink(missing_ok=True)  # that of an earlier run
        if self.scenario is not None:
            files += write_record(folder, self.scenario, self.made_from)
        return files

    def _repr_html_(self) -> str:
        table = self.data.describe().to_html(float_format="{:.4g}".format)
        return f"<p><b>{html.escape(repr(self))}</b></p>{table}"

    def explain(self) -> str:
        """Return how it was stepped: step, order, loops, unconnected inputs, delay and packet ledgers."""
        warnings = "".join(f"\n\nwarning: {line}" for line in self.warnings)
        return f"{self.explanation}\n\n{self.packets}{warnings}"
