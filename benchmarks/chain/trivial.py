"""The trivial FMU as a file, the plain C loop, and a chain of instances for it."""

from __future__ import annotations

import ctypes
import zipfile
from pathlib import Path

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

from interarea.fmu_build.write.compile import compile_library, host_platform
from interarea.fmu_build.write.sources import gather_sources

FOLDER = Path(__file__).resolve().parent
H = 0.01
GUID = "{3b1f1c52-5f0c-4a58-9d66-0f3a3a6a7f01}"
_DESCRIPTION = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="trivial" guid="{GUID}" variableNamingConvention="flat"
  description="dx/dt = u - x, y = x" author="interarea" version="1" generationTool="none">
  <CoSimulation modelIdentifier="trivial" canHandleVariableCommunicationStepSize="true"
    canInterpolateInputs="true" maxOutputDerivativeOrder="1" canGetAndSetFMUstate="true"
    canBeInstantiatedOnlyOncePerProcess="false"/>
  <DefaultExperiment startTime="0" stopTime="1" stepSize="{H}"/>
  <ModelVariables>
    <ScalarVariable name="u" description="input" valueReference="1" causality="input"
      variability="continuous">
      <Real start="0"/></ScalarVariable>
    <ScalarVariable name="y" description="output" valueReference="2" causality="output"
      variability="continuous">
      <Real/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="2" dependencies=""/></Outputs>
    <InitialUnknowns><Unknown index="2" dependencies=""/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""


def trivial_fmu(path: Path) -> Path:
    """Write the trivial FMU to `path` (compiled with the flags of every FMU here)."""
    binary = compile_library("trivial", gather_sources((FOLDER / "trivial.c",)), host_platform())
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", _DESCRIPTION)
        archive.write(binary, f"binaries/{host_platform()}/trivial{binary.suffix}")
    return path


def loop_library() -> ctypes.CDLL:
    """Return the plain C loop, compiled."""
    path = compile_library("chainloop", gather_sources((FOLDER / "loop.c",)), host_platform())
    return ctypes.CDLL(str(path))


def instances(fmu: Path, names: list[str]) -> list[FMU2Slave]:
    """Return initialised instances of an FMU, ready to step."""
    model = read_model_description(str(fmu))
    folder = extract(str(fmu))
    values = []
    for name in names:
        slave = FMU2Slave(
            guid=model.guid,
            unzipDirectory=folder,
            modelIdentifier=model.coSimulation.modelIdentifier,
            instanceName=name,
        )
        slave.instantiate()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        values.append(slave)
    return values
