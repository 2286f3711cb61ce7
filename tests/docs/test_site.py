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
REQUIRED = os.environ.get("INTERAREA_REQUIRE_BROWSER") == "1"


@pytest.fixture(scope="session")
def site(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
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
    environment = {**os.environ, "INTERAREA_CACHE": str(cache)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return out / "html"


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


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (1280, "dark"), (390, "light")])
def test_pages_have_no_findings_of_accessibility(site: Path, width: int, scheme: str) -> None:
    if not REQUIRED:
        pytest.importorskip("axe_playwright_python", reason="axe is not installed (extra `tools`)")
        if shutil.which("chromium") is None:
            pytest.skip("chromium is not installed")
    from axe_playwright_python.sync_playwright import Axe
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        tab = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme).new_page()
        said: list[Any] = []
        tab.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
        pages = sorted(p for p in site.rglob("*.html") if "_static" not in p.parts)
        assert len(pages) > 30
        axe, findings = Axe(), {}
        for page in pages:
            tab.goto(page.as_uri())
            wrong = [*said]
            found = axe.run(tab, options={"iframes": False}).response["violations"]
            wrong += [f"{f['id']}: {[n['html'][:160] for n in f['nodes']][:3]}" for f in found]
            if (wide := tab.evaluate("document.documentElement.scrollWidth")) > width:
                wrong.append(f"{wide} px wide")
            if wrong:
                findings[str(page.relative_to(site))] = wrong
            said.clear()  # axe asks for the style sheets again, which a page from disk may not
        browser.close()
    assert findings == {}
