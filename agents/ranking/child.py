"""The process of an entry. It imports the entry's module and answers requests, and contains no simulator.

A request arrives on stdin: its length in eight bytes, and a pickle that the evaluator wrote. An answer goes to stdout
as one line of JSON; everything that the entry prints goes to stderr.
"""

from __future__ import annotations

import json
import os
import pickle
import sys
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agents.drivers.base import find_agent, make_agent
from agents.evaluation.associators import find_associator
from slam_gym.association import resolve_relocator

Answers = tuple[dict[str, Any], Callable[..., Any]]
"""The first message to the evaluator, about the entry, and the function that answers requests."""


def load(role: str, name: str) -> Answers:
    """An entry of a role by name, `module:function`, `module:Class` or model file.

    Raises ValueError where there is none.
    """
    if role != "agent":
        return {}, (find_associator if role == "associator" else resolve_relocator)(name)
    model = Path(name).suffix == ".zip"
    if not model and not hasattr(find_agent(name), "act"):
        raise ValueError("it cannot act: give --role where it is no agent")
    agent = make_agent("ppo", name) if model else make_agent(name)

    def drive(method: str, *request: Any) -> Any:
        return agent.reset(*request) if method == "reset" else agent.act(*request)

    return {"name": agent.name, "action": agent.action}, drive


def plain(value: Any) -> Any:
    """A value that JSON does not know in types that it knows: arrays as lists, dataclasses as objects."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    raise TypeError(f"{type(value).__name__} cannot be sent")


def main(role: str, name: str) -> None:
    """Answer requests until there are no more. An error of the entry is the last answer."""
    incoming, outgoing = sys.stdin.buffer, os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    try:
        answer, entry = load(role, name)
        while True:
            print(json.dumps({"answer": answer}, default=plain), file=outgoing, flush=True)
            length = incoming.read(8)
            if len(length) < 8:
                return
            answer = entry(*pickle.loads(incoming.read(int.from_bytes(length, "little"))))
    except Exception as error:
        print(json.dumps({"error": f"{type(error).__name__}: {error}"}), file=outgoing, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
