"""README: its cheap numbers come out again digit for digit, and all of them name what gives them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from readme_numbers import README, TEXT, row, sections

from interarea.cli.app import COMMANDS
from interarea.cosim.run.artefacts import linear_plant
from interarea.design.linear.linearise import remove_reference
from interarea.design.modes.loop_selection import lead_by_coordinates, rank_loops
from interarea.design.modes.modes import modes_of
from interarea.models.case.case import Case

ROOT = Path(__file__).resolve().parents[2]


def test_inter_area_mode_and_lead_of_the_best_loop(two_area: Case, cache: Path) -> None:
    relative = remove_reference(linear_plant(two_area, cache))
    modes = modes_of(relative, two_area.areas)
    inter = modes.inter_area
    shown = f"{inter.frequency_hz:.4f} Hz, {inter.damping_ratio:.4f}"
    assert row("inter-area mode, no wide-area loop")[1:3] == [shown, shown]  # fitted: the printed digits too
    loops = rank_loops(relative, inter, areas=two_area.areas)
    table = lead_by_coordinates(relative, loops, inter.eigenvalue)
    lead = next(r["lead"] for r in table if r["coordinates"].startswith("pole vectors"))
    assert f"(ahead of dw14 by {100 * lead:.1f} %)" in row("best loop")[2]
    assert all(r["lead"] < 0.0 for r in table if r["coordinates"].startswith("balanced"))


@pytest.mark.parametrize("name", ["robust", "robust_linear", "robust_latency", "two_actuators"])
def test_table_of_bundled_controllers(name: str) -> None:
    """What `interarea certify` holds each to is its record; tests/unit/design/robust recomputes it."""
    held = json.loads((ROOT / "design" / "controllers" / f"{name}.json").read_text(encoding="utf-8"))
    record = held["certificate"]
    fastest = np.max(np.abs(np.linalg.eigvals(np.array(held["A"]))))
    cells = row(f"`{name}`")
    assert cells[1:5] == [
        *(f"{record[key]:.3f}" for key in ("worst_swing", "inter_area", "effort")),
        f"{fastest:.0f} rad/s",
    ]
    lost = [run["point"] for run in record["faults"] if not run["synchronism"]]
    assert lost == (["tie +100"] if name == "robust_linear" else [])
    if not lost:
        assert f"within {max(run['settled_s'] for run in record['faults']):.1f} s" in cells[5]


def test_acceptance_of_the_guarded_controllers() -> None:
    told = {
        "robust": "{lost} of {cases} lost, clearing times {mean:.1f} cycles longer on average and "
        "{worst:.1f} shorter at worst",
        "robust_latency": "{lost} of {cases} lost and {gained} gained that the grid alone does not survive, "
        "{mean:.1f} longer, {worst:.1f} shorter at worst",
        "two_actuators": "{lost} of {cases} lost and {gained} gained, {mean:.1f} longer, "
        "{worst:.1f} shorter at worst",
    }
    for name, text in told.items():
        held = json.loads((ROOT / "design" / "controllers" / f"{name}.json").read_text(encoding="utf-8"))
        found = held["certificate"]["acceptance"]
        both = [(r["without"], r["with_control"]) for r in found["clearing"]]
        change = [b - a for a, b in both if a is not None and b is not None]
        said = text.format(
            lost=len(found["lost"]),
            gained=len(found["gained"]),
            cases=found["cases"],
            mean=np.mean(change),
            worst=abs(min(*change, 0.0)),
        )
        assert said in TEXT, said


def test_delay_table_is_that_of_the_page_which_a_command_writes() -> None:
    page = (ROOT / "docs" / "delay_error.md").read_text(encoding="utf-8")
    head, *lines = page.partition("<!-- synchronous -->")[2].partition("<!-- end")[0].strip().splitlines()
    steps = [cell.strip() for cell in head.strip("|").split("|")]
    rows = {
        cells[0]: dict(zip(steps, cells, strict=True))
        for cells in ([c.strip() for c in line.strip("|").split("|")] for line in lines[1:])
    }
    for step in ("20 ms", "10 ms", "5 ms"):
        ours = [rows[way][f"H = {step}"] for way in ("held, Jacobi", "straight lines", "cubic Hermite")]
        assert row(step)[1:4] == [re.sub(r"e-0", "e-", text) for text in ours]


def test_every_section_with_numbers_names_its_commands_and_they_exist() -> None:
    named = re.compile(
        r"`(?:python )?"
        r"(interarea [a-z]+|make [a-z]+|benchmarks/[\w/]+\.py|pytest [\w/.]+|docs/\w+\.(?:py|md))"
    )
    for title, text in sections().items():
        found = named.findall(text) + re.findall(r"\((docs/[\w/]+\.md)\)", text)
        if title not in ("Limits", "Cite", "Start"):
            assert found or not re.search(r"\d\.\d", text), title
    for command in named.findall(README):
        kind, _, what = command.partition(" ")
        if kind == "interarea":
            assert what in COMMANDS, command
        elif kind == "make":
            assert re.search(rf"^{what}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE), (
                command
            )
        else:
            assert (ROOT / (what or kind)).exists(), command
