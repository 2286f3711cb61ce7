"""Every mistake that the master promises to name, with real FMUs, in both engines where it runs."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from misbehaving import misbehaving_fmu

from interarea.cosim.errors import GraphError, ScenarioError, StepError
from interarea.cosim.run.run import run_system
from interarea.cosim.run.system import System
from interarea.fmu_build.errors import FmuFileError
from interarea.fmu_build.open.fmu_file import FmuFile

ENGINES = ("kernel", "python")


@pytest.fixture(scope="module")
def misbehaving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return misbehaving_fmu(tmp_path_factory.mktemp("misbehaving"))


def pair(misbehaving: Path, **options: Any) -> System:
    return (
        System(stop_s=1.0, step_s=0.1, **options).fmu("first", misbehaving, u=1.0).fmu("second", misbehaving)
    )


@pytest.mark.parametrize(
    ("wires", "says"),
    [
        ([("frist.y", "second.u")], r"'frist.y' is not a connection end.*did you mean 'first'"),
        ([("first.x", "second.u")], r"first has no output 'x'; there are: y"),
        ([("first.y", "second.v")], r"second has no input 'v'; there are: u"),
        ([("first.y", "second")], r"'second' is not a connection end 'instance.variable'"),
        (
            [("first.y", "second.u"), ("second.y", "second.u")],
            "second.u has two sources, first.y and",
        ),
        ([("first.u", "second.u")], r"first.u has the wrong causality for a source: an output is needed"),
        ([("first.y", "second.y")], r"second.y has the wrong causality for a target: an input is needed"),
        ([("first.y", "second.x0")], r"second has no input 'x0'"),
    ],
)
def test_wrong_ends(misbehaving: Path, tmp_path: Path, wires: list[tuple[str, str]], says: str) -> None:
    system = pair(misbehaving)
    for wire in wires:
        system.connect(*wire)
    with pytest.raises(GraphError, match=says):
        system.master()
    fmus = {name: {"file": str(misbehaving)} for name in ("first", "second")}
    with pytest.raises(GraphError, match=says):  # and from a scenario
        run_system({"stop_s": 1.0, "fmus": fmus, "connections": [list(w) for w in wires]})


def test_an_input_left_unconnected_keeps_its_start_value_and_is_reported(misbehaving: Path) -> None:
    result = System(stop_s=1.0, step_s=0.1).fmu("alone", misbehaving, x0=2.0).run()
    assert "not connected: alone.u keeps its start value 0" in result.explain()
    np.testing.assert_array_equal(result["alone.y"], 2.0)


def test_compatible_units_are_converted(tmp_path: Path) -> None:
    """The plant's angle in rad arrives in degrees: the integral of a constant, 180/pi times as large."""
    degrees = misbehaving_fmu(tmp_path, unit="deg")
    system = System(stop_s=0.5, step_s=0.1).plant("two-area-thesis").fmu("x", degrees)
    result = system.connect("plant.G1_delta", "x.u").run()
    exact = 0.5 * np.degrees(result["plant.G1_delta"][0])
    assert result["x.y"][-1] == pytest.approx(exact, rel=1e-9)


def test_a_unit_that_nobody_defines_is_a_name_and_told(tmp_path: Path) -> None:
    odd = misbehaving_fmu(tmp_path, unit="furlong")
    (line,) = System(stop_s=0.1).fmu("x", odd).run().warnings
    assert re.search(r'variable "u" .*the unit "furlong" is not defined', line)
    with pytest.raises(FmuFileError, match='"furlong" is not defined'):
        System(stop_s=0.1, strict=True).fmu("x", odd)


def test_units_of_different_dimension_are_refused() -> None:
    system = System(stop_s=0.1).plant("two-area-thesis").channel("line").connect("plant.G1_delta", "line")
    with pytest.raises(GraphError, match=r"plant.G1_delta -> line.u: unit 'rad' \(rad\^1\) does not fit"):
        system.master()


