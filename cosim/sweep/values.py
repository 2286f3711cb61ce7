"""The values one parameter of a sweep takes: listed, in a range, sampled, or searched for.

Draws depend on the seed, the parameter's name and the number of the sample only (a counter-based generator),
so every run knows its values without the runs before it, and every cell of a grid sees the same samples.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Annotated, Any, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from interarea.models.table import Table

Value = float | int | bool | str | tuple[Any, ...]
TIME_DIGITS = 9  # the clock's tick is 1 ns: sampled times are rounded to it


class Range(Table):
    """From `start` to `stop`: by `step`, or `count` values evenly spaced on a linear or logarithmic scale."""

    start: float  #: first value
    stop: float  #: last value
    step: float | None = None  #: distance of two values; or `count`
    count: Annotated[int, Field(ge=1)] | None = None  #: number of values, both ends counted; or `step`
    scale: Literal["linear", "log"] = "linear"  #: uniform in the value or in its logarithm

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (self.step is None) == (self.count is None):
            raise ValueError("a range has step or count, allowed: exactly one of them")
        if self.step is not None:
            if self.scale == "log":
                raise ValueError("a range by step is linear, allowed: count with scale = 'log'")
            if not self.step * (self.stop - self.start) >= 0.0 or self.step == 0.0:
                raise ValueError(
                    f"step = {self.step:g} never leads from {self.start:g} to {self.stop:g}, "
                    "allowed: a step towards stop"
                )
        _check_scale(self.scale, self.start, self.stop)
        return self

    @property
    def size(self) -> int:
        """Number of values."""
        if self.count is not None:
            return self.count
        assert self.step is not None
        return math.floor((_exact(self.stop) - _exact(self.start)) / _exact(self.step)) + 1

    def value(self, k: int) -> float:
        """Return value number `k`, computed in fractions: 3 steps of 0.1 are 0.3, not 0.30000000000000004."""
        first, last = _exact(self.start), _exact(self.stop)
        if self.step is not None:
            return float(first + k * _exact(self.step))
        assert self.count is not None
        share = Fraction(k, max(1, self.count - 1))
        if self.scale == "log" and 0 < share < 1:
            return float(f"{_between(self.start, self.stop, float(share), self.scale):.12g}")
        return float(first + share * (last - first))


class Interval(Table):
    """Between `low` and `high`, uniform on a linear or log scale; rounded to `digits` decimal places."""

    low: float  #: lower end
    high: float  #: upper end
    scale: Literal["linear", "log"] = "linear"  #: uniform in the value or in its logarithm
    digits: Annotated[int, Field(ge=0, le=15)] | None = None  #: decimal digits

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not self.low < self.high:
            raise ValueError(f"low = {self.low:g}, high = {self.high:g}, allowed: low < high")
        _check_scale(self.scale, self.low, self.high)
        return self


class Draw(Table):
    """A random draw: uniform (`low`, `high`), normal (`mean`, `deviation`, cut to these), or `choose`."""

    low: float | None = None  #: lower end
    high: float | None = None  #: upper end of an even distribution
    scale: Literal["linear", "log"] = "linear"  #: uniform in the value or in its logarithm
    mean: float | None = None  #: of a normal distribution
    #: standard deviation of a normal distribution about `mean`
    deviation: Annotated[float, Field(gt=0.0)] | None = None
    choose: Annotated[tuple[Any, ...], Field(min_length=1)] | None = None  #: draw from this list
    digits: Annotated[int, Field(ge=0, le=15)] | None = None  #: decimal digits

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        normal = self.mean is not None or self.deviation is not None
        bounds = self.low is not None and self.high is not None
        if self.choose is not None:
            if normal or self.low is not None or self.high is not None:
                raise ValueError(
                    "a draw has choose, or low and high, or mean and deviation: one of these forms"
                )
            return self
        if normal and (self.mean is None or self.deviation is None):
            raise ValueError("a normal draw has both mean and deviation")
        if not normal and not bounds:
            raise ValueError("a draw has choose, or low and high, or mean and deviation: none is complete")
        if self.low is not None and self.high is not None:
            if not self.low < self.high:
                raise ValueError(f"low = {self.low:g}, high = {self.high:g}, allowed: low < high")
            _check_scale(self.scale, self.low, self.high)
        return self

    def at(self, u: float) -> Any:
        """Return the value at probability `u`, 0 < u < 1."""
        if self.choose is not None:
            return self.choose[min(int(u * len(self.choose)), len(self.choose) - 1)]
        if self.mean is None or self.deviation is None:
            assert self.low is not None and self.high is not None
            return _between(self.low, self.high, u, self.scale)
        from scipy.special import ndtri  # scipy takes long to load

        value = self.mean + self.deviation * float(ndtri(u))
        return _clipped(value, self.low, self.high)


class Search(Table):
    """Where stability ends, by simulation: `scan` points from `low` to `high`, then halving to `tolerance`.

    The first unstable point of the scan ends the bracket. With `seeds` above 1 a point counts as stable
    when the runs with all of these seeds are.
    """

    low: float  #: lower end
    high: float  #: upper end of the search
    tolerance: Annotated[float, Field(gt=0.0)]  #: width at which the search ends
    #: values tested before the bisection, so that islands are detected
    scan: Annotated[int, Field(ge=2, le=1000)] = 9
    seeds: Annotated[int, Field(ge=1, le=1000)] = 1  #: runs at each value; stable where all are

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not self.low < self.high:
            raise ValueError(f"low = {self.low:g}, high = {self.high:g}, allowed: low < high")
        return self


_FORMS = ("values", "range", "latin_hypercube", "random", "bisect")


class Parameter(Table):
    """One `[parameters.NAME]` table: where the value goes (`path`, default: the name) and which values."""

    #: the key of the scenario, or several with the same value; default: the parameter's name
    path: str | Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    values: tuple[Any, ...] | None = None  #: the values themselves
    range: Range | None = None  #: evenly spaced values
    latin_hypercube: Interval | None = None  #: latin-hypercube samples: each parameter is spread evenly
    random: Draw | None = None  #: drawn at random
    bisect: Search | None = None  #: search for the value at which the loop becomes unstable
    unit: str = ""  #: for maps and tables
    label: str = ""  #: for maps and tables; default: the parameter's name

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        provided = [f for f in _FORMS if getattr(self, f) is not None]
        if len(provided) != 1:
            raise ValueError(
                f"has {' and '.join(provided) or 'no values'}, allowed: exactly one of {', '.join(_FORMS)}"
            )
        if self.values is not None:
            seen: list[str] = []
            for value in self.values:
                if isinstance(value, float) and not math.isfinite(value):
                    raise ValueError(f"values has {value}, allowed: finite numbers")
                if isinstance(value, Mapping):
                    raise ValueError(
                        f"values has the table {value}, allowed: numbers, words, true/false, lists"
                    )
                if repr(value) in seen[-1000:]:
                    raise ValueError(f"values has {value!r} twice: every run once")
                seen.append(repr(value))
        return self

    @property
    def sampled(self) -> bool:
        """Whether the values are drawn for each sample instead of forming a grid."""
        return self.latin_hypercube is not None or self.random is not None

    @property
    def size(self) -> int:
        """Number of grid values; 1 for what is sampled or searched for."""
        if self.values is not None:
            return len(self.values)
        return self.range.size if self.range is not None else 1

    def grid_value(self, k: int) -> Value:
        """Return grid value number `k`."""
        if self.values is not None:
            value = self.values[k]
            return tuple(value) if isinstance(value, list) else value  # type: ignore[no-any-return]
        assert self.range is not None
        return self.range.value(k)

    def drawn_value(self, name: str, seed: int, k: int, samples: int, *, is_time: bool) -> Value:
        """Return the value of sample `k` of `samples`; a time is rounded to the clock's tick of 1 ns."""
        if self.latin_hypercube is not None:
            spread = self.latin_hypercube
            cell = int(_permutation(seed, name, samples)[k])
            u = (cell + unit_draw(seed, name, k)) / samples
            value: Any = _between(spread.low, spread.high, u, spread.scale)
            digits = spread.digits
            low: float | None = spread.low
            high: float | None = spread.high
        else:
            assert self.random is not None
            value = self.random.at(unit_draw(seed, name, k))
            digits, low, high = self.random.digits, self.random.low, self.random.high
            if isinstance(value, list):
                value = tuple(value)
        if isinstance(value, float):
            if digits is None and is_time:
                digits = TIME_DIGITS
            value = _clipped(value if digits is None else round(value, digits), low, high)
        return value  # type: ignore[no-any-return]

    def probes(self) -> Sequence[Value]:
        """Return values that show whether the parameter fits: all of a short grid, ends of the others."""
        if self.latin_hypercube is not None:
            return (self.latin_hypercube.low, self.latin_hypercube.high)
        if self.bisect is not None:
            return (self.bisect.low, self.bisect.high)
        if self.random is not None:
            if self.random.choose is not None:
                return tuple(tuple(v) if isinstance(v, list) else v for v in self.random.choose[:200])
            ends = [v for v in (self.random.low, self.random.high, self.random.mean) if v is not None]
            return tuple(ends)
        n = self.size
        chosen = range(n) if n <= 200 else [*range(100), *range(n - 100, n)]
        return tuple(self.grid_value(k) for k in chosen)


