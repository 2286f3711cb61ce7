"""A sweep: one scenario, many values. What is varied, how many runs that is, and which run has which values.

A sweep file is TOML:

    scenario = "lost-signal"            # bundled name, a file beside this one, or a [scenario] table
    seed = 1                            # of what is drawn
    samples = 200                       # draws for each cell of the grid (latin_hypercube, random)
    metrics = ["stable", "damping"]     # default: all of METRICS
    time_limit_s = 60.0                 # of computing, for each run
    [trajectories]
    keep = "unstable"                   # none | all | unstable
    [parameters.latency]
    path = "channels.remote.latency_s"  # default: the name of the table
    range = { start = 0.0, stop = 0.5, step = 0.05 }
    [parameters.loss]
    path = "channels.*.loss.rate"
    values = [0.0, 0.1, 0.3]

A parameter has one of `values`, `range`, `latin_hypercube`, `random`, `bisect` (see `sweep_values`); its
`path` leads into the case, the controller, a channel, an event, the seed or the master (see `sweep_point`).
Listed values and ranges form a grid, each cell of which has `samples` runs when something is sampled.
"""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from interarea.models.errors import Collected
from interarea.models.mistakes import mistakes, suggestion
from interarea.models.table import ShortName, Table, Title

from ..errors import SweepError, nearest
from ..results.largest_deviation import SHOWN
from ..results.metrics import METRICS, SYNCHRONISM
from ..scenario.document import scenario_document
from ..scenario.scenario import Scenario, load_scenario
from ..toml_file import read_toml
from .values import Parameter, Search, Value

COLUMNS_TAKEN = (
    "run", "status", "failure", "reason", "stable", "peak_pu", "energy_pu2s", "effort_pu2s", "fit_error",
)  # fmt: skip
LARGEST = 100_000  #: runs that need no confirmation
Path_ = tuple[str, ...]


class Trajectories(Table):
    """Which trajectories are stored, of which columns (default: all), every how many points."""

    keep: Literal["none", "all", "unstable"] = "none"  #: of no run, of all, or of unstable ones
    columns: tuple[str, ...] = ()  #: stored names; default: all
    every: Annotated[int, Field(ge=1)] = 1  #: every N-th point is stored


class Sweep(Table):
    """A checked sweep; `base` is the scenario that is varied."""

    name: ShortName = "sweep"  #: of the sweep
    title: Title = ""  #: one line on the purpose
    base: Scenario
    parameters: Mapping[str, Parameter] = {}  #: name -> varied quantity
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0  #: of the random parameters
    #: number of runs of random and latin-hypercube parameters
    samples: Annotated[int, Field(ge=1)] | None = None
    #: what a row holds; "synchronism" besides, for faults: angles, lowest voltage, extremes of frequency
    metrics: tuple[str, ...] = METRICS
    time_limit_s: Annotated[float, Field(gt=0.0)] = 60.0  #: of one run; longer ones are failed rows
    trajectories: Trajectories = Trajectories()  #: stored trajectories

    @model_validator(mode="after")
    def _metrics_exist(self) -> Self:
        for metric in self.metrics:
            if metric not in (*METRICS, SYNCHRONISM):
                raise ValueError(f"metrics has {metric!r}; {nearest(metric, (*METRICS, SYNCHRONISM))}")
        return self

    @model_validator(mode="after")
    def _names_are_free(self) -> Self:
        for name in self.parameters:
            if not name.isidentifier() or name in COLUMNS_TAKEN or name.startswith(("damping_", "packets_")):
                raise ValueError(
                    f"parameters.{name}: a name is letters, digits and _, and none of the result's columns "
                    f"({', '.join(COLUMNS_TAKEN)}, damping_*, packets_*)"
                )
        return self

    @model_validator(mode="after")
    def _drawn_as_often_as_said(self) -> Self:
        searched = [n for n, p in self.parameters.items() if p.bisect is not None]
        if len(searched) > 1:
            raise ValueError(f"bisect in {' and '.join(searched)}, allowed: in one parameter")
        sampled = [n for n, p in self.parameters.items() if p.sampled]
        if sampled and self.samples is None:
            raise ValueError(f"samples is missing: parameters.{sampled[0]} is drawn that many times")
        if self.samples is not None and not sampled:
            raise ValueError("samples is given, but no parameter has latin_hypercube or random")
        return self

    @property
    def searched(self) -> tuple[str, Search] | None:
        """The parameter that is searched for the edge of stability, if any."""
        for name, p in self.parameters.items():
            if p.bisect is not None:
                return name, p.bisect
        return None

    @property
    def show(self) -> tuple[str, ...] | None:
        """What the plants show, by pattern; None: what they show by themselves."""
        return SHOWN if SYNCHRONISM in self.metrics else None

    def paths(self, name: str) -> tuple[Path_, ...]:
        """Return where parameter `name` goes, `*` written out for each channel."""
        provided = self.parameters[name].path
        result: list[Path_] = []
        for text in (name,) if provided is None else (provided,) if isinstance(provided, str) else provided:
            words = split_path(text, f"parameters.{name}")
            if words[0] in ("channels", "concentrators") and words[1:2] == ("*",):
                lines = getattr(self.base, words[0])
                if not lines:
                    raise SweepError(
                        f"parameters.{name}: path = {text!r}, but the scenario has no {words[0]}"
                    )
                result += [(words[0], line, *words[2:]) for line in lines]
            else:
                result.append(words)
        return tuple(result)

    # -- which run is which ---------------------------------------------------------------

    @cached_property
    def axes(self) -> tuple[tuple[str, int], ...]:
        """Axes of the sweep, slowest first: (parameter, size), and ("", samples) for what is sampled.

        What makes new FMUs (case, controller) comes first, then what makes new communication points: so
        neighbouring runs share their instances.
        """
        grid = [
            (self._rank(n), n, p.size) for n, p in self.parameters.items() if not p.sampled and not p.bisect
        ]
        axes = [(rank, name, size) for rank, name, size in grid]
        if self.samples is not None:
            ranks = [self._rank(n) for n, p in self.parameters.items() if p.sampled]
            axes.append((min(ranks), "", self.samples))
        return tuple((name, size) for _, name, size in sorted(axes, key=lambda a: a[0]))

    @property
    def size(self) -> int:
        """Number of runs."""
        total = 1
        for _, size in self.axes:
            total *= size
        return total

    def values(self, run: int) -> dict[str, Value]:
        """Return the parameters of a run (without the one that is searched for)."""
        if not 0 <= run < self.size:
            raise SweepError(f"run {run} does not exist, allowed: 0 to {self.size - 1}")
        place: dict[str, int] = {}
        rest = run
        for name, size in reversed(self.axes):
            rest, place[name] = divmod(rest, size)
        result: dict[str, Value] = {}
        for name, p in self.parameters.items():
            if p.sampled:
                is_time = any(words[-1].endswith("_s") for words in self.paths(name))
                result[name] = p.drawn_value(name, self.seed, place[""], self.samples or 1, is_time=is_time)
            elif p.bisect is None:
                result[name] = p.grid_value(place[name])
        return result

    def _rank(self, name: str) -> int:
        ranks = []
        for words in self.paths(name):
            if words[0] == "case":
                ranks.append(0)
            elif words == ("controller",):
                ranks.append(1)
            elif words[-1] in (
                "latency_s",
                "pdc_wait_s",
                "wait_s",
                "start_s",
                "end_s",
                "stop_s",
                "step_s",
                "outages_s",
            ):
                ranks.append(2)
            else:
                ranks.append(3)
        return min(ranks)

    def document(self) -> dict[str, Any]:
        """Return the sweep as plain types; `sweep_of` reads it back."""
        table = self.model_dump(mode="json", exclude={"base"}, exclude_none=True)
        return table | {"scenario": scenario_document(self.base)}


