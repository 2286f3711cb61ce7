"""Where stability ends along one parameter: a scan, then bisection."""

from __future__ import annotations

from collections.abc import Callable

from .values import Search


def edge_of(stable: Callable[[float], bool], search: Search) -> tuple[float | None, float | None]:
    """Return the last stable value and the first unstable one.

    None: no value of the scan is stable, or none is unstable.
    """
    good: float | None = None
    bad: float | None = None
    for k in range(search.scan):
        at = round(search.low + (search.high - search.low) * k / (search.scan - 1), 9)
        if not stable(at):
            bad = at
            break
        good = at
    while good is not None and bad is not None and bad - good > search.tolerance:
        middle = round(0.5 * (good + bad), 9)
        if middle in (good, bad):
            break
        if stable(middle):
            good = middle
        else:
            bad = middle
    return good, bad
