"""Stop commands by signals at random moments; count what goes on afterwards and what is left.

    python tests/faults/signals.py --times 20

Every command that starts a process, and `compare`, which spends its time in an FMU's callbacks, gets SIGINT,
SIGTERM, SIGHUP and SIGKILL, sent to its own process alone after so much processor time. Five seconds later no
process may live that it has started; its temporary folder is empty (after SIGKILL: once the next command has
run); every file under its name is whole. Those of `EMPTY_CACHE` begin with an empty cache, so that compilers
run. Of a process that lives on it says how much processor time it had since, which is little on a busy
machine, and where it is.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
import uuid
import zipfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

import pyarrow.parquet as pq

sys.path.append(str(Path(__file__).resolve().parents[1]))
from misbehaving import misbehaving_fmu

from interarea.fmu_build.open.images import read_image

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGKILL")
LIMIT_S = 5.0
LONGEST_WAIT_S = 60.0  #: for a command that waits for others, or for its turn
_MARK = "INTERAREA_SIGNAL_TEST"  # in the environment of all that a command starts

#: command -> its words; {files} holds what `prepare` wrote, {out} is a new folder
COMMANDS = {
    "run": "run {files}/foreign.toml --out {out}",
    "isolate": "run {files}/isolated.toml --out {out}",
    "compare": "compare none robust --scenario ring-down --out {out}",
    "sweep": "sweep {files}/sweep.toml --workers 2 --out {out}",
    "study": "study thesis --out {out}",
    "build": "build two-area-thesis --out {out}",
    "ssp": "ssp ring-down --out {out}/a.ssp",
    "dll": "build two-area-thesis --controller robust --dll linux64,win64 --out {out}",
    "grid": "study two-area-thesis --minutes 1 --out {out}",
    "check": "check {files}/two-area-thesis.fmu",
    "modes": "modes two-area-thesis",
    "loops": "loops two-area-thesis",
    "certify": "certify robust",
    "design": "design robust --out {out}/robust.json",
    "screen": "screen two-area-thesis --workers 2 --out {out}",
    "maps": "maps {files}/swept --workers 2 --out {out}/maps.html",
    "container": "container lost-signal --out {out}/loop.fmu",
    "explore": "explore two-area-thesis --out {out}/page.html",
    "of-grid": "design two-area-thesis --minutes 1 --out {out}/made.json",
    "worth": "study worth --grid two-area-thesis --minutes 1 --out {out}",
    "actuators": "study actuators --grid two-area-thesis --actuator exciter --out {out}",
    "inverters": "study inverters --grid two-area-thesis --minutes 1 --out {out}",
    "wrong": "study wrong-signals --controller robust --points 1 --out {out}",
    "meter": "meter {files}/run/trajectory.parquet --case two-area-thesis",
    "locate": "locate {files}/run/trajectory.parquet --case two-area-thesis",
    "fit": "fit {files}/terminal/trajectory.parquet --case two-area-thesis --machine G1 --parameters H,Xd1",
    "fetch": "import npcc --out {out}/npcc.toml",
}
EMPTY_CACHE = {"study", "build", "ssp", "dll", "modes", "loops", "certify", "design", "container", "explore"}
FROM_REGISTRY = {"fetch"}  #: commands that ask the package registry
LONGEST_S = {
    "study": 40.0,
    "build": 20.0,
    "ssp": 20.0,
    "dll": 20.0,
    "grid": 20.0,
    "certify": 20.0,
    "design": 40.0,
    "of-grid": 20.0,
    "worth": 20.0,
    "actuators": 20.0,
    "inverters": 20.0,
    "wrong": 20.0,
}  # processor time before the signal; others 6 s

_SWEEP = """
[scenario]
case = "two-area-thesis"
controller = "none"
stop_s = 5.0
step_s = 0.02
[[scenario.event]]
kind = "vref_pulse"
machine = "G1"
size_pu = 0.05
start_s = 0.5
end_s = 0.7
[parameters.size]
path = "event.1.size_pu"
range = { start = 0.01, stop = 0.05, count = 2000 }
"""


def _heed_signals() -> None:
    """Let the command heed what this process may have been started to ignore, as `nohup` has it."""
    for number in ("SIGINT", "SIGTERM", "SIGHUP"):
        signal.signal(getattr(signal, number), signal.SIG_DFL)


#: what `fit` needs of G1: the voltage at its bus and the power in its branch, after a disturbance elsewhere
_TERMINAL = """
case = "two-area-thesis"
controller = "none"
stop_s = 12.0
show = ["bus1.re", "bus1.im", "branch[1-5].p", "branch[1-5].q"]
[[event]]
kind = "vref_pulse"
machine = "G2"
size_pu = 0.05
start_s = 1.0
end_s = 3.0
"""


def prepare(files: Path) -> None:
    """Write what the commands read, and fill the default cache."""
    fmu = misbehaving_fmu(files)
    for name, more in (("foreign", ""), ("isolated", "isolate = true\n")):
        table = f'[fmus.own]\nfile = "{fmu.as_posix()}"\n{more}start = {{ u = 1.0 }}\n'
        (files / f"{name}.toml").write_text(f"stop_s = 2e4\nstep_s = 0.05\n{table}", encoding="utf-8")
    (files / "sweep.toml").write_text(_SWEEP, encoding="utf-8")
    (files / "few.toml").write_text(_SWEEP.replace("2000", "4"), encoding="utf-8")
    few = ["sweep", str(files / "few.toml"), "--out", str(files / "swept")]
    subprocess.run(_command(few), check=True, capture_output=True)
    subprocess.run(_command(["build", "two-area-thesis", "--out", str(files)]), check=True)
    (files / "terminal.toml").write_text(_TERMINAL, encoding="utf-8")
    for scenario, folder in (("ring-down", "run"), (str(files / "terminal.toml"), "terminal")):
        few = ["run", scenario, "--out", str(files / folder)]
        subprocess.run(_command(few), check=True, capture_output=True)
    subprocess.run(
        _command(COMMANDS["compare"].format(out=files / "compared").split()), check=True, capture_output=True
    )


def stopped(name: str, number: str, files: Path, wait_s: float) -> list[str]:
    """Start a command, send it a signal after `wait_s` of processor time; return what is wrong afterwards.

    Of its own and of what it starts: on a busy machine it is as far then as on an idle one.
    """
    mark = uuid.uuid4().hex
    with tempfile.TemporaryDirectory(prefix="signals-") as folder:
        out, own, cache = (Path(folder) / n for n in ("out", "tmp", "cache"))
        for target in (out, own):
            target.mkdir()
        surroundings = {**os.environ, _MARK: mark, "TMPDIR": str(own), "PYTHONFAULTHANDLER": "1"}
        if name in EMPTY_CACHE:
            surroundings["INTERAREA_CACHE"] = str(cache)
        words = COMMANDS[name].format(files=files, out=out).split()
        said = Path(folder) / "said"
        with said.open("wb") as errors:
            main = subprocess.Popen(
                _command(words),
                stdout=errors,
                stderr=errors,
                env=surroundings,
                start_new_session=True,
                preexec_fn=_heed_signals,
            )
            started_s = time.monotonic()
            while main.poll() is None and time.monotonic() < started_s + LONGEST_WAIT_S:
                if sum(map(processor_s, living(mark))) >= wait_s:
                    break
                time.sleep(0.05)
            used_s = {process: processor_s(process) for process in living(mark)}
            sent_s = time.monotonic()
            main.send_signal(getattr(signal, number))
            try:
                code = main.wait(LIMIT_S)
            except subprocess.TimeoutExpired:
                code = None
        while (alive := living(mark)) and time.monotonic() < sent_s + LIMIT_S:
            time.sleep(0.05)
        since_s = {process: processor_s(process) - used_s.get(process, 0.0) for process in alive}
        wrong = [
            f"lives {LIMIT_S:g} s later, {since_s[process]:.1f} s of processor: {line}"
            for process, line in alive.items()
        ]
        for number_of_death in (signal.SIGABRT, signal.SIGKILL):  # the first prints where Python is
            for process in alive:
                with suppress(ProcessLookupError):
                    os.kill(process, number_of_death)
            time.sleep(0.5 if alive else 0.0)
        main.wait()
        sent = getattr(signal, number)
        expected = (0, 128 + sent, -sent)  # the last: before the program began, or after it
        text = said.read_text(encoding="utf-8", errors="replace")
        begun = (
            "<frozen runpy>" not in text or "__main__.py" in text
        )  # else Python still looks for the package
        begun = begun and (
            (number, code) != ("SIGINT", 1) or "__main__.py" in text or "interarea: stopped" in text
        )
        if code not in expected and code is not None and begun:  # else it has met Python's own start
            wrong.append(f"exit code {code}: {text[-300:]}")
        if alive:
            wrong.append(text.partition("Extension modules")[0][-2000:])  # where it was
        if begun and ("Traceback" in text or "Exception ignored" in text):
            wrong.append(f"a traceback: {text[-600:]}")
        if number == "SIGKILL":  # what it could not remove goes with the next command, whichever it is
            subprocess.run(_command(["list"]), env=surroundings, check=True, capture_output=True)
            after = "from interarea.models.files import temporary_folder as t\nwith t(): pass"
            subprocess.run([sys.executable, "-c", after], env=surroundings, check=True)
        else:
            wrong += [f"left: {p.relative_to(folder)}" for p in out.rglob("*.partial")]
        wrong += [f"left: {path.name}" for path in own.iterdir()]
        wrong += [f"not whole: {p.name}" for p in out.rglob("*") if p.is_file() and not whole(p)]
    return wrong


def _command(words: Sequence[str]) -> list[str]:
    return [sys.executable, "-m", "interarea", *words]


def processor_s(process: int) -> float:
    """Return the processor time of a process and of its ended children, s; 0 of one that is gone (Linux)."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def living(mark: str) -> dict[int, str]:
    """Return process -> its command line, of those that have `mark` in their environment (Linux)."""
    result = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            with suppress(OSError):
                if f"{_MARK}={mark}".encode() in (entry / "environ").read_bytes().split(b"\0"):
                    words = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode("utf-8", "replace")
                    if words:  # else it has ended and nobody has asked for its exit code
                        result[int(entry.name)] = words[:200]
    return result


