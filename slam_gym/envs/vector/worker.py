"""Worlds in a process of its own: what the process does, and the handle by which another one speaks to it.

The two speak over the process' standard input and output, one answer to every request. That works on every system and
needs no guard around the caller's main module, which the process does not import; it ends when its input does, however
its parent came to its end.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import traceback
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import cloudpickle

from slam_gym.envs.vector.buffers import Layout, opened
from slam_gym.envs.vector.worlds import Making, WorldError, Worlds

_START = "import sys; sys.path[:] = {path!r}; from slam_gym.envs.vector.worker import main; main()"
_PATIENCE = 5.0  # [s] that a process is given to end
_LENGTH = 8  # bytes before a message, which tell how many it has
_CHUNK = 1 << 16  # bytes read at once


class WorkerWorlds:
    """`Worlds` in another process. A request is sent at once, its answer fetched by `answer`: so several work at a
    time."""

    def __init__(self, making: Making, rows: range, layout: Layout, block: Path, *, niceness: int = 0) -> None:
        self._rows = rows
        start = [sys.executable, "-c", _START.format(path=[str(Path(p).resolve()) for p in sys.path])]
        self._process = subprocess.Popen(start, bufsize=0, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._end = weakref.finalize(self, _end, self._process)
        self._send(cloudpickle.dumps((making, rows, layout, block, niceness)))

    def request(self, name: str, *arguments: Any) -> None:
        """Have a method of the worlds called."""
        dumps = pickle.dumps if name == "step" else cloudpickle.dumps  # which takes ten times as long
        self._send(dumps((name, arguments)))

    def answer(self) -> Any:
        """What the last request, or the making of the worlds, came to.

        Raises WorldError where something was raised there, RuntimeError where the process is no more.
        """
        assert self._process.stdout is not None
        try:
            done, value = pickle.loads(_read(self._process.stdout))
        except (EOFError, pickle.UnpicklingError, OSError):
            raise self._lost() from None
        if done:
            return value
        raise value

    def close(self) -> None:
        """End the process."""
        self._end()

    def _send(self, message: bytes) -> None:
        assert self._process.stdin is not None
        try:
            _write(self._process.stdin, message)
        except (BrokenPipeError, OSError, ValueError):
            raise self._lost() from None

    def _lost(self) -> RuntimeError:
        code = None
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._process.wait(_PATIENCE)
        worlds = f"worlds {self._rows[0]} … {self._rows[-1]}"
        return RuntimeError(f"the process of {worlds} has ended (exit status {code}): make the environment anew")


def _end(process: subprocess.Popen[bytes]) -> None:
    """Let a process end by itself, which it does at the end of its input; else kill it."""
    for pipe in (process.stdin, process.stdout):
        with contextlib.suppress(OSError):
            assert pipe is not None
            pipe.close()
    try:
        process.wait(_PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def main() -> None:
    """Make worlds and serve requests until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent
    requests, answers = os.fdopen(os.dup(0), "rb", 0), os.fdopen(os.dup(1), "wb", 0)
    os.dup2(2, 1)  # what worlds print must not get among the answers
    _one_thread()
    worlds: Worlds | None = None

    def make(making: Making, rows: range, layout: Layout, path: Path, niceness: int) -> None:
        nonlocal worlds
        if hasattr(os, "nice"):
            os.nice(niceness)
        worlds = Worlds(making, rows, layout.buffers(opened(path, layout.size)).of(rows), ahead=True)

    with contextlib.suppress(EOFError, BrokenPipeError):
        _serve(requests, answers, lambda request: make(*request))
        while True:
            _serve(requests, answers, lambda request: getattr(worlds, request[0])(*request[1]))
    if worlds is not None:
        worlds.close()
    os._exit(0)  # at once: all is written, and Python takes its time


def _serve(requests: IO[bytes], answers: IO[bytes], answer: Callable[[Any], Any]) -> None:
    """Read a request and write what comes of it: whether it was done, and the result or the error."""
    request = pickle.loads(_read(requests))
    try:
        content = pickle.dumps((True, answer(request)), pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        told = error if isinstance(error, WorldError) else RuntimeError(f"{type(error).__name__}: {error}")
        told.add_note(f"In its worker process:\n{traceback.format_exc()}")
        content = pickle.dumps((False, told))
    _write(answers, content)


def _write(pipe: IO[bytes], message: bytes) -> None:
    """Write a message after its length, which is mostly one call of the system."""
    left = memoryview(len(message).to_bytes(_LENGTH, "little") + message)
    while left:
        left = left[pipe.write(left) :]


def _read(pipe: IO[bytes]) -> bytes:
    """The next message; nothing follows it before it is answered. Raises EOFError where the pipe has ended."""
    found = _some(pipe, _CHUNK)
    while len(found) < _LENGTH:
        found += _some(pipe, _CHUNK)
    parts, left = [found], _LENGTH + int.from_bytes(found[:_LENGTH], "little") - len(found)
    while left > 0:
        parts.append(_some(pipe, left))
        left -= len(parts[-1])
    return b"".join(parts)[_LENGTH:]


def _some(pipe: IO[bytes], most: int) -> bytes:
    if not (content := pipe.read(most)):
        raise EOFError
    return content


def _one_thread() -> None:
    """Threads of BLAS and torch on top of the processes would only get in each other's way."""
    with contextlib.suppress(ImportError):
        from threadpoolctl import threadpool_limits

        threadpool_limits(1)
