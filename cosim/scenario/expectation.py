"""`[expect]`: the outcome that a scenario states; `interarea run` exits with 1 where it is another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import AfterValidator, AliasChoices, Field

from interarea.models.table import Table

#: what a run comes to (`results/verdict.py`); the first two are stable
Verdict = Literal["settled", "settling slowly", "standing swing", "growing", "synchronism lost"]


def _rising(limits: tuple[float, float]) -> tuple[float, float]:
    if not limits[0] <= limits[1]:
        raise ValueError(f"has [{limits[0]:g}, {limits[1]:g}], allowed: [least, most]")
    return limits


Limits = Annotated[tuple[float, float], AfterValidator(_rising)]


class Expectation(Table):
    """The stated outcome: `damping_ratio` and `settling_time_s` as [least, most]."""

    #: whether synchronism is kept and the disturbance decays
    stable: bool | None = None
    #: whether no angle between machines or voltage sources of an island reaches half a turn
    synchronism: bool | None = None
    verdict: Verdict | None = None  #: verdict of the run
    damping_ratio: Mapping[str, Limits] = {}  #: mode -> [least, most]
    settling_time_s: Limits | None = None  #: [least, most]
    #: [least, most] of the swing signal
    peak_pu: Annotated[Limits | None, Field(validation_alias=AliasChoices("peak_pu", "peak_dw24"))] = None
