"""The page in Chromium, opened from disk: bits, silence, accessibility, bad input, ten thousand inputs."""

from __future__ import annotations

import base64
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_page_bits import settings

ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--js-flags=--expose-gc"]
REQUIRED = (
    os.environ.get("INTERAREA_REQUIRE_BROWSER") == "1" and os.environ.get("INTERAREA_REQUIRE_TOOLS") == "1"
)
SHOWN = "window.explorer && window.explorer.result && window.explorer.result.exact"
EVERYTHING = """async (state) => {
  const run = await explorer.everything(state);
  const bytes = new Uint8Array(run.rows.buffer);
  let text = '';
  for (let k = 0; k < bytes.length; k += 32768) text += String.fromCharCode(...bytes.subarray(k, k + 32768));
  return [run.columns, btoa(text)];
}"""

HASHES = """async (states) => {
  const found = [];
  for (const state of states) {
    const run = await explorer.everything(state);
    const hash = new Uint8Array(await crypto.subtle.digest('SHA-256', run.rows));
    found.push([run.columns, run.rows.length / run.columns.length,
      [...hash].map((x) => x.toString(16).padStart(2, '0')).join('')]);
  }
  return found;
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        assert not REQUIRED, "chromium is required here and not installed"
        pytest.skip("no Chromium is installed")
    if not REQUIRED:
        pytest.importorskip("playwright", reason="playwright is not installed (extra `tools`)")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        started = play.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield started
        started.close()


class Tab:
    """A page of the browser with all that it said and asked for."""

    def __init__(self, browser: Any, page: Path, link: str = "", width: int = 1280, **options: Any) -> None:
        self.said: list[str] = []
        self.requests: list[str] = []
        self.context = browser.new_context(
            viewport={"width": width, "height": 1000}, reduced_motion="reduce", **options
        )
        self.tab = self.context.new_page()
        self.tab.on("console", lambda message: self.said.append(message.text))
        self.tab.on("pageerror", lambda error: self.said.append(str(error)))
        self.tab.on("request", lambda request: self.requests.append(request.url))
        self.tab.goto(page.as_uri() + link)

    def __enter__(self) -> Any:
        self.tab.wait_for_function(SHOWN, timeout=60000)
        return self

    def __exit__(self, *error: object) -> None:
        self.context.close()
        if error[0] is None:
            assert not self.said
            assert all(url.startswith(("file:", "blob:", "data:")) for url in self.requests), self.requests

    def settle(self) -> None:
        """Wait until the exact run of the present state is shown."""
        self.tab.wait_for_timeout(300)
        self.tab.wait_for_function("explorer.flying === 0 && explorer.result.exact", timeout=60000)
        self.tab.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


@pytest.mark.slow
def test_presets_have_the_bits_of_node(browser: Any, page: Path, runs_of_node: Any) -> None:
    """And node has those of the FMU (test_page_bits)."""
    with Tab(browser, page) as it:
        for state, names, content in runs_of_node:
            columns, rows = it.tab.evaluate(EVERYTHING, state)
            assert columns == names
            assert base64.b64decode(rows) == content


@pytest.mark.slow
def test_fifty_random_settings_have_the_bits_of_node(
    browser: Any, page: Path, node: Any, data: dict[str, Any]
) -> None:
    """Every output of 20 s; node has those of the FMU (test_page_bits)."""
    states = settings(data, 50)
    theirs = [(run["columns"], run["rows"], run["hash"]) for run in node([{"run": s} for s in states])]
    with Tab(browser, page) as it:
        ours = it.tab.evaluate(HASHES, states)
    assert len(theirs) == 50
    assert sum(rows == 2001 for _, rows, _ in theirs) >= 40  # the others collapse
    assert [tuple(run) for run in ours] == theirs


@pytest.mark.slow
def test_what_is_saved_is_what_is_shown(
    browser: Any, page: Path, node: Any, runs_of_node: Any, data: dict[str, Any]
) -> None:
    """CSV: the bits of the exact run; scenario: the TOML that test_page_bits compares; link: the way back."""
    state, names, content = runs_of_node[3]
    with Tab(browser, page) as it:
        it.context.grant_permissions(["clipboard-read", "clipboard-write"])
        it.tab.evaluate("explorer.preset(3)")
        it.settle()
        with it.tab.expect_download() as started:
            it.tab.click("#csv")
        assert started.value.suggested_filename == "two-area-thesis-a-lost-signal.csv"
        head, *lines = Path(started.value.path()).read_text(encoding="utf-8").splitlines()
        assert head.split(",") == ["time_s", *names]
        table = np.array([[float(x) for x in line.split(",")] for line in lines])
        assert table[:, 0] == pytest.approx(np.arange(2001) / 100.0, abs=1e-12)
        assert table[:, 1:].tobytes() == content
        with it.tab.expect_download() as started:
            it.tab.click("#save")
        text = Path(started.value.path()).read_text(encoding="utf-8")
        assert text == node([{"toml": state, "title": "two-area-thesis: A lost signal"}])[0]
        it.tab.click("#link")
        it.tab.wait_for_function("document.getElementById('notice').textContent.includes('link')")
        link = it.tab.evaluate("navigator.clipboard.readText()")
    assert link.startswith(page.as_uri() + "#v=1&")
    back = node([{"link": link.partition("#")[2].join(["#", ""])}])[0]
    assert back["why"] == ""
    assert all(
        data["start"].get(key, value) == value or back["state"][key] == value for key, value in state.items()
    )


@pytest.mark.slow
def test_six_clicks_tell_the_story(browser: Any, page: Path) -> None:
    with Tab(browser, page) as it:
        reported = []
        for k in range(6):
            it.tab.click(f"#presets button:nth-child({k + 1})")
            it.settle()
            reported.append(it.tab.inner_text("#words"))
            assert it.tab.get_attribute(f"#presets button:nth-child({k + 1})", "aria-pressed") == "true"
            assert "all" in it.tab.inner_text("#planenote")
            assert "not all found" not in it.tab.inner_text("#planenote")
        assert [text.split()[0] for text in reported] == [
            "Settled.", "Settled.", "Standing", "Settled.", "Settled.", "Synchronism",
        ]  # fmt: skip
        assert "every eigenvalue is damped" in reported[5]
        assert "without the controller the grid stays in step" in it.tab.inner_text("#numbers")
        it.tab.wait_for_timeout(400)
        link = it.tab.evaluate("location.hash")
        assert "k=ftc" in link
        assert "ev=fault" in link
    with Tab(browser, page, link) as again:
        again.settle()
        assert again.tab.inner_text("#words") == reported[5]


@pytest.mark.slow
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (1280, "dark"), (390, "light")])
def test_accessibility_without_findings(browser: Any, page: Path, width: int, scheme: str) -> None:
    if not REQUIRED:
        pytest.importorskip("axe_playwright_python", reason="axe is not installed (extra `tools`)")
    from axe_playwright_python.sync_playwright import Axe

    with Tab(browser, page, "#v=1&remote.loss=20", width, color_scheme=scheme) as it:
        it.settle()
        violations = Axe().run(it.tab, None, {"resultTypes": ["violations"]}).response["violations"]
        assert [(f["id"], [n["html"][:120] for n in f["nodes"]]) for f in violations] == []
        wide = it.tab.evaluate("document.documentElement.scrollWidth")
        assert wide <= width


@pytest.mark.slow
def test_keyboard_moves_and_restores_a_slider(browser: Any, page: Path) -> None:
    with Tab(browser, page) as it:
        slider = it.tab.locator("#c-remote-latency")
        slider.focus()
        it.tab.keyboard.press("ArrowRight")
        it.settle()
        assert slider.get_attribute("aria-valuetext") == "55 ms"
        it.tab.keyboard.press("Delete")
        it.settle()
        assert slider.get_attribute("aria-valuetext") == "50 ms"
        assert it.tab.get_attribute("#words", "aria-live") == "polite"


@pytest.mark.slow
def test_nonsense_in_the_link_is_said(browser: Any, page: Path) -> None:
    with Tab(browser, page, "#v=1&k=%3Cimg%20src=x%20onerror=alert(1)%3E") as it:
        assert "the page shows its start" in it.tab.inner_text("#notice")
        assert it.tab.evaluate("Object.keys(explorer.state).length") == 0


@pytest.mark.slow
@pytest.mark.parametrize("missing", ["WebAssembly", "DecompressionStream", "Worker"])
def test_an_old_browser_shows_the_prepared_picture(browser: Any, page: Path, missing: str) -> None:
    context = browser.new_context()
    tab = context.new_page()
    said: list[str] = []
    tab.on("console", lambda message: said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.add_init_script(f"delete window.{missing}")
    tab.goto(page.as_uri())
    assert tab.is_visible("#prepared svg")
    assert "was prepared" in tab.inner_text("#whynot")
    assert not tab.is_visible("main")
    assert not said
    context.close()


@pytest.mark.slow
def test_without_scripts_the_picture_stands(browser: Any, page: Path) -> None:
    context = browser.new_context(java_script_enabled=False)
    tab = context.new_page()
    tab.goto(page.as_uri())
    assert tab.is_visible("#prepared svg")
    context.close()


@pytest.mark.slow
def test_ten_thousand_inputs_leave_no_trace(browser: Any, page: Path) -> None:
    drag = """async (count) => {
      const { controls } = explorer.controls;
      const keys = Object.keys(controls).filter((key) => controls[key].min !== undefined);
      let seed = 1;
      const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
      for (let n = 0; n < count; ++n) {
        const control = controls[keys[Math.floor(random() * keys.length)]];
        explorer.change(control.key, control.fromPlace(1000 * random()));
        if (n % 20 === 0) await new Promise((done) => setTimeout(done));
      }
      explorer.preset(1);
      while (explorer.flying > 0 || !explorer.result.exact) await new Promise((done) => setTimeout(done, 50));
      gc();
      return performance.memory.usedJSHeapSize;
    }"""
    with Tab(browser, page) as it:
        before = it.tab.evaluate(drag, 500)
        after = it.tab.evaluate(drag, 10000)
        assert after < 1.2 * before + 1e6
        assert it.tab.evaluate("explorer.waiters.size") <= 1
        assert np.isfinite(it.tab.evaluate("explorer.time"))
