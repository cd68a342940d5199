"""An entry in a process of its own, which receives what a robot could know and whose answers are checked.

The evaluator imports no code of an entry and unpickles none of its data: answers are JSON, with a limit on length and
time. An entry that fails loses the episode. There is no defence against reading the memory of another process.

The process runs this module by `main`, and contains no simulator. A request arrives on stdin as a pickle that the
evaluator wrote. An answer goes to stdout as one line of JSON; everything that the entry prints goes to stderr, and what
it reads from stdin is empty.
"""

import asyncio
import atexit
import contextlib
import json
import os
import pickle
import signal
import sys
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.drivers.base import ActionKind, Info, Observation, find_agent, make_agent
from slam_gym.association import check_relocation, resolve_associator, resolve_relocator
from slam_gym.association.prediction import Prediction
from slam_gym.types import UNPAIRED, Effort, Experience, Hypothesis, Landmarks, Locality, Relocation, Scan
from slam_gym.types._fields import floats
from slam_gym.validation import check_hypothesis

LIMIT = 60.0  # [s] for an answer
START = 600.0  # [s] for the first two answers of a process, which imports and compiles
_LONGEST = 1 << 22  # bytes of an answer
_NONSENSE = (KeyError, TypeError, ValueError, IndexError, OverflowError, np.linalg.LinAlgError)


class EntryError(ValueError):
    """A failure of an entry, by which it loses the episode."""


class EntryProcess:
    """An entry in a process of its own, which is started again for the next episode after a failure.

    Raises EntryError where no entry of this `role` has this name.
    """

    def __init__(self, role: str, name: str) -> None:
        self._entry = role, name
        self._loop = asyncio.new_event_loop()
        self._process: asyncio.subprocess.Process | None = None
        atexit.register(self.close)
        self.about = self._start()

    def ask(self, *request: Any) -> Any:
        """The answer of the entry to a request. Raises EntryError where it does not answer properly."""
        if self._process is None:
            self._start()
        limit, self._next_limit = self._next_limit, LIMIT
        return self._answer(pickle.dumps(request), limit)

    def refuse(self, reason: object) -> EntryError:
        """End the process; returns the error that ends the episode."""
        self.close()
        shown = "".join(letter if letter.isprintable() else " " for letter in str(reason)[:300])
        return EntryError(f"{' '.join(self._entry)}: {shown}")

    def close(self) -> None:
        """End the process and what it has started in its session."""
        process, self._process = self._process, None
        if process is None:
            return
        with contextlib.suppress(OSError):  # it has ended, and nothing of its session is left
            if hasattr(os, "killpg"):
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()
        if process.returncode is None:
            self._loop.run_until_complete(asyncio.wait([self._loop.create_task(process.wait())], timeout=5.0))

    def _start(self) -> dict[str, Any]:
        path = os.pathsep.join([str(Path(__file__).parents[2]), os.getcwd(), os.environ.get("PYTHONPATH", "")])
        pipe, env = asyncio.subprocess.PIPE, os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
        child = asyncio.create_subprocess_exec(
            sys.executable, "-P", "-m", __name__, *self._entry,
            stdin=pipe, stdout=pipe, limit=_LONGEST, env=env, start_new_session=True,
        )  # fmt: skip
        self._process, self._next_limit = self._loop.run_until_complete(child), START
        about = self._answer(b"", START)
        if not isinstance(about, dict):
            raise self.refuse("what it says of itself is nonsense")
        return about

    def _answer(self, request: bytes, seconds: float) -> Any:
        try:
            line = self._loop.run_until_complete(asyncio.wait_for(self._exchange(request), seconds))
            message = json.loads(line)
            if "answer" in message:
                return message["answer"]
            reason = message["error"]
        except TimeoutError:
            reason = f"no answer in {seconds:g} s"
        except (OSError, asyncio.IncompleteReadError):
            reason = "its process ended"
        except (*_NONSENSE, RecursionError, asyncio.LimitOverrunError):
            reason = "its answer is nonsense"
        raise self.refuse(reason)

    async def _exchange(self, request: bytes) -> bytes:
        self._process.stdin.write(request)
        await self._process.stdin.drain()
        return await self._process.stdout.readuntil(b"\n")


