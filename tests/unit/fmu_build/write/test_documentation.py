"""documentation/: what the page states, that it follows the sources, and that its links lead somewhere."""

from __future__ import annotations

import html
import posixpath
import re
import zipfile
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
from fmu_blocks import blocks
from fmu_runner import decay_block
from hypothesis import given
from hypothesis import strategies as st
from lxml import etree

from interarea.cosim.export.container import container_block
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.bundled import shipped_controller
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.compile import host_platform
from interarea.fmu_build.write.description_xml import attributes
from interarea.fmu_build.write.documentation import equations_of, ports_picture, references_in
from interarea.fmu_build.write.package import build_fmu
from interarea.models.blocks.plant import event_numbers, event_parameters, plant_block
from interarea.models.case.case import Case, load_case
from interarea.models.case.events import event_of


def page_of(fmu: Path) -> str:
    with zipfile.ZipFile(fmu) as archive:
        return archive.read("documentation/index.html").decode("utf-8")


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the plant FMU of the thesis."""
    return build_fmu(blocks()["plant"], tmp_path_factory.mktemp("plant"))


def test_plant_page_states_equations_works_case_and_platform(plant: Path, two_area: Case) -> None:
    page = html.unescape(page_of(plant))
    assert "2H  d slip/dt  = Tm - Te - D slip" in page
    assert "efd = lag(vref + vs - v, TA, K=KA, min=Efd_min, max=Efd_max)" in page
    assert "T y' = K u - y within min .. max" in page
    assert "Power System Stability and Control" in page  # cited by machine.h, from the bibliography
    assert two_area.hash in page
    assert f"binaries in this archive: {host_platform()}" in page


def test_plant_page_numbers_what_events_act_on(plant: Path, two_area: Case) -> None:
    """The numbers are those that a scenario's events become."""
    page = html.unescape(page_of(plant)).replace("\N{NO-BREAK SPACE}", " ")
    one = {"start_s": 1.0, "size_pu": 0.1}
    for event, name in (
        ({"kind": "bus_fault", "bus": 8, "start_s": 1.0, "end_s": 1.1}, "8"),
        ({"kind": "branch_trip", "branch": "8-9 a", "start_s": 1.0}, "8-9 a"),
        ({"kind": "vref_pulse", "machine": "G3", "end_s": 1.2, **one}, "G3"),
        ({"kind": "load_step", "bus": two_area.loads[1].bus, **one}, two_area.loads[1].name),
    ):
        number = event_parameters(two_area, [event_of(event, where="event")])["event[1].target"]
        (row,) = (r for r in re.findall("<tr><td>.*?</tr>", page) if str(event["kind"]) in r)
        assert re.search(rf"[>, ]{number} = {re.escape(name)}[,<]", row), row
    assert event_numbers(two_area)["machine"] == ["G1", "G2", "G3", "G4"]


def test_picture_shows_every_port_or_how_many_of_a_kind(two_area: Case) -> None:
    few = etree.fromstring(ports_picture(plant_block(two_area)))
    texts = [e.text for e in few.iter("text")]
    assert len(texts) == 1 + 4 + 4 * 4 + 1 and "G1_dw (pu)" in texts and "tie_p (pu)" in texts
    assert few.findtext("title") == "two_area_thesis: 4 inputs, 17 outputs"
    many = etree.fromstring(ports_picture(plant_block(load_case("new-england"))))
    lines = [e.text for e in many.iter("text") if e.text and "10 ports" in e.text]
    assert len(lines) >= 4 and float(many.get("width", "0")) < 700


@pytest.mark.parametrize("kind", ["decay", "controller", "channel", "plant", "loop"])
def test_page_is_well_formed_and_names_every_variable(kind: str, tmp_path: Path) -> None:
    block = blocks()[kind]
    page = page_of(build_fmu(block, tmp_path))
    parser = etree.HTMLParser(recover=False)
    root = etree.fromstring(page.encode("utf-8"), parser)
    codes = {"".join(e.itertext()) for e in root.iter("code")}
    assert {v.name for v in block.table} <= codes


def test_links_lead_into_the_archive(plant: Path) -> None:
    targets = re.findall(r'(?:href|src)="([^"]+)"', page_of(plant))
    with zipfile.ZipFile(plant) as archive:
        names = set(archive.namelist())
        headers = archive.read("documentation/licenses/fmi_headers.txt").decode("utf-8")
    assert len(targets) >= 3
    for target in targets:
        assert posixpath.normpath(posixpath.join("documentation", target)) in names, target
    assert "Modelica Association" in headers
    assert "Redistribution and use in source and binary forms" in headers


def test_robust_controller_brings_its_family_certificate(tmp_path: Path, two_area: Case) -> None:
    controller = shipped_controller("robust")
    assert controller.certificate is not None
    page = html.unescape(page_of(build_fmu(controller.block(two_area.omega_b), tmp_path)))
    for row in controller.certificate["rows"]:
        assert f"<td>{row['point']}</td><td>{row['condition']}</td>" in page
        assert f"<td>{row['worst_swing']:.6g}</td>" in page
    assert f"<th>worst_swing</th><td>{controller.certificate['worst_swing']:.6g}</td>" in page
    assert controller.design["method"] in page


def test_page_follows_sources_and_parameters(tmp_path: Path) -> None:
    first = page_of(build_fmu(decay_block(), tmp_path / "a.fmu"))
    assert page_of(build_fmu(decay_block(), tmp_path / "b.fmu")) == first
    assert page_of(build_fmu(decay_block(internal_step_s=0.02), tmp_path / "c.fmu")) != first


def test_equations_are_those_of_the_block_not_of_the_fmi_layer() -> None:
    sources = {
        "solver.c": b"/* Not this:\n *\n *     x = y\n */\n",
        "lag.h": b"/* A lag [Kundur1994]:\n *\n *     T dx/dt = u - x\n */\n/* only words */\n",
    }
    assert equations_of(sources) == {"lag.h": "A lag [Kundur1994]:\n\n    T dx/dt = u - x"}
    assert list(references_in(equations_of(sources)["lag.h"])) == ["Kundur1994"]
    assert references_in("nothing cited here") == {}


def test_container_documents_its_members_and_connections(
    cache: Path, by_hand: Controller, tmp_path: Path, two_area: Case
) -> None:
    table = {"case": "two-area-thesis", "controller": "ftc", "stop_s": 1.0}
    table |= {"channels": {"remote": {"signal": "G2_dw", "latency_s": 0.1}}}
    block = container_block(load_scenario(table), cache=cache, controller=by_hand)
    page = html.unescape(page_of(build_fmu(block, tmp_path, cache=cache)))
    assert "<td>plant.G2_dw</td><td>remote.u</td>" in page
    assert "<td>controller.G4_vs</td><td>plant.G4_vs</td>" in page
    assert "<h2>controller: Equations</h2>" in page
    assert "2H  d slip/dt  = Tm - Te - D slip" in page
    assert two_area.hash in page


@given(st.text(st.sampled_from("ab<>&\"'\n\r\té;#")))
def test_attributes_are_quoted_as_the_standard_library_does_it(text: str) -> None:
    assert attributes({"name": text}) == f" name={quoteattr(text)}"
