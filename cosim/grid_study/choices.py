"""The user's choices in the study of a grid, and their file; rules determine the rest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from interarea.design.delay.signal_conditions import LONGEST_MS
from interarea.models.case.write_toml import toml_text
from interarea.models.mistakes import mistakes
from interarea.models.table import Table

from ..errors import ScenarioError
from ..toml_file import read_toml

MINUTES = 10.0  #: of a whole study
#: damping ratio below which a mode counts as weak, and what a design adds to a weak one unless it gets there
WEAK, GAIN = 0.1, 0.05
#: damping ratio of inter-area modes beyond which more is no reason for another actuator, nor to take more
#: from other modes: a swing is then gone after one period
ENOUGH = 0.25


class Choices(Table):
    """A study of a grid; every key but `grid` has a default."""

    grid: Annotated[
        str,
        Field(
            description="bundled case, a case, RAW or MATPOWER file (relative path), or a grid to download"
        ),
    ]
    dyr: Annotated[
        str | None,
        Field(description="PSS/E dynamic data of a RAW file, relative path", examples=["mine.dyr"]),
    ] = None
    minutes: Annotated[
        float,
        Field(gt=0.0, description="limit of the processor time; the page lists the parts that exceed it"),
    ] = MINUTES
    #: none: what `required_damping` says
    inter_area: Annotated[
        float | None,
        Field(ge=0.0, lt=1.0, description="required damping ratio of the inter-area modes"),
    ] = None
    given_away: Annotated[
        float,
        Field(
            gt=0.0, description="what any mode may lose of its damping ratio, or of 0.1 where that is less"
        ),
    ] = 0.005
    #: none: all
    actuators: Annotated[tuple[str, ...], Field(description="voltage set-points available to the loops")] = ()
    most_actuators: Annotated[
        int, Field(ge=1, le=6, description="largest number of actuators of a set of loops")
    ] = 4
    #: with any one lost there are others
    signals: Annotated[
        int, Field(ge=1, le=10, description="largest number of speeds per actuator, including its own")
    ] = 3
    #: as in the bundled designs of large grids
    order: Annotated[int, Field(ge=1, le=20, description="states of each loop")] = 4
    #: noise of 1 mHz on a speed then moves an output by .0016 pu at most
    effort: Annotated[float, Field(gt=0.0, description="largest effort, pu per rad/s")] = 0.25
    latencies_ms: Annotated[
        tuple[Annotated[int, Field(gt=0, le=LONGEST_MS)], ...],
        Field(description="latencies of all signals, in addition to zero"),
    ] = (100, 200)
    faults: Annotated[int, Field(ge=1, description="largest number of fault locations")] = 6
    #: runs end at 10 s, and a swing needs some seconds to be judged
    clear_s: Annotated[float, Field(gt=0.0, le=5.0, description="duration of a fault, s")] = 0.1

    def required_damping(self, least: float) -> float:
        """Return the required inter-area damping ratio if the least without control is `least`.

        >>> choices = Choices(grid="new-england")
        >>> [round(choices.required_damping(damping), 3) for damping in (0.02, 0.08, 0.2)]
        [0.07, 0.1, 0.2]
        """
        if self.inter_area is not None:
            return self.inter_area
        return min(least + GAIN, max(WEAK, least))


def load_choices(path: Path) -> Choices:
    """Read the file of a grid study. Raises ScenarioError with one line for each error."""
    keys = read_toml(path, "study", ScenarioError)
    try:
        return Choices.model_validate(keys)
    except ValidationError as error:
        raise ScenarioError(*(f"{path}: {line}" for line in mistakes(error, Choices))) from error


def choices_text(choices: Choices, findings: Sequence[str]) -> str:
    """Return the text of a study file with every choice, and properties of its grid as comments."""
    keys: dict[str, Any] = choices.model_dump(mode="json", exclude_none=True)
    lines = [f"# {line}" for line in findings]
    for key, value in keys.items():
        lines += [f"# {Choices.model_fields[key].description}", toml_text({key: value}).strip()]
    return "\n".join(lines) + "\n"
