"""What the kernel draws of signals: bits of the reference for every kind, jumps and units included."""

from __future__ import annotations

import ctypes
import re
from ctypes import POINTER, byref, c_double, c_int, c_int64
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmu_mutation import Entries, mutated
from fmu_runner import decay_block
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from plant_shim import FLAGS, compile_shared

from interarea.cosim.clock import seconds
from interarea.cosim.master import kernel
from interarea.cosim.master.instances import FmuParticipant
from interarea.cosim.master.kernel.build import KIND_OF, KernelSignal
from interarea.cosim.master.master import Master
from interarea.cosim.master.plan import LoopPlan
from interarea.cosim.master.signals import Kind, Signal
from interarea.cosim.polynomials import mean_between, slope_at, value_at
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.fmu_build.write.package import block_fmu

SHIM = """
#include "signals.h"
void begin(KernelSignal *s, int64_t tick, int edge);
void know(KernelSignal *s, int64_t tick, double h, int edge, double value, double slope);
void accept(KernelSignal *s, int64_t end, double h, int edge);
void read(const double *d, double a, double b, double *found);
void begin(KernelSignal *s, int64_t tick, int edge) { signal_begin(s, tick, edge); }
void know(KernelSignal *s, int64_t tick, double h, int edge, double value, double slope)
{
    signal_know(s, tick, h, edge, value, slope);
}
void accept(KernelSignal *s, int64_t end, double h, int edge) { signal_accept(s, end, h, edge); }
void read(const double *d, double a, double b, double *found)
{
    found[0] = value_at(d, a);
    found[1] = slope_at(d, a);
    found[2] = mean_between(d, a, b);
}
"""


@pytest.fixture(scope="module")
def shim(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    source = tmp_path_factory.mktemp("signal") / "signal_shim.c"
    source.write_text(SHIM)
    headers = (Path(kernel.__file__).parent, Path(fmpy.__file__).parent / "c-code")
    library = ctypes.CDLL(str(compile_shared((source,), (*FLAGS, *(f"-I{h}" for h in headers)))))
    signal = POINTER(KernelSignal)
    library.begin.argtypes = [signal, c_int64, c_int]
    library.know.argtypes = [signal, c_int64, c_double, c_int, c_double, c_double]
    library.accept.argtypes = [signal, c_int64, c_double, c_int]
    library.read.argtypes = [POINTER(c_double), c_double, c_double, POINTER(c_double)]
    return library


number = st.floats(-10.0, 10.0)
#: length in ticks, whether a discontinuity lies in it, value and slope supposed and computed at its end
step = st.tuples(st.integers(1, 10**8), st.integers(0, 5).map(lambda k: k == 5), *[number] * 4)


@pytest.mark.parametrize("kind", KIND_OF)
@settings(max_examples=20, phases=(Phase.generate,))
@given(number, number, st.lists(step, min_size=8, max_size=12))
def test_every_kind_has_the_bits_of_the_reference(
    shim: ctypes.CDLL, kind: Kind, value: float, slope: float, steps: list[Any]
) -> None:
    """Whatever comes after what: predictions, steps repeated with other guesses, discontinuities."""
    signal = Signal("a.y", "a", 0, 0, kind, 1.0)
    signal.start(0, value, slope)
    mirror = KernelSignal(kind=KIND_OF[kind], n_past=1, peak=abs(value), nominal=1.0)
    mirror.v0 = mirror.v1 = value
    mirror.s0 = mirror.s1 = slope
    mirror.d[:] = signal.d
    mirror.values[0] = value
    now = 0

    def same() -> None:
        assert (mirror.v0, mirror.s0, mirror.v1, mirror.s1) == (signal.v0, signal.s0, signal.v1, signal.s1)
        assert (*mirror.d,) == signal.d
        assert (mirror.h_last, mirror.peak) == (signal.h_last, signal.peak)
        if kind == "points":
            assert mirror.ticks[: mirror.n_past] == signal.ticks
            assert mirror.values[: mirror.n_past] == signal.values
        a, b = seconds(end - now) / 3.0, seconds(end - now)
        read = (c_double * 3)()
        shim.read(mirror.d, a, b, read)
        d = signal.d
        assert (*read,) == (value_at(d, a), slope_at(d, a), mean_between(d, a, b))

    for length, edge, supposed, guess, reached, rate in steps:
        end = now + length
        h = seconds(length)
        signal.begin(now, edge)
        shim.begin(byref(mirror), now, edge)
        same()
        for v, s in ((supposed, guess), (reached, rate)):
            signal.know(now, end, edge, v, s)
            shim.know(byref(mirror), now, h, edge, v, s)
            same()
        signal.accept(now, end, edge)
        shim.accept(byref(mirror), end, h, edge)
        same()
        now = end


def kelvin_and_celsius(*, derivatives: bool) -> Any:
    """Return an edit: the decay's output is in K, its input in degC; it takes input derivatives or none."""

    def edit(entries: Entries) -> None:
        text = entries["modelDescription.xml"].decode()
        units = '<Unit name="K"><BaseUnit K="1"/></Unit>'
        units += '<Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit>'
        text = text.replace("</UnitDefinitions>", units + "</UnitDefinitions>")
        for name, unit in (("u", "degC"), ("y", "K")):
            text, count = re.subn(
                rf'(<ScalarVariable name="{name}"[^>]*>\s*<Real )unit="1"', rf'\1unit="{unit}"', text
            )
            assert count == 1
        if not derivatives:
            text = text.replace('canInterpolateInputs="true"', 'canInterpolateInputs="false"')
        entries["modelDescription.xml"] = text.encode()

    return edit


@pytest.mark.parametrize("engine", ["kernel", "python"])
@pytest.mark.parametrize("derivatives", [True, False], ids=["cubics", "means over parts"])
def test_an_offset_between_units_is_never_dropped(
    engine: Any, derivatives: bool, cache: Path, tmp_path: Path
) -> None:
    """A constant 300 K is 26.85 degC to what follows, at both ends of every step: x' = 26.85 - x, and after
    it z' = (x - 273.15) - z, whose input is drawn with the slopes that x has at the ends of steps."""
    fmu = mutated(
        block_fmu(decay_block(), cache), tmp_path / "decay.fmu", kelvin_and_celsius(derivatives=derivatives)
    )
    file = FmuFile(fmu)
    parts = [
        FmuParticipant("a", file, {"x": 300.0, "rate": 0.0}),
        FmuParticipant("b", file, {"x": 280.0}),
        FmuParticipant("c", file, {"x": 0.0}),
    ]
    wires = [("a.y", "b.u"), ("b.y", "c.u")]
    with Master(LoopPlan(wires, stop_s=2.0, step_s=0.05, engine=engine), parts) as master:
        run = master.run()
    t, warm, cold = np.asarray(run.time_s), 26.85, 26.85 - 273.15
    decay = np.exp(-t)
    np.testing.assert_allclose(run["b.y"], warm + (280.0 - warm) * decay, rtol=0, atol=1e-6)
    expected = cold + (0.0 - cold) * decay + (280.0 - warm) * t * decay
    np.testing.assert_allclose(run["c.y"], expected, rtol=0, atol=1e-4 if derivatives else 5e-3)
