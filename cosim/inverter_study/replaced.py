"""A grid with a share of every machine replaced by an inverter at its bus, the power flow unchanged.

Every machine that gives active power keeps 1 - share of its rating, of its P and of its Q; an inverter at the
same bus gives the rest. Grid-following: the package's `wecc_converter`. Grid-forming: its `regfm_a1`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from interarea.models.case.case import Case
from interarea.models.case.schema import Machine
from interarea.models.grid.powerflow import solve_powerflow

FOLLOWING, FORMING = "grid-following", "grid-forming"
KINDS = (FOLLOWING, FORMING)
#: apparent power at rest over rating, at most; a smaller machine's inverter is rated above its machine's part
LOADED = 0.9
#: controls of a grid-following inverter: the plant control holds the voltage of its own bus by Q, which
#: has priority. Times: the public PSS/E record RENA. Gains of the plant control: ours, for those of that
#: record (18, 5) are too fast at large shares. Limits: wide enough for any dispatch
FOLLOWS: Mapping[str, Any] = {
    "kind": "wecc_converter",
    "LVPLSW": 1.0,
    "VFLAG": 1.0,
    "QMAX": 0.9,
    "QMIN": -0.9,
    "VMAX": 1.2,
    "VMIN": 0.8,
    "Imax": 1.2,
    "PLANT": 1.0,
    "plant_REFFLAG": 1.0,
    "plant_Tfltr": 0.02,
    "plant_Kp": 2.0,
    "plant_Ki": 5.0,
    "plant_Tfv": 0.05,
    "plant_Qmax": 0.9,
    "plant_Qmin": -0.9,
}
#: controls of a grid-forming inverter: the device's defaults, which are the published ones, but a droop of
#: 5 % as of governors, the current limit of the grid-following one, and limits wide enough for any dispatch
FORMS: Mapping[str, Any] = {
    "kind": "regfm_a1",
    "mp": 0.05,
    "Imax": 1.2,
    "Emax": 1.3,
    "Qmax": 0.9,
    "Qmin": -0.9,
}
CONTROLS = {FOLLOWING: FOLLOWS, FORMING: FORMS}
_RATED = ("Trate",)  #: values of a governor in MVA


def replaced(case: Case, kind: str, share: float) -> Case:
    """Return `case` with a share of every machine's power given by inverters; with 0 the case itself.

    kind : of `KINDS`. share : 0 to under 1.

    Raises
    ------
    CaseError : no power flow, or a name `M_inverter` that the case has already.
    """
    if not share:
        return case
    flow = solve_powerflow(case)
    machines: dict[str, dict[str, Any]] = {}
    converters: dict[str, dict[str, Any]] = {}
    for row, power in zip(case.machines, flow.generation * case.base_mva, strict=True):
        if not power.real > 0.0 or row.model not in ("round_rotor", "classical"):
            continue
        machines[row.name] = _smaller(row, power, 1.0 - share)
        converters[f"{row.name}_inverter"] = {
            "bus": row.bus,
            "base_mva": max(share * row.base_mva, share * abs(power) / LOADED),
            "P_mw": share * power.real,
            "Q_mvar": share * power.imag,
            "control": dict(CONTROLS[kind]),
        }
    change = {"machines": machines, "converters": converters}
    return case.with_changes(change, name=f"{case.name}-{kind}-{round(100 * share)}")


def _smaller(row: Machine, power: complex, left: float) -> dict[str, Any]:
    """Return the changes of a machine of which so much is left; its values per unit stay as they are."""
    change: dict[str, Any] = {
        "base_mva": left * row.base_mva,
        "P_mw": left * power.real,
        "Q_mvar": left * power.imag,
    }
    rated = {key: left * getattr(row.governor, key) for key in _RATED if getattr(row.governor, key, 0.0)}
    return change | ({"governor": rated} if rated else {})
