"""The site as a reader meets it: built without a warning, every cell run, opened from disk in a browser."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs" / "site"))
import written  # noqa: E402  of the site, no package

REQUIRED = os.environ.get("INTERAREA_REQUIRE_BROWSER") == "1"


@pytest.fixture(scope="session")
def samples(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which the commands have run whose files are examples of the site."""
    folder = tmp_path_factory.mktemp("samples")
    written.write_samples(folder)
    return folder


@pytest.fixture(scope="session")
def site(cache: Path, samples: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the built site; a warning fails."""
    pytest.importorskip("myst_nb", reason="sphinx and myst-nb are not installed (extra `docs`)")
    out = tmp_path_factory.mktemp("site")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-b",
        "html",
        "-W",
        "--keep-going",
        "-q",
        "docs",
        str(out / "html"),
    ]
    environment = {**os.environ, "INTERAREA_CACHE": str(cache), "INTERAREA_DOCS_SAMPLES": str(samples)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return out / "html"


@pytest.mark.slow
def test_every_file_and_key_that_is_written_is_told(samples: Path) -> None:
    for name, folder in written.samples_in(samples).items():
        command = next(c for c in written.WRITTEN["command"] if c["name"] == name)
        files = {str(p.relative_to(folder)): p for p in folder.rglob("*") if p.is_file()}
        assert files
        used: set[str] = set()
        for path, file in files.items():
            entry = written.entry_of(path, command)
            assert entry is not None, f"{name}: {path} is not told"
            if "keys" in entry:
                for key in written.keys_of(file):
                    reported = written.covered_by(key, entry["keys"])
                    assert reported is not None, f"{name}: {path}: {key} is not told"
                    used.add(f"{entry['path']} {reported}")
        documented = {f"{file['path']} {key}" for file in command["file"] for key in file.get("keys", {})}
        assert documented == used, f"{name}: told and not there: {documented - used}"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_site_is_built_and_searchable(site: Path) -> None:
    for name in ("index", "tutorial/tutorial", "eigenvalues", "generated/python", "formats/scenario"):
        assert (site / f"{name}.html").is_file()
    assert "Search.setIndex" in (site / "searchindex.js").read_text(encoding="utf-8")[:100]
    assert "holds what was asked: True" in (site / "tutorial" / "tutorial.html").read_text(encoding="utf-8")
    drawn = (site / "own_device.html").read_text(encoding="utf-8")
    for line in ("poles, inputs held", "slip.toml:6: ledlag", "KA = 200: 0.627 Hz, damping ratio 0.021"):
        assert line in drawn, line
    pages = "".join(p.read_text(encoding="utf-8") for p in site.rglob("*.html"))
    assert 'src="http' not in pages  # works from disk


#: what depends on the width of a page; colours and everything else are looked at in the wide one
OF_THE_WIDTH = [
    *("scrollable-region-focusable", "target-size", "meta-viewport", "aria-hidden-focus", "bypass"),
    *("button-name", "link-name", "label", "skip-link", "nested-interactive", "landmark-one-main"),
]
COLOURS = "color-contrast"
OPTIONS = {"iframes": False, "resultTypes": ["violations"]}  # what passes is counted, not described
#: Marks the elements with text of their own whose look (tags and classes up to the root, own styles, odd or
#: even row) is not among the `known`, and returns these looks: colours follow from them, one of each will do.
MARK_NEW_LOOKS = """known => {
  const seen = new Set(known), fresh = [];
  const name = e => `${e.tagName}.${e.className?.baseVal ?? e.className}[${e.getAttribute("style") ?? ""}]` +
    (e.tagName === "TR" ? [...e.parentNode.children].indexOf(e) % 2 : "");
  const look = e => e === null ? "" : look(e.parentElement) + ">" + name(e);
  for (const e of document.body.querySelectorAll("*")) {
    if (![...e.childNodes].some(n => n.nodeType === Node.TEXT_NODE && n.data.trim())) continue;
    const own = look(e);
    if (seen.has(own)) continue;
    seen.add(own);
    fresh.push(own);
    e.setAttribute("data-new-look", "");
  }
  return fresh;
}"""


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_pages_have_no_findings_of_accessibility(site: Path, tmp_path: Path) -> None:
    """All rules in light, colours again in dark, and some at the width of a phone, in a tab of that width."""
    if not REQUIRED:
        pytest.importorskip("axe_playwright_python", reason="axe is not installed (extra `tools`)")
        if shutil.which("chromium") is None:
            pytest.skip("chromium is not installed")
    from playwright.sync_api import sync_playwright

    pages = sorted(p for p in site.rglob("*.html") if "_static" not in p.parts)
    assert len(pages) > 30
    spoilt = pages[0].with_name("spoilt.html")  # so that a check which sees nothing is seen
    pale = '<p style="color: #aab; background: #fff">pale</p><button></button></article>'
    spoilt.write_text(pages[0].read_text(encoding="utf-8").replace("</article>", pale, 1), encoding="utf-8")
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        said: list[str] = []
        tabs = {}
        for width in (1280, 390):
            context = browser.new_context(
                viewport={"width": width, "height": 900}, color_scheme="light", reduced_motion="reduce"
            )
            tabs[width] = context.new_page()
            tabs[width].on(
                "console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None
            )
        looks: list[str] = []
        result = {str(page.relative_to(site)): findings(tabs, page, said, looks) for page in [*pages, spoilt]}
        browser.close()
    spoils = result.pop("spoilt.html")
    spoilt.unlink()
    for expected in (f"light: {COLOURS}", f"dark: {COLOURS}", "light: button-name", "390 px: button-name"):
        assert any(wrong.startswith(expected) for wrong in spoils), spoils
    assert {page: wrong for page, wrong in result.items() if wrong} == {}


def findings(tabs: dict[int, Any], page: Path, said: list[str], looks: list[str]) -> list[str]:
    """Return what is wrong with a page in light, in dark and at 390 px.

    `tabs`: one for each width; `said`: their console; `looks`: those of the pages before, whose colours are
    known; its own are added.
    """
    from axe_playwright_python.sync_playwright import Axe

    said.clear()
    for tab in tabs.values():
        tab.goto(page.as_uri())
    wrong = [*said]
    fresh = tabs[1280].evaluate(MARK_NEW_LOOKS, looks)
    looks += fresh
    new_looks = "[data-new-look]" if fresh else None
    colours = {"runOnly": {"type": "rule", "values": [COLOURS]}}
    for view, width, scheme, place, rules in (
        ("light", 1280, "light", None, {"rules": {COLOURS: {"enabled": False}}}),
        ("light", 1280, "light", new_looks, colours),
        ("dark", 1280, "dark", new_looks, colours),
        ("390 px", 390, "light", None, {"runOnly": {"type": "rule", "values": OF_THE_WIDTH}}),
    ):
        if rules is colours and not fresh:
            continue
        tab = tabs[width]
        tab.emulate_media(color_scheme=scheme)
        tab.wait_for_function("scheme => document.documentElement.dataset.theme === scheme", arg=scheme)
        violations = Axe().run(tab, place, OPTIONS | rules).response["violations"]
        wrong += [f"{view}: {f['id']}: {[n['html'][:160] for n in f['nodes']][:3]}" for f in violations]
        if (wide := tab.evaluate("document.documentElement.scrollWidth")) > width:
            wrong.append(f"{view}: {wide} px wide")
    return wrong


@pytest.mark.slow
def test_the_search_finds_a_page_from_disk(site: Path) -> None:
    if not REQUIRED:
        pytest.importorskip("playwright", reason="playwright is not installed (extra `tools`)")
        if shutil.which("chromium") is None:
            pytest.skip("chromium is not installed")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        tab = browser.new_page()
        said: list[str] = []
        tab.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
        tab.goto((site / "index.html").as_uri())
        tab.keyboard.press("Control+k")
        tab.keyboard.type("latency margin")
        tab.keyboard.press("Enter")
        tab.wait_for_selector("#search-results li a")
        titles = tab.locator("#search-results li a").all_inner_texts()
        browser.close()
    assert any("certificate" in title for title in titles), titles
    assert said == []