def split_path(text: str, where: str) -> Path_:
    """Return the words of a path; a word with dots stands in double quotes.

    >>> split_path('case.branches."8-9 a".x', "path")
    ('case', 'branches', '8-9 a', 'x')
    """
    words: list[str] = []
    rest = text
    while True:
        if rest.startswith('"') and '"' in rest[1:]:
            word, _, rest = rest[1:].partition('"')
        else:
            cut = rest.find(".")
            word, rest = (rest, "") if cut < 0 else (rest[:cut], rest[cut:])
        if not word.strip():
            raise SweepError(
                f'{where}: path = {text!r}, allowed: words with dots between them, such as "a.b.c"'
            )
        words.append(word)
        if not rest:
            return tuple(words)
        if not rest.startswith(".") or rest == ".":
            raise SweepError(
                f'{where}: path = {text!r}, allowed: words with dots between them, such as "a.b.c"'
            )
        rest = rest[1:]


def load_sweep(source: str | Path | Mapping[str, Any]) -> Sweep:
    """Return the sweep of a TOML file or a dict of the same keys.

    Raises
    ------
    SweepError, ScenarioError : one line with file, key, value and what is allowed.
    """
    if isinstance(source, Mapping):
        return sweep_of(dict(source), "sweep", Path())
    path = Path(source)
    if not path.exists():
        raise SweepError(f"{path}: no such sweep file")
    table = read_toml(path, "sweep", SweepError)
    return sweep_of({"name": path.stem[:64], **table}, str(path), path.parent)


def sweep_of(table: Mapping[str, Any], where: str, folder: Path) -> Sweep:
    """Return the sweep of a table; `where` names it in errors, files are looked for in `folder`."""
    raw, sweep = dict(table), Collected()
    base = raw.pop("base", None)
    if base is not None:
        sweep.lines.append(f"{where}: base = {base!r}: no such key; {suggestion('base', _KEYS)}")
    with sweep:
        raw["base"] = _base(raw.pop("scenario", None), where, folder, raw)
    try:
        swept = Sweep.model_validate(raw)
    except ValidationError as error:
        reported = mistakes(error, Sweep)
        sweep.lines += [f"{where}: {line}" for line in reported if line != "base is missing"]
    sweep.end(SweepError)
    return swept


_KEYS = [*(k for k in Sweep.model_fields if k != "base"), "scenario"]


def _base(provided: Any, where: str, folder: Path, others: Mapping[str, Any]) -> Scenario:
    """Return the scenario that a sweep names or holds."""
    if provided is None:
        near = get_close_matches("scenario", others, 1)
        hint = f" (is {near[0]!r} meant as that?)" if near else ""
        raise SweepError(
            f"{where}: scenario is missing, allowed: a file, a bundled name or a [scenario] table{hint}"
        )
    if isinstance(provided, Mapping):
        return load_scenario({"folder": folder, **provided})
    if isinstance(provided, str) and provided:
        beside = folder / provided
        return load_scenario(beside if beside.is_file() or beside.suffix else provided)
    raise SweepError(
        f"{where}: scenario = {provided!r}, allowed: a file, a bundled name or a [scenario] table"
    )
