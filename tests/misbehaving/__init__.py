"""An FMU in C that misbehaves on demand (misbehaving.c), for the tests of the master."""

from __future__ import annotations

import zipfile
from pathlib import Path

from interarea.fmu_build.write.compile import compile_library, host_platform
from interarea.fmu_build.write.sources import fmi_headers

_SOURCE = Path(__file__).parent / "misbehaving.c"
_DEGREES = (
    '<UnitDefinitions><Unit name="deg"><BaseUnit rad="1" factor="0.017453292519943295"/></Unit>'
    "</UnitDefinitions>"
)
TIMES = ("early_at", "kick", "longest", "end_at", "nan_at", "abort_at", "back_at", "hang_at", "warn_at")
PARAMETERS = (*TIMES, "alone", "x0")


def misbehaving_fmu(folder: Path, *, saves_state: bool = True, unit: str = "", once: bool = False) -> Path:
    """Build the FMU in `folder`; `unit` of its input (deg is defined, others are not).

    once : whether its description allows one instance in a process only.
    """
    platform = host_platform()
    names = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
    sources = {name: (fmi_headers() / name).read_bytes() for name in names}
    library = compile_library("misbehaving", {**sources, "misbehaving.c": _SOURCE.read_bytes()}, platform)
    variables = [
        '<ScalarVariable name="u" valueReference="0" causality="input">'
        f'<Real start="0"{_unit(unit)}/></ScalarVariable>',
        '<ScalarVariable name="y" valueReference="1" causality="output"><Real/></ScalarVariable>',
    ]
    for k, name in enumerate(PARAMETERS, start=2):
        start = "0" if name in ("kick", "x0") else "1e30"
        variables.append(
            f'<ScalarVariable name="{name}" valueReference="{k}" causality="parameter" '
            f'variability="fixed"><Real start="{start}"/></ScalarVariable>'
        )
    saves = str(saves_state).lower()
    text = (
        '<?xml version="1.0" encoding="UTF-8"?>'
        '<fmiModelDescription fmiVersion="2.0" modelName="misbehaving" guid="{misbehaving}">'
        '<CoSimulation modelIdentifier="misbehaving" canHandleVariableCommunicationStepSize="true" '
        'canInterpolateInputs="true" maxOutputDerivativeOrder="1" '
        f'canGetAndSetFMUstate="{saves}" canBeInstantiatedOnlyOncePerProcess="{str(once).lower()}"/>'
        f"{_DEGREES if unit == 'deg' else ''}"
        f"<ModelVariables>{''.join(variables)}</ModelVariables>"
        '<ModelStructure><Outputs><Unknown index="2" dependencies=""/></Outputs>'
        '<InitialUnknowns><Unknown index="2" dependencies=""/></InitialUnknowns></ModelStructure>'
        "</fmiModelDescription>"
    )
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "misbehaving.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.write(library, f"binaries/{platform}/misbehaving{library.suffix}")
    return path


def _unit(name: str) -> str:
    return f' unit="{name}"' if name else ""
