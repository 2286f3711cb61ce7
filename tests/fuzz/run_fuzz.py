"""Fuzz every block kind for as long as asked: `python tests/fuzz/run_fuzz.py --calls 10000000`."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from fuzz_blocks import fuzz_block  # noqa: E402
from fuzz_build import build_driver, sanitizing_compiler  # noqa: E402
from test_fuzz import SOURCES  # noqa: E402

#: of the calls
SHARE = {
    "controller": 0.24,
    "supervisor": 0.15,
    "channel": 0.15,
    "concentrator": 0.15,
    "plant": 0.3,
    "loop": 0.01,
}


def main() -> int:
    """Return 0 when nothing was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    compiler = sanitizing_compiler()
    if compiler is None:
        print("no compiler here has the runtime of a sanitizer")
        return 2
    print(f"{' '.join(compiler.command)}: {compiler.sanitizers}")
    with tempfile.TemporaryDirectory() as folder:
        for kind, share in SHARE.items():
            driver = build_driver(fuzz_block(kind), SOURCES, compiler, Path(folder) / kind)
            left, seed = int(share * chosen.calls), chosen.seed
            while left > 0:
                begin = time.monotonic()
                calls = min(left, 500_000)
                try:
                    said = driver.run(seed, calls, timeout_s=3600.0).strip()
                except AssertionError as error:
                    print(f"{kind}, seed {seed}: {error}")
                    return 1
                print(f"{kind}, seed {seed}: {said}; {time.monotonic() - begin:.0f} s", flush=True)
                left, seed = left - calls, seed + 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
