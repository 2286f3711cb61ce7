"""How far a delayed closed loop is from its delay differential equation, over the step, input by input.

The plant of `two-area-thesis` (linearised, all states) and a controller of two lags are FMUs, G2_dw goes
through a channel of 100 ms, G4_dw through another (synchronous) or directly (non-synchronous); a pulse of
0.2 s acts on G1's voltage reference. The reference is the delay differential equation itself, solved by
collocation at Chebyshev points on panels of 2.5 ms: nothing of the master, the channels or the FMUs is in
it, and all jumps lie on panel ends.

    python docs/delay_error.py

writes docs/delay-error.svg and the tables of docs/delay_error.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import control
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from scipy.linalg import lu_factor, lu_solve

from interarea.cosim.master.instances import FmuParticipant
from interarea.cosim.plots.curves import DASHES, SERIES, new_figure, save_figure
from interarea.cosim.run.artefacts import linear_plant
from interarea.cosim.run.controllers import design_controller
from interarea.cosim.run.system import System
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.cache import default_cache
from interarea.fmu_build.write.package import block_fmu
from interarea.models.blocks.controller import controller_block
from interarea.models.case.case import load_case

Array = npt.NDArray[np.float64]
CASE, LATENCY_S, STOP_S = "two-area-thesis", 0.1, 10.0
PULSE, PULSE_S = 1e-3, (1.0, 1.2)  # pu: so small that no limit of the controller is near
STEPS_S = (0.04, 0.02, 0.01, 0.005, 0.0025)
INPUTS = {
    "hold-jacobi": "held, Jacobi",
    "hold-gauss-seidel": "held, Gauss-Seidel",
    "linear": "straight lines",
    "hermite": "cubic Hermite",
}
_PANEL_S, _POINTS = 0.0025, 14
FOLDER = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Loop:
    """x' = A x + b push + E y(t - latency), y = C x; rows of C: G2_dw, G4_dw."""

    A: Array
    b: Array
    E: Array
    C: Array


def two_lags() -> Controller:
    """Return a controller of two lags, 1/6 and 1/20 s, on the difference of the speeds."""
    A, B = np.array([[-6.0, 0.0], [6.0, -20.0]]), np.array([[6.0, -6.0], [0.0, 0.0]])
    K = control.ss(A, B, [[0.0, 0.05]], np.zeros((1, 2)), inputs=["G2_dw", "G4_dw"], outputs=["G4_vs"])
    return Controller("two_lags", K)


def loop_of(controller: Controller, synchronous: bool) -> Loop:
    """Return the closed loop of linear plant and controller; the local signal is delayed when synchronous."""
    case = load_case(CASE)
    G, K = linear_plant(case, default_cache()), controller.system
    inputs, outputs = G.input_labels, G.output_labels
    n, m = G.nstates, K.nstates
    A, E = np.zeros((n + m, n + m)), np.zeros((n + m, 2))
    C = np.zeros((2, n + m))
    C[:, :n] = G.C[[outputs.index(s) for s in ("G2_dw", "G4_dw")]]
    A[:n, :n], A[n:, n:] = G.A, K.A
    A[:n, n:] = np.outer(G.B[:, inputs.index("G4_vs")], K.C[0])
    late = case.omega_b * K.B[:, [K.input_labels.index(s) for s in ("G2_dw", "G4_dw")]]
    E[n:] = late
    if not synchronous:
        A[n:] += np.outer(late[:, 1], C[1])
        E[:, 1] = 0.0
    b = np.concatenate([G.B[:, inputs.index("G1_vs")], np.zeros(m)])
    return Loop(A, b, E, C)


def solve_dde(loop: Loop, points: int = _POINTS) -> Array:
    """Return y at the ends of all panels, (panels + 1, 2), from rest."""
    nodes = 0.5 * (1.0 - np.cos(np.pi * np.arange(points + 1) / points))  # 0 to 1
    D = _derivative(nodes) / _PANEL_S
    n, late = len(loop.A), round(LATENCY_S / _PANEL_S)
    solver = lu_factor(np.kron(D[1:, 1:], np.eye(n)) - np.kron(np.eye(points), loop.A))
    x, history = np.zeros(n), [np.zeros((points, 2))] * late
    ends = [loop.C @ x]
    for k in range(round(STOP_S / _PANEL_S)):
        pushed = PULSE if PULSE_S[0] <= (k + 0.5) * _PANEL_S < PULSE_S[1] else 0.0
        force = history[k] @ loop.E.T + pushed * loop.b + loop.A @ x
        inside = x + lu_solve(solver, force.ravel()).reshape(points, n)  # what is solved for is the change
        history.append(inside @ loop.C.T)
        x = inside[-1]
        ends.append(loop.C @ x)
    return np.array(ends)


def _derivative(nodes: Array) -> Array:
    """Return the matrix that takes values at `nodes` to slopes there (barycentric weights)."""
    gaps = nodes[:, None] - nodes[None, :] + np.eye(len(nodes))
    weights = 1.0 / np.prod(gaps, axis=1)
    D = weights[None, :] / weights[:, None] / gaps
    np.fill_diagonal(D, 0.0)
    return D - np.diag(D.sum(axis=1))


