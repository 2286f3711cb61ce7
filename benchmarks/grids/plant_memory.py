"""What making and opening the plant of a large grid takes of memory, beside what is estimated beforehand.

    python benchmarks/grids/plant_memory.py FILE.m ..

Grids of MATPOWER with devices by the rule of `ruled_grid`, each in a process of its own: the largest memory
of the process when the FMU is made (the binary is compiled by another one) and when it is open and started.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from ruled_grid import ruled_grid

from interarea.cosim.run.artefacts import plant_fmu
from interarea.fmu_build.open.plant import open_plant
from interarea.fmu_build.write.cache import default_cache
from interarea.models.blocks.plant_shown import shows_powers
from interarea.models.grid.memory import MIB, build_bytes, run_bytes


def peak_mib() -> float:
    """Return the largest memory that this process has had, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def built(path: Path, folder: Path) -> str:
    """Make the plant of a grid; return the line that says what it took."""
    case = ruled_grid(path)
    plant_fmu(case, folder)
    needed_mib = build_bytes(case, powers=shows_powers(case)) / MIB
    return f"{path.stem}: {len(case.buses)} buses, made {peak_mib():.0f} MiB, estimated {needed_mib:.0f} MiB"


def opened(path: Path, folder: Path) -> str:
    """Open the plant made before; return the line that says what it took."""
    case = ruled_grid(path)
    with open_plant(plant_fmu(case, folder)):
        needed_mib = run_bytes(case, powers=shows_powers(case)) / MIB
        return (
            f"{path.stem}: {len(case.buses)} buses, open {peak_mib():.0f} MiB, estimated {needed_mib:.0f} MiB"
        )


def main() -> None:
    """Print two lines for each grid."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("grids", type=Path, nargs="+", metavar="FILE.m")
    start = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory(dir=default_cache()) as folder:
        for path in parser.parse_args().grids:
            for measure in (built, opened):
                with start.Pool(1) as pool:
                    print(pool.apply(measure, (path, Path(folder))), flush=True)


if __name__ == "__main__":
    main()
