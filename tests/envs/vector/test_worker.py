"""A worker process: what it is told reaches its worlds, what they print or raise harms nobody, and it never stays."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path


def test_a_worker_that_is_killed_is_told_of_and_workers_end_with_their_parent(tmp_path) -> None:
    script = tmp_path / "script.py"  # without a guard around its main module, and with an associator of its own
    script.write_text(
        "import os, sys, gymnasium as gym, numpy as np, slam_gym\n"
        "from slam_gym.association import jcbb\n"
        "def mine(scan, prediction):\n"
        "    print('printed by a world')\n"
        "    return jcbb(scan, prediction)\n"
        "envs = gym.make_vec('slam_gym/Explore-v0', num_envs=3, workers=3, scenario='office-small', action='twist',\n"
        "                    associator=mine)\n"
        "envs.reset(seed=0)\n"
        "envs.step(np.zeros((3, 2)))\n"
        "processes = [group._process for group in envs._groups[1:]]\n"
        "processes[1].kill()\n"
        "try:\n"
        "    envs.step(np.zeros((3, 2)))\n"
        "except RuntimeError as error:\n"
        "    print('TOLD', error)\n"
        "print('PID', processes[0].pid, flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])}
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=120, env=env)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert "TOLD the process of worlds 2 … 2 has ended (exit status -9)" in done.stdout
    pid = int(done.stdout.split("PID")[1])
    deadline = time.monotonic() + 30.0
    while _alive(pid) and time.monotonic() < deadline:
        pass
    assert not _alive(pid)


def _alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
