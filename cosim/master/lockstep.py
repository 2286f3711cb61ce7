"""Several masters at once: their plants advance side by side, in the lanes of the processor's vectors.

Each run takes the steps it would take alone, with the same bits: the kernel steps every run until it needs
its plant stepped, and steps the plants of all the runs that wait for theirs in one call (`fmu_build.group`).
Runs may have other events, latencies, outages, lengths or structures; one that ends, or fails, leaves the
others alone.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from interarea.fmu_build.write.lane_library import GroupLibrary, GroupWork

from ..clock import seconds
from .kernel.kernel import MOST_TOGETHER, Kernel, run_kernels
from .master import Master

_BUDGET_S = 0.1  # of computing between two looks at the clock, all runs
Watch = Callable[[int, float, float], object]


def advance_together(masters: Sequence[Master], *, watch: Watch | None = None) -> list[Exception | None]:
    """Step every master to its end; return of each what ended it before, or None.

    Plants advance side by side where their participants have a group library (`FmuParticipant.group`) and the
    kernel can step the run; a run that Python has to step goes alone. An error carries the results so far, as
    that of `Master.advance`.

    watch : called with (number of the master, present time, stop time) at least every 0.1 s of computing, for
        each that is under way. An exception it raises ends that run alone and is returned.
    """
    ended: list[Exception | None] = [None] * len(masters)
    handed: list[tuple[int, Kernel]] = []
    for number, master in enumerate(masters):
        try:
            kernel = master.to_kernel()
            if kernel is not None:
                handed.append((number, kernel))
            elif watch is None:
                master.advance()
            else:
                master.advance(progress=partial(watch, number))
        except Exception as error:
            ended[number] = error
    for first in range(0, len(handed), MOST_TOGETHER):
        chunk = handed[first : first + MOST_TOGETHER]
        with _side_by_side([kernel for _, kernel in chunk]):
            _step(masters, chunk, watch, ended)
    return ended


def _step(
    masters: Sequence[Master],
    in_progress: list[tuple[int, Kernel]],
    watch: Watch | None,
    ended: list[Exception | None],
) -> None:
    """Let the kernels step until each has ended."""
    steps = {number: len(masters[number].clock.steps) for number, _ in in_progress}
    while in_progress:
        kernels = [kernel for _, kernel in in_progress]
        try:
            errors = run_kernels(kernels, [steps[number] for number, _ in in_progress], budget_s=_BUDGET_S)
        finally:  # Ctrl-C too
            for number, kernel in in_progress:
                masters[number].sync_from_kernel(kernel)
        going: list[tuple[int, Kernel]] = []
        for (number, kernel), error in zip(in_progress, errors, strict=True):
            master = masters[number]
            if error is not None:
                master.fail(error)
            elif watch is not None:
                try:
                    watch(number, master.time_s, seconds(master.clock.stop))
                except Exception as raised:
                    error = raised
            ended[number] = error
            if error is None and not (master.finished or master.cancelled):
                kernel.begin(kernel.index, kernel.row)
                going.append((number, kernel))
        in_progress = going


@contextmanager
def _side_by_side(kernels: Sequence[Kernel]) -> Iterator[None]:
    """Join the participants that have a group library, as many as it steps at once."""
    groups: dict[tuple[Path, Path], list[tuple[Kernel, int]]] = defaultdict(list)
    libraries: dict[Path, GroupLibrary] = {}
    for kernel in kernels:
        for number, p in enumerate(kernel.participants):
            if p.group is not None:
                libraries[p.group.path] = p.group
                groups[p.group.path, p.file.path].append((kernel, number))
    works: list[GroupWork] = []
    try:
        for (path, _), places in groups.items():
            library = libraries[path]
            parts = -(-len(places) // library.lanes)
            for part in range(parts):
                chunk = places[part::parts]
                kernel, number = chunk[0]
                work = library.work(kernel.components[number], len(chunk))
                if work is None:
                    continue
                works.append(work)
                for kernel, number in chunk:
                    kernel.join(number, library.step, work.address)
        yield
    finally:
        for kernel in kernels:
            kernel.leave()
