"""`interarea check` on system structures: what the program writes is clean, seeded defects are found."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from fmu_mutation import Entries, mutated

from interarea.cosim.export.ssp import write_ssp
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.check.check import check_file

STRUCTURE = "SystemStructure.ssd"
Edit = Callable[[Entries], None]


@pytest.fixture(scope="module")
def loop(by_hand: Controller, cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bundled ring-down as an SSP, with the controller written by hand."""
    out = tmp_path_factory.mktemp("ssp") / "loop.ssp"
    return write_ssp(load_scenario("wide-area-damping"), out, cache=cache, controller=by_hand)


def _sub(pattern: str, new: str, file: str = STRUCTURE) -> Edit:
    def edit(entries: Entries) -> None:
        text, count = re.subn(pattern, new, entries[file].decode(), count=1)
        assert count == 1, f"{pattern!r} is not in {file}"
        entries[file] = text.encode()

    return edit


def _without_fmu(entries: Entries) -> None:
    del entries["resources/remote.fmu"]


def _hollow_fmu(entries: Entries) -> None:
    entries["resources/remote.fmu"] = b"no archive"


DEFECTS: dict[str, tuple[Edit, str, str]] = {
    "connector that the FMU does not have": (
        _sub('Connector name="tie_p"', 'Connector name="tie_q"'),
        "SSP connectors",
        "no such variable",
    ),
    "connector of the wrong kind": (
        _sub('name="tie_p" kind="output"', 'name="tie_p" kind="input"'),
        "SSP connectors",
        "the variable is output",
    ),
    "connector of the wrong type": (
        _sub(r'(name="valid" kind="output"[^>]*>)<ssc:Boolean/>', r"\1<ssc:Integer/>"),
        "SSP connectors",
        "is Integer, the variable is Boolean",
    ),
    "unit of another dimension": (
        _sub(r'(name="tie_p"[^>]*><ssc:Real unit=)"pu"', r'\1"s"'),
        "SSP units",
        "has unit s, the variable pu",
    ),
    "unit that is not defined": (
        _sub(r'(name="tie_p"[^>]*><ssc:Real unit=)"pu"', r'\1"MW"'),
        "SSP units",
        "MW is not defined",
    ),
    "connection to nowhere": (_sub('endConnector="u"', 'endConnector="v"'), "SSP connections", "there is no"),
    "connection of two inputs": (
        _sub('startElement="plant" startConnector="G2_dw"', 'startElement="plant" startConnector="G4_vs"'),
        "SSP connections",
        "goes from input to input",
    ),
    "connection of two units": (
        _sub('startElement="plant" startConnector="G2_dw"', 'startElement="plant" startConnector="G1_delta"'),
        "SSP units",
        "goes from rad to pu",
    ),
    "two sources for one input": (
        _sub(r"(<ssd:Connection [^>]*startConnector=\")y(\"[^>]*/>)", r"\1y\2\n\1age\2"),
        "SSP connections",
        "also fed by",
    ),
    "parameter that the FMU does not have": (
        _sub('name="latency"', 'name="latencey"', "resources/remote.ssv"),
        "SSP parameters",
        "no such variable",
    ),
    "parameter in another dimension": (
        _sub(r'(name="latency"><ssv:Real value="[^"]*" unit=)"s"', r'\1"pu"', "resources/remote.ssv"),
        "SSP units",
        "has unit pu, the variable s",
    ),
    "parameter set that is not valid": (
        _sub("<ssv:Integer ", "<ssv:Whole ", "resources/remote.ssv"),
        "XSD SystemStructureParameterValues.xsd",
        "Whole",
    ),
    "structure that is not valid": (
        _sub("<ssd:Elements>", '<ssd:Elements many="yes">'),
        "XSD SystemStructureDescription.xsd",
        "many",
    ),
    "FMU that is not there": (_without_fmu, "SSP source", "is not in the archive"),
    "FMU that is none": (_hollow_fmu, "archive", "is no zip archive"),
    "source outside the archive": (
        _sub('source="resources/remote.fmu"', 'source="../remote.fmu"'),
        "SSP source",
        "leaves the archive",
    ),
    "interface that the FMU does not have": (
        _sub(r'(source="resources/remote.fmu" implementation=)"CoSimulation"', r'\1"ModelExchange"'),
        "SSP implementation",
        "asks for ModelExchange",
    ),
    "entity expansion in a parameter set": (
        _sub(r"\?>", '?><!DOCTYPE a [<!ENTITY b "c">]>', "resources/remote.ssv"),
        "XML",
        "DOCTYPE",
    ),
    "times in the wrong order": (
        _sub(r'DefaultExperiment startTime="[^"]*"', 'DefaultExperiment startTime="1e9"'),
        "SSP DefaultExperiment",
        "stopTime",
    ),
}


@pytest.mark.slow
def test_what_the_program_writes_is_clean(loop: Path) -> None:
    report = check_file(loop, run=False)
    assert report.clean, [f.line() for f in report.findings]
    assert report.facts["components"] == len(report.facts["fmus"]) == 4


@pytest.mark.slow
@pytest.mark.usefixtures("_without_validators")
def test_the_same_structure_as_version_1_1(loop: Path, tmp_path: Path) -> None:
    newer = mutated(loop, tmp_path / "x.ssp", _sub('version="1.0" name', 'version="1.1" name'))
    assert [f.line() for f in check_file(newer, run=False).findings] == []
    wrong = mutated(newer, tmp_path / "z.ssp", _sub("<ssd:Elements>", '<ssd:Elements many="yes">'))
    assert [f.rule for f in check_file(wrong, run=False).findings] == ["XSD SystemStructureDescription11.xsd"]
    unknown = mutated(loop, tmp_path / "y.ssp", _sub('version="1.0" name', 'version="7.0" name'))
    assert [f.rule for f in check_file(unknown, run=False).findings] == ["SSP version"]


@pytest.fixture
def _without_validators(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the FMUs inside have their own tests and cost most of the time."""
    monkeypatch.setattr("interarea.fmu_build.check.check.fmpy_rules", lambda *_: None)
    monkeypatch.setattr("interarea.fmu_build.check.check.toolbox_rules", lambda *_: None)


@pytest.mark.usefixtures("_without_validators")
@pytest.mark.parametrize("defect", DEFECTS)
def test_defect_is_found(defect: str, loop: Path, tmp_path: Path) -> None:
    edit, rule, words = DEFECTS[defect]
    report = check_file(mutated(loop, tmp_path / "x.ssp", edit), run=False)
    reported = [f for f in report.findings if f.rule == rule]
    assert any(words in f.message for f in reported), [f.line() for f in report.findings]


@pytest.mark.slow
def test_every_binary_inside_runs_clean(loop: Path) -> None:
    report = check_file(loop)
    assert report.clean, [f.line() for f in report.findings]
    assert all(len(fmu["topics"]) >= 9 for fmu in report.facts["fmus"].values())
