"""Files that are whole or not there, temporary folders that end with their process."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from interarea.models import files
from interarea.models.files import (
    new_folder,
    one_at_a_time,
    remove_left,
    sweep,
    temporary_folder,
    temporary_root,
    write_whole,
)

MAKES_ONE = """
import sys, time
from pathlib import Path
from interarea.models.files import new_folder
folder = new_folder(Path(sys.argv[1]))
(folder / "data").write_bytes(b"x" * 1000)
print(folder, flush=True)
if len(sys.argv) > 2:
    time.sleep(60)
"""


def in_a_process(parent: Path, *more: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", MAKES_ONE, str(parent), *more], stdout=subprocess.PIPE, text=True
    )


def test_a_process_leaves_nothing_behind(tmp_path: Path) -> None:
    process = in_a_process(tmp_path)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 0 and Path(said.strip()).parent.parent == tmp_path
    assert list(tmp_path.iterdir()) == []


def _child(parent: Path) -> None:
    (new_folder(parent) / "data").write_bytes(b"x")


@pytest.mark.slow
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_child_process_leaves_nothing_behind(tmp_path: Path, method: str) -> None:
    """A child of multiprocessing ends without atexit; a forked one must not remove what its parent has."""
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {method} here")
    folder = new_folder(tmp_path)
    child = multiprocessing.get_context(method).Process(target=_child, args=(tmp_path,))
    child.start()
    child.join(60)
    assert child.exitcode == 0 and folder.is_dir()
    assert list(tmp_path.iterdir()) == [folder.parent]


def test_what_a_killed_process_left_goes_at_the_next_start(tmp_path: Path) -> None:
    process = in_a_process(tmp_path, "and stays")
    assert process.stdout is not None
    left = Path(process.stdout.readline().strip())
    assert sweep(tmp_path) == 0 and left.is_dir()  # it lives
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    assert left.is_dir()
    own = new_folder(tmp_path)
    assert own.is_dir() and not left.parent.exists()


def test_a_folder_that_is_about_to_be_locked_is_left_alone(tmp_path: Path) -> None:
    young, old = tmp_path / "interarea-1-young", tmp_path / "interarea-1-old"
    for folder in (young, old):
        folder.mkdir()
    os.utime(old, (time.time() - 3600.0,) * 2)
    assert sweep(tmp_path) == 1 and young.is_dir() and not old.exists()


def test_a_temporary_folder_goes_with_its_block(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), temporary_folder(tmp_path) as folder:
        (folder / "below").mkdir()
        raise ZeroDivisionError
    assert not folder.exists()


def test_a_file_is_the_old_or_the_new_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_whole(tmp_path / "below" / "a.txt", "old")
    synced: list[int] = []
    monkeypatch.setattr(files.os, "fsync", synced.append)
    write_whole(path, b"new")
    assert path.read_text() == "new" and len(synced) >= 1

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_whole(path, "half")
    assert path.read_text() == "new" and list(path.parent.iterdir()) == [path]


WRITES_ONE = """
import sys, time
from pathlib import Path
from interarea.models.files import Partial
partial = Partial(Path(sys.argv[1]))
partial.file.write(b"half")
partial.file.flush()
print("there", flush=True)
time.sleep(60)
"""


def test_what_a_killed_process_was_writing_goes_at_the_next_start(tmp_path: Path) -> None:
    """Not while it lives, and nothing that only looks like it."""
    letter = tmp_path / ".letter.partial"
    letter.write_text("dear")
    command = [sys.executable, "-c", WRITES_ONE, str(tmp_path / "a.txt")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "there\n"
    (left,) = tmp_path.glob(".a.txt-*.partial")
    assert f"-{process.pid}-" in left.name and left.read_bytes() == b"half"
    remove_left(tmp_path)
    assert left.exists()
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    path = write_whole(tmp_path / "b.txt", "new")
    assert sorted(tmp_path.iterdir()) == [letter, path]


def test_a_disk_without_locks_is_written_to_and_nothing_there_is_taken_for_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fcntl = pytest.importorskip("fcntl")

    def none(*_: object) -> None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    monkeypatch.setattr(fcntl, "flock", none)
    other = tmp_path / ".c.txt-1-abcdefgh.partial"
    other.write_text("of a process that may live elsewhere")
    path = write_whole(tmp_path / "b.txt", "new")
    assert sorted(tmp_path.iterdir()) == [other, path] and path.read_text() == "new"
    assert new_folder(tmp_path).is_dir()


INSIDE = """
import sys, time
from pathlib import Path
from interarea.models.files import one_at_a_time
for _ in range(20):
    with one_at_a_time(Path(sys.argv[1])):
        for what in ("in", "out"):
            with open(sys.argv[2], "a") as log:
                log.write(f"{what}\\n")
            time.sleep(0.002)
