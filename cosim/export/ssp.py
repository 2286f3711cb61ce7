"""Write a scenario's whole loop as one SSP 1.0 archive, for tools that know nothing of this project.

Every instance has an FMU of its own: the scenario's parameters are its start values too, because some
tools ignore the parameter sets (SSV) that the components also carry. Archives of the same scenario are
the same bytes. What the receiving tool adds to the latency of a connection is that tool's: most hold an
input over its step, as our master does with `inputs = "hold-jacobi"`.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from pathlib import Path

from interarea.fmu_build.open.description import ScalarVariable
from interarea.fmu_build.open.ports import Port
from interarea.fmu_build.open.units import BASE, UnitOf
from interarea.fmu_build.write.description_xml import attributes, product_version
from interarea.fmu_build.write.package import archive_bytes, build_fmu
from interarea.models.files import temporary_folder, write_whole

from ..run.controllers import ControllerLike
from ..scenario.scenario import Scenario
from .instances import Member, Members, members_of

_SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
_SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
_SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
_OSP = "https://open-simulation-platform.com/SSP/OSPAnnotations"


def write_ssp(
    scenario: Scenario,
    path: Path | str,
    *,
    cache: Path,
    platforms: Sequence[str] | None = None,
    controller: ControllerLike | None = None,
) -> Path:
    """Write plant, channels and controller of `scenario`, connected, as one ``.ssp``; return its path.

    Parameters
    ----------
    cache : folder of FMUs and designs.
    platforms : keys of `compile.PLATFORMS` for the FMUs inside; None = the one this Python runs on.
    controller : in place of the one the scenario names (`controller_of`).

    Raises
    ------
    ScenarioError, CaseError, BuildError : as `members_of` and `build_fmu` say.
    """
    members = members_of(scenario, cache=cache, controller=controller)
    entries = {"SystemStructure.ssd": structure(members).encode("utf-8")}
    with temporary_folder() as folder:
        for member in members.all:
            fmu = member.file.path  # of others: as it is
            if member.block is not None:
                block = member.baked(step_s=members.step_s, stop_s=scenario.stop_s)
                fmu = build_fmu(block, folder / f"{member.name}.fmu", platforms=platforms, cache=cache)
            entries[f"resources/{member.name}.fmu"] = fmu.read_bytes()
            if _settable(member):
                entries[f"resources/{member.name}.ssv"] = parameter_set(member).encode("utf-8")
    return write_whole(Path(path), archive_bytes(entries, first="SystemStructure.ssd", stored=(".fmu",)))


def structure(members: Members) -> str:
    """Return the text of ``SystemStructure.ssd``; the step goes to tools that read OSP annotations."""
    scenario = members.scenario
    fed = {target for _, target in members.connections}
    units = {p.unit.name: p.unit for m in members.all for _, p in _signals(m, fed) if p.unit is not None}
    head = {
        "xmlns:ssd": _SSD,
        "xmlns:ssc": _SSC,
        "xmlns:osp": _OSP,  # on the root: libcosim takes an attribute of Algorithm for an algorithm
        "version": "1.0",
        "name": scenario.name,
        "description": scenario.title or scenario.name,
        "generationTool": f"interarea {product_version()}",
    }
    experiment = {"startTime": 0.0, "stopTime": float(scenario.stop_s)}
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f"<ssd:SystemStructureDescription{attributes(head)}>",
        f"  <ssd:System{attributes({'name': 'loop', 'description': scenario.title or None})}>",
        "    <ssd:Elements>",
        *(line for m in members.all for line in _component(m, fed)),
        "    </ssd:Elements>",
        *_connections(members.connections),
        "  </ssd:System>",
        *_units("ssd", units),
        f"  <ssd:DefaultExperiment{attributes(experiment)}>",
        "    <ssd:Annotations>",
        '      <ssc:Annotation type="com.opensimulationplatform">',
        "        <osp:Algorithm>",
        f"          <osp:FixedStepAlgorithm{attributes({'baseStepSize': members.step_s})}/>",
        "        </osp:Algorithm>",
        "      </ssc:Annotation>",
        "    </ssd:Annotations>",
        "  </ssd:DefaultExperiment>",
        "</ssd:SystemStructureDescription>",
    ]
    return "\n".join(lines) + "\n"


def parameter_set(member: Member) -> str:
    """Return the text of the SSV with the values that the scenario gives a member.

    Enumerations are left out where the FMU has them as its start values: libcosim ends the process at one.
    """
    variables = _settable(member)
    known = member.file.model.unit_table
    units = {v.unit: known[v.unit] for v in variables if v.unit in known}
    # one name for all: Ecos applies the sets of the name that it gets
    head = {"xmlns:ssv": _SSV, "xmlns:ssc": _SSC, "version": "1.0", "name": "start"}
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f"<ssv:ParameterSet{attributes(head)}>",
        "  <ssv:Parameters>",
        *(
            f"    <ssv:Parameter{attributes({'name': v.name})}>{_value(member, v)}</ssv:Parameter>"
            for v in variables
        ),
        "  </ssv:Parameters>",
        *_units("ssv", units),
        "</ssv:ParameterSet>",
    ]
    return "\n".join(lines) + "\n"


def _settable(member: Member) -> list[ScalarVariable]:
    variables = [member.file.variables[name] for name in member.start]
    return [v for v in variables if member.block is None or v.type != "Enumeration"]


def _component(member: Member, fed: Container[str]) -> list[str]:
    head = {
        "name": member.name,
        "description": member.file.model.description or None,
        "type": "application/x-fmu-sharedlibrary",
        "source": f"resources/{member.name}.fmu",
        "implementation": "CoSimulation",
    }
    lines = [f"      <ssd:Component{attributes(head)}>", "        <ssd:Connectors>"]
    for kind, port in _signals(member, fed):
        where = attributes({"name": port.name, "kind": kind, "description": port.description or None})
        unit = port.unit.name if port.unit is not None and port.unit.exponents is not None else None
        of_type = f"<ssc:{port.type}{attributes({'unit': unit})}/>"
        lines.append(f"          <ssd:Connector{where}>{of_type}</ssd:Connector>")
    lines.append("        </ssd:Connectors>")
    if _settable(member):
        binding = {"type": "application/x-ssp-parameter-set", "source": f"resources/{member.name}.ssv"}
        lines += [
            "        <ssd:ParameterBindings>",
            f"          <ssd:ParameterBinding{attributes(binding)}/>",
            "        </ssd:ParameterBindings>",
        ]
    return [*lines, "      </ssd:Component>"]


def _signals(member: Member, fed: Container[str]) -> list[tuple[str, Port]]:
    """The inputs in `fed` and all outputs, each with its kind.

    An input that nothing feeds keeps its start value; FMPy cannot load one that is listed, and libcosim
    knows no enumerations as connectors, so parameters are left to the SSV.
    """
    description = member.file.description
    inputs = [("input", p) for p in description.inputs if f"{member.name}.{p.name}" in fed]
    return inputs + [("output", p) for p in description.outputs]


def _connections(pairs: Iterable[tuple[str, str]]) -> list[str]:
    lines = []
    for source, target in pairs:
        (a, b), (c, d) = source.split(".", 1), target.split(".", 1)
        ends = {"startElement": a, "startConnector": b, "endElement": c, "endConnector": d}
        lines.append(f"      <ssd:Connection{attributes(ends)}/>")
    return ["    <ssd:Connections>", *lines, "    </ssd:Connections>"] if lines else []


def _value(member: Member, v: ScalarVariable) -> str:
    number = member.start[v.name] if v.type == "String" else member.number(v.name)
    kinds = {"Real": float, "Integer": int, "Boolean": bool, "String": str}
    if v.type == "Enumeration":
        items = {value: item for item, value in member.file.enumerations[v.name].items()}
        return f"<ssv:Enumeration{attributes({'value': items[int(number)]})}/>"
    unit = v.unit if v.unit in member.file.model.unit_table else None
    return f"<ssv:{v.type}{attributes({'value': kinds[v.type](number), 'unit': unit})}/>"


def _units(space: str, units: Mapping[str, UnitOf]) -> list[str]:
    lines = []
    for name, unit in sorted(units.items()):
        if unit.exponents is None:
            continue
        base: dict[str, object] = {k: e for k, e in zip(BASE, unit.exponents, strict=True) if e}
        base |= {
            k: v for k, v, usual in (("factor", unit.factor, 1.0), ("offset", unit.offset, 0.0)) if v != usual
        }
        lines.append(
            f"    <ssc:Unit{attributes({'name': name})}><ssc:BaseUnit{attributes(base)}/></ssc:Unit>"
        )
    return [f"  <{space}:Units>", *lines, f"  </{space}:Units>"] if lines else []
