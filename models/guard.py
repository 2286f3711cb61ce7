"""Run a command that ends with the process that started this one: `python -I -S guard.py COMMAND ...`.

Standard input is a pipe of which that process holds the other end: it closes when the process ends, however
it ends. Then this process and everything that the command has started (one process group) is killed. It loads
nothing but `os`: it begins with every compilation.
"""

import _thread
import os
import sys


def _kill_with_parent() -> None:
    while os.read(0, 1):
        pass
    os.killpg(0, 9)


def main(command: list[str]) -> int:
    """Run `command` with no standard input; return its exit code, 128 + N where signal N ended it."""
    nothing = (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0)
    try:
        child = os.posix_spawnp(command[0], command, os.environ, file_actions=[nothing])
    except OSError as error:
        os.write(2, f"{command[0]}: {error.strerror}\n".encode("utf-8", "surrogateescape"))
        return 127
    _thread.start_new_thread(_kill_with_parent, ())
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return code if code >= 0 else 128 - code


if __name__ == "__main__":
    os._exit(main(sys.argv[1:]))
