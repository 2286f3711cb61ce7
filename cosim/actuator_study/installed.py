"""The actuators of a grid that are compared: one of each kind, what its full output is, what it sees.

Equal effort: every loop gives its full output at the same deviation of speed, `FULL_AT`. Full output is
`SHARE` of the same installed power for every device, for an exciter what field stabilizers are limited to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import control
import numpy as np

from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.design.modes.loop_points import LoopSet
from interarea.models.case.case import Case
from interarea.models.case.hvdc_schema import Hvdc
from interarea.models.case.vsc_schema import Vsc
from interarea.models.grid.powerflow import PowerFlow, solve_powerflow

from ..errors import ScenarioError
from ..grid_study.link_worth import AFAR, OWN, LoopTerms, signals_of_set
from ..grid_study.proposal import LIMIT_PU
from ..grid_study.weak_modes import WeakModes
from ..run.artefacts import linear_plant

#: kind -> its name in words
KINDS = {
    "exciter": "exciter",
    "lcc": "LCC dc link",
    "vsc": "VSC dc link",
    "svc": "SVC",
    "statcom": "STATCOM",
    "tcsc": "TCSC",
}
SHARE = 0.3  #: of a device's installed power that its full output moves, at most
FULL_AT = (
    0.4  #: rad/s (64 mHz): speed at which a loop may give its full output; .125 pu per rad/s at an exciter
)
#: current of a series capacitor's line for which it is rated, of that at rest
RATED_CURRENT = 2.0
_GAIN = {"svc": "K", "statcom": "KR"}  #: regulator gain of a device file, output over voltage


@dataclass(frozen=True)
class Installed:
    """An actuator. full : its full output, unit of the input.

    mva : installed power; None: an exciter, whose machine is there anyway. sees : "own" and "remote" ->
    signals, of which those of `near` are wired in. per_rad : signals -> their size in the mode, by a rad/s of
    the speed difference that remote signals show.
    """

    kind: str
    actuator: str
    mva: float | None
    full: float
    sees: Mapping[str, tuple[str, ...]]
    near: tuple[str, ...]
    per_rad: Mapping[str, float]

    def terms(self, signals: str, starts: int) -> LoopTerms:
        """Return what a loop may do that sees "own" or "remote" signals."""
        return LoopTerms(self.full / (FULL_AT * self.per_rad[signals]), self.full, self.near, starts)


def _links(case: Case) -> dict[str, tuple[Hvdc | Vsc, ...]]:
    """Return kind -> the dc links of a grid."""
    return {"lcc": case.hvdcs, "vsc": case.vscs}


def ratings(case: Case) -> dict[str, dict[str, float]]:
    """Return kind -> device -> installed power, MVA, for each device of a grid that can be compared."""
    flow = solve_powerflow(case)
    rated: dict[str, dict[str, float]] = {
        kind: {row.name: row.base_mva for row in rows} for kind, rows in _links(case).items()
    }
    for kind in _GAIN:
        rated[kind] = {row.name: row.base_mva for row in case.svcs if row.control.kind == kind}
    rated["tcsc"] = {
        row.name: row.x_max_pu * (RATED_CURRENT * abs(_current(case, flow, row.branch))) ** 2 * case.base_mva
        for row in case.tcscs
    }
    return rated


def _current(case: Case, flow: PowerFlow, branch: str) -> complex:
    """Return the current at rest into a line with a series capacitor, pu of the case."""
    line = case.branch(branch)
    return flow.flow(branch, line.from_bus) / flow.voltage(line.from_bus)


def installed(
    weak: WeakModes, kinds: Sequence[str], mva: float | None, cache: Path
) -> tuple[dict[str, Installed], float | None]:
    """Return kind -> the actuator that is compared, the largest of its kind; and the installed power, MVA.

    mva : at which devices are compared; None: the smallest of those there.

    Raises ScenarioError: a kind that the grid does not have, or less than `mva` of it.
    """
    case = weak.case
    rated = ratings(case)
    chosen: dict[str, tuple[str, float]] = {}
    for kind in (k for k in kinds if k != "exciter"):
        if not rated[kind]:
            there = [KINDS[k] for k, rows in rated.items() if rows] or ["exciter alone"]
            raise ScenarioError(
                f"{case.name}: no {KINDS[kind]} in this grid, present: {', '.join(there)}; add a row to the "
                f"table {_TABLE[kind]}, or leave --actuator {kind} out"
            )
        chosen[kind] = max(rated[kind].items(), key=lambda item: item[1])
    power = mva if mva is not None else min((r for _, r in chosen.values()), default=None)
    for kind, (name, rating) in chosen.items():
        if power is not None and not power <= rating * (1.0 + 1e-9):
            raise ScenarioError(
                f"--mva {power:g}: {name} ({KINDS[kind]}) of {case.name} has {rating:.4g} MVA, allowed: "
                "above 0 and at most that; increase its rating or reduce --mva"
            )
    plant = speeds_in_rad(remove_reference(linear_plant(case, cache)), case.omega_b)
    return {k: _installed(k, weak, plant, chosen.get(k), power) for k in kinds}, power


_TABLE = {"lcc": "hvdcs", "vsc": "vscs", "svc": "svcs", "statcom": "svcs", "tcsc": "tcscs"}
_WORD = {"lcc": "p_mod", "vsc": "p_mod", "svc": "v_mod", "statcom": "v_mod", "tcsc": "x_mod"}


def _sizes(plant: control.StateSpace, eigenvalue: complex) -> dict[str, complex]:
    """Return output -> what it shows of a mode, rad/s or pu."""
    values, right = np.linalg.eig(np.asarray(plant.A))
    mode = int(np.argmin(np.abs(values - eigenvalue)))
    return dict(zip(plant.output_labels, np.asarray(plant.C) @ right[:, mode], strict=True))


def _own_signal(case: Case, kind: str, name: str) -> str:
    """Return what a device measures where it stands: the tie's power at its end, else its own output."""
    links = _links(case)
    if kind in links:
        row = next(row for row in links[kind] if row.name == name)
        ends, own = {row.bus, row.seen_bus}, f"{name}_q_{'rectifier' if kind == 'lcc' else 'from'}"
    elif kind == "tcsc":
        line = case.branch(next(row.branch for row in case.tcscs if row.name == name))
        ends, own = {line.from_bus, line.to_bus}, f"{name}_i"
    else:
        ends, own = {next(row.bus for row in case.svcs if row.name == name)}, f"{name}_q"
    return "tie_p" if case.tie is not None and case.tie.from_bus in ends else own


