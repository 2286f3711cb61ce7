"""README's figure: dw24 after a bus-8 fault and the trip of one circuit, from the study's own results.

Run `make study`, then `python docs/ring_down.py`; it reads out/thesis/results and writes docs/ring-down.svg.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd

from interarea.cosim.plots.curves import difference_label, save_figure, time_plot

CURVES = {
    "no wide-area control": "none-fault",
    "WDC": "wdc-fault",
    "CC, remote lost at 1.5 s": "cc-fault-lost",
    "FTC, remote lost at 1.5 s": "ftc-fault-lost",
}


def main(results: Path, target: Path) -> None:
    """Draw the four runs of `results` into `target`."""
    curves = {}
    for label, name in CURVES.items():
        data = pd.read_parquet(results / f"{name}.parquet")
        curves[label] = (
            data["time_s"].to_numpy(),
            (data["plant.G2_dw"] - data["plant.G4_dw"]).to_numpy(),
        )
    save_figure(time_plot(curves, ylabel=difference_label("dw24"), marks={"signal lost": 1.5}), target)


if __name__ == "__main__":
    folder = Path(__file__).resolve().parent
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", nargs="?", type=Path, default=Path("out/thesis/results"))
    main(parser.parse_args().results, folder / "ring-down.svg")
