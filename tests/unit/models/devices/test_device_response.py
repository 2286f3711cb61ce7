"""One device by itself: its step response and poles against the formula, its diagram as SVG."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from interarea.models.devices.drawing import diagram_svg
from interarea.models.devices.language.read import device_of
from interarea.models.devices.library import library
from interarea.models.devices.response import missing, response_of
from interarea.models.errors import DeviceError

SEXS = {"TA_TB": 0.1, "TB": 10.0, "K": 100.0, "TE": 0.05, "EMIN": -5.0, "EMAX": 5.0}
OWN = '''name = "MY_AVR"
kind = "exciter"
title = "an <script>alert(1)</script> example"
diagram = """
y   = leadlag(vref + vs - vc, TC, TB)        # lead & lag
efd = lag(y, TA, K=KA, min=EMIN, max=EMAX)   # field voltage
"""
[parameters]
TC = { unit = "s", min = 0 }
TB = { unit = "s", min = 0 }
KA = { above = 0 }
TA = { unit = "s", min = 0 }
EMIN = { unit = "pu" }
EMAX = { unit = "pu" }
'''


def test_step_response_and_poles_are_those_of_the_transfer_function():
    """K (1 + s TA)/((1 + s TB)(1 + s TE)), by partial fractions."""
    response = response_of(library()["sexs"], SEXS, stop_s=4.0)
    slow, fast = -1.0 / SEXS["TB"], -1.0 / SEXS["TE"]
    assert response.poles == pytest.approx([slow, fast], rel=1e-12)
    lead, gain = SEXS["TA_TB"] * SEXS["TB"], SEXS["K"] * slow * fast
    residue = {p: gain * (1.0 + lead * p) / (p * (p - q)) for p, q in ((slow, fast), (fast, slow))}
    expected = SEXS["K"] + sum(r * np.exp(p * response.times) for p, r in residue.items())
    assert response.step == ("vref", 0.01)
    np.testing.assert_allclose(response.output, 0.01 * expected, atol=1e-6)


def test_a_limit_holds_in_the_step_response():
    response = response_of(library()["sexs"], SEXS | {"EMAX": 1.9}, stop_s=4.0)
    assert response.output.max() == pytest.approx(0.1, abs=1e-9)


def test_what_is_wrong_is_named():
    model = library()["sexs"]
    assert missing(model, {"K": 100.0}) == ["TA_TB", "TB", "TE", "EMIN", "EMAX"]
    with pytest.raises(DeviceError, match=r"SEXS\.KA = 1\.0: no such key"):
        response_of(model, SEXS | {"KA": 1.0})
    with pytest.raises(DeviceError, match=r"pm = 1 is not one of its signals; known: .*vt"):
        response_of(model, SEXS, {"pm": 1.0})
    for wrong in ({"vt": 0.0}, {"vt": -1.0}, {"vt": 2e3}, {"slip": 2e3}, {"efd": np.nan}):
        with pytest.raises(DeviceError, match=rf"{next(iter(wrong))} = .*, allowed: (above 0|-1000 to)"):
            response_of(model, SEXS, wrong)
    with pytest.raises(DeviceError, match=r"efd .* above EMAX = 1"):
        response_of(model, SEXS | {"EMAX": 1.0})


@pytest.mark.parametrize("key", sorted(library()))
def test_every_device_can_be_drawn(key):
    device = library()[key].device
    root = ET.fromstring(diagram_svg(device))
    boxes = root.findall(".//{http://www.w3.org/2000/svg}rect")
    assert len(boxes) == len(device.lines)
    width = float(root.get("width"))
    assert all(float(b.get("x")) > 0 and float(b.get("x")) + float(b.get("width")) < width for b in boxes)
    places = {(b.get("x"), b.get("y")) for b in boxes}
    assert len(places) == len(boxes)


def test_a_strangers_words_are_escaped():
    text = diagram_svg(device_of(OWN, "my_avr.toml"))
    assert "<script" not in text and "&lt;script&gt;" in text and "lead &amp; lag" in text


def test_the_command_shows_a_users_device(tmp_path, monkeypatch, capsys):
    import sys

    from interarea.cli.app import main

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["interarea", "device", *map(str, arguments)])
        try:
            main()
        except SystemExit as stopped:
            code = int(stopped.code or 0)
        shown = capsys.readouterr()
        return code, shown.out, shown.err

    file, svg = tmp_path / "my_avr.toml", tmp_path / "my_avr.svg"
    file.write_text(OWN)
    sets = [f"--set={n}={v}" for n, v in {"TC": 1, "TB": 10, "KA": 100, "TA": 0.05}.items()]
    code, out, _ = call(file, *sets, "--set=EMIN=-5", "--set=EMAX=5", "--draw", svg, "--json")
    document = json.loads(out)
    assert code == 0 and svg.is_file() and document["references"]["vref"] == pytest.approx(1.0 + 1.8 / 100.0)
    assert sorted(p[0] for p in document["poles"]) == pytest.approx([-20.0, -0.1])
    code, _, err = call(file, *sets)
    assert code == 2 and "no value for EMIN, EMAX; give --set EMIN=" in err
    drawing = tmp_path / "sexs.svg"
    code, out, err = call(
        "sexs", "--draw", drawing
    )  # a line of docs/reference.md: no values, the diagram alone
    assert code == 0 and drawing.is_file() and "efd = lag(lead_lag, TE" in out and "diagram only" in err
    assert call("sexs", "--set=K=100")[0] == 2 and call("sexs", "--json")[0] == 2
    assert call("sex")[0] == 2 and call(file, "--set", "KA=x")[0] == 2
    code, out, _ = call(file, *sets, "--set=EMIN=-5", "--set=EMAX=5")
    assert code == 0 and re.search(r"efd within -5 \.\. 5: 3\.2 away", out)
