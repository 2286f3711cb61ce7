"""Load and run an FMU's binary in a process of its own: one that crashes or hangs is a finding."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

from interarea.models.files import temporary_folder

from ..errors import FmuFileError
from ..finding import Report
from ..open.description import ModelDescription
from ..open.fmu_file import host_folders
from ..open.images import FOLDERS, Image

TIMEOUT_S = 120.0  #: for the topics of one process
_TOPICS = (
    "load",
    "start values",
    "reset",
    "two instances",
    "saved states",
    "step splitting",
    "dependencies",
    "directional derivatives",
    "declared abilities",
    "one model",
    "illegal calls",
)


def check_running(d: ModelDescription, folder: Path, report: Report, *, timeout_s: float = TIMEOUT_S) -> None:
    """Run every topic of the check on the binary for this machine, if there is one."""
    todo: list[list[str]] = []
    for interface, attributes in d.interfaces.items():
        binary = _binary(folder, attributes.get("modelIdentifier", ""))
        if attributes.get("needsExecutionTool", "false") in ("true", "1"):
            report.notes.append(f"{interface} needs an execution tool: it was not run")
            report.not_run.append(f"{interface} needs an execution tool")
        elif binary is None:
            report.notes.append(f"{interface}: no binary for this machine: it was not run")
            report.not_run.append(f"{interface} has no binary for this machine")
        else:
            todo += [[interface, str(binary), topic] for topic in _TOPICS]
    run_topics(todo, folder, report, timeout_s)


def run_topics(todo: list[list[str]], folder: Path, report: Report, timeout_s: float) -> None:
    """Run topics ([interface, binary, topic]) in processes of their own: one that dies ends no other."""
    ran = report.facts.setdefault("topics", [])
    while todo:
        done = _run(todo, folder, report, timeout_s)
        ran += [f"{interface}: {topic}" for interface, _, topic in todo[:done]]
        last, todo = todo[done - 1], todo[done:]
        if _hopeless(report, last[0]):
            # what cannot be loaded cannot be run; what hung, or crashed twice, will do so again
            todo = [t for t in todo if t[0] != last[0]]


def _host_folders() -> tuple[str, ...]:
    """`host_folders`, none where no binary is made for this machine."""
    try:
        return host_folders()
    except FmuFileError:
        return ()


def loadable_on_host(image: Image) -> bool:
    """Return whether this machine can load a library."""
    return not set(image.folders).isdisjoint(_host_folders())


def _binary(folder: Path, identifier: str) -> Path | None:
    files = (folder / "binaries" / name / (identifier + FOLDERS[name][2]) for name in _host_folders())
    return next((file for file in files if file.is_file()), None)


def _hopeless(report: Report, interface: str) -> bool:
    bad = [f for f in report.findings if f.where == interface and f.rule.startswith("run:")]
    return any(f.rule == "run: load" or "hangs" in f.message for f in bad) or len(bad) >= 2


def _run(todo: list[list[str]], folder: Path, report: Report, timeout_s: float) -> int:
    """Run topics in one process; return how many of them are over (at least one)."""
    with temporary_folder() as scratch:
        request, result = scratch / "request.json", scratch / "result.jsonl"
        request.write_text(json.dumps({"folder": str(folder.resolve()), "todo": todo}), encoding="utf-8")
        result.touch()
        command = [sys.executable, "-m", "interarea.fmu_build.check.probe"]
        command += [str(request), str(result), str(os.getpid())]
        try:
            process = subprocess.run(
                command,
                cwd=scratch,
                env={**os.environ, "PYTHONFAULTHANDLER": ""},
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=timeout_s,
                check=False,
            )
            code, errors = process.returncode, process.stderr.decode("utf-8", "replace").strip()
        except subprocess.TimeoutExpired:
            code, errors = None, ""
        over = 0
        for line in result.read_text(encoding="utf-8").splitlines():
            entry = json.loads(line)
            if "done" in entry:
                over += 1
                for rule, where, message, fix in entry["findings"]:
                    report.add(rule, _in(where, entry["done"][0]), message, fix)
    if over == len(todo):
        return over
    interface, _, topic = todo[over]
    report.add(
        f"run: {topic}", interface, _ending(code, errors, timeout_s), "debug the binary at this call sequence"
    )
    return over + 1


def _in(where: str, interface: str) -> str:
    return where if where == interface else f"{interface} {where}"


def _ending(code: int | None, message: str, timeout_s: float) -> str:
    if code is None:
        return f"the binary hangs: no answer after {timeout_s:g} s"
    if code < 0:
        try:
            return f"the binary crashes ({signal.Signals(-code).name})"
        except ValueError:
            return f"the binary crashes (signal {-code})"
    last = message.splitlines()[-1] if message else ""
    return f"the process ended with code {code}" + (f": {last}" if last else "")
