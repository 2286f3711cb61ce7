"""What a person may choose in the study of a grid, and the file that holds it; the rest follows by rules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from interarea.models.case.write_toml import toml_text
from interarea.models.mistakes import mistakes
from interarea.models.table import Table

from ..errors import ScenarioError
from ..toml_file import read_toml

MINUTES = 10.0  #: of a whole study
#: damping ratio below which a mode counts as weak, and what a design adds to a weak one unless it gets there
WEAK, GAIN = 0.1, 0.05
Positive = Annotated[float, Field(gt=0.0)]
Ratio = Annotated[float, Field(ge=0.0, lt=1.0)]


class Choices(Table):
    """A study of a grid; every key but `grid` has a default."""

    grid: str  #: bundled case, a case, RAW or MATPOWER file beside this one, or a grid to download
    dyr: str | None = None  #: PSS/E dynamic data of a RAW file, beside this one
    minutes: Positive = MINUTES  #: that it may take; what there is no time for is left out and said
    #: inter-area damping ratio that is asked for; none: 0.05 more than without control, or 0.1, which is less
    inter_area: Ratio | None = None
    #: what any mode may lose of its damping ratio without control, or of 0.1 where that is less
    given_away: Positive = 0.005
    #: voltage set-points that the loops may drive, such as "G4_vs"; none: all
    actuators: tuple[str, ...] = ()
    most_actuators: Annotated[int, Field(ge=1, le=6)] = 4  #: of a set of loops
    #: speeds that each actuator sees at most: with any one lost there are others
    signals: Annotated[int, Field(ge=1, le=10)] = 3
    order: Annotated[int, Field(ge=1, le=20)] = (
        4  #: states of each loop, as in the bundled designs of large grids
    )
    #: pu per rad/s: noise of 1 mHz on a speed then moves an output by .0016 pu at most
    effort: Positive = 0.25
    latencies_ms: tuple[Annotated[int, Field(gt=0)], ...] = (100, 200)  #: of all signals, beside none
    faults: Annotated[int, Field(ge=1)] = 6  #: places of faults at most
    clear_s: Positive = 0.1  #: how long a fault lasts

    def wanted(self, least: float) -> float:
        """Return the inter-area damping ratio asked for where the least without control is `least`.

        >>> choices = Choices(grid="new-england")
        >>> round(choices.wanted(0.02), 3), choices.wanted(0.08), choices.wanted(0.2)
        (0.07, 0.1, 0.2)
        """
        if self.inter_area is not None:
            return self.inter_area
        return min(least + GAIN, max(WEAK, least))


def load_choices(path: Path) -> Choices:
    """Read the file of a study of a grid. Raises ScenarioError: each mistake in a line."""
    keys = read_toml(path, "study", ScenarioError)
    try:
        return Choices.model_validate(keys)
    except ValidationError as error:
        raise ScenarioError(*(f"{path}: {line}" for line in mistakes(error, Choices))) from error


#: key -> what it says in a file to start from
_WORDS: Mapping[str, str] = {
    "grid": "bundled case, a case, RAW or MATPOWER file beside this one, or a grid to download",
    "dyr": "PSS/E dynamic data of a RAW file, beside this one",
    "minutes": "that it may take; what there is no time for is left out and said",
    "inter_area": "damping ratio that is asked of the inter-area modes",
    "given_away": "what any mode may lose of its damping ratio, or of 0.1 where that is less",
    "actuators": "voltage set-points that the loops may drive",
    "most_actuators": "of a set of loops",
    "signals": "speeds that each actuator sees at most, its own among them",
    "order": "states of each loop",
    "effort": "pu per rad/s, at most",
    "latencies_ms": "of all signals, beside none",
    "faults": "places of faults, at most",
    "clear_s": "how long a fault lasts",
}


def choices_text(choices: Choices, found: Sequence[str]) -> str:
    """Return the file of a study with every choice in it, and what was found in its grid as comments."""
    keys: dict[str, Any] = choices.model_dump(mode="json", exclude_none=True)
    lines = [f"# {line}" for line in found]
    for key, value in keys.items():
        lines += [f"# {_WORDS[key]}", toml_text({key: value}).strip()]
    return "\n".join(lines) + "\n"
