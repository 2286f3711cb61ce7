"""Grids published without dynamic data, with devices by a rule that is stated: for size, not for truth.

MATPOWER's large synthetic grids say what machines deliver, not what they are. Every machine gets the data of
one published machine (Kundur1994, Ex. 12.6) on its own rating, with an inertia that grows with the rating, a
thyristor exciter of half that book's gain, the governor TGOV1 and, from 75 MVA on, that book's stabilizer at
half its gain: 13 or 16 states. The rating is that of the file, raised where needed so that a machine delivers
at most nine tenths of it and absorbs at most a quarter: beyond that the rule is unstable. Loads are constant
impedances. The files are those of the Python package `matpower`, in its folder `data`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from interarea.models.case.case import Case
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.matpower import import_matpower

STABILIZER_FROM_MVA = 75.0
MOST_DELIVERED, MOST_ABSORBED = 0.9, 0.25  #: apparent power and absorbed reactive power, of the rating

_MACHINE = {
    "model": "round_rotor",
    "Ra": 0.0025,
    "Xl": 0.2,
    "Xd": 1.8,
    "Xq": 1.7,
    "Xd1": 0.3,
    "Xq1": 0.55,
    "Xd2": 0.25,
    "Xq2": 0.25,
    "Td01": 8.0,
    "Tq01": 0.4,
    "Td02": 0.03,
    "Tq02": 0.05,
}
_EXCITER = {"kind": "static", "KA": 100.0, "TA": 0.02, "TR": 0.01, "Efd_min": -6.0, "Efd_max": 6.0}
_STABILIZER = {
    "kind": "speed",
    "K": 10.0,
    "Tw": 10.0,
    "T1": 0.05,
    "T2": 0.02,
    "T3": 3.0,
    "T4": 5.4,
    "Vs_min": -0.1,
    "Vs_max": 0.1,
}
_GOVERNOR = {"kind": "tgov1", "R": 0.05, "T1": 0.5, "Vmax": 1.0, "T2": 2.1, "T3": 7.0, "Dt": 0.0}


def ruled_machine(P_mw: float, Q_mvar: float, base_mva: float) -> dict[str, Any]:
    """Return what the rule gives a machine that delivers P_mw + j Q_mvar, in the form of a case file."""
    rating = max(base_mva, abs(complex(P_mw, Q_mvar)) / MOST_DELIVERED, -Q_mvar / MOST_ABSORBED, 1.0)
    change: dict[str, Any] = _MACHINE | {"base_mva": rating, "H": 3.0 + 3.5 * min(rating / 900.0, 1.0)}
    change |= {"exciter": _EXCITER, "governor": _GOVERNOR | {"Vmin": 0.0 if P_mw >= 0.0 else -1.0}}
    if rating >= STABILIZER_FROM_MVA:
        change["stabilizer"] = _STABILIZER
    return change


def ruled(case: Case) -> Case:
    """Return `case` with devices by the rule at every machine that has no dynamic data.

    Raises
    ------
    CaseError : a machine that the case refuses with these data.
    """
    rows = {
        m.name: ruled_machine(m.P_mw, m.Q_mvar or 0.0, m.base_mva)
        for m in case.machines
        if m.model == "power_flow"
    }
    return case.with_changes({"machines": rows})


def ruled_grid(path: str | Path) -> Case:
    """Return the grid of a MATPOWER file with devices by the rule.

    Raises
    ------
    CaseError, PowerFlowError : as `import_matpower`.
    """
    return ruled(import_matpower(path, options=ImportOptions(island="all")).case)
