"""What leaves and enters a page: the saved scenario, the link, and what neither lets through."""

from __future__ import annotations

import contextlib
import re
import struct
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from interarea.cli.app import main
from interarea.cosim.errors import ScenarioError
from interarea.cosim.explorer.address import link_of
from interarea.cosim.explorer.layout import bus_positions
from interarea.cosim.explorer.models import delta, models_of
from interarea.cosim.explorer.page import explorer_page, page_data
from interarea.cosim.explorer.subject import subject_of
from interarea.cosim.export.container import container_block
from interarea.cosim.scenario.channels import GilbertElliottLoss
from interarea.cosim.scenario.scenario import Scenario, load_scenario
from interarea.cosim.scenario.signal_faults import fault_parameters
from interarea.cosim.scenario.signal_paths import ChannelTable
from interarea.design.controllers.controller import Controller
from interarea.models.blocks.channel import SIGNAL_FAULT
from interarea.models.blocks.variables import Block
from interarea.models.case.case import load_case
from interarea.models.devices.header import devices_file, with_devices


def test_saved_scenario_says_everything_the_page_sets(node: Any) -> None:
    state = {
        "k": "ftc", "g": 1.25, "l": 0.1, "op": 1, "cl": 5.5, "ev": "fault", "fault": 8, "tc": 120,
        "br": "8-9 a",
        "remote.latency": 137.5, "remote.loss": 20, "remote.burst": 4, "remote.jitter": 12, "remote.seed": 7,
        "remote.interval": 25, "remote.lost": 3.5, "remote.back": 9, "local.on_loss": "hold",
    }  # fmt: skip
    scenario = load_scenario(tomllib.loads(node([{"toml": state, "title": 'a "quoted" title'}])[0]))
    assert (scenario.controller, scenario.controller_gain, scenario.controller_limit_pu) == ("ftc", 1.25, 0.1)
    assert scenario.title == 'a "quoted" title'
    assert scenario.operating_point.tie_flow_mw == -100.0
    assert scenario.plant["G3.exciter.Efd_min"] == -5.5
    remote, local = scenario.channels["remote"], scenario.channels["local"]
    assert (remote.latency_s, remote.jitter_s, remote.reporting_interval_s, remote.seed) == (
        0.1375,
        0.012,
        0.025,
        7,
    )
    assert remote.outages_s == ((3.5, 9.0),)
    assert isinstance(remote.loss, GilbertElliottLoss)
    bad = remote.loss.good_to_bad / (remote.loss.good_to_bad + remote.loss.bad_to_good)
    assert bad == pytest.approx(0.2)
    assert 1.0 / remote.loss.bad_to_good == pytest.approx(4.0)
    assert (local.on_loss, local.loss, local.latency_s) == ("hold", None, 0.05)
    fault, trip = scenario.event
    assert (fault.bus, fault.end_s, trip.branch, trip.start_s) == (8, 1.12, "8-9 a", 1.12)


WRONG = (
    "stuck",
    "zero",
    "times 3",
    "polarity",
    "bias of 100 mHz",
    "spikes of 500 mHz, 5 %",
    "stamp 0.8 s wrong",
)


def test_a_wrong_signal_is_one_of_the_scenario(node: Any, data: dict[str, Any]) -> None:
    assert set(WRONG) <= set(data["wrong"])
    states = [{"k": "ftc", "remote.wrong": kind, "remote.since": 2.5} for kind in data["wrong"]]
    for text, (words, known) in zip(
        node([{"toml": s, "title": "x"} for s in states]), data["wrong"].items(), strict=True
    ):
        channels = load_scenario(tomllib.loads(text)).channels
        (fault,) = channels["remote"].signal_faults
        assert (fault.start_s, fault.end_s) == (2.5, None), words
        assert fault.model_dump(include=set(known["table"])) == known["table"]
        assert channels["local"].signal_faults == ()
        assert (channels["remote"].reporting_interval_s > 0.0) >= fault.packets


