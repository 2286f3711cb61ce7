"""Processes that are started do not outlive the one that started them, whatever ends it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from interarea.models.processes import begun, process_pool, processor_s, run_guarded

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and process groups")

GUARDED = """
    from interarea.models.processes import run_guarded
    run_guarded(["sh", "-c", "sleep 60 & echo $! > {file}; sleep 60"])
"""
SIDE_BY_SIDE = """
    import os, signal, threading
    from interarea.models.processes import run_guarded, side_by_side
    threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
    def call(k):
        run_guarded(["sh", "-c", "echo $$ > {file}; sleep 60"])
        open("{file}.again", "w")
    side_by_side(call, range(9))
"""
POOL = """
    import os, time
    from interarea.models.files import new_folder
    from interarea.models.processes import process_pool
    def begin():
        new_folder()
        open("{file}", "w").write(str(os.getpid()))
        time.sleep(60)
    with process_pool(2) as pool:
        pool.submit(begin)
        time.sleep(60)
"""
CHILD = """
    import os, subprocess, sys, time
    text = "import os, sys, time; from interarea.models.processes import end_with_parent as e; "
    text += "e(int(sys.argv[1])); open(sys.argv[2], 'w').write(str(os.getpid())); time.sleep(60)"
    subprocess.Popen([sys.executable, "-c", text, str(os.getpid()), "{file}"])
    time.sleep(60)
"""
CALLBACK = """
    import ctypes, os, signal, sys, time
    from interarea import __main__
    from interarea.cli import app
    back = ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGINT))
    def run(stops):
        back()  # the interrupt comes while C waits for Python
        time.sleep(60)
    app.main = run
    __main__.main()
"""

IMPORTED = """
    import sys
    from interarea import __main__
    from interarea.cli import app
    open("{file}.py", "w").write('\\n'.join([
        "import os, signal, time",
        "try:",
        "    os.kill(os.getpid(), signal.SIGTERM)",
        "    time.sleep(60)",
        "except BaseException:  # as who can do without a module in C whose loading was interrupted",
        "    print('swallowed', file=__import__('sys').stderr)",
        "time.sleep({goes_on_s})",
    ]))
    def run(stops):
        sys.path.insert(0, "{file}".rpartition("/")[0])
        __import__("{file}".rpartition("/")[2])
        sys.modules["time"].sleep(60)
    app.main = run
    __main__.main()
"""


def _started(text: str, file: Path) -> subprocess.Popen[bytes]:
    surroundings = {**os.environ, "TMPDIR": str(file.parent)}
    script = textwrap.dedent(text).replace("{file}", str(file))
    return subprocess.Popen([sys.executable, "-c", script], env=surroundings, stderr=subprocess.PIPE)


def _written(file: Path) -> int:
    """Return the process that a file names, once it is there."""
    assert _comes(lambda: file.exists() and bool(file.read_text().strip()))
    return int(file.read_text())


def _comes(is_so: Callable[[], bool]) -> bool:
    """Return whether something is so within 30 s, half of what each process here would live."""
    until = time.monotonic() + 30.0
    while not is_so() and time.monotonic() < until:
        time.sleep(0.02)
    return is_so()


def _lives(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("text", [GUARDED, POOL, CHILD], ids=["command", "pool", "own"])
def test_a_killed_process_takes_along_what_it_started(text: str, tmp_path: Path) -> None:
    main = _started(text, tmp_path / "pid")
    child = _written(tmp_path / "pid")
    main.kill()
    main.wait()
    assert _comes(lambda: not _lives(child))
    assert _comes(lambda: not list(tmp_path.glob("interarea-*"))), "a temporary folder stays"


def test_interrupted_side_by_side_ends_commands_and_begins_no_other(tmp_path: Path) -> None:
    main = _started(SIDE_BY_SIDE, tmp_path / "pid")
    assert main.wait(50) != 0  # before any of the commands would end
    assert not (tmp_path / "pid.again").exists()


def test_calls_begun_before_a_body_that_fails_end(tmp_path: Path) -> None:
    begin_s = time.monotonic()
    with pytest.raises(ZeroDivisionError), begun(run_guarded, [["sleep", "60"]] * 9):
        raise ZeroDivisionError
    assert time.monotonic() - begin_s < 50.0


def test_calls_begun_go_on_after_the_body_and_others_are_cancelled(tmp_path: Path) -> None:
    line = "echo a >> {0}.begun; sleep 1; echo a >> {0}.done"
    with begun(run_guarded, [["sh", "-c", line.format(tmp_path / "calls")]] * 99) as calls:
        assert _comes(lambda: (tmp_path / "calls.begun").exists())
    assert calls[-1].cancelled() and calls[0].result().returncode == 0
    assert (tmp_path / "calls.done").exists()


def test_an_interrupt_in_a_callback_comes_again(tmp_path: Path) -> None:
    main = _started(CALLBACK, tmp_path / "pid")
    _, said = main.communicate(timeout=50)
    assert main.returncode == 128 + signal.SIGINT and b"Exception ignored" not in said


@pytest.mark.parametrize("goes_on_s", [60, 0.01, 0])
def test_an_interrupt_that_an_import_swallows_comes_again(tmp_path: Path, goes_on_s: float) -> None:
    main = _started(IMPORTED.replace("{goes_on_s}", str(goes_on_s)), tmp_path / "loaded")
    _, said = main.communicate(timeout=50)
    assert main.returncode == 128 + signal.SIGTERM and said.count(b"swallowed") == 1


def test_a_pool_left_by_an_error_is_killed() -> None:
    begin_s = time.monotonic()
    with pytest.raises(ZeroDivisionError), process_pool(1) as pool:
        pool.submit(time.sleep, 60.0)
        raise ZeroDivisionError
    assert time.monotonic() - begin_s < 50.0


def test_a_command_gives_code_and_text() -> None:
    done = run_guarded(["sh", "-c", "echo a; echo b >&2; exit 3"])
    assert (done.returncode, done.stdout, done.stderr) == (3, "a\n", "b\n")
    assert run_guarded(["sh", "-c", "kill -9 $$"]).returncode == 128 + 9
    assert run_guarded(["/no/such/command"]).returncode == 127
    assert run_guarded(["cat"]).stdout == "", "standard input is empty, not the lifeline"
    with pytest.raises(subprocess.TimeoutExpired):
        run_guarded(["sleep", "60"], timeout_s=0.2)


def test_processor_time_counts_work_of_ended_children_but_no_waiting() -> None:
    """A child states its own processor time; a second of sleep costs nearly none."""
    busy = "import time\nwhile time.process_time() < 0.5: pass\nprint(time.process_time())"
    before = processor_s()
    time.sleep(1.0)
    waited = processor_s() - before
    own = float(
        subprocess.run([sys.executable, "-c", busy], capture_output=True, text=True, check=True).stdout
    )
    spent = processor_s() - before - waited
    assert waited < 0.5
    assert own <= spent + 0.02  # os.times counts in hundredths
