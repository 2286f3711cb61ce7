"""Pages that follow from what the package holds: public names, devices, variables of FMUs, the explorer.

A Sphinx extension: everything is written before the sources are read, into docs/generated (not kept by git)
and docs/site/static.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import typer
from written import written_page

import interarea as ia
from interarea.cli.app import COMMANDS, load
from interarea.command_help import EXAMPLES
from interarea.cosim.explorer.page import write_explorer
from interarea.fmu_build.write.cache import default_cache
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.concentrator import concentrator_block
from interarea.models.blocks.controller import Guard, controller_block
from interarea.models.blocks.detector import detector_block
from interarea.models.blocks.plant import plant_block
from interarea.models.blocks.pmu import pmu_block
from interarea.models.blocks.supervisor import supervisor_block
from interarea.models.blocks.variables import Block
from interarea.models.devices.document import diagram_text, range_text
from interarea.models.devices.library import library

FOLDER = Path(__file__).resolve().parent
GENERATED = FOLDER.parent / "generated"
_KINDS = {
    "grids": "Grids",
    "synthesis": "Controllers",
    "simulation": "Simulation",
    "exchange": "FMUs and SSPs",
}


def python_page() -> Iterator[str]:
    """Every public name, in the order of the front door, from its docstring."""
    yield "# Python"
    yield ""
    yield (
        "For those who write scripts. After this page you know every public name of "
        "`import interarea as ia`, with shapes, units, errors and an example. Other names may "
        "change without notice."
    )
    places = ia._PLACE  # module of each public name
    for module, title in (*_KINDS.items(), ("", "Objects and errors")):
        yield from ("", f"## {title}", "")
        for name, place in places.items():
            if (place == module) if module else (place not in _KINDS):
                kind = "autoclass" if isinstance(getattr(ia, name), type) else "autofunction"
                options = "   :members:\n   :no-index-entry:\n" if kind == "autoclass" else ""
                yield f"```{{eval-rst}}\n.. {kind}:: interarea.{name}\n{options}```\n"
    yield "Next: [the same on the command line](commands.md)."


def commands_page() -> Iterator[str]:
    """Every command with its arguments and options, from the command line itself."""
    yield "# Commands"
    yield ""
    yield (
        "For those who work in a terminal. After this page you know every command of `interarea` with its "
        "options. Exit code 0: success; 1: a requirement is not met (a certificate, a check, a single "
        "successful run of a sweep); 2: a user error, reported in one line."
    )
    for name, (_, line) in COMMANDS.items():
        command = load(name)
        context = typer.Context(command, info_name=name)
        usage = " ".join(command.collect_usage_pieces(context))
        yield from ("", f"## {name}", "", line, "")
        yield from (
            "```",
            f"interarea {name} {usage}",
            f"# {EXAMPLES[name]}",
            "```",
            "",
            "| argument | meaning |",
            "|---|---|",
        )
        for p in command.params:
            if not getattr(p, "hidden", False):
                long = ", ".join(p.opts) + (f" {p.metavar}" if p.metavar else "")
                shown = long if p.opts[0].startswith("-") else p.metavar or p.name.upper()
                words = getattr(p, "help", "") or ""
                default = (
                    ""
                    if p.default in (None, "", False, ()) or callable(p.default)
                    else f" (default: {p.default})"
                )
                yield f"| `{shown}` | {words}{default} |".replace("\n", " ")
    yield from ("", "## Environment", "", "| variable | meaning |", "|---|---|")
    yield from (f"| `{name}` | {words} |" for name, words in ENVIRONMENT.items())
    yield from ("", "Next: [a scenario's keys](../formats/scenario.md), or [the written files](written.md).")


#: variables of the environment that the package reads
ENVIRONMENT = {
    "INTERAREA_CACHE": "cache folder (FMUs, binaries, designs); default: the user's cache folder",
    "INTERAREA_DEBUG": "1: an error shows its place in the code instead of one line",
    "CC": "C compiler to use instead of zig",
    "XDG_CACHE_HOME": "parent of the user's cache folder (Linux, macOS); default: ~/.cache",
    "LOCALAPPDATA": "likewise (Windows)",
}


def devices_page() -> Iterator[str]:
    """Every device: diagram, parameters, records, validation."""
    yield "# Devices"
    yield ""
    yield (
        "For those who import or write a case: exciters, governors, stabilizers, limiters and compensators "
        "that a machine can have. After this page you know the key of each, its parameters and its "
        "signal flow. Each is one TOML file in `models/devices`; the C code, the import of PSS/E records "
        "and this page are generated from it."
    )
    for key, model in library().items():
        device = model.device
        yield from (
            "",
            f"## {device.name}",
            "",
            f'{device.title}: `kind = "{key}"` of a machine\'s {device.kind}.',
            "",
        )
        yield from ("```", diagram_text(device).strip("\n"), "```", "")
        yield from ("| parameter | unit | allowed | meaning |", "|---|---|---|---|")
        for p in device.parameters:
            cells = (f"`{p.name}`", p.unit, range_text(p), p.text)
            yield "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"
        yield from ("", f"Source: {'; '.join(device.sources)}. Compared with: {device.oracle or 'nothing'}.")
    yield from ("", "Next: [a device of your own](../own_device.md).")


def blocks() -> Iterator[tuple[str, Block]]:
    """One block of each kind that becomes an FMU."""
    yield "Plant", plant_block(ia.load_case("two-area-thesis"))
    yield "Channel", channel_block()
    yield "Concentrator of two signals", concentrator_block(2)
    yield "Detector of wrong signals, for three", detector_block(["G1_dw", "G2_dw", "G4_dw"])
    yield "Phasor measurement unit", pmu_block()
    signals, actuators = ["G2_dw", "G4_dw"], ["G4_vs"]
    one = (np.array([[-1.0]]), np.array([[1.0, -1.0]]), np.array([[0.1]]), np.zeros((1, 2)))
    guard = Guard({"G4_vs": "G4_dw"}, {"G4_vs": 0.5}, 0.01)
    yield "Controller", controller_block("controller", *one, signals, actuators, guard=guard)
    bank = {"both": one, "off": one}
    choice = ["off", "off", "off", "both"]
    yield "Supervisor of a bank of controllers", supervisor_block("bank", bank, choice, signals, actuators)


def variables_page() -> Iterator[str]:
    """The variables of the FMUs that the package builds, of one grid and of a channel."""
    yield "# Variables of the FMUs"
    yield ""
    yield (
        "For those who load an FMU in another tool. After this page you know name, role and unit of "
        "every variable. The plant's names contain the ids of the case; here those of `two-area-thesis`, "
        "where `G1` represents "
        "any machine. A controller's FMU has its signals as inputs and its actuators as outputs; here "
        "`G2_dw`, `G4_dw` and `G4_vs`. A closed loop in one FMU has the parameters of all as `MEMBER.NAME`."
    )
    for title, block in blocks():
        yield from ("", f"## {title}", "", "| variable | role | unit | meaning |", "|---|---|---|---|")
        yield from _rows(block)
    yield from ("", "Next: [the loop in another tool](../other_tools.md).")


def _rows(block: Block) -> Iterator[str]:
    first: set[str] = set()
    for v in block.table:
        kind = "".join("#" if c.isdigit() else c for c in v.name)  # one row for G1, G2, ...
        if kind in first:
            continue
        first.add(kind)
        cells = (f"`{v.name}`", v.role, v.unit, v.description)
        yield "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


def write_pages(pages: dict[str, Iterable[str]]) -> None:
    """Write what has changed, so that an unchanged page is not read again."""
    GENERATED.mkdir(exist_ok=True)
    for name, lines in pages.items():
        text = "\n".join(lines) + "\n"
        file = GENERATED / f"{name}.md"
        if not file.is_file() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


def _write_all(*_: object) -> None:
    write_pages(
        {
            "python": python_page(),
            "commands": commands_page(),
            "devices": devices_page(),
            "variables": variables_page(),
            "written": written_page(),
        }
    )
    (FOLDER / "static").mkdir(exist_ok=True)
    write_explorer("wide-area-damping", FOLDER / "static" / "explorer.html", cache=default_cache())


def setup(app: object) -> dict[str, bool]:
    """Sphinx calls this."""
    app.connect("config-inited", _write_all)  # type: ignore[attr-defined]
    return {"parallel_read_safe": True}