def whole(path: Path) -> bool:
    """Whether a file under its final name can be read to its end."""
    if path.name.startswith("."):  # without a name of its own yet, or a lock
        return True
    kinds: dict[str, Callable[[], object]] = {
        ".json": lambda: json.loads(path.read_text(encoding="utf-8")),
        ".toml": lambda: tomllib.loads(path.read_text(encoding="utf-8")),
        ".parquet": lambda: pq.read_table(path),
        ".svg": lambda: ElementTree.parse(path),
        ".csv": lambda: list(csv.reader(path.open(encoding="utf-8"), strict=True)),
        ".html": lambda: _require(path.read_text(encoding="utf-8").rstrip().endswith("</html>")),
        ".dll": lambda: read_image(path.read_bytes()),
        ".fmu": lambda: _require(zipfile.ZipFile(path).testzip() is None),
    }
    kinds |= {".ssp": kinds[".fmu"], ".so": kinds[".dll"]}
    try:
        kinds.get(path.suffix, lambda: None)()
    except Exception:  # whatever its reader raises
        return False
    return True


def _require(holds: bool) -> None:
    if not holds:
        raise ValueError


def main() -> None:
    """Send every signal to every command as often as is asked; exit code 1 if anything does not hold."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--command", action="append", choices=COMMANDS)
    parser.add_argument("--signal", action="append", choices=SIGNALS)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    chance, files, total = random.Random(options.seed), Path(tempfile.mkdtemp(prefix="signals-")), 0
    try:
        prepare(files)
        for name in options.command or COMMANDS:
            for number in options.signal or SIGNALS:
                bad = 0
                for _ in range(options.times):
                    wait_s = chance.uniform(0.0, LONGEST_S.get(name, 6.0))
                    if wrong := stopped(name, number, files, wait_s):
                        bad += 1
                        when = f"after {wait_s:.2f} s of processor"
                        print(f"{name} {number} {when}: " + "; ".join(wrong), flush=True)
                print(f"{name} {number}: {options.times} times, {bad} bad", flush=True)
                total += bad
    finally:
        shutil.rmtree(files, ignore_errors=True)
    sys.exit(1 if total else 0)


if __name__ == "__main__":
    main()