def unit_draw(seed: int, name: str, k: int) -> float:
    """Return draw number `k` of a parameter, uniform in (0, 1)."""
    digest = hashlib.sha256(f"{seed}/{name}/{k}".encode()).digest()
    return (int.from_bytes(digest[:7], "little") % 2**53 + 0.5) / 2**53


@lru_cache(maxsize=64)
def _permutation(seed: int, name: str, n: int) -> npt.NDArray[np.int64]:
    key = int.from_bytes(hashlib.sha256(f"{seed}/{name}/cells".encode()).digest()[:16], "little")
    return np.random.Generator(np.random.Philox(key=key)).permutation(n)


def _between(low: float, high: float, u: float, scale: str) -> float:
    if scale == "log":
        return math.exp(math.log(low) + u * (math.log(high) - math.log(low)))
    return low + u * (high - low)


def _check_scale(scale: str, low: float, high: float) -> None:
    if scale == "log" and not (low > 0.0 and high > 0.0):
        raise ValueError(f"scale = 'log' from {low:g} to {high:g}, allowed: both above 0")


def _exact(value: float) -> Fraction:
    """Return the number that is written as this double is."""
    return Fraction(repr(value))


def _clipped(value: float, low: float | None, high: float | None) -> float:
    return min(max(value, -math.inf if low is None else low), math.inf if high is None else high)


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