def test_a_wrong_signal_has_the_numbers_of_its_fmu(data: dict[str, Any]) -> None:
    for words, known in data["wrong"].items():
        fault = ChannelTable.model_validate(
            {
                "signal": "G2_dw",
                "reporting_interval_s": 0.02,
                "signal_faults": [{**known["table"], "start_s": 2.5}],
            }
        ).signal_faults[0]
        values = fault_parameters((fault,))
        code = {name: number for name, number, _ in SIGNAL_FAULT.items}[values["fault[1].kind"]]
        own = [known["code"], *list(known["table"].values())[1:], 0.0, 0.0]
        assert own[:3] == [code, values["fault[1].size"], values["fault[1].detail"]], words


def test_link_and_back(node: Any, data: dict[str, Any]) -> None:
    state = {"k": "ftc", "remote.latency": 450, "ev": "fault", "tc": 400, "cl": 5, "br": "8-9 a", "op": 2}
    address = node([{"address": state}])[0]
    assert address.startswith("#v=1&k=ftc&")
    back = node([{"link": address}])[0]
    assert back == {"state": state, "why": ""}
    assert node([{"address": {}}, {"address": dict(data["start"])}]) == ["", ""]


@pytest.mark.slow
def test_links_of_a_report_open_the_presets(node: Any, data: dict[str, Any]) -> None:
    for preset in data["presets"]:
        opened = node([{"link": link_of(preset["state"])}])[0]
        assert opened == {"state": preset["state"], "why": ""}


@pytest.mark.slow
def test_run_writes_the_page_of_its_scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ["interarea", "run", "ring-down", "--out", str(tmp_path / "out"), "--explore"]
    monkeypatch.setattr(sys, "argv", arguments)
    with contextlib.suppress(SystemExit):
        main()
    text = (tmp_path / "out" / "explorer.html").read_text(encoding="utf-8")
    assert "<title>Open loop: how the areas swing after a pulse" in text
    assert 'href="explorer.html"' in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("link", "said"),
    [
        ("#v=2&k=ftc", "version 1"),
        ("#k=ftc", "version 1"),
        ("#v=1&k=nobody", 'k = "nobody"'),
        ("#v=1&remote.latency=1e9", "0 to 1000"),
        ("#v=1&remote.latency=NaN", "remote.latency"),
        ("#v=1&remote.latency=", "remote.latency"),
        ("#v=1&remote.seed=1.5", "remote.seed"),
        ("#v=1&remote.wrong=often", "remote.wrong"),
        ("#v=1&fault=8%22%3E%3Cscript%3E", "fault"),
        ("#v=1&__proto__=1", "__proto__"),
        ("#\u0000\u0000%", "version"),
    ],
)
def test_nonsense_in_a_link_gives_the_start_and_a_sentence(node: Any, link: str, said: str) -> None:
    answer = node([{"link": link}])[0]
    assert answer["state"] == {}
    assert said in answer["why"]
    assert answer["why"].endswith("the page shows its start.")


def apply_delta(reference: bytes, changes: bytes) -> bytes:
    """What `undelta` of worker.js does."""
    out, at = bytearray(), 0
    while at < len(changes):
        start, length, changed = struct.unpack_from("<3I", changes, at)
        at += 12
        out += reference[start : start + length] + changes[at : at + changed]
        at += changed
    return bytes(out)


@pytest.mark.slow
def test_records_are_what_their_differences_make(cache: Path) -> None:
    subject = subject_of("two-area-thesis", cache)
    known, parts = page_data(subject)
    whole: list[bytes] = []
    for model in known["models"]:
        part = parts[model["part"]]
        whole.append(part if model["reference"] < 0 else apply_delta(whole[model["reference"]], part))
        assert whole[-1].startswith(b"IAREC001")
        assert int.from_bytes(whole[-1][8:16], "little") == len(whole[-1])
    assert len(set(whole)) == len(whole)


