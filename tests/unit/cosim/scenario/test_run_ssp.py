"""A system structure runs as a scenario: its FMUs, nested systems, values and connections."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from misbehaving import misbehaving_fmu

from interarea.cosim.errors import ScenarioError
from interarea.cosim.export.ssp import write_ssp
from interarea.cosim.run.run import run_scenario, run_system
from interarea.cosim.run.system import System
from interarea.cosim.scenario.scenario import load_scenario

NS = "http://ssp-standard.org/SSP1/"
EXPERIMENT = '<ssd:DefaultExperiment startTime="0" stopTime="2"/>'


def connector(name: str, kind: str, unit: str = "") -> str:
    typed = f'<ssc:Real unit="{unit}"/>' if unit else "<ssc:Real/>"
    return f'<ssd:Connector name="{name}" kind="{kind}">{typed}</ssd:Connector>'


def component(name: str, inside: str = "", **units: str) -> str:
    ends = connector("u", "input", units.get("u", "")) + connector("y", "output", units.get("y", ""))
    return (
        f'<ssd:Component name="{name}" source="resources/misbehaving.fmu">'
        f"<ssd:Connectors>{ends}</ssd:Connectors>{inside}</ssd:Component>"
    )


def values(prefix: str = "", mapping: str = "", **value: float) -> str:
    rows = "".join(
        f'<ssv:Parameter name="{n.replace("__", ".")}"><ssv:Real value="{v}"/></ssv:Parameter>'
        for n, v in value.items()
    )
    mapped = (
        f"<ssd:ParameterMapping><ssm:ParameterMapping>{mapping}</ssm:ParameterMapping></ssd:ParameterMapping>"
    )
    return (
        f'<ssd:ParameterBindings><ssd:ParameterBinding prefix="{prefix}"><ssd:ParameterValues>'
        f'<ssv:ParameterSet version="1.0" name="p"><ssv:Parameters>{rows}</ssv:Parameters></ssv:ParameterSet>'
        f"</ssd:ParameterValues>{mapped if mapping else ''}</ssd:ParameterBinding></ssd:ParameterBindings>"
    )


def wire(start: str, end: str, inside: str = "") -> str:
    ends = []
    for side, text in (("start", start), ("end", end)):
        element, _, name = text.rpartition(".")
        of = f'{side}Element="{element}" ' if element else ""
        ends.append(f'{of}{side}Connector="{name}"')
    return f"<ssd:Connection {' '.join(ends)}>{inside}</ssd:Connection>"


def system(name: str, elements: str, wires: str = "", connectors: str = "", bound: str = "") -> str:
    return (
        f'<ssd:System name="{name}"><ssd:Connectors>{connectors}</ssd:Connectors>{bound}'
        f"<ssd:Elements>{elements}</ssd:Elements><ssd:Connections>{wires}</ssd:Connections></ssd:System>"
    )


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return misbehaving_fmu(tmp_path_factory.mktemp("ssp"))


def archive(folder: Path, fmu: Path, top: str, experiment: str = EXPERIMENT) -> Path:
    names = ("ssd", "Description"), ("ssc", "Common"), ("ssv", "ParameterValues"), ("ssm", "ParameterMapping")
    spaces = " ".join(f'xmlns:{short}="{NS}SystemStructure{long}"' for short, long in names)
    path = folder / "x.ssp"
    with zipfile.ZipFile(path, "w") as z:
        z.writestr(
            "SystemStructure.ssd",
            f'<?xml version="1.0"?><ssd:SystemStructureDescription {spaces} version="1.0" name="t">'
            f"{top}{experiment}</ssd:SystemStructureDescription>",
        )
        z.write(fmu, "resources/misbehaving.fmu")
    return path


#: an oscillator a, b (x' = u, y = x) of which b lies in a system; its values come from inside and outside
INNER = system(
    "sub",
    component("b", values(x0=9.0)),
    wire("u", "b.u") + wire("b.y", "y"),
    connector("u", "input") + connector("y", "output"),
)
TWICE_AND_ONE = (
    '<ssm:MappingEntry source="p.k" target="sub.b.x0"><ssc:LinearTransformation factor="2" offset="1"/>'
    "</ssm:MappingEntry>"
)


@pytest.mark.slow
def test_it_is_the_system_that_it_describes(fmu: Path, tmp_path: Path) -> None:
    """The value of the outer system, mapped, takes the place of the inner one."""
    top = system(
        "root",
        component("a", values(x0=-0.5)) + INNER,
        wire("a.y", "sub.u") + wire("sub.y", "a.u"),
        bound=values(prefix="p.", mapping=TWICE_AND_ONE, k=0.5),
    )
    run = run_system(archive(tmp_path, fmu, top))
    by_hand = System(stop_s=2.0).fmu("a", fmu, x0=-0.5).fmu("sub_b", fmu, x0=2.0)
    expected = by_hand.connect("a.y", "sub_b.u").connect("sub_b.y", "a.u").run()
    for name in ("a.y", "sub_b.y"):
        np.testing.assert_array_equal(np.asarray(run[name]), np.asarray(expected[name]))
    assert "a <-> sub_b" in run.explain()


@pytest.mark.slow
def test_a_value_of_a_system_reaches_what_its_connector_feeds(fmu: Path, tmp_path: Path) -> None:
    inner = system("sub", component("b"), wire("u", "b.u"), connector("u", "input"), values(u=0.25))
    run = run_system(archive(tmp_path, fmu, system("root", inner)))
    assert run["sub_b.y"][-1] == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize(
    ("top", "experiment", "says"),
    [
        (system("root", component("a")), "", "no stopTime, allowed: a DefaultExperiment that has one"),
        (
            system("root", component("a")),
            '<ssd:DefaultExperiment startTime="1" stopTime="2"/>',
            "startTime = 1, allowed: 0",
        ),
        (
            system("root", component("a") + component("b"), wire("a.y", "b.v")),
            EXPERIMENT,
            "b: has no connector 'v', allowed: one that is declared",
        ),
        (
            system("root", component("a", y="deg") + component("b", u="rad"), wire("a.y", "b.u")),
            EXPERIMENT,
            "connection a.y -> b.u: goes from deg to rad, allowed: the same unit",
        ),
        (
            system(
                "root",
                component("a") + component("b"),
                wire("a.y", "b.u", '<ssc:LinearTransformation factor="2"/>'),
            ),
            EXPERIMENT,
            "connection a.y -> b.u: has a transformation, allowed: none; put it into an FMU",
        ),
        (
            system("root", component("a") + component("b"), wire("a.y", "b.u") + wire("b.y", "b.u")),
            EXPERIMENT,
            "connection b.y -> b.u: is given in addition to one of a.y, allowed: one source",
        ),
        (
            system("root", component("a").replace("misbehaving.fmu", "gone.fmu")),
            EXPERIMENT,
            "a: source 'resources/gone.fmu' is not in the archive",
        ),
    ],
)
def test_what_it_does_not_do_is_one_line(
    fmu: Path, tmp_path: Path, top: str, experiment: str, says: str
) -> None:
    with pytest.raises(ScenarioError) as error:
        load_scenario(archive(tmp_path, fmu, top, experiment))
    assert says in str(error.value) and "\n" not in str(error.value)


def test_what_is_no_structure_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "x.ssp"
    path.write_bytes(b"no archive")
    with pytest.raises(ScenarioError, match="not a readable zip archive"):
        load_scenario(path)
    with zipfile.ZipFile(path, "w") as z:
        z.writestr("other.txt", "")
    with pytest.raises(ScenarioError, match=r"has no SystemStructure\.ssd"):
        load_scenario(path)


@pytest.mark.slow
def test_our_own_archive_gives_the_run_that_it_was_written_from(tmp_path: Path, cache: Path) -> None:
    """The receiving loop knows no channel, so it iterates; what is left is its tolerance."""
    file = write_ssp(load_scenario("lost-signal"), tmp_path / "loop.ssp", cache=cache)
    run, expected = run_system(file, cache=cache), run_scenario("lost-signal", cache=cache)
    times, speed = expected.data["time_s"], expected.data["plant.G4_dw"]
    again = np.interp(times, run.data["time_s"], run.data["fmu_plant.G4_dw"])
    assert np.abs(again - speed).max() < 1e-7 * np.abs(speed).max()
