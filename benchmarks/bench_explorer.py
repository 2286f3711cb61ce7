"""How large a page of `interarea explore` is, how soon it shows something, how often it redraws when dragged.

    python benchmarks/bench_explorer.py [--case NAME ...] [--chromium PATH]

Headless Chromium through Playwright (extra `tools`); on an idle machine. Redraws: a slider (latency, a
fault's clearing time) moves on every frame for 6 s; the median of three such runs. Beside it, whatever else
the machine does: the processor time that one redraw takes of the page's thread and of the worker's (Linux).
Exit code 1 if a page misses what is wanted of it.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from interarea.cosim.explorer.page import write_explorer
from interarea.fmu_build.write.cache import default_cache

ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
#: case -> largest page in kB, redraws a second
LIMITS = {"two-area-thesis": (250, 30), "new-england": (900, 10), "nets-nyps": (900, 4)}
AT_LIMITS = 20  #: redraws a second of two areas with field limits
#: preset -> slider that moves and between what, where not the latency; half of these faults are survived
MOVED = {"Left alone": ("sz", [-20, 20]), "The fault": ("tc", [50, 500])}

DRAG = """async ([key, low, high, ms]) => {
  const page = window.explorer, began = performance.now();
  let frames = 0, curve = page.frames || 0;
  await new Promise((resolve) => {
    const step = (now) => {
      const share = 0.5 + 0.5 * Math.sin(frames++ / 15);
      page.change(key, Math.round(low + share * (high - low)));
      if (now - began > ms) resolve(); else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  });
  return [(page.frames - curve) / ((performance.now() - began) / 1000), page.result.ms];
}"""


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    arguments.add_argument("--case", action="append")
    arguments.add_argument("--chromium", default=shutil.which("chromium"))
    arguments.add_argument("--seconds", type=float, default=6.0)
    chosen = arguments.parse_args()
    from playwright.sync_api import sync_playwright

    missed = 0
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chosen.chromium, args=ARGUMENTS)
        for case in chosen.case or LIMITS:
            path = write_explorer(case, Path(folder) / f"{case}.html", cache=default_cache())
            kilobytes, limits = path.stat().st_size / 1000, LIMITS.get(case, (900, 4))
            print(f"{case}: {kilobytes:.0f} kB (wanted <= {limits[0]})")
            missed += kilobytes > limits[0]
            missed += not measure(browser, path, limits[1], chosen.seconds)
        browser.close()
    return 1 if missed else 0


def measure(browser: Any, path: Path, limit: float, seconds: float) -> bool:
    """Print what one page does; return whether it is as wanted."""
    firsts = []
    for _ in range(3):
        page = browser.new_page(viewport={"width": 1280, "height": 1000}, reduced_motion="reduce")
        began = time.perf_counter()
        page.goto(path.as_uri())
        page.wait_for_function("window.explorer && window.explorer.frames > 0", polling=10)
        firsts.append(time.perf_counter() - began)
        page.close()
    print(f"  first curves after navigation: {statistics.median(firsts):.2f} s")
    page = browser.new_page(viewport={"width": 1280, "height": 1000}, reduced_motion="reduce")
    page.goto(path.as_uri())
    page.wait_for_function("window.explorer && window.explorer.frames > 0")
    key = page.evaluate("explorer.data.channels.length ? explorer.data.channels[0].name + '.latency' : 'sz'")
    span = [0, 600] if key != "sz" else [-20, 20]
    names = page.evaluate("explorer.data.presets.map((p) => p.label)")
    good = True
    threads = renderer_threads()
    for label in names:
        if label not in ("The wide-area loop", "A lost signal", "The fault", "Left alone"):
            continue
        which, reach = MOVED.get(label, (key, span))
        rates, spent = [], {}
        for _ in range(3):
            page.evaluate("(k) => explorer.preset(k)", names.index(label))
            page.wait_for_timeout(1500)
            before, frames = cpu_seconds(threads()), page.evaluate("explorer.frames")
            rates.append(page.evaluate(DRAG, [which, *reach, 1000 * seconds]))
            drawn = page.evaluate("explorer.frames") - frames
            spent = {n: 1000 * (t - before.get(n, 0.0)) / drawn for n, t in cpu_seconds(threads()).items()}
        rate = statistics.median(r for r, _ in rates)
        need = AT_LIMITS if label == "The fault" and limit >= AT_LIMITS else limit
        print(
            f"  {label}: {rate:.1f} redraws a second (wanted >= {need}), run {rates[-1][1]:.0f} ms; "
            + ", ".join(f"{n} {t:.1f} ms" for n, t in sorted(spent.items()) if t > 0.2)
            + " of processor time each"
        )
        good = good and rate >= need
    page.close()
    return good


def renderer_threads() -> Callable[[], list[Path]]:
    """Return a function that lists the threads (`/proc/PID/task/TID`) of this process' renderers."""

    def below(pid: int) -> list[int]:
        processes = [pid]
        for stat in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):
                fields = stat.read_text().rpartition(")")[2].split()
                if int(fields[1]) == pid:
                    processes += below(int(stat.parent.name))
        return processes

    processes = [
        pid for pid in below(os.getpid()) if b"--type=renderer" in _read(Path(f"/proc/{pid}/cmdline"))
    ]
    return lambda: [t for pid in processes for t in Path(f"/proc/{pid}/task").glob("*")]


def cpu_seconds(threads: list[Path]) -> dict[str, float]:
    """Return processor seconds by the name of the thread."""
    spent: dict[str, float] = {}
    for thread in threads:
        name = _read(thread / "comm").decode().strip()
        fields = _read(thread / "stat").rpartition(b")")[2].split()
        if len(fields) > 12:
            spent[name] = spent.get(name, 0.0) + (int(fields[11]) + int(fields[12])) / os.sysconf(
                "SC_CLK_TCK"
            )
    return spent


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        return b""


if __name__ == "__main__":
    sys.exit(main())
