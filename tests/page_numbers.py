"""The numbers of the pages as the commands that they name give them, in the digits that the pages show."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
NAMES = ("README.md", "docs/controllers.md", "docs/benchmarks.md", "docs/study_page.md")
PAGES = {name: (ROOT / name).read_text(encoding="utf-8") for name in NAMES}
TEXT = " ".join(" ".join(PAGES.values()).split())


def row(page: str, start: str) -> list[str]:
    """Return the cells of the one table row of a page whose first cell begins with `start`."""
    (line,) = [x for x in PAGES[page].splitlines() if x.startswith(f"| {start}")]
    return [cell.strip() for cell in line.strip().strip("|").split(" | ")]


def study_sentences(study: Mapping[str, Any]) -> list[str]:
    """Return what the pages say of `interarea study`, written with the numbers of study.json."""
    inter = study["modes"]["inter-area"]
    lead = {r["coordinates"]: r["lead"] for r in study["loops"]["coordinate_table"]}
    zeta = {
        name: [c["damping_ratio"][k]["inter-area"] for k in ("normal", "remote_lost")]
        for name, c in study["controllers"].items()
    }
    price = study["controllers"]["wdc"]["reduction_price"]
    shared = study["methods"]["inter_area_roots"]["wdc"]["normal"][1][1]
    delay = {kind: study["delay"][kind] for kind in ("synchronous", "non_synchronous")}
    late = next(
        r
        for r in delay["synchronous"]["redesigned"]
        if (r["latency_s"], r["on"], r["order"]) == (0.2, "both", 8)
    )
    half = next(z for at, z in delay["non_synchronous"]["damping"] if at == 0.5)
    fault = {
        (r["ceiling"], r["controller"], r["signals"]): r
        for r in study["survival"]["rows"]
        if r["point"] == "tie +100 MW"
    }
    alone, ceiled = (fault[c, "none", "nothing lost"]["largest_angle_rad"] * 57.29578 for c in ("none", "±5"))
    ftc = fault["none", "ftc", "nothing lost"]
    wdc, cc = (fault["none", name, "remote lost"] for name in ("wdc", "cc"))
    assert not ftc["synchronism"] and not wdc["synchronism"] and not cc["synchronism"]
    assert cc["critical_cycles"] == 0.0
    critical = {(r["controller"], r["on_loss"]): r["critical_loss"] for r in study["packets"]["mean_square"]}
    assert all(critical[name, "zero"] == 1.0 for name in ("wdc", "cc", "ftc"))
    return [
        f"{inter['frequency_hz']:.4f} Hz, {inter['damping_ratio']:.4f} | `modes`",
        f"ahead of dw14 by {100 * lead['pole vectors (free of coordinates)']:.1f} %",
        f"{zeta['wdc'][0]:.3f} (sector 0.28), and {shared:.3f} of a root",
        f"raises the weighted norm from {price['norm'][0]:.3f} to {price['norm'][1]:.3f}, the effort from "
        f"{price['effort'][0]:.3f} to {price['effort'][1]:.3f}",
        f"{zeta['cc'][0]:.3f} / {zeta['cc'][1]:.3f}, linear loop stable | `controllers.cc`",
        f"{zeta['ftc'][0]:.3f} / {zeta['ftc'][1]:.3f}, linear loop stable | `controllers.ftc`",
        f"{delay['synchronous']['margin_s']:.3f} s exact; co-simulated 5 % below decays, 5 % above grows",
        f"200 ms {late['least_damping']:.3f} instead of {late['least_damping_without']:.3f}, for "
        f"{late['least_damping_undelayed']:.3f} without delay and {late['least_damping_remote_lost']:.3f}",
        f"damped up to 0.5 s ({half:.2f})",
        f"({alone:.0f}° between machines at most, {ceiled:.0f}° with exciter ceilings of ±5 pu)",
        f"stable up to {ftc['critical_cycles']:.1f} cycles instead of "
        f"{fault['none', 'none', 'nothing lost']['critical_cycles']:.1f}",
        f"stable up to {wdc['critical_cycles']:.1f} cycles, and not even for 1",
        f"Holding the last value destabilises them from {100 * critical['cc', 'hold']:.0f} % (CC) and "
        f"{100 * critical['ftc', 'hold']:.0f} % (FTC)",
    ]


def missing(sentences: list[str]) -> list[str]:
    """Return those of the sentences that no page has."""
    return [sentence for sentence in sentences if " ".join(sentence.split()) not in TEXT]


def sections(page: str) -> dict[str, str]:
    """Return title -> text of a page's sections."""
    parts = re.split(r"^## (.+)\n", PAGES[page], flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))
