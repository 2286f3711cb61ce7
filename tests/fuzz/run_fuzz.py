"""Fuzz every block kind for as long as asked: `python tests/fuzz/run_fuzz.py --minutes 60 --calls 100000000`.

Ends after that time or that many calls, whichever comes first. Seeds go on where the last command ended: the
file `--seeds` (JSON, kind -> next seed) says where that is. A seed that found something stays next.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
sys.path.extend([str(FOLDER), str(FOLDER.parent)])

from fuzz_blocks import fuzz_block  # noqa: E402
from fuzz_build import build_driver, sanitizing_compiler  # noqa: E402
from test_fuzz import SOURCES  # noqa: E402

ROUND = 1_000_000  #: calls of all kinds between two looks at the clock
#: of the calls
SHARE = {
    "controller": 0.24,
    "supervisor": 0.15,
    "channel": 0.15,
    "concentrator": 0.1,
    "detector": 0.05,
    "pmu": 0.1,
    "plant": 0.3,
    "loop": 0.01,
}


def main() -> int:
    """Return 0 when nothing was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=10_000_000)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--kind", choices=SHARE, action="append", help="default: all")
    parser.add_argument("--seeds", type=Path, help="file of the next seeds; default: all begin at 1")
    chosen = parser.parse_args()
    compiler = sanitizing_compiler()
    if compiler is None:
        print("no compiler here has the runtime of a sanitizer")
        return 2
    print(f"{' '.join(compiler.command)}: {compiler.sanitizers}")
    kinds = chosen.kind or list(SHARE)
    seeds = dict.fromkeys(SHARE, 1)
    if chosen.seeds is not None and chosen.seeds.is_file():
        seeds |= json.loads(chosen.seeds.read_text(encoding="utf-8"))
    total = 0
    with tempfile.TemporaryDirectory() as folder:
        drivers = {
            k: build_driver(fuzz_block(k), SOURCES, compiler, Path(folder) / k, optimised=True) for k in kinds
        }
        end = time.monotonic() + 60.0 * chosen.minutes
        while total < chosen.calls and time.monotonic() < end:
            for kind, driver in drivers.items():
                begin, calls = time.monotonic(), int(SHARE[kind] * min(chosen.calls, ROUND))
                try:
                    said = driver.run(seeds[kind], calls, timeout_s=3600.0).strip()
                except AssertionError as error:
                    print(f"{kind}, seed {seeds[kind]}, {calls} calls: {error}")
                    return 1
                print(f"{kind}, seed {seeds[kind]}: {said}; {time.monotonic() - begin:.0f} s", flush=True)
                seeds[kind], total = seeds[kind] + 1, total + calls
                if chosen.seeds is not None:
                    chosen.seeds.parent.mkdir(parents=True, exist_ok=True)
                    chosen.seeds.write_text(json.dumps(seeds, indent=1), encoding="utf-8")
    print(f"{total} calls: nothing found")
    return 0


if __name__ == "__main__":
    sys.exit(main())
