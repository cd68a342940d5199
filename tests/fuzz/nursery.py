"""A small process from which others are forked to read MATLAB files: a fork of the tests' own is slow: it is large.

`python nursery.py FOLDER`, FOLDER that of `matlab_child`: for each line on stdin, a JSON list of the time that a child
may take [s] and what `matlab_child.main` is to be called with, it answers by a line with its exit code and its stderr.
"""

import json
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any


class Nursery:
    """That process. In place of `subprocess.run` it answers what a child that is started would."""

    def __init__(self, program: Path) -> None:
        command = [sys.executable, "-P", __file__, str(program.parent)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def run(self, command: list[str], timeout: float, **_: Any) -> subprocess.CompletedProcess[bytes]:
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None and stdout is not None
        print(json.dumps([timeout, *command[3:]]), file=stdin, flush=True)
        code, said = json.loads(stdout.readline())
        if code == -signal.SIGKILL:
            raise subprocess.TimeoutExpired(command, timeout)
        return subprocess.CompletedProcess(command, code, b"", said.encode())

    def __enter__(self) -> "Nursery":
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._process.communicate()  # the end of its stdin is its own


def forked(timeout: float, given: list[str]) -> tuple[int, str]:
    """Exit code and stderr of a child that reads a file; −SIGKILL where it took longer than `timeout` [s]."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            sys.stderr = os.fdopen(writing, "w")
            code = matlab_child.main(*given)
            sys.stderr.flush()
        finally:
            os._exit(code)
    os.close(writing)
    said, over = b"", time.monotonic() + timeout
    while select.select([reading], [], [], max(over - time.monotonic(), 0.0))[0]:
        if not (part := os.read(reading, 4096)):
            break
        said += part
    else:
        os.kill(child, signal.SIGKILL)
    os.close(reading)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), said.decode(errors="replace")


if __name__ == "__main__":
    sys.path.insert(0, sys.argv[1])
    import matlab_child

    while line := sys.stdin.readline():
        limit, *arguments = json.loads(line)
        print(json.dumps(forked(limit, arguments)), flush=True)
