"""The few functions of a C library that a page brings along: numbers in texts are those of the C standard."""

from __future__ import annotations

import ctypes
import random
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from interarea.cosim.explorer.wasm import LIBRARY
from interarea.fmu_build.write.compile import compile_library, host_platform

FORMATS = ("%g", "%.1g", "%.3g", "%.9g", "%.17g", "%.0f", "%.2f")
WRITERS = b"""
#define SHOWN __attribute__((visibility("default")))
int text_of_number(char *to, size_t size, const char *format, double x);
SHOWN int text_of_number(char *to, size_t size, const char *format, double x)
{
    return snprintf(to, size, format, x);
}
int text_of_others(char *to, size_t size, const char *text);
SHOWN int text_of_others(char *to, size_t size, const char *text)
{
    return snprintf(to, size, "%d %u %zu %lx %s %.3s 100%%", -5, 7u, (size_t)9, 255ul, text, text);
}
"""

Writer = Callable[..., str]


@pytest.fixture(scope="module")
def library(cache: Path) -> ctypes.CDLL:
    sources = {path.name: path.read_bytes() for path in LIBRARY.glob("*.h")}
    own = b"#define snprintf page_snprintf\n#define vsnprintf page_vsnprintf\n"
    sources["print.c"] = own + (LIBRARY / "print.c").read_bytes() + WRITERS
    return ctypes.CDLL(str(compile_library("print", sources, host_platform(), cache=cache)))


def written(function: Callable[..., int], *value: object, size: int = 2000) -> str:
    room = ctypes.create_string_buffer(size)
    length = function(room, ctypes.c_size_t(size), *value)
    assert len(room.value) == min(length, size - 1)
    return room.value.decode("ascii")


def test_numbers_have_the_digits_that_python_gives(library: ctypes.CDLL) -> None:
    chance = random.Random(1)
    numbers = [0.0, -0.0, 0.5, 1.5, 2.5, 9.5, 0.95, 999999.5, 1e-5, 9.9999995e-5, 5e-324, 2.0**53, 1e22, 1e23]
    numbers += [1.7976931348623157e308, float("inf"), -float("inf"), float("nan")]
    numbers += [struct.unpack("<d", struct.pack("<Q", chance.getrandbits(63)))[0] for _ in range(1000)]
    numbers += [chance.uniform(-1e3, 1e3) * 10.0 ** chance.randint(-12, 12) for _ in range(1000)]
    for x in numbers:
        for form in FORMATS:
            assert written(library.text_of_number, form.encode(), ctypes.c_double(x)) == form % x, (form, x)


def test_the_other_formats_and_what_does_not_fit(library: ctypes.CDLL) -> None:
    assert written(library.text_of_others, b"abcdef") == "-5 7 9 ff abcdef abc 100%"
    assert written(library.text_of_others, b"abcdef", size=8) == "-5 7 9 "
