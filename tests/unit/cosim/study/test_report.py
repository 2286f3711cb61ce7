"""The report: self-contained, complete, and its verdicts follow the numbers."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from sample_study import CLAIMS, sample_study

from interarea.cosim.errors import ScenarioError
from interarea.cosim.plots.curves import SERIES, magnitude_plot, save_figure, time_plot
from interarea.cosim.plots.html import inline_svg, page_figure
from interarea.cosim.plots.mode_shapes import participation_plot
from interarea.cosim.study.printed import PrintedNumber, printed_rows
from interarea.cosim.study.report import render_report, write_report


def curve() -> Figure:
    t = np.linspace(0.0, 5.0, 51)
    return time_plot({"a": (t, np.sin(t))}, ylabel="y")


def shown(folder: Path, key: str) -> Path:
    """Write what a page shows of a figure."""
    file = folder / f"{key}.html"
    file.write_text(page_figure(curve(), key), encoding="utf-8")
    return file


@pytest.fixture
def figure(tmp_path: Path) -> Path:
    return shown(tmp_path, "5.10")


class Page(HTMLParser):
    """Collects ids, references and unclosed tags."""

    VOID = frozenset({"meta", "br", "img", "link", "hr", "input"})

    def __init__(self) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.addresses: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id" and value is not None:
                self.ids.append(value)
            if name in ("src", "href", "xlink:href") and value is not None:
                self.addresses.append(value)
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-3:]}"
        self.open.pop()


@pytest.mark.slow
def test_page_is_well_formed_and_loads_nothing(tmp_path: Path) -> None:
    text = render_report(sample_study(), {key: shown(tmp_path, key) for key in ("5.10", "5.15", "delay")})
    page = Page()
    page.feed(text)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))  # two figures share no id
    local = {f"#{name}" for name in page.ids}
    assert [a for a in page.addresses if a not in local] == []
    assert "http" not in re.sub(r'xmlns(:\w+)?="[^"]*"', "", text)


def test_page_shows_printed_beside_ours(figure: Path) -> None:
    text = render_report(sample_study(), {"5.10": figure})
    for word in ("0.6227", "0.08055", "0.08059", "0.1996", "430.1 ms", "0.296"):
        assert word in text


def test_the_ring_down_stands_beside_the_root(figure: Path) -> None:
    text = render_report(sample_study(), {"5.10": figure})
    assert '<td class="n">0.296</td><td class="n">0.297</td>' in text


def test_packets_are_told(figure: Path) -> None:
    text = render_report(sample_study(), {"5.10": figure})
    for word in ("42.7 %", "−0.2471", "11 of 12", "5.20 s, 6.30 s, 7.90 s"):
        assert word in text
    without = sample_study()
    del without["packets"]
    assert "Packet loss and random latency" not in render_report(without, {"5.10": figure})


def test_the_same_study_gives_the_same_page(tmp_path: Path, figure: Path) -> None:
    pages = [write_report(sample_study(), {"5.10": figure}, tmp_path / f"{k}.html") for k in range(2)]
    assert pages[0].read_bytes() == pages[1].read_bytes()
    assert not list(tmp_path.glob("*.partial"))


def test_a_figure_has_its_values_its_text_its_data_and_its_command(figure: Path) -> None:
    text = render_report(sample_study(), {"5.10": figure})
    (data,) = re.findall(r'<script type="application/json">(.*?)</script>', text)
    (axis,) = json.loads(data)["axes"]
    assert axis["curves"][0]["name"] == "a" and axis["curves"][0]["y"][10] == 841.5  # sin(1) in 1e-3
    assert "addEventListener('pointermove'" in text  # what shows them
    assert re.search(r"<text[^>]*>time \(s\)</text>", text)
    caption = "results/wdc-pulse.parquet; interarea study thesis --out out"
    assert f'<span class="from">{caption}</span>' in text


def test_values_under_the_pointer_follow_a_logarithmic_axis() -> None:
    omega = np.logspace(-1.0, 2.0, 4)
    drawn = page_figure(magnitude_plot({"S": np.array([1.0, 2.0, 4.0, 8.0])}, omega, "dB"), "s")
    (data,) = re.findall(r'<script type="application/json">(.*?)</script>', drawn)
    (axis,) = json.loads(data)["axes"]
    assert axis["log"] is True and axis["x"] == [0.1, 100.0]
    assert axis["curves"][0]["x"] == [0.1, 1.0, 10.0, 100.0]


def test_bars_have_names_and_values_where_they_lie() -> None:
    figure = participation_plot({"G1.delta": 0.5, "G2.speed": 0.25, "G1.psi": 0.0}, ["G1", "G2"])
    (data,) = re.findall(r'<script type="application/json">(.*?)</script>', page_figure(figure, "bars"))
    first, second = json.loads(data)["bars"]
    assert [first["text"], second["text"]] == ["G1.delta 0.5", "G2.speed 0.25"]
    (a0, a1, a2, a3), (b0, b1, b2, b3) = first["at"], second["at"]
    assert a0 == b0 and a2 - a0 == pytest.approx(2 * (b2 - b0), abs=0.2)  # twice as long, from the same zero
    assert a1 < a3 < b1 < b3  # the largest on top


def test_colours_of_an_inlined_figure_follow_the_theme(tmp_path: Path) -> None:
    text = inline_svg(save_figure(curve(), tmp_path / "figure.svg"), "5.10")
    assert "var(--s0)" in text
    assert not any(colour in text.lower() for colour in SERIES)


def test_names_from_a_study_file_cannot_break_the_page(figure: Path) -> None:
    study = sample_study() | {"title": "<script>alert(1)</script>"}
    assert "<script>alert" not in render_report(study, {"5.10": figure})


@pytest.mark.parametrize(
    ("text", "ours", "agrees"), [("0.6227", 0.62274, True), ("0.6227", 0.62276, False), ("8", 8.4, True)]
)
def test_printed_digits_are_the_tolerance(text: str, ours: float, agrees: bool) -> None:
    assert PrintedNumber(text).agrees(ours) is agrees


def test_a_table_that_was_fitted_never_agrees() -> None:
    rows = sample_study()["printed"]["modes"]
    verdicts = {(r["mode"], r["reading"]): r["frequency_hz"]["verdict"] for r in rows}
    assert verdicts["inter-area", "as printed"] == "fitted"
    assert verdicts["local area 1", "as printed"] == "differs"
    assert verdicts["local area 2", "rows exchanged"] == "fitted"
    assert "agrees" not in {r[q]["verdict"] for r in rows for q in ("frequency_hz", "damping_ratio")}


def test_loops_are_ranked_among_those_that_both_have() -> None:
    rows = {
        (r["actuator"], r["signal"]): (r["rank_printed"], r["rank_ours"])
        for r in sample_study()["printed"]["loops"]
    }
    assert rows["G4", "dw24"] == (1, 1)
    assert rows["G1", "dw13"] == (None, None)  # not in the sample


def test_a_study_of_another_case_has_a_page_without_claims(figure: Path) -> None:
    study = sample_study()
    del study["printed"]
    text = render_report(study, {"5.10": figure})
    assert "Table 5.1" not in text and "printed statements" not in text
    page = Page()
    page.feed(text)
    assert page.open == [] and "#statements" not in page.addresses


def test_claims_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.toml", tmp_path / "bad.toml"):
        (tmp_path / "bad.toml").write_text("[[statement]\n")
        with pytest.raises(ScenarioError, match=path.name):
            printed_rows(path, sample_study())
    assert printed_rows(CLAIMS, sample_study())["corrections"]


@pytest.mark.slow
def test_page_links_the_explorer_beside_it(figure: Path) -> None:
    study = sample_study()
    assert "explorer.html" not in render_report(study, {"5.10": figure})
    study["explorer"] = [{"label": "A <late> signal", "href": "explorer.html#v=1&k=wdc"}]
    text = render_report(study, {"5.10": figure})
    assert '<a href="explorer.html">Explorer</a>' in text
    assert '<a href="explorer.html#v=1&amp;k=wdc">a &lt;late&gt; signal</a>.' in text
