"""Rules on the shared libraries of an FMU: there, for that platform, loadable elsewhere, exporting FMI."""

from __future__ import annotations

from pathlib import Path

from ..finding import Report
from ..open.description import ModelDescription
from ..open.images import FOLDERS, Image, ImageError, read_image

NEWEST_GLIBC = (2, 28)  #: of the oldest Linux distributions still supported
_SYSTEM_LIBRARIES = {
    "ELF": ("libc.so", "libm.so", "libdl.so", "libpthread.so", "librt.so", "ld-linux", "libgcc_s.so"),
    "PE": (
        "kernel32",
        "msvcrt",
        "ucrtbase",
        "api-ms-win",
        "user32",
        "advapi32",
        "ntdll",
        "ws2_32",
        "shell32",
    ),
    "Mach-O": ("/usr/lib/", "/System/Library/"),
}
#: Linker's own names, which every library may export.
_LINKER = {
    "_init",
    "_fini",
    "_edata",
    "_end",
    "__bss_start",
    "_etext",
    "__data_start",
    "edata",
    "end",
    "etext",
}

_BOTH = """GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance SetupExperiment
EnterInitializationMode ExitInitializationMode Terminate Reset GetReal GetInteger GetBoolean GetString
SetReal SetInteger SetBoolean SetString GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize
SerializeFMUstate DeSerializeFMUstate GetDirectionalDerivative"""
_ONLY = {
    "ModelExchange": """
EnterEventMode NewDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep SetTime
SetContinuousStates GetDerivatives GetEventIndicators GetContinuousStates GetNominalsOfContinuousStates""",
    "CoSimulation": """
SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep GetStatus GetRealStatus
GetIntegerStatus GetBooleanStatus GetStringStatus""",
}


def functions_of(interface: str) -> list[str]:
    """Return the names of the FMI 2.0 functions that a binary for `interface` must export."""
    return [f"fmi2{name}" for name in (_BOTH + " " + _ONLY[interface]).split()]


def check_binaries(d: ModelDescription, folder: Path, report: Report) -> None:
    """Look at every file below ``binaries/``; facts go into ``report.facts["binaries"]``."""
    binaries = folder / "binaries"
    platforms = sorted(p for p in binaries.iterdir() if p.is_dir()) if binaries.is_dir() else []
    if not platforms:
        if (folder / "sources").is_dir() and d.sources:
            report.notes.append("a source-code FMU without binaries: nothing was loaded")
        else:
            report.add("FMI2 2.1 binaries", "binaries", "there is no binary and no source", "pack a binary")
        return
    facts = report.facts.setdefault("binaries", {})
    for platform in platforms:
        known = FOLDERS.get(platform.name)
        if known is None:
            report.notes.append(f"binaries/{platform.name}: a platform this check does not know")
            continue
        for interface, attributes in d.interfaces.items():
            name = attributes.get("modelIdentifier", "") + known[2]
            image = _image(platform, name, interface, report)
            if image is not None:
                where = f"binaries/{platform.name}/{name}"
                facts[where] = _facts(image)
                _platform(image, known, where, report)
                _functions(image, interface, where, report)
                _needs(image, platform, where, report)


def _image(platform: Path, name: str, interface: str, report: Report) -> Image | None:
    """Read the library of an interface; None, with a finding, where there is none."""
    where = f"binaries/{platform.name}/{name}"
    if "/" in name or not (platform / name).is_file():
        there = ", ".join(sorted(p.name for p in platform.iterdir())) or "nothing"
        report.add(
            "FMI2 2.1 modelIdentifier",
            where,
            f"is not there for {interface}; the folder has {there}",
            "name the library as modelIdentifier says",
        )
        return None
    try:
        return read_image((platform / name).read_bytes())
    except ImageError as error:
        report.add("binary format", where, str(error), "compile the library again")
        return None


def _facts(image: Image) -> dict[str, object]:
    return {
        "format": image.format,
        "machine": image.machine,
        "needed": list(image.needed),
        "glibc": None if image.glibc is None else ".".join(map(str, image.glibc)),
        "exports": len(image.exports),
    }


def _platform(image: Image, known: tuple[str, str, str], where: str, report: Report) -> None:
    if image.format != known[0] or known[1] not in image.machine.split("+"):
        report.add(
            "FMI2 2.1 platform folder",
            where,
            f"is {image.format} for {image.machine}, the folder is for {known[0]}, {known[1]}",
            "put the library into the folder of its own platform",
        )


def _functions(image: Image, interface: str, where: str, report: Report) -> None:
    missing = sorted(set(functions_of(interface)) - set(image.exports))
    if missing:
        more = f" and {len(missing) - 4} more" if len(missing) > 4 else ""
        report.add(
            "FMI2 2.1.1 exported functions",
            where,
            f"does not export {', '.join(missing[:4])}{more}, which {interface} needs",
            "export every function of the interface, optional ones as stubs that return fmi2Error",
        )
    others = [n for n in image.exports if not n.startswith(("fmi2", "fmi3")) and n not in _LINKER]
    if others and image.format == "ELF":  # the other loaders keep each library's names apart
        report.add(
            "binary symbols",
            where,
            f"exports {len(others)} names beside FMI's ({', '.join(n[:40] for n in others[:4])}), "
            "which can clash with those of another library in the same process",
            "compile with -fvisibility=hidden",
        )


def _needs(image: Image, platform: Path, where: str, report: Report) -> None:
    system = _SYSTEM_LIBRARIES[image.format]
    beside = {p.name.lower() for p in platform.iterdir()}
    for library in image.needed:
        at_hand = library.rsplit("/", 1)[-1].lower() in beside
        if not at_hand and not any(library.lower().startswith(s.lower()) for s in system):
            report.add(
                "binary libraries",
                where,
                f"needs {library}, which is neither in the archive nor part of every system",
                "link it statically or pack it beside the library",
            )
    if image.glibc is not None and image.glibc > NEWEST_GLIBC:
        report.add(
            "binary glibc",
            where,
            f"needs glibc {'.'.join(map(str, image.glibc))}, newer than "
            f"{'.'.join(map(str, NEWEST_GLIBC))}: it does not load on older Linux systems",
            "compile on or for an older system",
        )
    if any(p.startswith("/") for p in image.search_path.split(":")):
        report.add(
            "binary search path",
            where,
            f"looks for libraries in {image.search_path}, a folder of the machine it was made on",
            "link without -rpath, or with $ORIGIN",
        )
