"""An entry in a process of its own: it gets observations, scans and predictions, and sends decisions back.

There is no simulator in that process, and no seed of a world in what it is told. What a prediction computes only when
asked for (joint covariances, localities, visibility) the entry asks for over the same pipe.
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np

from agents.drivers.base import ActionKind, Info, Observation, find_agent, is_learned, make_agent
from agents.evaluation.associators import find_associator
from agents.ranking.wire import receive, send
from slam_gym.association import resolve_relocator
from slam_gym.types import Hypothesis, Landmarks, Locality, Prediction, Relocation, Scan

Role = Literal["agent", "associator", "relocator"]
TIMEOUT = 600.0  # [s] for one answer: the first of a process compiles, on a busy machine for minutes
_ASKED = ("joint", "local", "view")  # what a prediction computes only when it is asked to
_SENT = tuple(f.name for f in fields(Prediction) if f.name not in _ASKED)


class EntryError(ValueError):
    """What an entry did that ends its evaluation."""


class Entry:
    """The evaluation's end of an entry's process."""

    def __init__(self, role: Role, name: str, timeout: float = TIMEOUT) -> None:
        self._who, self._timeout, self._deadline = f"{role} {name!r}", timeout, float("inf")
        root = str(Path(__file__).parents[2])
        path = os.pathsep.join([root, os.getcwd(), os.environ.get("PYTHONPATH", "")])
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__, role, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env=os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        threading.Thread(target=self._watch, daemon=True).start()
        self.about: dict[str, Any] = self._answer({}, TIMEOUT)  # of a process that must first import everything

    def ask(self, request: dict[str, Any], helpers: dict[str, Callable[..., Any]] | None = None) -> Any:
        """Its answer; meanwhile it may ask the helpers. Raises EntryError where it fails, or takes too long."""
        try:
            send(self._out, request)
        except OSError:
            raise self._ended() from None
        return self._answer(helpers or {}, self._timeout)

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()

    def _answer(self, helpers: dict[str, Callable[..., Any]], timeout: float) -> Any:
        self._deadline = time.monotonic() + timeout
        try:
            while True:
                message = receive(self._in)
                if "ask" not in message:
                    break
                send(self._out, helpers[message["ask"]](*message["arguments"]))
        except (EOFError, OSError):
            raise self._ended() from None
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise EntryError(f"{self._who}: {error}") from None
        finally:
            self._deadline = float("inf")
        if "error" in message:
            raise EntryError(f"{self._who}: {message['error']}")
        return message["answer"]

    @property
    def _in(self) -> BinaryIO:
        assert self._process.stdout is not None
        return self._process.stdout  # type: ignore[return-value]

    @property
    def _out(self) -> BinaryIO:
        assert self._process.stdin is not None
        return self._process.stdin  # type: ignore[return-value]

    def _ended(self) -> EntryError:
        late = time.monotonic() > self._deadline
        return EntryError(f"{self._who}: " + (f"no answer in {self._timeout:g} s" if late else "its process ended"))

    def _watch(self) -> None:
        while self._process.poll() is None:
            if time.monotonic() > self._deadline:
                self._process.kill()
            time.sleep(min(0.5, self._timeout / 4))


@functools.lru_cache(maxsize=4)
def entry(role: Role, name: str) -> Entry:
    """The process of an entry, one for each process of the evaluation."""
    return Entry(role, name)


class ServedAgent:
    """A driver in a process of its own."""

    def __init__(self, of: Entry) -> None:
        self._entry = of
        self.name: str = of.about["name"]
        self.action: ActionKind = of.about["action"]

    def reset(self, seed: int) -> None:
        self._entry.ask({"reset": seed})

    def act(self, observation: Observation, info: Info) -> Any:
        answer = self._entry.ask({"observation": dict(observation), "info": dict(info)})
        return int(answer) if self.action == "goal" else np.asarray(answer, np.float32)


class ServedAssociator:
    """An associator in a process of its own."""

    def __init__(self, of: Entry) -> None:
        self._entry = of

    def __call__(self, scan: Scan, prediction: Prediction) -> Hypothesis:
        helpers = {name: found for name in _ASKED if (found := getattr(prediction, name)) is not None}
        sent = {name: getattr(prediction, name) for name in _SENT}
        found = self._entry.ask({"scan": scan, "prediction": sent, "helpers": list(helpers)}, helpers)
        if not isinstance(found, Hypothesis):
            raise EntryError(f"expected a Hypothesis, got {type(found).__name__}")
        return found


class ServedRelocator:
    """A relocator in a process of its own."""

    def __init__(self, of: Entry) -> None:
        self._entry = of

    def __call__(self, scan: Scan, landmarks: Landmarks, locality: Locality | None) -> Relocation:
        found = self._entry.ask({"scan": scan, "landmarks": landmarks, "locality": locality})
        if not isinstance(found, Relocation):
            raise EntryError(f"expected a Relocation, got {type(found).__name__}")
        return found


# -- the entry's own process -------------------------------------------------------------------------------------------


def serve(role: Role, name: str, incoming: BinaryIO, outgoing: BinaryIO) -> None:
    """Answer requests until there are no more."""

    def ask(what: str, *arguments: Any) -> Any:
        send(outgoing, {"ask": what, "arguments": list(arguments)})
        return receive(incoming)

    try:
        answer, about = _ANSWERS[role](name, ask)
        send(outgoing, {"answer": about})
    except Exception as error:
        send(outgoing, {"error": f"{type(error).__name__}: {error}"})
        return
    while True:
        try:
            request = receive(incoming)
        except EOFError:
            return
        try:
            send(outgoing, {"answer": answer(request)})
        except Exception as error:
            send(outgoing, {"error": f"{type(error).__name__}: {error}"})


Answer = tuple[Callable[[dict[str, Any]], Any], dict[str, Any]]
"""What answers requests, and what is told of the entry at first."""
Ask = Callable[..., Any]
"""Asks the evaluation for what a prediction computes only when asked: its name, and arguments."""


def _agent(name: str, _: Ask) -> Answer:
    learned = Path(name).suffix == ".zip"
    agent = make_agent("ppo", name) if learned else make_agent(name)

    def answer(request: dict[str, Any]) -> Any:
        if "reset" in request:
            return agent.reset(request["reset"])
        return agent.act(request["observation"], request["info"])

    return answer, {"name": agent.name, "action": agent.action}


def _associator(name: str, ask: Ask) -> Answer:
    associate = find_associator(name)

    def answer(request: dict[str, Any]) -> Hypothesis:
        lazy = {what: functools.partial(ask, what) if what in request["helpers"] else None for what in _ASKED}
        return associate(request["scan"], Prediction(**request["prediction"], **lazy))

    return answer, {}


def _relocator(name: str, _: Ask) -> Answer:
    relocate = resolve_relocator(name)
    return lambda request: relocate(request["scan"], request["landmarks"], request["locality"]), {}


_ANSWERS: dict[str, Callable[[str, Ask], Answer]] = {
    "agent": _agent,
    "associator": _associator,
    "relocator": _relocator,
}


def role_of(name: str) -> Role:
    """What an entry is, by its name. Raises ValueError for what could be several things."""
    from agents.drivers.base import AGENTS
    from slam_gym.association import ASSOCIATORS, RELOCATORS

    tables: dict[Role, Any] = {"agent": AGENTS, "associator": ASSOCIATORS, "relocator": RELOCATORS}
    found = [role for role, table in tables.items() if name in table]
    if not found and Path(name).suffix == ".zip":
        from agents.learning.models import read_about

        found = ["associator" if read_about(Path(name)).action == "branch" else "agent"]
    if not found and ":" in name and hasattr(find_agent(name), "act"):
        found = ["agent"]
    if len(found) != 1:
        known = "; ".join(f"{role}s: {', '.join(table)}" for role, table in tables.items())
        raise ValueError(f"entry {name!r}: give --role, since its name does not tell ({known})")
    if found[0] == "agent" and name in AGENTS and is_learned(name):
        raise ValueError(f"entry {name!r}: give its model file instead")
    return found[0]


def main() -> None:
    """Requests come on stdin and answers go to stdout; whatever the entry prints goes to stderr."""
    incoming, outgoing = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: SIM115 (for as long as the process lives)
    role, name = sys.argv[1:]
    serve(role, name, incoming, outgoing)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
