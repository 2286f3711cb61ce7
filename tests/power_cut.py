"""A power cut, simulated: of a folder there stays what was forced to disk, of the rest what chance leaves.

    python power_cut.py DISK N sweep FILE.toml --out FOLDER ..

runs the command line until its N-th `os.fsync`, before which it is killed, and keeps in the folder DISK what
the others have forced to disk: the content of a file, the names in a folder. `cut` then puts FOLDER into a
state that a disk may have after the power was lost: a name that no fsync of its folder has made sure may be
there or not, new or removed, and what was not forced to disk of a content is cut off, zeros or garbage.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import signal
import stat
import sys
from pathlib import Path


class Disk:
    """What is certain of files and folders: contents by what identifies a file's state, names by folder."""

    def __init__(self, place: Path) -> None:
        self.place = place
        place.mkdir(exist_ok=True)

    def begin(self, folder: Path) -> None:
        """Note all that is in a folder and below as certain: it was there when the power came."""
        for one in [folder, *(p for p in folder.rglob("*") if p.is_dir())] if folder.is_dir() else ():
            for file in (p for p in one.iterdir() if p.is_file()):
                self._note(self.place / _state(file), file.read_bytes())
            self._note(self._names_of(one), self._listed(one))

    def forced(self, handle: int) -> None:
        """Note that a file or folder was forced to disk."""
        path = Path(f"/proc/self/fd/{handle}").readlink()
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            self._note(self._names_of(path), self._listed(path))
        else:
            self._note(self.place / _state(path), path.read_bytes())

    def names(self, folder: Path) -> dict[str, str]:
        """Return the names that are certain in a folder, each with the file here that has its content."""
        file = self._names_of(folder)
        return dict(json.loads(file.read_text())) if file.exists() else {}

    def content(self, path: Path) -> bytes | None:
        """Return the content of a file where it was forced to disk as it is now."""
        stored = self.place / _state(path)
        return stored.read_bytes() if stored.exists() else None

    def _listed(self, folder: Path) -> bytes:
        files = {p.name: _state(p) for p in folder.iterdir() if p.is_file()}
        stored = {name: state if (self.place / state).exists() else "" for name, state in files.items()}
        return json.dumps(stored).encode()

    def _names_of(self, folder: Path) -> Path:
        return self.place / hashlib.sha256(str(folder).encode()).hexdigest()[:24]

    @staticmethod
    def _note(path: Path, content: bytes) -> None:
        """The process may be killed here too: whole or not at all."""
        beside = path.with_name(path.name + "~")
        beside.write_bytes(content)
        beside.replace(path)


def _state(path: Path) -> str:
    """Name a file in its present state; what writes to it changes the name, what renames it does not."""
    result = path.stat()
    return f"{result.st_ino}-{result.st_size}-{result.st_mtime_ns}"


def cut(folder: Path, place: Path, chance: random.Random) -> int:
    """Put a folder into a state after a power cut, by the notes of a `Disk`; return what was lost."""
    disk, lost = Disk(place), 0
    for one in [folder, *(p for p in folder.rglob("*") if p.is_dir())]:
        certain = disk.names(one)
        present = {p.name: p for p in one.iterdir() if p.is_file()}
        after: dict[str, bytes] = {}
        for name in sorted({*certain, *present}):
            new = disk.content(present[name]) if name in present else None
            old = (disk.place / certain[name]).read_bytes() if certain.get(name) else None
            if name in certain and (name not in present or new != old) and chance.random() < 0.5:
                after[name] = _torn(b"", chance) if old is None else old  # the rename or removal is lost
                lost += 1
            elif name in present and (name in certain or chance.random() < 0.5):
                after[name] = _torn(present[name].read_bytes(), chance) if new is None else new
                lost += new is None
            elif name in present:
                lost += 1  # a name that was never made sure
        for path in present.values():
            path.unlink()
        for name, content in after.items():
            (one / name).write_bytes(content)
    shutil.rmtree(disk.place)
    return lost


def _torn(content: bytes, chance: random.Random) -> bytes:
    """Return what may be there of a content that was not forced to disk."""
    head = content[: chance.randint(0, len(content))]
    return head + chance.choice([b"", bytes(len(content) - len(head)), chance.randbytes(64)])


def main() -> None:
    """Run the command line as it is, but for the notes and its end."""
    disk, real = Disk(Path(sys.argv.pop(1))), os.fsync
    left = int(sys.argv.pop(1))
    disk.begin(Path(sys.argv[sys.argv.index("--out") + 1]).absolute())

    def noted(handle: int) -> None:
        nonlocal left
        left -= 1
        if not left:
            os.kill(os.getpid(), signal.SIGKILL)
        real(handle)
        disk.forced(handle)

    os.fsync = noted  # type: ignore[assignment]
    from interarea.cli.app import main as command_line

    command_line()


if __name__ == "__main__":
    main()