class EntryAgent:
    """A driver in a process of its own."""

    def __init__(self, process: EntryProcess) -> None:
        self._process = process
        self.name = str(process.about.get("name"))
        self.action: ActionKind = "twist" if process.about.get("action") == "twist" else "goal"

    def reset(self, seed: int) -> None:
        self._process.ask("reset", seed)

    def act(self, observation: Observation, info: Info) -> int | NDArray[np.float32]:
        action = self._process.ask("act", dict(observation), dict(info))
        try:
            if self.action == "twist":
                return _numbers({"twist": action}, "twist", (2,)).clip(-1.0, 1.0).astype(np.float32)
            if action not in np.flatnonzero(info["action_mask"]).tolist():
                raise ValueError(f"goal {str(action)[:80]} is not legal")
            return int(action)
        except _NONSENSE as error:
            raise self._process.refuse(error) from None


def _decisions(answer: Any, kind: type[np.generic]) -> NDArray[Any]:
    """An answer for each measurement, in its own type, or in that of `kind` for an empty scan."""
    return np.array(answer) if answer else np.empty(0, kind)


def associate_in(process: EntryProcess, scan: Scan, prediction: Prediction) -> Hypothesis:
    """The hypothesis of an associator in a process of its own."""
    answer = process.ask(scan, prediction)
    try:
        new, known = answer["new"], answer["experience"]
        hypothesis = Hypothesis(
            _decisions(answer["features"], np.int64),
            float(_numbers(answer, "joint_distance", ())),
            int(answer["dof"]),
            new=None if new is None else _decisions(new, np.bool_),
            exclusive=bool(answer["exclusive"]),
            experience=None if known is None else Experience(
                float(_numbers(known, "unpaired", ())), float(_numbers(known, "area", ())),
                _numbers(known, "detections", (-1,)),
            ),
        )  # fmt: skip
        return check_hypothesis(hypothesis, len(scan), int(prediction.features.max(initial=-1)) + 1)
    except _NONSENSE as error:
        raise process.refuse(f"no hypothesis, {error}") from None


def relocate_in(process: EntryProcess, scan: Scan, landmarks: Landmarks, locality: Locality | None) -> Relocation:
    """The relocation of a relocator in a process of its own."""
    answer = process.ask(scan, landmarks, locality)
    try:
        features = _decisions(answer["features"], np.int64)
        pose, covariance = np.full(3, np.nan), np.full((3, 3), np.nan)
        distance, located = 0.0, (features != UNPAIRED).sum() >= 2
        if located:
            distance = float(_numbers(answer, "joint_distance", ()))
            pose, covariance = _numbers(answer, "pose", (3,)), _numbers(answer, "covariance", (3, 3))
        dof, least, ambiguous, ties = (int(answer[name]) for name in ("dof", "min_pairings", "ambiguous", "ties"))
        found = Relocation(features, pose, covariance, distance, dof, least, bool(ambiguous), ties, Effort())
        return check_relocation(found, len(scan), len(landmarks))
    except _NONSENSE as error:
        raise process.refuse(f"no relocation, {error}") from None


def _numbers(answer: dict[str, Any], name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """An entry of an answer as an array of finite numbers of this shape; ValueError as `floats`."""
    array = floats(name, answer[name], shape)
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: a number is not finite")
    return array


# -- in the process of the entry ------------------------------------------------------------------------------------


def _load(role: str, name: str) -> tuple[dict[str, Any], Callable[..., Any]]:
    """An entry by name, `module:function`, `module:Class` or model file: the first message to the evaluator, about the
    entry, and the function that answers requests. Raises ValueError where there is none."""
    if role != "agent":
        return {}, (resolve_associator if role == "associator" else resolve_relocator)(name)
    model = Path(name).suffix == ".zip"
    if not model and not hasattr(find_agent(name), "act"):
        raise ValueError("it cannot act: give --role where it is no agent")
    if not model and hasattr(find_agent(name), "behold"):
        raise ValueError("it drives by the truth, which no entry is told")
    agent = make_agent("ppo", name) if model else make_agent(name)
    about = {"name": agent.name, "action": agent.action}
    return about, lambda method, *request: getattr(agent, method)(*request)


def _plain(value: Any) -> Any:
    """A value that JSON does not know in types that it knows: arrays as lists, dataclasses as objects."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    raise TypeError(f"{type(value).__name__} cannot be sent")


def main(role: str, name: str) -> None:
    """Answer requests until there are no more. An error of the entry is the last answer."""
    incoming, outgoing = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    try:
        answer, entry = _load(role, name)
        while True:
            print(json.dumps({"answer": answer}, default=_plain), file=outgoing, flush=True)
            if not incoming.peek(1):
                return
            answer = entry(*pickle.load(incoming))
    except KeyboardInterrupt:
        return
    except Exception as error:
        print(json.dumps({"error": f"{type(error).__name__}: {error}"}), file=outgoing, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
