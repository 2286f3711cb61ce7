"""The process in which an FMU's binary is loaded, started as a module: REQUEST RESULT PARENT.

Each topic writes a line when it begins and one when it is done, so that the
process that started this one knows where it died or hung.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

from interarea.models.processes import end_with_parent

from ..errors import FmuFileError
from ..finding import Report
from ..open.description import read_description
from ..open.fmi2 import CallFailed, Library
from ..open.real_code import RealCodeLibrary
from ..open.xml import read_xml
from . import declared as check_declared
from . import real_code as check_real_code
from . import runs as check_runs
from . import sensitivity as check_sensitivity

TOPICS: dict[str, Callable[[Library, check_runs.Tell], None]] = {
    "load": check_runs.load,
    "start values": check_runs.start_values,
    "reset": check_runs.reset,
    "two instances": check_runs.interleaved,
    "saved states": check_runs.replay,
    "step splitting": check_runs.split_steps,
    "dependencies": check_sensitivity.dependencies,
    "directional derivatives": check_sensitivity.directional,
    "declared abilities": check_declared.abilities,
    "one model": check_declared.one_model,
    "illegal calls": check_runs.illegal_calls,
}


def main(request_file: str, result_file: str) -> None:
    """Run the topics of the request: {folder, todo: [[interface, binary, topic], ...]}."""
    request = json.loads(Path(request_file).read_text(encoding="utf-8"))
    folder = Path(request["folder"])
    _no_core_dumps()
    libraries: dict[str, Any] = {}
    with Path(result_file).open("a", encoding="utf-8") as result:
        for interface, binary, topic in request["todo"]:
            _write(result, {"begin": [interface, topic]})
            reported: list[tuple[str, str, str, str]] = []
            try:
                if interface not in libraries:
                    libraries[interface] = None  # where it cannot be loaded, which is reported once
                    libraries[interface] = _library(interface, folder, Path(binary))
                topics = check_real_code.TOPICS if interface == check_real_code.INTERFACE else TOPICS
                if libraries[interface] is not None:
                    topics[topic](libraries[interface], lambda *f, rows=reported: rows.append(f))  # type: ignore[operator]
            except CallFailed as error:
                reported.append(
                    (
                        f"run: {topic}",
                        interface,
                        str(error),
                        "make this legal call work, or take back what the description declares",
                    )
                )
            except (OSError, AttributeError, FmuFileError) as error:
                reported.append(
                    (f"run: {topic}", interface, f"cannot be loaded: {error}", "link it for this platform")
                )
            _write(result, {"done": [interface, topic], "findings": reported})


def _library(interface: str, folder: Path, binary: Path) -> Library | RealCodeLibrary:
    if interface == check_real_code.INTERFACE:
        return RealCodeLibrary(binary)
    root = read_xml(folder / "modelDescription.xml", "modelDescription.xml", Report(""))
    return Library(read_description(root), interface, folder, binary)


def _write(result: TextIO, line: dict[str, Any]) -> None:
    result.write(json.dumps(line) + "\n")
    result.flush()


def _no_core_dumps() -> None:
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (ImportError, OSError, ValueError):
        return


if __name__ == "__main__":
    end_with_parent(int(sys.argv[3]))
    main(*sys.argv[1:3])
