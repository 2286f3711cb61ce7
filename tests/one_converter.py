"""One converter beside the machines of a grid, or alone behind a line to an infinite bus, for its tests."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.integrate
from plant_shim import BlockShim

from interarea.models.blocks.plant import event_parameters, plant_block
from interarea.models.case.case import Case, case_of, load_case
from interarea.models.case.events import events_of

Vector = npt.NDArray[np.float64]
NAME = "pv1"
SHARE = 2.0  #: its base over that of the case, beside machines
X_LINE = 0.3  #: pu, of the line
X_TO_BUS = X_LINE + 1e-8  #: with the reactance behind the infinite bus


def beside_machines(control: Mapping[str, Any], base: str = "two-area-thesis", **where: Any) -> Case:
    """Return a case with a `wecc_converter` of 100 MW and 20 Mvar at bus 8; where : more keys of its row."""
    row = {"bus": 8, "base_mva": 100.0 * SHARE, "P_mw": 100.0, "Q_mvar": 20.0} | where
    row["control"] = {"kind": "wecc_converter"} | dict(control)
    return load_case(base).with_changes({"converters": {NAME: row}})


def behind_a_line(control: Mapping[str, Any]) -> Case:
    """Return a case of a `wecc_converter` of 50 MW and 10 Mvar at bus 1 and an infinite bus 2 of 1 pu."""
    machine = {"bus": 2, "area": 1, "model": "infinite_bus", "Xd1": 1e-6, "base_mva": 1e4}
    plant = {"bus": 1, "base_mva": 100.0, "P_mw": 50.0, "Q_mvar": 10.0}
    document = {
        "name": "alone",
        "title": "a converter on an infinite bus",
        "source": "ours",
        "frequency_hz": 50.0,
        "base_mva": 100.0,
        "buses": {"1": {"area": 1}, "2": {"area": 1}},
        "branches": {"line": {"from": 1, "to": 2, "x": X_LINE}},
        "machines": {"G2": machine | {"P_mw": 0.0, "V_pu": 1.0, "slack": True}},
        "converters": {NAME: plant | {"control": {"kind": "wecc_converter"} | dict(control)}},
    }
    return case_of(document, where="alone")


def states_of(plant: BlockShim) -> dict[str, int]:
    """Return the places of the converter's states by name."""
    names = enumerate(plant.state_names)
    return {n.removeprefix(f"{NAME}."): k for k, n in names if n.startswith(f"{NAME}.")}


def course(
    case: Case, seconds: float, step_s: float, inputs: Mapping[str, float] | None = None,
    events: Iterable[Mapping[str, Any]] = (),
) -> tuple[Vector, dict[str, Vector], dict[str, Vector]]:  # fmt: skip
    """Return times, states of the converter and outputs of the plant; inputs : `p_mod`, `q_mod` from 0 s."""
    plant = BlockShim(plant_block(case), event_parameters(case, events_of(list(events), where="test")))
    u = plant.u.copy()
    for name, value in (inputs or {}).items():
        u[plant.input_names.index(f"{NAME}_{name}")] = value
    time_s, x, y = plant.run(seconds, step_s, u)
    states = {name: x[:, k] for name, k in states_of(plant).items()}
    return time_s, states, {name: y[:, k] for k, name in enumerate(plant.output_names)}


def solved(
    rates: Callable[[float, Vector], Sequence[float]], begin: Sequence[float], at: Vector
) -> npt.NDArray[np.float64]:
    """Return the solution of a diagram written a second time, by scipy in steps of 1 ms at most."""
    options = {"rtol": 1e-9, "atol": 1e-11, "max_step": 1e-3}
    return scipy.integrate.solve_ivp(rates, (at[0], at[-1]), begin, t_eval=at, **options).y