@pytest.mark.parametrize(
    ("reference", "target"),
    [
        (b"", b""),
        (b"", b"abc"),
        (bytes(range(256)) * 4, bytes(range(256)) * 4),
        (bytes(range(256)) * 4, b"new" + bytes(range(7, 256)) + b"end"),
        (bytes(200), bytes(500)),
    ],
)
def test_difference_and_back(reference: bytes, target: bytes) -> None:
    assert apply_delta(reference, delta(reference, target)) == target


def test_page_needs_nothing_from_anywhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert len(text.encode()) <= 250_000
    for word in ("http://", "https://", "@import", 'src="', "url("):
        assert word not in text.replace("http://www.w3.org/2000/svg", ""), word


def test_only_the_devices_of_the_grid_are_kept() -> None:
    header = devices_file().read_text(encoding="ascii")
    cases = re.findall(r"case DEVICE_NUMBER_(\w+):", header)
    assert len(set(cases)) > 10
    devices = re.findall(r"case DEVICE_NUMBER_(\w+):", with_devices(header, {"static", "steam"}))
    assert set(devices) == {"STATIC", "STEAM"}
    assert len(devices) == cases.count("STATIC") + cases.count("STEAM")
    lines = header.count("\n") - (len(cases) - len(devices))
    assert with_devices(header, {"static", "steam"}).count("\n") == lines
    with pytest.raises(ValueError, match="NOSUCH"):
        with_devices(header, {"nosuch"})


def test_buses_of_a_case_have_places_apart() -> None:
    for name in ("two-area-thesis", "new-england"):
        case = load_case(name)
        places = list(bus_positions(case).values())
        assert len(places) == len(case.buses)
        gaps = [(a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 for i, a in enumerate(places) for b in places[:i]]
        assert min(gaps) > 1e-4
        assert min(x for x, _ in places) == 0.0
        assert max(x for x, _ in places) == pytest.approx(1.0)
        assert bus_positions(case) == bus_positions(case)


def test_what_a_container_cannot_hold_is_named(tmp_path: Path, cache: Path) -> None:
    base = 'case = "two-area-thesis"\ncontroller = "ftc"\nstop_s = 5.0\n'
    pdc = '[concentrators.pdc]\nwait_s = 0.1\n[[concentrators.pdc.signals]]\nsignal = "G2_dw"\n'
    for text, said in (
        (base + pdc, "concentrators"),
        ('stop_s = 1.0\n[fmus.mine]\nfile = "mine.fmu"\n', "case is missing"),
        (base.replace('"ftc"', '"mine.fmu"'), "mine.fmu"),
    ):
        file = tmp_path / "s.toml"
        file.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=said):
            explorer_page(subject_of(file, cache))
    with pytest.raises(ScenarioError, match="neither a file nor a bundled scenario or case"):
        subject_of("nothing-of-that-name", cache)


@pytest.mark.slow
def test_page_of_a_scenario_starts_as_the_scenario_says(cache: Path) -> None:
    subject = subject_of("lost-signal", cache)
    known, _ = page_data(subject)
    start = known["start"]
    assert (start["k"], start["ev"], start["sz"], start["remote.lost"]) == ("ftc", "nudge", 5.0, 1.0)
    assert start["remote.on_loss"] == "zero"
    assert subject.first == "ftc"


@pytest.mark.slow
def test_a_study_hands_its_own_controllers_over(
    hand_controller: Controller, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The models are made of what is handed over, not of what a name stands for."""
    own = dict.fromkeys(("wdc", "cc", "ftc"), hand_controller)
    subject = subject_of("two-area-thesis", cache, own)
    assert subject.first == "wdc"
    assert all(subject.controllers[name] is hand_controller for name in own)
    sources = {}

    def block(scenario: Scenario, *, controller: Controller | None, **known: Any) -> Block:
        sources[scenario.controller] = controller
        return container_block(scenario, controller=controller, **known)

    monkeypatch.setattr("interarea.cosim.explorer.models.container_block", block)
    models_of(subject)
    assert all(sources[name] is hand_controller for name in own)
    assert sources["none"] is None and sources["robust"] is None  # by their names