def _full(case: Case, kind: str, name: str, mva: float) -> float:
    """Return the modulation that moves `SHARE` of so many MVA of a device, unit of its input."""
    links = _links(case)
    if kind in links:
        row = next(row for row in links[kind] if row.name == name)
        return min(SHARE * mva / row.base_mva, row.p_mod_pu)
    if kind == "tcsc":
        branch = next(row.branch for row in case.tcscs if row.name == name)
        rated = RATED_CURRENT * abs(_current(case, solve_powerflow(case), branch))
        return SHARE * mva / case.base_mva / rated**2
    svc = next(row for row in case.svcs if row.name == name)
    return SHARE * mva / svc.base_mva / float(getattr(svc.control, _GAIN[kind]))


def _installed(
    kind: str, weak: WeakModes, plant: control.StateSpace, chosen: tuple[str, float] | None, mva: float | None
) -> Installed:
    if chosen is None or mva is None:
        best = next((one for one in weak.sets if one.actuators[0].endswith("_vs")), None)
        if best is None:
            raise ScenarioError(
                f"{weak.case.name}: no exciter of this grid regulates; name only devices with --actuator, "
                "or add an exciter to a machine"
            )
        actuator = best.actuators[0]
        sees, _ = signals_of_set(weak, best)
        both = {"own": sees[OWN][actuator], "remote": sees[AFAR][actuator]}
        return Installed(kind, actuator, None, LIMIT_PU, both, (), dict.fromkeys(both, 1.0))
    name, _ = chosen
    actuator = f"{name}_{_WORD[kind]}"
    pair = signals_of_set(weak, LoopSet((actuator,), 1.0, 0.0, "", {}))[0][AFAR][actuator]
    own = _own_signal(weak.case, kind, name)
    sizes = _sizes(plant, weak.weakest.eigenvalue)
    per_rad = {"own": float(abs(sizes[own]) / abs(sizes[pair[0]] - sizes[pair[1]])), "remote": 1.0}
    full = _full(weak.case, kind, name, mva)
    return Installed(kind, actuator, mva, full, {"own": (own,), "remote": pair}, (own,), per_rad)
