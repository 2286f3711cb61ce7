"""The page's eigenvalues against the package's: Aberth's iteration on transfer functions there, a spectral
discretisation of the delay equation with Newton's correction here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interarea.cosim.explorer.linear import modal
from interarea.cosim.explorer.subject import subject_of
from interarea.design.delay.characteristic_roots import rightmost_roots
from interarea.design.delay.curves import delayed_loop
from interarea.design.linear.linearise import speeds_in_rad

STATES: list[dict[str, Any]] = [
    {"k": "wdc", "remote.latency": 0, "local.latency": 0},
    {"k": "wdc", "remote.latency": 450, "local.latency": 450},
    {"k": "ftc", "remote.latency": 120, "local.latency": 30, "g": 1.7},
    {"k": "robust", "remote.latency": 250, "local.latency": 10, "op": 1},
    {"k": "two_actuators", "remote.latency": 200, "local.latency": 80, "G1_dw_channel.latency": 60},
]


@pytest.mark.slow
@pytest.mark.parametrize("state", STATES, ids=lambda s: f"{s['k']}-{s['remote.latency']}")
def test_every_root_in_sight_is_that_of_the_delay_equation(
    state: dict[str, Any], node: Any, data: dict[str, Any], cache: Path
) -> None:
    roots = node([{"roots": state}])[0]
    subject = subject_of("two-area-thesis", cache)
    controller = subject.controllers[state["k"]].scaled(state.get("g", 1.0))
    plant = speeds_in_rad(subject.linear(subject.points[state.get("op", 0)]), subject.case.omega_b)
    latency_of = {
        signal: state.get(f"{name}.latency", 50.0 if name in ("remote", "local") else 0.0) / 1000.0
        for name, (signal, _) in subject.channels.items()
        if signal in controller.inputs
    }
    box = roots["box"]
    ours = rightmost_roots(delayed_loop(plant, controller.system, latency_of), right_of=box["left"])
    inside = [z for z in ours if box["low"] < z.imag < box["high"] and box["left"] < z.real < box["right"]]
    theirs = [complex(*root["s"]) for root in roots["roots"]]
    assert roots["proven"]
    assert len(theirs) == len(inside) >= 3
    for z in inside:
        assert min(abs(z - s) for s in theirs) < 1e-8
    # and the winding number knows when one is missing
    assert roots["open"]


def test_they_are_found_again_where_something_moves_them(node: Any, data: dict[str, Any]) -> None:
    state = {"k": "wdc", "remote.latency": 200, "local.latency": 100}
    moved = [{"g": 1.3}, {"remote.latency": 230}, {"remote.lost": 2.0}, {"op": 1}, {"k": "ftc"}]
    jobs = [{"roots": state}, {"roots": state | {"ev": "fault", "tc": 70}}]
    for change in moved:
        jobs += [{"roots": state | change}, {"roots": state}]
    first, same, *others = node(jobs)
    assert same == first
    for other, back in zip(others[::2], others[1::2], strict=True):
        assert other["proven"] and back["proven"]
        assert other["roots"] != first["roots"]
        near = [min(abs(complex(*r["s"]) - complex(*s["s"])) for s in back["roots"]) for r in first["roots"]]
        assert max(near) < 1e-8


def test_without_a_controller_they_are_the_plants(node: Any, data: dict[str, Any], cache: Path) -> None:
    roots = node([{"roots": {"k": "none"}}])[0]
    subject = subject_of("two-area-thesis", cache)
    poles = np.linalg.eigvals(subject.linear(subject.points[0]).A)
    theirs = [complex(*root["s"]) for root in roots["roots"]]
    assert len(theirs) >= 3
    for s in theirs:
        assert np.min(np.abs(poles - s)) < 1e-9
    slow = min(roots["roots"], key=lambda r: abs(r["s"][1] - 3.9))
    shape = np.array([complex(*z) for z in slow["shape"]])
    assert np.max(np.abs(shape)) == pytest.approx(1.0)
    assert np.real(shape[0] * np.conj(shape[2])) < 0.0  # area against area
    assert np.real(shape[0] * np.conj(shape[1])) > 0.0


def test_the_track_ends_where_the_latency_says(node: Any, data: dict[str, Any]) -> None:
    """At half and twice the latency the track, stepped by derivatives, meets roots found from scratch."""
    state = {"k": "wdc", "remote.latency": 200, "local.latency": 100}
    other = {"k": "wdc", "remote.latency": 400, "local.latency": 200}
    track, twice = node([{"track": state}, {"roots": other}])
    ends = [complex(re, im) for re, im, factor in track["paths"] if abs(factor - 2.0) < 1e-9]
    assert len(ends) >= 3
    roots = [complex(*root["s"]) for root in twice["roots"]]
    for end in ends:
        assert min(abs(end - s) for s in roots) < 1e-8


def test_modal_form_is_the_transfer_function(cache: Path) -> None:
    subject = subject_of("two-area-thesis", cache)
    plant = subject.linear(subject.points[0])
    form = modal(plant, ["G4_vs"], ["G2_dw", "tie_p"])
    for s in (0.3 + 2j, -0.5 + 7j, 4.0 + 0j):
        total = np.array(form["d"], dtype=complex)[:, 0]
        for j, (re, im) in enumerate(form["poles"]):
            term = np.array([complex(*row[j]) * complex(*form["b"][0][j]) for row in form["c"]])
            total = total + term / (s - complex(re, im))
            if im > 0:
                total = total + np.conj(term) / (s - complex(re, -im))
        rows = [plant.output_labels.index(name) for name in ("G2_dw", "tie_p")]
        column = plant.input_labels.index("G4_vs")
        direct = plant.C[rows] @ np.linalg.solve(s * np.eye(plant.nstates) - plant.A, plant.B[:, column])
        assert total == pytest.approx(direct + plant.D[rows, column], rel=1e-8)
