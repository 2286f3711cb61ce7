"""The table of a scenario that says how the master steps."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from interarea.models.table import Table

from ..stepping_words import Early, Inputs, Loops, early_word


class MasterTable(Table):
    """How the master transfers inputs and treats loops (see `Master`)."""

    #: inputs between communication points: cubics, straight lines, or held
    inputs: Inputs = "hermite"
    #: loops without a channel: iterate with saved states, extrapolate, or whichever is possible
    loops: Loops = "auto"
    tolerance: Annotated[float, Field(gt=0.0, lt=1.0)] = 1e-7  #: of the iteration, relative
    #: if an FMU ends a step early: continue from there, or roll all back to the last point
    early: Annotated[Early, BeforeValidator(early_word)] = "continue"
    #: packets arrive at their instant, or at communication points
    arrivals: Literal["exact", "grid"] = "exact"
    joint: bool = False  #: no master: plant, controller and channels in one block (`run_joint`)

    @property
    def options(self) -> dict[str, Any]:
        """What `Master` takes of this table."""
        return self.model_dump(exclude={"arrivals", "joint"})
