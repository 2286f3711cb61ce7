"""Run ANDES on rows that it reads from stdin; write what it finds to stdout. Needs ANDES only.

Input, JSON: {"rows": [[model, {...}], ...], "frequency_hz": f, "base_mva": S, "loads": {...},
"stop_s": T or null, "step_s": h, "tolerance": newton, "every": n, "repeat": times}, or
{"files": [RAW, DYR]} for a grid that comes with ANDES or lies on disk, with rows of events beside.
Output, JSON: power flow, eigenvalues, time and speed of each machine, CPU seconds of the time-domain runs.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import io
import json
import logging
import sys
import time
from typing import Any


def system_of(problem: dict[str, Any]) -> Any:
    """Return an ANDES system with its power flow solved and the dynamics initialised."""
    import andes

    if "files" in problem:  # a grid of ANDES's own: what it reads from the same files
        raw, dyr = (andes.get_case(name) for name in problem["files"])
        system = andes.load(raw, addfile=dyr, no_output=True, default_config=True, setup=False)
        for model, parameters in problem.get("rows", ()):
            system.add(model, {"u": 1} | parameters)
        system.setup()
        system.files_read = [raw, dyr]
        system.PFlow.config.tol = 1e-10
        if not system.PFlow.run():
            raise RuntimeError("ANDES: the power flow does not converge")
        return system
    system = andes.System(default_config=True, no_output=True)
    system.config.freq = problem["frequency_hz"]
    system.config.mva = problem["base_mva"]
    for model, parameters in problem["rows"]:
        system.add(model, {"u": 1} | parameters)
    system.setup()
    for key, share in problem["loads"].items():
        setattr(system.PQ.config, key, share)
    system.PFlow.config.tol = 1e-10
    if not system.PFlow.run():
        raise RuntimeError("ANDES: the power flow does not converge")
    return system


def run(problem: dict[str, Any]) -> dict[str, Any]:
    """Return the results for one problem."""
    system = system_of(problem)
    result: dict[str, Any] = {
        "buses": [int(b) for b in system.Bus.idx.v],
        "v": system.Bus.v.v.tolist(),
        "a": system.Bus.a.v.tolist(),
        "machines": list(system.GENROU.gen.v),
        "machine_buses": [int(bus) for bus in system.GENROU.bus.v],
        "version": importlib.metadata.version("andes"),
        "files": [str(name) for name in getattr(system, "files_read", ())],
    }
    if not problem.get("stop_s"):
        system.EIG.run()
        result["eigenvalues"] = [[z.real, z.imag] for z in system.EIG.mu]
        return result
    result["cpu_s"] = []
    for _ in range(problem.get("repeat", 1)):
        system = system_of(problem)
        config = system.TDS.config
        config.tf, config.tstep, config.fixt, config.no_tqdm = problem["stop_s"], problem["step_s"], 1, 1
        config.tol = problem["tolerance"]
        config.criteria = 0
        system.TDS.init()
        begin = time.process_time()
        done = system.TDS.run()
        result["cpu_s"].append(time.process_time() - begin)
        if not done:
            raise RuntimeError(f"ANDES: the run stops at {float(system.dae.t):g} s")
    every = problem.get("every", 1)
    result["t"] = [float(t) for t in system.dae.ts.t[::every]]
    speed = system.dae.ts.x[::every, system.GENROU.omega.a] - 1.0
    result["dw"] = speed.T.tolist()
    return result


def main() -> None:
    """Read, run, write; ANDES's own words go to stderr."""
    logging.disable(logging.WARNING)
    words = io.StringIO()
    with contextlib.redirect_stdout(words):
        result = run(json.load(sys.stdin))
    sys.stderr.write(words.getvalue())
    json.dump(result, sys.stdout)


if __name__ == "__main__":
    main()
