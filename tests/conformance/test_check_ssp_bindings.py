"""`interarea check` on parameter bindings of systems, on mappings, and on units that the FMUs alone state."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest
from misbehaving import misbehaving_fmu

from interarea.fmu_build.check.check import check_file
from interarea.fmu_build.finding import Report

NS = "http://ssp-standard.org/SSP1/"
ENDS = (("u", "input"), ("y", "output"))
CONNECTORS = "".join(f'<ssd:Connector name="{n}" kind="{k}"><ssc:Real/></ssd:Connector>' for n, k in ENDS)
GAIN = '<ssv:Parameter name="gain"><ssv:Real value="3"/></ssv:Parameter>'


@pytest.fixture(autouse=True)
def _without_validators(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the FMUs inside have their own tests and cost most of the time."""
    monkeypatch.setattr("interarea.fmu_build.check.check.fmpy_rules", lambda *_: None)
    monkeypatch.setattr("interarea.fmu_build.check.check.toolbox_rules", lambda *_: None)


def component(name: str, fmu: str = "misbehaving.fmu", inside: str = "") -> str:
    return (
        f'<ssd:Component name="{name}" type="application/x-fmu-sharedlibrary" source="resources/{fmu}">'
        f"<ssd:Connectors>{CONNECTORS}</ssd:Connectors>{inside}</ssd:Component>"
    )


def binding(mapping: str = "", *, file: str = "p.ssv", prefix: str = "") -> str:
    inside = f'<ssd:ParameterMapping source="resources/{mapping}"/>' if mapping else ""
    return (
        f'<ssd:ParameterBindings><ssd:ParameterBinding source="resources/{file}" prefix="{prefix}">{inside}'
        "</ssd:ParameterBinding></ssd:ParameterBindings>"
    )


def archive(
    folder: Path,
    fmus: Sequence[Path],
    bound: str,
    *,
    elements: str,
    entries: Sequence[str] = (),
    values: str = GAIN,
    connection: str = "",
) -> Report:
    """Check a system whose binding `bound` uses p.ssv with `values` and m.ssm with `entries`."""
    both = f'startElement="a" startConnector="y" endElement="b" endConnector="u"{connection}'
    structure = (
        f'<?xml version="1.0"?><ssd:SystemStructureDescription xmlns:ssd="{NS}SystemStructureDescription" '
        f'xmlns:ssc="{NS}SystemStructureCommon" version="1.0" name="t"><ssd:System name="root">{bound}'
        f"<ssd:Elements>{elements}</ssd:Elements>"
        f"<ssd:Connections><ssd:Connection {both}/></ssd:Connections></ssd:System>"
        "</ssd:SystemStructureDescription>"
    )
    ssv = (
        f'<?xml version="1.0"?><ssv:ParameterSet xmlns:ssv="{NS}SystemStructureParameterValues" '
        f'version="1.0" name="p"><ssv:Parameters>{values}</ssv:Parameters></ssv:ParameterSet>'
    )
    ssm = (
        f'<?xml version="1.0"?><ssm:ParameterMapping xmlns:ssm="{NS}SystemStructureParameterMapping" '
        f'xmlns:ssc="{NS}SystemStructureCommon" version="1.0">{"".join(entries)}</ssm:ParameterMapping>'
    )
    path = folder / "x.ssp"
    with zipfile.ZipFile(path, "w") as z:
        z.writestr("SystemStructure.ssd", structure)
        for fmu in fmus:
            z.write(fmu, f"resources/{fmu.name}")
        z.writestr("resources/p.ssv", ssv)
        z.writestr("resources/m.ssm", ssm)
    return check_file(path, run=False)


def entry(source: str, target: str, inside: str = "", more: str = "") -> str:
    return f'<ssm:MappingEntry source="{source}" target="{target}"{more}>{inside}</ssm:MappingEntry>'


PAIR = component("a") + component("b")
NESTED = (
    component("a")
    + component("b")
    + (
        '<ssd:System name="sub"><ssd:Connectors><ssd:Connector name="K" kind="parameter"><ssc:Real/>'
        f"</ssd:Connector></ssd:Connectors><ssd:Elements>{component('c')}</ssd:Elements></ssd:System>"
    )
)
LINEAR = '<ssc:LinearTransformation factor="2" offset="1"/>'
FLAG = (
    '<ssc:BooleanMappingTransformation><ssc:MapEntry source="true" target="false"/>'
    "</ssc:BooleanMappingTransformation>"
)

CLEAN = {
    "mapped to a component": [entry("gain", "a.x0")],
    "mapped to both": [entry("gain", "a.x0"), entry("gain", "b.x0", LINEAR)],
    "mapped into a system inside": [entry("gain", "sub.c.x0")],
    "mapped to a parameter of a system inside": [entry("gain", "sub.K")],
}
WRONG = {
    "no such variable": ([entry("gain", "a.kk")], "parameter a.kk: the FMU has no such variable"),
    "no such element": ([entry("gain", "c.x0")], "parameter c.x0: there is no element 'c'"),
    "no such element inside": ([entry("gain", "sub.d.x0")], "there is no element 'd'"),
    "not a dotted name": ([entry("gain", "x0")], "x0: there is no such parameter or connector"),
    "source that the set does not have": (
        [entry("gain", "a.x0"), entry("gian", "b.x0")],
        "mapping of gian: the parameter set has no such parameter",
    ),
    "target with two sources": ([entry("gain", "a.x0")] * 2, "mapping to a.x0: has two sources"),
    "an output": ([entry("gain", "a.y")], "parameter a.y: output, which cannot be set"),
    "a transformation of another type": (
        [entry("gain", "a.x0", FLAG)],
        "BooleanMappingTransformation of Real",
    ),
}


