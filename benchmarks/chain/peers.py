"""Other masters on a chain of N trivial FMUs, each set up once and then timed over a number of steps.

A route is a function (FMU file, N, working folder) -> `Route`; it raises ImportError
when the tool is not installed. `Route.run(steps)` goes on from where it stands.
"""

from __future__ import annotations

import ctypes
import itertools
import json
import os
import shutil
import zipfile
from collections.abc import Callable
from ctypes import c_double, c_int64, c_uint, c_void_p
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .trivial import H, instances, loop_library


@dataclass(frozen=True)
class Route:
    """`run(steps)` does that many steps; `steps` is enough to time; `fixed`: each run has its own set-up.

    `before` prepares a run and is not timed.
    """

    run: Callable[[int], object]
    steps: int
    fixed: bool = False
    before: Callable[[], object] = lambda: None
    close: Callable[[], object] = lambda: None


def plain_c(fmu: Path, n: int, folder: Path) -> Route:
    """Function pointers in a C loop; every output kept."""
    slaves = instances(fmu, [f"t{k}" for k in range(n)])
    library = loop_library()
    components = (c_void_p * n)(*[s.component for s in slaves])
    dll = slaves[0].dll
    set_real, do_step, get_real = (_address(dll, f"fmi2{f}") for f in ("SetReal", "DoStep", "GetReal"))
    steps = 100_000
    times, records = (c_double * steps)(), (c_double * (steps * n))()

    def run(count: int) -> None:
        # H as a double argument, pointers as they are
        failed = library.chain_loop(
            components, set_real, do_step, get_real, n, c_int64(count), c_double(H), times, records
        )
        if failed:
            raise RuntimeError("the plain loop failed")

    return Route(run, steps)


def ecos(fmu: Path, n: int, folder: Path) -> Route:
    """Ecos, nothing recorded."""
    return _ecos(fmu, n, None)


def ecos_csv(fmu: Path, n: int, folder: Path) -> Route:
    """Ecos, every output into a CSV file."""
    return _ecos(fmu, n, folder / f"ecos{n}.csv")


def _ecos(fmu: Path, n: int, csv: Path | None) -> Route:
    try:
        from ecospy import EcosSimulation, EcosSimulationStructure
    except OSError as error:  # its library wants libtbb, which the wheel `tbb` brings
        _load_tbb()
        try:
            from ecospy import EcosSimulation, EcosSimulationStructure
        except OSError:
            raise ImportError(str(error)) from error
    structure = EcosSimulationStructure()
    for k in range(n):
        structure.add_model(f"t{k}", str(fmu))
    for k in range(1, n):
        structure.make_real_connection(f"t{k - 1}::y", f"t{k}::u")
    simulation = EcosSimulation(structure=structure, step_size=H)
    if csv is not None:
        simulation.add_csv_writer(str(csv), identifiers=[f"t{k}::y" for k in range(n)])
    simulation.init()

    def close() -> None:
        simulation.terminate()
        simulation.free()

    return Route(simulation.step, 20_000, close=close)


def _load_tbb() -> None:
    import importlib.metadata as metadata

    for file in metadata.files("tbb") or []:
        if file.name.startswith("libtbb.so"):
            ctypes.CDLL(str(file.locate()), mode=ctypes.RTLD_GLOBAL)
            return


def fmucontainer(fmu: Path, n: int, folder: Path) -> Route:
    """A container FMU holding the chain (sequential), stepped and read by the plain C loop."""
    from fmu_manipulation_toolbox.assembly import Assembly

    parts = folder / f"container{n}"
    parts.mkdir()
    names = [f"t{k}.fmu" for k in range(n)]
    for name in names:
        shutil.copyfile(fmu, parts / name)
    description = {
        "name": "chain.fmu",
        "fmu": names,
        "link": [[names[k - 1], "y", names[k], "u"] for k in range(1, n)],
        "input": [["u", names[0], "u"]],
        "output": [[names[k], "y", f"y{k}"] for k in range(n)],
        "step_size": H,
        "sequential": True,
    }
    (parts / "chain.json").write_text(json.dumps(description), encoding="utf-8")
    assembly = Assembly("chain.json", fmu_directory=parts)
    assembly.make_fmu()
    (slave,) = instances(parts / "chain.fmu", ["chain"])
    from fmpy import read_model_description

    outputs = {
        v.name: v.valueReference for v in read_model_description(str(parts / "chain.fmu")).modelVariables
    }
    references = (c_uint * n)(*[outputs[f"y{k}"] for k in range(n)])
    library = loop_library()
    do_step, get_real = _address(slave.dll, "fmi2DoStep"), _address(slave.dll, "fmi2GetReal")
    steps = 20_000
    times, records = (c_double * steps)(), (c_double * (steps * n))()

    def before() -> None:  # the container wants a time axis without jumps
        slave.terminate()
        slave.reset()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()

    def run(count: int) -> None:
        failed = library.container_loop(
            c_void_p(slave.component),
            do_step,
            get_real,
            references,
            n,
            c_int64(count),
            c_double(H),
            times,
            records,
        )
        if failed:
            raise RuntimeError("the container failed")

    return Route(run, steps, before=before)


