"""One attack: many inputs on one reader, in a child process with bounds on its memory and its time."""

import faulthandler
import gc
import json
import os
import signal
import sys
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

MEMORY = 1 << 30  # bytes above those in use when the attack begins
SECONDS = 10  # for one input


def attack(read: Callable[[Path], object], path: Path, contents: st.SearchStrategy[bytes], inputs: int) -> Counter[str]:
    """How many of `inputs` written to `path` were read, and how many refused by a ValueError that names the file.

    Fails for any other end: another error, one that names no file, a crash, more than `SECONDS`, more than `MEMORY`.
    What was being read is left in `path`.
    """
    counts: Counter[str] = Counter()

    @settings(max_examples=inputs, deadline=None, derandomize=True, database=None, phases=[Phase.generate],
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(contents)
    def one(content: bytes) -> None:
        path.write_bytes(content)
        signal.setitimer(signal.ITIMER_REAL, SECONDS)
        faulthandler.dump_traceback_later(3 * SECONDS, exit=True, file=sys.__stderr__)  # where no signal is heard
        try:
            read(path)
        except ValueError as error:
            # the file, its unzipped name, or the folder where files do not fit together
            named = (f"{path}: ", f"{path.with_suffix('')}: ", f"{path.parent}: ")
            assert str(error).startswith(named), f"names no file: {error}"
            counts["refused"] += 1
        else:
            counts["read"] += 1
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            faulthandler.cancel_dump_traceback_later()

    said = _in_a_child(one, counts) if hasattr(os, "fork") else _here(one, counts)
    if "failure" in said:
        pytest.fail(f"{path}: {said['failure']}")
    return Counter(said)


def _here(one: Callable[[], None], counts: Counter[str]) -> dict[str, int | str]:
    try:
        one()
    except BaseException:
        return {"failure": traceback.format_exc()}
    return dict(counts)


def _in_a_child(one: Callable[[], None], counts: Counter[str]) -> dict[str, int | str]:
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        try:
            signal.signal(signal.SIGALRM, _too_long)
            gc.freeze()  # hypothesis collects garbage at its start: what the parent left takes long
            _bound_memory()
            said = _here(one, counts)
            os.write(writing, json.dumps(said)[:60_000].encode())
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        content = pipe.read()
    status = os.waitpid(child, 0)[1]
    return json.loads(content) if content else {"failure": f"the process ended with status {status}"}


def _too_long(*_: object) -> None:
    raise TimeoutError(f"took more than {SECONDS} s")


def _bound_memory() -> None:
    if sys.platform == "linux":
        import resource

        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