"""


def test_of_three_processes_one_at_a_time_is_inside_and_nothing_is_left(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    lock, log = tmp_path / "x.lock", tmp_path / "log"
    words = [sys.executable, "-c", INSIDE, str(lock), str(log)]
    assert [p.wait() for p in [subprocess.Popen(words) for _ in range(3)]] == [0, 0, 0]
    assert log.read_text().split() == ["in", "out"] * 60
    assert list(tmp_path.iterdir()) == [log]


def test_who_is_killed_inside_keeps_nobody_out(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    lock, log = tmp_path / "x.lock", tmp_path / "log"
    code = INSIDE.replace("0.002", "60.0")
    killed = subprocess.Popen([sys.executable, "-c", code, str(lock), str(log)])
    while not log.exists():
        time.sleep(0.01)
    killed.kill()
    killed.wait()
    with one_at_a_time(lock):
        assert lock.exists()
    assert not lock.exists()


def test_where_nothing_can_be_locked_nobody_waits(tmp_path: Path) -> None:
    with one_at_a_time(tmp_path / "no" / "such folder"):
        assert list(tmp_path.iterdir()) == []


def test_what_is_no_file_is_written_to() -> None:
    """A pipe or /dev/stdout cannot be replaced by a new file."""
    code = "from interarea.models.files import write_whole; write_whole('/dev/stdout', 'text')"
    if not Path("/dev/stdout").exists():
        pytest.skip("no /dev/stdout here")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "text"


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals cannot be held there")
def test_a_signal_leaves_nothing_of_the_trial_of_the_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes after the file by which Python tries the folder is made, before that is removed."""
    unlink, before = os.unlink, signal.signal(signal.SIGTERM, signal.default_int_handler)

    def late(path: str) -> None:
        signal.raise_signal(signal.SIGTERM)
        unlink(path)

    monkeypatch.setattr(os, "unlink", late)
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    try:
        with pytest.raises(KeyboardInterrupt):
            temporary_root()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert not list(tmp_path.iterdir())
    assert temporary_root() == tmp_path


@pytest.mark.skipif(not hasattr(os, "fork"), reason="starts processes by fork")
def test_an_interrupt_at_any_line_leaves_no_temporary_folder(tmp_path: Path) -> None:
    """The folder of a process goes at its end, also if an interrupt comes while it is being made."""
    code = """
import os, sys
from pathlib import Path
from interarea.models import files

root = Path(sys.argv[1])
def interrupted(at):
    left = [at]
    def trace(frame, event, _):
        if frame.f_code.co_filename != files.__file__:
            return None
        if event == "line":
            left[0] -= 1
            if left[0] == 0:
                sys.settrace(None)
                raise KeyboardInterrupt
        return trace
    sys.settrace(trace)
    try:
        files.new_folder(root)
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(None)
    return False

for at in range(1, 200):
    child = os.fork()
    if not child:
        sys.exit(3 if interrupted(at) else 0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if list(root.iterdir()):
        sys.exit(f"line {at}: left {list(root.iterdir())}")
    if code == 0:
        print(at)
        break
"""
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 20  # lines that ran before the folder was there