def changed(path: Path, to: Path, old: str, new: str, *, platform: str | None = None) -> Path:
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(to, "w") as target:
        for name in source.namelist():
            raw = source.read(name)
            if name == "modelDescription.xml":
                raw = re.sub(old.encode(), new.encode(), raw)
            elif platform is not None:
                name = f"binaries/{platform}/{Path(name).name}"
            target.writestr(name, raw)
    return to


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('fmiVersion="2.0"', 'fmiVersion="1.0"', "is FMI 1.0; the master steps FMI 2.0 FMUs"),
        ('fmiVersion="2.0"', 'fmiVersion="3.0"', "is FMI 3.0; the master steps FMI 2.0 FMUs"),
        ("<CoSimulation [^>]*/>", '<ModelExchange modelIdentifier="x"/>', "has no co-simulation part"),
        ('causality="output"', 'causality="outcome"', "breaks the standard"),
    ],
)
def test_other_standards(misbehaving: Path, tmp_path: Path, old: str, new: str, says: str) -> None:
    with pytest.raises(FmuFileError, match=says):
        FmuFile(changed(misbehaving, tmp_path / "odd.fmu", old, new))


def test_another_platform(misbehaving: Path, tmp_path: Path) -> None:
    with pytest.raises(FmuFileError, match=r"has no binary for this platform \(\w+\); it has amiga68"):
        FmuFile(changed(misbehaving, tmp_path / "odd.fmu", "", "", platform="amiga68"))


@pytest.mark.parametrize("engine", ENGINES)
def test_an_output_that_turns_nan_stops_the_run_there(misbehaving: Path, engine: str) -> None:
    system = pair(misbehaving, engine=engine).fmu("bad", misbehaving, nan_at=0.45).connect("first.y", "bad.u")
    system.fmu("sink", misbehaving).connect("bad.y", "sink.u")
    with pytest.raises(StepError, match=r"bad: reading outputs at t = 0\.5 s: output y is nan") as caught:
        system.run()
    run = caught.value.trajectory
    assert run is not None and run.time_s[-1] == 0.4
    np.testing.assert_allclose(run["bad.y"], run.time_s**2 / 2, rtol=1e-12)


def test_nan_that_nobody_takes_is_told_once(misbehaving: Path) -> None:
    """The run goes on to its end, with the same bits whoever steps."""
    result = []
    for engine in ENGINES:
        system = (
            pair(misbehaving, engine=engine).fmu("bad", misbehaving, nan_at=0.45).connect("first.y", "bad.u")
        )
        result.append(system.run())
    a, b = result
    (line,) = a.warnings
    assert b.warnings == (line,) and line in a.explain()
    assert line == "bad.y is nan at 6 of 11 points, first at t = 0.5 s; nothing is connected to it"
    assert a.data.equals(b.data)
    assert a.trajectory.time_s[-1] == 1.0 and np.isfinite(a["first.y"]).all()


@pytest.mark.parametrize("engine", ENGINES)
def test_time_does_not_go_backwards(misbehaving: Path, engine: str) -> None:
    with pair(misbehaving, engine=engine).master() as master:
        master.run(until_s=0.5)
        with pytest.raises(ScenarioError, match=r"until_s = 0\.3: time does not go backwards from 0\.5 s"):
            master.run(until_s=0.3)
        assert master.run().time_s[-1] == 1.0
    with pytest.raises(ScenarioError, match="must lie after the start"):
        System(stop_s=1.0, start_s=2.0).fmu("a", misbehaving).master()


@pytest.mark.parametrize("engine", ENGINES)
def test_an_fmu_whose_time_goes_backwards_is_named(misbehaving: Path, engine: str) -> None:
    system = System(stop_s=1.0, step_s=0.1, engine=engine).fmu("back", misbehaving, back_at=0.25)
    with pytest.raises(StepError, match=r"back: fmi2DoStep at t = 0\.2 s: .* names t = -0\.8 s"):
        system.run()
