"""Thirteen seeded defects: `interarea check` catches every one; what fmpy catches is counted beside it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from fmpy.validation import validate_fmu
from fmu_mutation import Entries, in_description, mutated

from interarea.fmu_build.check.check import check_file

Edit = Callable[[Entries], None]


def _sub(pattern: str, new: str) -> Edit:
    def edit(entries: Entries) -> None:
        text, count = re.subn(pattern, new, entries["modelDescription.xml"].decode(), count=1)
        assert count == 1, pattern
        entries["modelDescription.xml"] = text.encode()

    return edit


def _backslash(entries: Entries) -> None:
    entries["resources\\model.bin"] = entries["resources/model.bin"]


#: defect -> (mutation of the first-order lag, rule that must be told, whether fmpy sees it)
DEFECTS: dict[str, tuple[Edit, str, bool]] = {
    "wrong GUID": (_sub(r'guid="\{........', 'guid="{00000000'), "run: load", False),
    "undefined unit": (in_description('unit="1/s"', 'unit="1/h"'), "FMI2 2.2.2 units", True),
    "missing InitialUnknowns entry": (
        _sub(r"(<InitialUnknowns>\s*)<Unknown [^>]*/>", r"\1"),
        "FMI2 2.2.8 InitialUnknowns",
        True,
    ),
    "duplicate names": (in_description('name="w"', 'name="y"'), "FMI2 2.2.7 unique names", True),
    "dependency index out of range": (
        in_description('dependencies="1"', 'dependencies="99"'),
        "FMI2 2.2.8 indices",
        True,
    ),
    "derivative attribute missing": (in_description(' derivative="1"', ""), "FMI2 2.2.8 Derivatives", True),
    "parameter without start": (_sub(r'(max="1000000.0") start="1.0"', r"\1"), "FMI2 2.2.7 start", True),
    "start value that the binary does not have": (
        _sub(r'(max="1000000.0") start="1.0"', r'\1 start="1.5"'),
        "FMI2 2.2.7 start is the binary's",
        False,
    ),
    "modelIdentifier that does not match": (
        in_description('modelIdentifier="decay"', 'modelIdentifier="decay_"', 2),
        "FMI2 2.1 modelIdentifier",
        False,
    ),
    "causality and variability that do not go together": (
        in_description(
            'causality="parameter" variability="fixed"', 'causality="parameter" variability="discrete"'
        ),
        "FMI2 2.2.7 causality, variability, initial",
        True,
    ),
    "attribute that the schema does not know": (
        in_description("<CoSimulation ", '<CoSimulation canDoEverything="true" '),
        "XSD fmi2ModelDescription.xsd",
        True,
    ),
    "illegal structured name": (in_description('name="w"', 'name="w w"'), "FMI2 2.2.9 variable names", True),
    "continuous Boolean": (
        _sub(r'(name="kicking"[^>]*variability=)"fixed"', r'\1"continuous"'),
        "FMI2 2.2.7 continuous",
        True,
    ),
}


@pytest.fixture(scope="module")
def seeded(built: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return one FMU per defect."""
    folder = tmp_path_factory.mktemp("defects")
    return {
        defect: mutated(built["decay"], folder / f"{k}.fmu", edit)
        for k, (defect, (edit, _, _)) in enumerate(DEFECTS.items())
    }


@pytest.mark.slow
@pytest.mark.parametrize("defect", DEFECTS)
def test_defect_is_found_with_rule_and_fix(defect: str, seeded: dict[str, Path]) -> None:
    _, rule, _ = DEFECTS[defect]
    # only what the binary itself shows needs it to be run
    report = check_file(seeded[defect], run="binary" in defect or "GUID" in defect)
    reported = [f for f in report.findings if f.rule == rule]
    assert reported, [f.line() for f in report.findings]
    assert all(f.where and f.message and f.fix and "\n" not in f.line() for f in report.findings)


@pytest.mark.slow
def test_fmpy_finds_ten_of_the_thirteen(seeded: dict[str, Path]) -> None:
    result = {defect for defect, file in seeded.items() if validate_fmu(str(file))}
    assert result == {defect for defect, (_, _, seen) in DEFECTS.items() if seen}
    assert (len(result), len(DEFECTS)) == (10, 13)


def test_backslash_in_an_entry(decay: Path, tmp_path: Path) -> None:
    report = check_file(mutated(decay, tmp_path / "x.fmu", _backslash), run=False)
    assert "FMI2 2.1 archive paths" in {f.rule for f in report.findings}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("edit", "rule"),
    [
        (_sub(r'(name="y"[^>]*valueReference=)"\d+"', r'\1"77"'), None),
        (in_description('max="1000000.0" start="1.0"', 'max="0.5" start="1.0"'), "FMI2 2.2.7 min, max"),
        (in_description('nominal="2.0"', 'nominal="-2.0"'), "FMI2 2.2.7 nominal"),
        (in_description('stopTime="2.0"', 'stopTime="-2.0"'), "FMI2 2.2.5 DefaultExperiment"),
        (in_description('File name="decay.c"', 'File name="gone.c"'), "FMI2 2.2.4 SourceFiles"),
        (in_description('start="0.55"', 'start="NaN"'), "FMI2 2.2.7 values"),
        (in_description(' canGetAndSetFMUstate="true"', ""), "FMI2 3.3.1, 4.3.1 capabilities"),
        (_sub(r'(name="kick.size"[^>]*valueReference=)"\d+"', r'\1"5"'), "FMI2 2.2.7 aliases"),
    ],
)
def test_rules_that_only_this_check_has(decay: Path, tmp_path: Path, edit: Edit, rule: str | None) -> None:
    report = check_file(mutated(decay, tmp_path / "x.fmu", edit), run=rule is None)
    if rule is None:  # a value reference the binary does not know shows when it is read
        assert any("there is no Real variable with value reference 77" in f.message for f in report.findings)
    else:
        assert rule in {f.rule for f in report.findings}, [f.line() for f in report.findings]