def libcosim(fmu: Path, n: int, folder: Path) -> Route:
    """libcosim's fixed-step algorithm, every output observed into memory."""
    from libcosimpy.CosimEnums import CosimVariableType
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.ERROR)
    execution = CosimExecution.from_step_size(step_size=round(H * 1e9))  # ns
    slaves = [CosimLocalSlave(fmu_path=str(fmu), instance_name=f"t{k}") for k in range(n)]
    places = [execution.add_local_slave(s) for s in slaves]
    for a, b in itertools.pairwise(places):
        execution.connect_real_variables(a, 2, b, 1)
    steps = 5_000
    observer = CosimObserver.create_time_series(buffer_size=steps)
    execution.add_observer(observer)
    for place in places:
        observer.start_time_series(place, 2, CosimVariableType.REAL)
    references = (slaves, observer)
    return Route(lambda count: execution.step(step_count=count), steps, close=lambda: references)


def cofmupy(fmu: Path, n: int, folder: Path) -> Route:
    """cofmupy, Gauss-Seidel, results in memory."""
    import logging

    logging.getLogger("cofmupy").setLevel(logging.ERROR)
    from cofmupy import Coordinator

    ends = [({"id": f"t{k - 1}", "variable": "y"}, {"id": f"t{k}", "variable": "u"}) for k in range(1, n)]
    description = {
        "fmus": [{"id": f"t{k}", "path": str(fmu), "name": f"t{k}"} for k in range(n)],
        "connections": [{"source": a, "target": b} for a, b in ends],
        "cosim_method": "gauss_seidel",
        "iterative": False,
    }
    path = folder / f"cofmupy{n}.json"
    path.write_text(json.dumps(description), encoding="utf-8")
    coordinator = Coordinator()
    coordinator.start(str(path))

    def run(count: int) -> None:
        for _ in range(count):
            coordinator.do_step(H)

    return Route(run, 300)


def fmpy_ssp(fmu: Path, n: int, folder: Path) -> Route:
    """fmpy's simulation of an SSP file; its set-up is taken off by timing two lengths."""
    from fmpy.ssp.simulation import simulate_ssp

    def component(k: int) -> str:
        ports = "".join(
            f'<ssd:Connector name="{v}" kind="{kind}"><ssc:Real/></ssd:Connector>'
            for v, kind in (("u", "input"), ("y", "output"))
            if k or v == "y"  # it wants a source for every input that is declared
        )
        return (
            f'<ssd:Component name="t{k}" type="application/x-fmu-sharedlibrary" '
            f'source="resources/trivial.fmu"><ssd:Connectors>{ports}</ssd:Connectors></ssd:Component>'
        )

    def wire(k: int) -> str:
        return (
            f'<ssd:Connection startElement="t{k - 1}" startConnector="y" endElement="t{k}" endConnector="u"/>'
        )

    text = (
        '<?xml version="1.0" encoding="UTF-8"?><ssd:SystemStructureDescription '
        'xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription" '
        'xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" version="1.0" name="chain">'
        '<ssd:System name="chain"><ssd:Elements>'
        + "".join(component(k) for k in range(n))
        + "</ssd:Elements><ssd:Connections>"
        + "".join(wire(k) for k in range(1, n))
        + "</ssd:Connections></ssd:System></ssd:SystemStructureDescription>"
    )
    path = folder / f"chain{n}.ssp"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", text)
        archive.write(fmu, "resources/trivial.fmu")
    return Route(
        lambda count: simulate_ssp(str(path), stop_time=(count - 0.5) * H, step_size=H), 2_000, fixed=True
    )


def _address(dll: Any, name: str) -> c_void_p:
    return ctypes.cast(getattr(dll, name), c_void_p)


PEERS: dict[str, Callable[[Path, int, Path], Route]] = {
    "Ecos, nothing recorded": ecos,
    "Ecos, CSV": ecos_csv,
    "fmucontainer": fmucontainer,
    "libcosim": libcosim,
    "cofmupy": cofmupy,
    "fmpy SSP": fmpy_ssp,
}

# some of them write progress to the terminal
os.environ.setdefault("TQDM_DISABLE", "1")