@pytest.fixture(scope="module")
def misbehaving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return misbehaving_fmu(tmp_path_factory.mktemp("misbehaving"))


def said(report: Report) -> str:
    return " | ".join(f.line() for f in report.findings if f.rule.startswith("SSP"))


@pytest.mark.parametrize("name", CLEAN)
def test_a_right_mapping_is_clean(misbehaving: Path, tmp_path: Path, name: str) -> None:
    report = archive(tmp_path, [misbehaving], binding("m.ssm"), elements=NESTED, entries=CLEAN[name])
    assert said(report) == ""


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_mapping_is_found(misbehaving: Path, tmp_path: Path, name: str) -> None:
    entries, words = WRONG[name]
    report = archive(tmp_path, [misbehaving], binding("m.ssm"), elements=NESTED, entries=entries)
    assert words in said(report)


def test_a_mapping_that_is_not_there_is_found(misbehaving: Path, tmp_path: Path) -> None:
    for elements, bound in (
        (PAIR, binding("n.ssm")),
        (component("a", inside=binding("n.ssm")) + component("b"), ""),
    ):
        report = archive(tmp_path, [misbehaving], bound, elements=elements)
        assert "'resources/n.ssm' is not in the archive" in said(report)


@pytest.mark.parametrize(
    ("parameter", "prefix", "words"),
    [
        ("a.x0", "", ""),
        ("x0", "b.", ""),
        ("c.x0", "", "there is no element 'c'"),
        ("x0", "c.", "there is no element 'c'"),
        ("a.k", "", "the FMU has no such variable"),
    ],
)
def test_a_set_of_the_system_names_what_there_is(
    misbehaving: Path, tmp_path: Path, parameter: str, prefix: str, words: str
) -> None:
    values = GAIN.replace("gain", parameter)
    report = archive(tmp_path, [misbehaving], binding(prefix=prefix), elements=PAIR, values=values)
    assert words in said(report) and (words or not said(report))


def test_a_value_of_the_wrong_type_or_given_twice_is_found(misbehaving: Path, tmp_path: Path) -> None:
    values = '<ssv:Parameter name="a.x0"><ssv:String value="3"/></ssv:Parameter>'
    assert "is String, the variable is Real" in said(
        archive(tmp_path, [misbehaving], binding(), elements=PAIR, values=values)
    )
    twice = GAIN.replace("gain", "a.x0") * 2
    assert "is given twice in one set" in said(
        archive(tmp_path, [misbehaving], binding(), elements=PAIR, values=twice)
    )


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ('<ssv:Real value="abc"/>', "'abc' is not a valid value"),
        ('<ssv:Integer value="1.5"/>', "'1.5' is not a valid value"),
        ("", "Missing child element"),
        ('<ssv:Real value="2"/>', ""),
    ],
)
def test_a_set_inside_the_structure_obeys_the_schema_of_sets(
    misbehaving: Path, tmp_path: Path, value: str, words: str
) -> None:
    """The schema of the structure lets anything stand there."""
    inside = (
        "<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>"
        f'<ssv:ParameterSet xmlns:ssv="{NS}SystemStructureParameterValues" version="1.0" name="p">'
        f'<ssv:Parameters><ssv:Parameter name="x0">{value}</ssv:Parameter></ssv:Parameters>'
        "</ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings>"
    )
    elements = component("a", inside=inside) + component("b")
    findings = [f.line() for f in archive(tmp_path, [misbehaving], "", elements=elements).findings]
    assert words in " ".join(findings) and (words or not findings)


def test_units_that_only_the_fmus_state_are_compared(misbehaving: Path, tmp_path: Path) -> None:
    """a.y has no unit, b.u degrees: nothing to compare; then a.y in metres, which are none."""
    degrees = misbehaving_fmu(tmp_path / "deg", unit="deg").rename(tmp_path / "degrees.fmu")
    metres = tmp_path / "metres.fmu"
    with zipfile.ZipFile(misbehaving) as old, zipfile.ZipFile(metres, "w") as new:
        for name in old.namelist():
            text = old.read(name)
            if name == "modelDescription.xml":
                unit = b'<UnitDefinitions><Unit name="m"><BaseUnit m="1"/></Unit></UnitDefinitions>'
                text = text.replace(b"<ModelVariables>", unit + b"<ModelVariables>")
                text = text.replace(b'causality="output"><Real/>', b'causality="output"><Real unit="m"/>')
            new.writestr(name, text)
    into = component("b", "degrees.fmu")
    assert said(archive(tmp_path, [misbehaving, degrees], "", elements=component("a") + into)) == ""
    elements = component("a", "metres.fmu") + into
    report = archive(tmp_path, [metres, degrees], "", elements=elements)
    assert "goes from m to deg [SSP units]" in said(report)
    suppressed = ' suppressUnitConversion="true"'
    assert said(archive(tmp_path, [metres, degrees], "", elements=elements, connection=suppressed)) == ""


def test_components_that_share_a_single_instance_are_noted(tmp_path: Path) -> None:
    once = misbehaving_fmu(tmp_path / "once", once=True)
    (note,) = [n for n in archive(tmp_path, [once], "", elements=PAIR).notes if "only once" in n]
    assert note.startswith(
        "root.a, root.b: resources/misbehaving.fmu can be instantiated only once per process"
    )
