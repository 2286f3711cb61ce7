"""Progress of long work: bars on a terminal and in a notebook, lines elsewhere."""

from __future__ import annotations

import html
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from rich.progress import TaskID

    from interarea.cosim.sweep.front import Progress

_LINE_S = 10.0  #: between two lines about the same stage
_DRAWN_S, _FIRST_S = 0.2, 0.5  #: between two pictures of a notebook's bars; before the first of them


class Report(Protocol):
    """Reports the completed share `done` (0 to 1) of a stage, and its state as text."""

    def __call__(self, stage: str, done: float, text: str = "") -> None: ...


class _Stage:
    """Start of a stage, its completed share, and the instant of the last report."""

    def __init__(self) -> None:
        self.begin_s: float | None = None
        self.end_s: float | None = None
        self.first = self.done = 0.0
        self.text = ""

    def tell(self, done: float, text: str) -> None:
        if self.begin_s is None:
            self.begin_s, self.first = time.monotonic(), done
        self.done, self.text = min(done, 1.0), text or self.text
        if done >= 1.0 and self.end_s is None:
            self.end_s = time.monotonic()

    @property
    def spent_s(self) -> float:
        end_s = time.monotonic() if self.end_s is None else self.end_s
        return 0.0 if self.begin_s is None else end_s - self.begin_s

    @property
    def words(self) -> str:
        """Completed share, state, and remaining time at the present rate."""
        gained = self.done - self.first if self.done < 1.0 else 0.0
        left = f"{duration(self.spent_s * (1.0 - self.done) / gained)} left" if gained > 0.0 else ""
        return ", ".join(part for part in (f"{100.0 * self.done:.0f} %", self.text, left) if part)


def silent(stage: str, done: float, text: str = "") -> None:
    """Report nothing."""


def lines(stages: Sequence[str], write: Callable[[str], object], *, timed: bool = False) -> Report:
    """Return a report that writes a line at the end of a stage, and one every ten seconds.

    A single stage that ends before any other line has no line. timed : always write it, with its duration.
    """
    known = {stage: _Stage() for stage in stages}
    spoken: dict[str, float] = {}
    over: set[str] = set()

    def report(stage: str, done: float, text: str = "") -> None:
        one, now = known[stage], time.monotonic()
        one.tell(done, text)
        if done >= 1.0 and stage not in over:
            over.add(stage)
            if timed or len(known) > 1 or stage in spoken:
                took = f" in {one.spent_s:.1f} s" if timed else ""
                write(f"{stage}: done{took}{one.text and f', {one.text}'}")
        elif done < 1.0 and one.begin_s is not None and now - spoken.get(stage, one.begin_s) >= _LINE_S:
            spoken[stage] = now
            write(f"{stage}: {one.words}")

    return report


def tell_runs(report: Report, p: Progress) -> None:
    """Report the progress of a sweep as the stage `runs`."""
    failed = f", {p.failed} failed" if p.failed else ""
    forked = f", {p.forked} forked" if p.forked else ""
    report("runs", p.done / p.size, f"{p.done} of {p.size}{failed}{forked}, {p.rate:.1f} runs/s")


@contextmanager
def terminal_bars(stages: Sequence[str]) -> Iterator[Report]:
    """Draw a bar for each stage on stderr, a terminal: completed share, state, time spent and left."""
    from rich import progress as bars
    from rich.console import Console

    columns = (
        bars.SpinnerColumn(finished_text="✓"),
        bars.TextColumn("{task.description}", markup=False),
        bars.BarColumn(),
        bars.TaskProgressColumn(),
        bars.TimeElapsedColumn(),
        bars.TextColumn("left"),
        bars.TimeRemainingColumn(),
        bars.TextColumn("{task.fields[text]}", markup=False),
    )
    with bars.Progress(*columns, console=Console(stderr=True)) as progress:
        tasks: dict[str, TaskID] = {s: progress.add_task(s, total=1.0, start=False, text="") for s in stages}

        def report(stage: str, done: float, text: str = "") -> None:
            progress.start_task(tasks[stage])
            more = {"text": text} if text else {}
            progress.update(tasks[stage], completed=done, **more)  # type: ignore[arg-type]

        yield report


@contextmanager
def notebook_bars(stages: Sequence[str]) -> Iterator[Report | None]:
    """Draw a bar for each stage below the cell of a notebook; None if there is no notebook."""
    shell: Any = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if getattr(shell, "kernel", None) is None:
        yield None
        return
    bars = _NotebookBars(stages)
    try:
        yield bars.report
    finally:
        bars.draw()


class _NotebookBars:
    """The bars of a notebook: drawn where the work takes longer than a moment, then again and again."""

    def __init__(self, stages: Sequence[str]) -> None:
        self._stages = {stage: _Stage() for stage in stages}
        self._next_s = time.monotonic() + _FIRST_S
        self._handle: Any = None

    def report(self, stage: str, done: float, text: str = "") -> None:
        self._stages[stage].tell(done, text)
        if time.monotonic() >= self._next_s:
            if self._handle is None:
                from IPython.display import display

                self._handle = display(self, display_id=True)
            self.draw()
            self._next_s = time.monotonic() + _DRAWN_S

    def draw(self) -> None:
        """Draw the bars, if they are shown."""
        if self._handle is not None:
            self._handle.update(self)

    def _repr_html_(self) -> str:
        rows = [
            f'<div><progress max="1" value="{one.done:.4f}" aria-label="{html.escape(stage)}"></progress> '
            f"{html.escape(f'{stage}: {one.words}, {duration(one.spent_s)}')}</div>"
            for stage, one in self._stages.items()
            if one.begin_s is not None
        ]
        return "".join(rows)

    def __repr__(self) -> str:
        begun = {stage: one for stage, one in self._stages.items() if one.begin_s is not None}
        return "\n".join(f"{stage}: {one.words}" for stage, one in begun.items())


def duration(seconds: float) -> str:
    """Return a time in words.

    >>> duration(12.3), duration(200.0), duration(7200.0)
    ('12 s', '3 min', '2.0 h')
    """
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    if seconds < 5400.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"
