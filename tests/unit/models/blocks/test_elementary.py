"""sin, cos, exp, ln, angle of a pair: close to the true values, of one number or several the same bits."""

from __future__ import annotations

import ctypes
import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import interarea.models.blocks.binary_table
from interarea.fmu_build.write.cache import COMPILERS_OWN
from interarea.fmu_build.write.compile import PLATFORMS, SYSTEM_LIBRARIES, host_platform

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Werror")
HEAD = """#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
"""
ONE = """#include "scalar.h"
void one(size_t n, const double *x, double *y)
{
    for (size_t k = 0; k < n; ++k) {
        num_sincos(x[k], &y[k], &y[n + k]);
        y[2 * n + k] = num_exp(x[k]);
        y[3 * n + k] = num_log(x[k]);
        y[4 * n + k] = num_angle(x[k], x[n - 1 - k]);
    }
}
"""
SEVERAL = """#define PLANT_LANES 2
#define NAME(f) f##_2
#define PART(a) (a)
#include "scalar.h"
static num swapped(num a) { return (num){ a[1], a[0] }; }
void several(size_t n, const double *from, double *to)
{
    const num *x = (const num *)(const void *)from;
    num *y = (num *)(void *)to;
    for (size_t k = 0; k < n / 2; ++k) {
        num_sincos(x[k], &y[k], &y[n / 2 + k]);
        y[n + k] = num_exp(x[k]);
        y[3 * n / 2 + k] = num_log(x[k]);
        y[2 * n + k] = num_angle(x[k], swapped(x[n / 2 - 1 - k]));
    }
}
"""
EDGES = [0.0, -0.0, 700.0, 700.1, -700.0, -701.0, 1e6, -1e6, 1e300, -1e300, np.inf, -np.inf, np.nan, 5e-324]
EDGES += [2.3e-308, 2.2e-308, 1.7e308, 1.75e308, np.sqrt(2.0), np.nextafter(np.sqrt(2.0), 2.0), 1.0, -1.0]


@pytest.fixture(scope="module")
def library(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    folder = tmp_path_factory.mktemp("elementary")
    sources = [folder / "one.c", folder / "several.c"]
    for path, text in zip(sources, (ONE, HEAD + SEVERAL), strict=True):
        path.write_text(text)
    compiler = shlex.split(os.environ.get("CC", "")) or [sys.executable, "-m", "ziglang", "cc"]
    environment = dict(os.environ)
    if sys.platform == "linux" and "ziglang" in compiler:  # as for FMUs: their C library's parts are there
        compiler += ["-target", PLATFORMS[host_platform()].targets[0], "-rtlib=none"]
        environment["ZIG_GLOBAL_CACHE_DIR"] = str(cache / COMPILERS_OWN / SYSTEM_LIBRARIES)
    includes = f"-I{Path(interarea.models.__path__[0]) / 'c' / 'plant' / 'numbers'}"
    output = folder / "elementary.so"
    command = [*compiler, *FLAGS, includes, "-shared", "-fPIC", "-o", str(output), *map(str, sources), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(output))


def values(library: ctypes.CDLL, how: str, x: np.ndarray) -> np.ndarray:
    """Rows sin, cos, exp, ln at x, angle of (x from behind, x)."""
    y = np.empty((5, len(x)))
    pointers = (a.ctypes.data_as(ctypes.c_void_p) for a in (x, y))
    getattr(library, how)(ctypes.c_size_t(len(x)), *pointers)
    return y


def points() -> np.ndarray:
    rng = np.random.default_rng(20250101)
    spread = 10.0 ** rng.uniform(-12.0, 2.8, 20000) * rng.choice([-1.0, 1.0], 20000)
    return np.concatenate(
        [EDGES, spread, rng.uniform(-7.0, 7.0, 20000), 10.0 ** rng.uniform(-300, 300, 2000)]
    )


def test_several_numbers_have_the_bits_of_each_alone(library: ctypes.CDLL) -> None:
    x = points()
    alone, beside = values(library, "one", x), values(library, "several", x)
    numbers = ~np.isnan(alone)
    np.testing.assert_array_equal(np.isnan(beside), ~numbers)
    np.testing.assert_array_equal(beside.view(np.int64)[numbers], alone.view(np.int64)[numbers])


def test_values_are_those_of_mathematics(library: ctypes.CDLL) -> None:
    """numpy's are good to less than 1 ulp; ours say 1 ulp, the logarithm 2."""
    x = points()[len(EDGES) :]
    sine, cosine, exponential, logarithm, angle = values(library, "one", x)
    near = np.abs(x) < 1e6
    for got, exact in ((sine, np.sin(x)), (cosine, np.cos(x))):
        assert np.max(np.abs(got - exact)[near] / np.spacing(np.abs(exact))[near]) <= 2.0
    bounded = np.exp(np.clip(x, -700.0, 700.0))
    assert np.max(np.abs(exponential - bounded) / np.spacing(bounded)) <= 2.0
    positive = x > 0.0
    exact = np.log(x[positive])
    assert np.max(np.abs(logarithm[positive] - exact) / np.spacing(np.maximum(np.abs(exact), 1e-3))) <= 3.0
    squared = (np.abs(x) > 1e-100) & (np.abs(x) < 1e100)  # whose squares are numbers
    pairs, exact = squared & squared[::-1], np.arctan2(x, x[::-1])
    assert np.sum(pairs) > 30000
    assert np.max(np.abs(angle - exact)[pairs] / np.spacing(np.abs(exact[pairs]))) <= 8.0


def test_beyond_their_range_they_say_so(library: ctypes.CDLL) -> None:
    x = np.array(EDGES)
    sine, cosine, exponential, logarithm, _ = values(library, "one", x)
    assert (sine[0], cosine[0], exponential[0]) == (0.0, 1.0, 1.0)
    assert np.all(exponential[[3, 8, 10]] == exponential[2])
    assert np.all(exponential[[5, 9, 11]] == exponential[4])
    assert np.all(np.isnan([sine[12], cosine[12], exponential[12], logarithm[12]]))
    assert np.all(np.isnan(logarithm[[0, 1, 4, 10, 11, 13, 15, 17, 21]]))
    assert logarithm[20] == 0.0
