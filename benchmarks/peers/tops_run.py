"""Run tops on tables that it reads from stdin; write what it finds to stdout. Needs tops only.

Input, JSON: {"tables": {...}} or {"grid": "n44"} (a grid that comes with tops, without its controls),
"machine": "tops" or "sixth order" (the equations of the field's standard model instead of tops's own).
Output, JSON: tables, bus voltages, eigenvalues, version.
"""

from __future__ import annotations

import contextlib
import copy
import importlib
import importlib.metadata
import io
import json
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np


def sixth_order() -> Any:
    """Return a machine model for tops: GENROU's equations, the torque constant, in place of GEN's."""
    from tops.dyn_models.gen import GEN

    class SixthOrder(GEN):  # type: ignore[misc]
        def state_derivatives(self, dx: Any, x: Any, v: Any) -> None:
            p, X, dX = self.par, self.local_view(x), self.local_view(dx)
            i_d, i_q = self.i_d(x, v), self.i_q(x, v)
            d, q = p["X_d_t"] - p["X_l"], p["X_q_t"] - p["X_l"]
            torque = X["e_d_st"] * i_d + X["e_q_st"] * i_q
            dX["speed"][:] = (self.P_m(x, v) - torque - p["D"] * X["speed"]) / (2 * p["H"])
            dX["angle"][:] = X["speed"] * 2 * np.pi * self.sys_par["f_n"]
            a, b = (p["X_d_st"] - p["X_l"]) / d, (p["X_q_st"] - p["X_l"]) / q
            field = self.E_f(x, v) - X["e_q_t"]
            field = field - (p["X_d"] - p["X_d_t"]) * (a * i_d + (X["e_q_t"] - X["e_q_st"]) / d)
            damper = -X["e_d_t"] + (p["X_q"] - p["X_q_t"]) * (b * i_q - (X["e_d_t"] - X["e_d_st"]) / q)
            dX["e_q_t"][:] = field / p["T_d0_t"]
            dX["e_d_t"][:] = damper / p["T_q0_t"]
            fast_d = X["e_q_t"] - X["e_q_st"] - (p["X_d_t"] - p["X_d_st"]) * i_d
            fast_q = X["e_d_t"] - X["e_d_st"] + (p["X_q_t"] - p["X_q_st"]) * i_q
            dX["e_q_st"][:] = a * dX["e_q_t"] + fast_d / p["T_d0_st"]
            dX["e_d_st"][:] = b * dX["e_d_t"] + fast_q / p["T_q0_st"]

    return SimpleNamespace(gen=SimpleNamespace(GEN=SixthOrder))


def jacobian(system: Any, step: float = 1e-6) -> Any:
    """Return the state matrix by central differences; tops's own step of 1e-10 leaves 1e-4 of noise."""
    columns = []
    for k in range(system.n_states):
        sides = []
        for sign in (1.0, -1.0):
            x = system.x0.copy()
            x[k] += sign * step
            sides.append(system.ode_fun(0.0, x))
        columns.append((sides[0] - sides[1]) / (2 * step))
    return np.column_stack(columns)


def main() -> None:
    """Read, run, write; tops's own words go to stderr."""
    problem = json.load(sys.stdin)
    words = io.StringIO()
    with contextlib.redirect_stdout(words):
        import tops.dynamic as tops

        if "grid" in problem:
            tables = importlib.import_module(f"tops.ps_models.{problem['grid']}").load()
            tables = {key: value for key, value in tables.items() if key not in ("avr", "pss", "gov")}
        else:
            tables = problem["tables"]
        if problem["machine"] == "sixth order" and "X_l" not in tables["generators"]["GEN"][0]:
            rows = tables["generators"]["GEN"]
            at = rows[0].index("X_d_st")
            tables["generators"]["GEN"] = [[*rows[0], "X_l"]] + [
                [*row, problem["leakage"] * row[at]] for row in rows[1:]
            ]
        copied = copy.deepcopy(tables)
        library = sixth_order() if problem["machine"] == "sixth order" else None
        system = tops.PowerSystemModel(model=tables, user_mdl_lib=library)
        system.pf_tol, system.pf_max_it = 1e-11, 30
        system.power_flow()
        if not system.power_flow_ready:
            raise RuntimeError("tops: the power flow does not converge")
        system.init_dyn_sim()
        rest = float(np.abs(system.ode_fun(0.0, system.x0)).max())
        poles = np.linalg.eigvals(jacobian(system))
    sys.stderr.write(words.getvalue())
    result = {
        "tables": copied,
        "v": [[float(z.real), float(z.imag)] for z in np.asarray(system.v_0).ravel()],
        "rest": rest,
        "eigenvalues": [[float(z.real), float(z.imag)] for z in poles],
        "version": importlib.metadata.version("tops"),
    }
    json.dump(result, sys.stdout)


if __name__ == "__main__":
    main()
