"""Read RAW files with VeraGrid or pypowsybl and solve their power flow. Needs that one tool only.

Input, JSON on stdin: {"tool": "veragrid" or "pypowsybl", "grids": [{"file": RAW, "volts": {bus: pu},
"shunts": {bus: Mvar}}, ...]}: the magnitudes that units hold and the switched shunts, so that both sides
solve the same problem. Limits, taps and shunts do not move.
Output, JSON: for each grid {"buses": {number: [pu, degrees]}, "flows": [[from, to, P, Q, P, Q], ...]} in MW
into each end of each branch of two ends, or {"refused": why}.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import io
import json
import logging
import math
import sys
from typing import Any


def veragrid(file: str, volts: dict[str, float], **_: Any) -> dict[str, Any]:
    """Return voltages and flows of `file` by VeraGrid."""
    import VeraGridEngine as vg
    from VeraGridEngine.enumerations import ShuntControlMode

    grid = vg.open_file(file)
    for unit in grid.get_generators():
        unit.Vset = volts.get(unit.bus.code, unit.Vset)
        unit.control_bus = unit.bus  # not one elsewhere
    for shunt in grid.get_controllable_shunts():
        shunt.control_mode = ShuntControlMode.Locked
    options = vg.PowerFlowOptions(
        solver_type=vg.SolverType.NR,
        retry_with_other_methods=False,
        tolerance=1e-9,
        max_iter=60,
        control_q=False,
        control_taps_modules=False,
        control_taps_phase=False,
        control_remote_voltage=False,
    )
    solution = vg.power_flow(grid, options=options)
    if not solution.converged:
        raise RuntimeError("its power flow does not converge")
    buses = {
        bus.code: [abs(v), math.degrees(math.atan2(v.imag, v.real))]
        for bus, v in zip(grid.get_buses(), solution.voltage, strict=True)
    }
    branches = grid.get_branches(add_vsc=False, add_hvdc=False, add_switch=True)
    flows = [
        [b.bus_from.code, b.bus_to.code, s.real, s.imag, t.real, t.imag]
        for b, s, t in zip(branches, solution.Sf, solution.St, strict=True)
    ]
    return {"buses": buses, "flows": flows}


def _hold_shunts(network: Any, shunts: dict[str, float]) -> None:
    """Put switched shunts at their stored Mvar: pypowsybl takes the nearest whole block."""
    import pandas

    table = network.get_shunt_compensators(all_attributes=True)
    kv = network.get_voltage_levels().nominal_v
    for row in [r for r in table.itertuples() if "-SwSH" in r.Index]:
        network.remove_elements(row.Index)
        siemens = shunts.get(row.bus_breaker_bus_id[1:], 0.0) / kv[row.voltage_level_id] ** 2
        network.create_shunt_compensators(
            shunt_df=pandas.DataFrame.from_records(
                [(row.Index, row.voltage_level_id, row.bus_breaker_bus_id, "LINEAR", 1)],
                columns=["id", "voltage_level_id", "bus_id", "model_type", "section_count"],
                index="id",
            ),
            linear_model_df=pandas.DataFrame.from_records(
                [(row.Index, 0.0, siemens, 1)],
                columns=["id", "g_per_section", "b_per_section", "max_section_count"],
                index="id",
            ),
        )


def pypowsybl(file: str, volts: dict[str, float], shunts: dict[str, float]) -> dict[str, Any]:
    """Return voltages and flows of `file` by pypowsybl."""
    import pypowsybl

    flow = pypowsybl.loadflow
    network = pypowsybl.network.load(file)
    network.per_unit = True
    units = network.get_generators(all_attributes=True)
    unit_volts = {unit: volts[bus[1:]] for unit, bus in units.bus_breaker_bus_id.items() if bus[1:] in volts}
    if unit_volts:
        network.update_generators(
            id=list(unit_volts), regulated_element_id=list(unit_volts)
        )  # not a bus elsewhere
        network.update_generators(id=list(unit_volts), target_v=list(unit_volts.values()))
    network.per_unit = False
    _hold_shunts(network, shunts)
    for start in (flow.VoltageInitMode.PREVIOUS_VALUES, flow.VoltageInitMode.DC_VALUES):
        how = flow.Parameters(
            voltage_init_mode=start,
            distributed_slack=False,
            use_reactive_limits=False,
            transformer_voltage_control_on=False,
            phase_shifter_regulation_on=False,
            shunt_compensator_voltage_control_on=False,
            read_slack_bus=True,
            provider_parameters={"newtonRaphsonConvEpsPerEq": "1e-8", "useLoadModel": "true"},
        )
        solution = flow.run_ac(network, how)[0]
        if solution.status.name == "CONVERGED":
            break
    else:
        raise RuntimeError(f"its power flow does not converge: {solution.status_text}")
    table = network.get_bus_breaker_view_buses(all_attributes=True)
    kv = network.get_voltage_levels().nominal_v
    buses = {
        row.Index[1:]: [row.v_mag / kv[row.voltage_level_id], row.v_angle]
        for row in table.itertuples()
        if row.v_mag > 0.0
    }
    flows = [
        [row.bus_breaker_bus1_id[1:], row.bus_breaker_bus2_id[1:], row.p1, row.q1, row.p2, row.q2]
        for table in (network.get_lines, network.get_2_windings_transformers)
        for row in table(all_attributes=True).itertuples()
        if row.connected1 and row.connected2 and math.isfinite(row.p1)
    ]
    return {"buses": buses, "flows": flows}


TOOLS = {"veragrid": veragrid, "pypowsybl": pypowsybl}
PACKAGES = {"veragrid": "VeraGridEngine", "pypowsybl": "pypowsybl"}


def main() -> None:
    """Read, solve, write; the tool's own words go nowhere."""
    logging.disable(logging.CRITICAL)
    problem = json.load(sys.stdin)
    read, answers = TOOLS[problem["tool"]], []
    for grid in problem["grids"]:
        with contextlib.redirect_stdout(io.StringIO()):
            try:
                answers.append(read(**grid))
            except Exception as error:  # whatever a foreign tool raises is its answer
                answers.append({"refused": f"{type(error).__name__}: {error}"[:200]})
    version = importlib.metadata.version(PACKAGES[problem["tool"]])
    json.dump({"version": version, "grids": answers}, sys.stdout)


if __name__ == "__main__":
    main()
