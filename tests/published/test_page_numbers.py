"""The pages: their cheap numbers come out again digit for digit, and all of them name what gives them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_numbers import NAMES, PAGES, row, sections

from interarea.cli.app import COMMANDS
from interarea.cosim.run.artefacts import linear_plant
from interarea.design.linear.linearise import remove_reference
from interarea.design.modes.loop_selection import lead_by_coordinates, rank_loops
from interarea.design.modes.modes import modes_of
from interarea.models.case.case import Case

ROOT = Path(__file__).resolve().parents[2]
CONTROLLERS, STUDY = "docs/controllers.md", "docs/study_page.md"


def controller(name: str) -> dict[str, Any]:
    """Return the file of a bundled controller."""
    text = (ROOT / "design" / "controllers" / f"{name}.json").read_text(encoding="utf-8")
    return dict(json.loads(text))


def test_inter_area_mode_and_lead_of_the_best_loop(two_area: Case, cache: Path) -> None:
    relative = remove_reference(linear_plant(two_area, cache))
    modes = modes_of(relative, two_area.areas)
    inter = modes.inter_area
    shown = f"{inter.frequency_hz:.4f} Hz, {inter.damping_ratio:.4f}"
    cells = row(STUDY, "inter-area mode, no wide-area loop")
    assert cells[1:3] == [shown, shown]  # fitted: the printed digits too
    loops = rank_loops(relative, inter, areas=two_area.areas)
    table = lead_by_coordinates(relative, loops, inter.eigenvalue)
    lead = next(r["lead"] for r in table if r["coordinates"].startswith("pole vectors"))
    assert f"(ahead of dw14 by {100 * lead:.1f} %)" in row(STUDY, "best loop")[2]
    assert all(r["lead"] < 0.0 for r in table if r["coordinates"].startswith("balanced"))


@pytest.mark.parametrize("name", ["robust", "robust_linear", "robust_latency", "wide_area", "two_actuators"])
def test_table_of_bundled_controllers(name: str) -> None:
    """What `interarea certify` holds each to is its record; tests/unit/design/robust recomputes it."""
    record = controller(name)["certificate"]
    fastest = np.max(np.abs(np.linalg.eigvals(np.array(controller(name)["A"]))))
    (line,) = [x for x in PAGES[CONTROLLERS].splitlines() if x.startswith(f"| `{name}`") and "rad/s" in x]
    cells = [cell.strip() for cell in line.strip("|").split(" | ")]
    assert cells[1:5] == [
        *(f"{record[key]:.3f}" for key in ("worst_swing", "inter_area", "effort")),
        f"{fastest:.0f} rad/s",
    ]
    lost = [run["point"] for run in record["faults"] if not run["synchronism"]]
    assert lost == (["tie +100"] if name == "robust_linear" else [])
    if not lost:
        assert f"within {max(run['settled_s'] for run in record['faults']):.1f} s" in cells[5]


@pytest.mark.parametrize("name", ["robust", "robust_latency", "wide_area", "two_actuators"])
def test_acceptance_of_the_guarded_controllers(name: str) -> None:
    record = controller(name)["certificate"]
    acceptance = record["acceptance"]
    times = [(r["without"], r["with_control"]) for r in acceptance["clearing"]]
    change = [b - a for a, b in times if a is not None and b is not None]
    (line,) = [x for x in PAGES[CONTROLLERS].splitlines() if x.startswith(f"| `{name}`") and "cycles" in x]
    assert [cell.strip() for cell in line.strip("|").split(" | ")][2:] == [
        *(str(k) for k in (acceptance["cases"], len(acceptance["lost"]), len(acceptance["gained"]))),
        f"{np.mean(change):+.1f} cycles",
        f"{min(*change, 0.0):+.1f} cycles",
    ]


def test_the_front_page_repeats_the_record_of_the_default_controller() -> None:
    record = controller("wide_area")["certificate"]
    assert row("README.md", "least damping ratio of the default")[1] == f"{record['worst_swing']:.3f}"
    assert row("README.md", f"faults, of {record['acceptance']['cases']},")[1] == str(
        len(record["acceptance"]["lost"])
    )


@pytest.mark.parametrize(
    ("page", "start"),
    [("README.md", "The remote signal of the default"), (CONTROLLERS, "The default is `wide_area`.")],
)
def test_what_the_remote_signal_adds_is_stated(page: str, start: str) -> None:
    worth = controller("wide_area")["certificate"]["worth"]
    whole, rival = worth["whole"], worth["rival"]
    cycles = whole["clearing_cycles"] - rival["clearing_cycles"]
    stated = " ".join(PAGES[page].split()).partition(start)[2].partition(" cycles")[0]
    assert re.findall(r"\d\.\d+", stated) == [f"{cycles:.1f}"]
    both = [f"{side['inter_area']:.3f}" for side in (whole, rival)]
    assert f"{both[0]} against {both[1]}" in " ".join(PAGES[CONTROLLERS].split())
    changes = [f"{side['clearing_cycles']:.1f}" for side in (whole, rival)]
    assert row("README.md", "with its remote signal")[1] == (
        f"{', '.join(both)}; {', '.join(changes)} cycles"
    )


def test_the_error_of_the_delay_is_that_of_the_page_which_a_command_writes() -> None:
    page = (ROOT / "docs" / "delay_error.md").read_text(encoding="utf-8")
    head, *lines = page.partition("<!-- synchronous -->")[2].partition("<!-- end")[0].strip().splitlines()
    steps = [cell.strip() for cell in head.strip("|").split("|")]
    rows = {
        cells[0]: dict(zip(steps, cells, strict=True))
        for cells in ([c.strip() for c in line.strip("|").split("|")] for line in lines[1:])
    }
    cubic, held = (
        re.sub(r"e-0", "e-", rows[name]["H = 10 ms"]) for name in ("cubic Hermite", "held, Jacobi")
    )
    stated = row("README.md", "a co-simulated loop")[1]
    assert stated == f"{cubic} of the peak ({held} with held inputs)"


@pytest.mark.parametrize("page", NAMES)
def test_every_section_with_numbers_names_its_commands_and_they_exist(page: str) -> None:
    named = re.compile(
        r"`(?:python )?"
        r"(interarea [a-z]+|make [a-z]+|benchmarks/[\w/]+\.py|pytest [\w/.]+|docs/\w+\.(?:py|md))"
    )
    for title, text in sections(page).items():
        commands = named.findall(text) + re.findall(r"\((?:docs/)?[\w/]+\.md\)", text)
        if title != "Cite":
            plain = re.sub(r"```python\n.*?```", "", text, flags=re.DOTALL)
            assert commands or not re.search(r"\d\.\d", plain), title
    for command in named.findall(PAGES[page]):
        kind, _, what = command.partition(" ")
        if kind == "interarea":
            assert what in COMMANDS, command
        elif kind == "make":
            makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
            assert re.search(rf"^{what}:|^test-fast {what}", makefile, re.MULTILINE), command
        else:
            assert (ROOT / (what or kind)).exists(), command


def test_the_front_page_is_short() -> None:
    assert PAGES["README.md"].count("\n") <= 120
    assert len(PAGES["README.md"].split()) <= 900


def test_a_release_takes_at_most_sixty_lines_of_the_changelog() -> None:
    parts = re.split(r"^## (.+)\n", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert len(parts) > 4
    for title, text in zip(parts[1::2], parts[2::2], strict=True):
        assert text.count("\n") <= 60, title
