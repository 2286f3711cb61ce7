"""The SSP of a scenario: schema, contents, and the same trajectories in FMPy, libcosim and Ecos."""

from __future__ import annotations

import io
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmu_runner import decay_block
from lxml import etree
from tools.conftest import RunTool

from interarea.cli.app import main
from interarea.cosim.errors import ScenarioError
from interarea.cosim.export.container import container_block
from interarea.cosim.export.ssp import write_ssp
from interarea.cosim.run.run import run_scenario
from interarea.cosim.scenario.scenario import load_scenario
from interarea.design.controllers.controller import Controller
from interarea.fmu_build.write.compile import host_platform
from interarea.fmu_build.write.package import build_fmu

STEP, STOP, LATENCY = 0.01, 3.0, 0.1
SCENARIO = {
    "name": "remote",
    "case": "two-area-thesis",
    "controller": "ftc",
    "stop_s": STOP,
    "step_s": STEP,
    "channels": {
        "remote": {"signal": "G2_dw", "latency_s": LATENCY, "on_loss": "hold", "outages_s": [[2.0, 2.5]]}
    },
    "event": [{"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}],
}
COLUMNS = ["plant.G2_dw", "plant.tie_p", "remote.y", "controller.G4_vs"]
SCHEMAS = Path(fmpy.__file__).parent / "ssp" / "schema"
NS = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
}


@pytest.fixture(scope="module")
def archive(cache: Path, by_hand: Controller, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the SSP of `SCENARIO`."""
    file = tmp_path_factory.mktemp("ssp") / "remote.ssp"
    return write_ssp(load_scenario(SCENARIO), file, cache=cache, controller=by_hand)


def test_structure_and_parameters_obey_the_schemas(archive: Path) -> None:
    with zipfile.ZipFile(archive) as parts:
        assert parts.namelist()[0] == "SystemStructure.ssd"
        for name in parts.namelist():
            if not name.endswith((".ssd", ".ssv")):
                continue
            kind = "Description" if name.endswith(".ssd") else "ParameterValues"
            schema = etree.XMLSchema(etree.parse(str(SCHEMAS / f"SystemStructure{kind}.xsd")))
            assert schema.validate(etree.parse(io.BytesIO(parts.read(name)))), (name, schema.error_log)


def test_every_reference_resolves(archive: Path) -> None:
    """Sources lie in the archive, connectors and SSV parameters are variables of the FMU, with its units."""
    with zipfile.ZipFile(archive) as parts:
        root = etree.fromstring(parts.read("SystemStructure.ssd"))
        signals = {}
        for component in root.iterfind(".//ssd:Component", NS):
            name = component.get("name")
            model = fmpy.read_model_description(io.BytesIO(parts.read(component.get("source"))))
            variables = {v.name: v for v in model.modelVariables}
            for connector in component.iterfind(".//ssd:Connector", NS):
                signals[name, connector.get("name")] = connector.get("kind")
                assert variables[connector.get("name")].causality == connector.get("kind")
                assert variables[connector.get("name")].unit == connector[0].get("unit")
            for binding in component.iterfind(".//ssd:ParameterBinding", NS):
                values = etree.fromstring(parts.read(binding.get("source")))
                units = {u.get("name") for u in values.iter("{*}Unit")}
                for parameter in values.iterfind(".//ssv:Parameter", NS):
                    variable, value = variables[parameter.get("name")], parameter[0]
                    assert float(variable.start) == float(value.get("value")), variable.name
                    assert variable.type == etree.QName(value).localname
                    assert value.get("unit") in {None, *units}
        ends = [
            (c.get("startElement"), c.get("startConnector"), c.get("endElement"), c.get("endConnector"))
            for c in root.iterfind(".//ssd:Connection", NS)
        ]
        assert ("plant", "G2_dw", "remote", "u") in ends
        assert ("remote", "y", "controller", "G2_dw") in ends
        assert ("plant", "G4_dw", "controller", "G4_dw") in ends
        for a, b, c, d in ends:
            assert (signals[a, b], signals[c, d]) == ("output", "input")
        experiment = root.find("ssd:DefaultExperiment", NS)
        assert (experiment.get("startTime"), experiment.get("stopTime")) == ("0.0", str(STOP))


def test_same_scenario_gives_same_bytes(
    archive: Path, cache: Path, by_hand: Controller, tmp_path: Path
) -> None:
    again = write_ssp(
        load_scenario(SCENARIO), tmp_path / "sub" / "other.ssp", cache=cache, controller=by_hand
    )
    assert again.read_bytes() == archive.read_bytes()
    assert [f.name for f in again.parent.iterdir()] == ["other.ssp"]


@pytest.mark.slow
@pytest.mark.tools
@pytest.mark.parametrize("driver", ["fmpy_ssp", "libcosim_ssp", "ecos_ssp"])
def test_tools_give_the_trajectory_of_held_inputs(
    driver: str, archive: Path, run_tool: RunTool, cache: Path, by_hand: Controller
) -> None:
    """All three hold an input over the step, which our master repeats as "hold-jacobi": equal to rounding.

    Against the exact delay (our default) what is left is that hold, H/2 on the mean per connection.
    """
    result = run_tool(driver, archive, STEP, STOP, COLUMNS)
    held, exact = (
        run_scenario({**SCENARIO, "master": {"inputs": mode}}, cache=cache, controller=by_hand).trajectory
        for mode in ("hold-jacobi", "hermite")
    )
    assert np.allclose(result["time"], held.time_s[1:], rtol=0.0, atol=1e-9)
    for column in COLUMNS:
        peak = np.max(np.abs(held[column]))
        assert peak > 0.0
        assert np.max(np.abs(result[column] - held[column][1:])) <= 1e-12 * peak, column
        assert np.max(np.abs(result[column] - exact[column][1:])) <= 0.05 * peak, column


@pytest.fixture(scope="module")
def foreign(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the SSP of a scenario without a case: two FMUs taken as they are, one channel."""
    folder = tmp_path_factory.mktemp("foreign")
    build_fmu(decay_block(), folder, cache=cache)
    (folder / "pair.toml").write_text(
        """
        stop_s = 1.0
        step_s = 0.01
        connections = [["first.y", "line", "second.u"]]
        [fmus.first]
        file = "decay.fmu"
        start = { rate = 2.0 }
        [fmus.second]
        file = "decay.fmu"
        start = { "kick.size" = 0.0 }
        [channels.line]
        latency_s = 0.1
        """,
        encoding="utf-8",
    )
    return write_ssp(load_scenario(folder / "pair.toml"), folder / "pair.ssp", cache=cache)


def test_fmus_of_others_go_in_as_they_are(foreign: Path) -> None:
    with zipfile.ZipFile(foreign) as parts:
        assert parts.read("resources/first.fmu") == foreign.with_name("decay.fmu").read_bytes()
        values = etree.fromstring(parts.read("resources/first.ssv"))
        result = {p.get("name"): (p[0].get("value"), p[0].get("unit")) for p in values.iter("{*}Parameter")}
    assert result == {"rate": ("2.0", "1/s")}


@pytest.mark.tools
@pytest.mark.parametrize("driver", ["libcosim_ssp", "ecos_ssp"])
def test_tools_take_start_values_from_the_parameter_sets(
    driver: str, foreign: Path, run_tool: RunTool
) -> None:
    """y = exp(-2 t) in the first FMU, whose own rate is 1, and the same 0.1 s later out of the channel."""
    trajectory = run_tool(driver, foreign, 0.01, 1.0, ["first.y", "line.y"])
    t = trajectory["time"]
    assert np.allclose(trajectory["first.y"], np.exp(-2.0 * t), rtol=1e-6)
    late = t > 0.12
    assert np.allclose(trajectory["line.y"][late], np.exp(-2.0 * (t[late] - 0.1)), rtol=1e-3)


def test_container_refuses_fmus_of_others(foreign: Path, cache: Path) -> None:
    with pytest.raises(ScenarioError, match=r"first, second are third-party FMUs, which one block cannot"):
        container_block(load_scenario(foreign.with_name("pair.toml")), cache=cache)


def test_command_writes_it_for_the_platforms_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "open.toml"
    scenario.write_text('case = "two-area-thesis"\nstop_s = 1.0\n', encoding="utf-8")

    def call(out: Path, platforms: str) -> tuple[int, str, str]:
        words = ["interarea", "ssp", str(scenario), "--out", str(out), "--platforms", platforms]
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as stopped:
            main()
        return int(stopped.value.code or 0), *capfd.readouterr()

    code, printed, _ = call(tmp_path / "a.ssp", host_platform())
    assert (code, printed.strip()) == (0, str(tmp_path / "a.ssp"))
    with zipfile.ZipFile(tmp_path / "a.ssp") as parts:
        assert parts.namelist() == ["SystemStructure.ssd", "resources/plant.fmu"]
    code, _, said = call(tmp_path / "b.ssp", "beos")
    assert code != 0
    assert "unknown platform 'beos'" in said
    assert not (tmp_path / "b.ssp").exists()