def run_fmus(controller: Controller, synchronous: bool, inputs: str, step_s: float) -> tuple[Array, Array]:
    """Return times and dw24 of the co-simulated loop of FMUs."""
    case, store = load_case(CASE), default_cache()
    G = linear_plant(case, store)
    rows = [G.output_labels.index(s) for s in ("G2_dw", "G4_dw")]
    columns = [G.input_labels.index(s) for s in ("G1_vs", "G4_vs")]
    block = controller_block(
        "linear_plant", G.A, G.B[:, columns], G.C[rows], np.zeros((2, 2)),
        ["G1_vs", "G4_vs"], ["G2_dw", "G4_dw"], limit=1e3,
    )  # fmt: skip
    fine = 0.00025  # the FMUs' own Runge-Kutta steps: far below what is measured here
    files = {"plant": block_fmu(replace(block, internal_step_s=fine), store)}
    own = controller.block(case.omega_b)
    files["controller"] = block_fmu(replace(own, internal_step_s=fine), store)
    system = System(stop_s=STOP_S, step_s=step_s, inputs=inputs, tolerance=1e-10)
    for name, file in files.items():
        system.fmu(name, file)
    # a channel that always sends PULSE and is out of service but for the pulse
    outages_s = [(0.0, PULSE_S[0]), (PULSE_S[1], 2.0 * STOP_S)]
    system.channel("pulse", outages_s=outages_s, on_loss="zero")
    system.connect("pulse", "plant.G1_vs").connect("controller.G4_vs", "plant.G4_vs")
    system.channel("remote", latency_s=LATENCY_S).connect("plant.G2_dw", "remote", "controller.G2_dw")
    if synchronous:
        system.channel("local", latency_s=LATENCY_S).connect("plant.G4_dw", "local", "controller.G4_dw")
    else:
        system.connect("plant.G4_dw", "controller.G4_dw")
    parts = {name: system.participant(name) for name in system.instances}
    source = parts["pulse"]
    assert isinstance(source, FmuParticipant)
    source.set_start({**system.channels["pulse"].parameters("pulse"), "u": PULSE})
    steps = tuple(replace(p, discrete=True) for p in source.description.outputs)
    source.description = replace(source.description, outputs=steps)  # held between its jumps by every master
    with system.master(parts.values()) as master:
        run = master.run()
    return run["time_s"], run["plant.G2_dw"] - run["plant.G4_dw"]


def errors(
    controller: Controller,
    synchronous: bool,
    inputs: Iterable[str] = tuple(INPUTS),
    steps_s: Iterable[float] = STEPS_S,
) -> dict[str, list[float]]:
    """Return, for each way to hand inputs over, the largest dw24 error over the peak at each step."""
    y = solve_dde(loop_of(controller, synchronous))
    exact = y[:, 0] - y[:, 1]
    peak = np.max(np.abs(exact))
    measured: dict[str, list[float]] = {}
    for interpolated in inputs:
        measured[interpolated] = []
        for step_s in steps_s:
            times, dw24 = run_fmus(controller, synchronous, interpolated, step_s)
            grid = np.round(times / _PANEL_S).astype(int)
            if not np.max(np.abs(grid * _PANEL_S - times)) < 1e-12:
                raise ValueError(f"H = {step_s:g} s is no multiple of {_PANEL_S:g} s")
            measured[interpolated].append(float(np.max(np.abs(dw24 - exact[grid])) / peak))
    return measured


def table(measured: dict[str, list[float]], title: str = "inputs") -> str:
    """Return a Markdown table of `errors`, with the order between 20 and 5 ms."""
    head = [title, *(f"H = {1e3 * h:g} ms" for h in STEPS_S), "order, 20 to 5 ms"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    first, last = STEPS_S.index(0.02), STEPS_S.index(0.005)
    for name, row in measured.items():
        order = np.log(row[first] / row[last]) / np.log(STEPS_S[first] / STEPS_S[last])
        cells = [INPUTS.get(name, name), *(f"{e:.1e}" for e in row), f"{order:.1f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def figure_of(measured: dict[bool, dict[str, list[float]]]) -> Figure:
    """Draw the errors over the step, synchronous and not."""
    figure, axes = new_figure(1, 2, height=3.0, sharey=True)
    for ax, (synchronous, rows) in zip(axes, measured.items(), strict=True):
        for k, (inputs, row) in enumerate(rows.items()):
            style = {"color": SERIES[k], "linestyle": DASHES[k], "marker": "o", "markersize": 3}
            ax.loglog([1e3 * h for h in STEPS_S], row, label=INPUTS[inputs], **style)
        ax.set_xlabel("communication step H (ms)")
        ax.set_title(
            "both signals 100 ms late" if synchronous else "G2 100 ms late, G4 direct", fontsize=9, loc="left"
        )
        ax.set_xticks([1e3 * h for h in STEPS_S], [f"{1e3 * h:g}" for h in STEPS_S])
        ax.minorticks_off()
    axes[0].set_ylabel("largest dw24 error over peak")
    axes[0].legend(loc="lower right", fontsize=7, frameon=False)
    return figure


def main() -> None:
    """Measure, draw and write."""
    measured = {s: errors(two_lags(), s) for s in (True, False)}
    save_figure(figure_of(measured), FOLDER / "delay-error.svg")
    case, designed = load_case(CASE), {}
    for name in ("wdc", "cc", "ftc"):
        controller = design_controller(case, name, default_cache())
        designed[name.upper()] = errors(controller, True, ["hermite"])["hermite"]
    tables = {
        "synchronous": table(measured[True]),
        "non-synchronous": table(measured[False]),
        "designed": table(designed, "controller"),
    }
    page = FOLDER / "delay_error.md"
    text = page.read_text(encoding="utf-8")
    for name, rows in tables.items():
        start, end = f"<!-- {name} -->", f"<!-- end {name} -->"
        before, _, rest = text.partition(start)
        text = f"{before}{start}\n{rows}\n{end}{rest.partition(end)[2]}"
    page.write_text(text, encoding="utf-8")
    print(*tables.values(), sep="\n\n")


if __name__ == "__main__":
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    main()
