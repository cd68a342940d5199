"""Processes that compile at the same time."""

import subprocess
import sys
from collections import deque
from collections.abc import Callable
from pathlib import Path

import pytest

from slam_gym import _claims
from slam_gym._claims import claimed

TRY = """
import fcntl, sys, zlib
file = open(sys.argv[1] + '/claims', 'ab')
for name in ('taken', 'free'):
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, zlib.crc32(f'module {name}'.encode()))
        print(name, 'yes')
    except OSError:
        print(name, 'no')
"""
HOLD = """
import sys
from pathlib import Path
from slam_gym._claims import claimed
with claimed(Path(sys.argv[1]) / 'module', 'taken'):
    print('held', flush=True)
    sys.stdin.readline()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="bytes of files are not locked there")
def test_while_one_process_compiles_a_kernel_others_leave_it_alone(tmp_path: Path) -> None:
    said = []
    for name in ("taken", "other"):
        with claimed(tmp_path / "module", name), claimed(tmp_path / "module", "part of it"):
            pass
        with claimed(tmp_path / "module", name):
            with claimed(tmp_path / "module", "part of it"):  # which gives up no more than itself
                pass
            command = [sys.executable, "-c", TRY, str(tmp_path)]
            said.append(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert said == ["taken no\nfree yes\n", "taken yes\nfree yes\n"]


@pytest.mark.skipif(sys.platform == "win32", reason="bytes of files are not locked there")
def test_whoever_would_wait_does_what_else_there_is_last_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    meanwhile: deque[Callable[[], object]] = deque()
    monkeypatch.setattr(_claims, "meanwhile", meanwhile)
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdin is not None and other.stdout is not None
        assert other.stdout.readline() == "held\n"
        end = other.stdin.close
        meanwhile.extend([lambda: done.append("never"), lambda: (end(), other.wait()), lambda: done.append("first")])
        with claimed(tmp_path / "module", "taken", busy=True):
            assert done == ["first"]
        assert len(meanwhile) == 1
