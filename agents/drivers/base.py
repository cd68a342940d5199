"""The protocol of agents, and the list of the shipped ones.

A new agent is one class with `name`, `action`, `reset` and `act`, and optionally one line in `AGENTS`: `module:Class`
is accepted wherever a name is.
"""

from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Protocol, cast, get_args

import numpy as np
from numpy.typing import NDArray

from slam_gym.validation import imported, one_of

ActionKind = Literal["goal", "twist"]
Observation = Mapping[str, NDArray[Any]]
Info = Mapping[str, Any]


class Agent(Protocol):
    """The driver of an episode. It sees the observation and the part of `info` that the robot itself could know.

    Drivers that choose among goals derive from it. One without memory need not define `reset`.
    """

    name: str
    action: ActionKind = "goal"

    def __init__(self) -> None:
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Forget the last episode; all randomness of the next comes from `seed`."""

    @abstractmethod
    def act(self, observation: Observation, info: Info) -> int | NDArray[np.float32]:
        """The slot of a legal goal (action "goal"), or forward and turning speed in [−1, 1] (action "twist")."""


AGENTS: dict[str, str] = {
    "random": "agents.drivers.baselines:RandomAgent",
    "nearest_frontier": "agents.drivers.baselines:NearestFrontier",
    "lawnmower": "agents.drivers.baselines:Lawnmower",
    "information_gain": "agents.drivers.baselines:InformationGain",
    "information_gain_no_revisits": "agents.drivers.baselines:InformationGainNoRevisits",
    "learned": "agents.drivers.learned:LearnedDriver",
    "clairvoyant": "agents.drivers.clairvoyant:Clairvoyant",
    "ppo": "agents.learning.policies:PolicyAgent",
}

BASELINES = ("random", "nearest_frontier", "lawnmower", "information_gain")
"""The classical drivers, which need no model file."""

SHOWN = (*BASELINES, "learned", "clairvoyant")
"""The default drivers of an evaluation: the classical ones, the shipped learned driver, and the one that knows the
truth."""

LOOK_AROUND = 0
"""The goal that is always legal, by `info["action_mask"]` (K,)."""


def visible(info: Info) -> dict[str, Any]:
    """The part of `info` that an agent may see, which depends on no truth."""
    return {key: info[key] for key in ("pose", "ticks", "action_mask") if key in info}


def find_agent(name: str) -> Any:
    """The class of a name in `AGENTS` or of `module:Class`. Raises ValueError, listing the known names."""
    return imported("agent", AGENTS.get(name, name), AGENTS)


def is_learned(name: str) -> bool:
    """Whether the agent is loaded from a model file, by its `load(path, trust)`."""
    return hasattr(find_agent(name), "load")


def make_agent(name: str, model: Path | str | None = None, *, trust: bool = False) -> Agent:
    """A new agent. Learned ones need a model file; `trust` allows formats that can run code when they are read.

    Raises ValueError for an unknown name, a missing file, and a class that is no agent.
    """
    cls = find_agent(name)
    if hasattr(cls, "load") and model is None:
        raise ValueError(f"agent {name!r} is learned: give its file (evaluate: --model FILE; slam-gym train makes one)")
    if not hasattr(cls, "load") and model is not None:
        raise ValueError(f"agent {name!r} takes no model file")
    agent = cls() if model is None else cls.load(Path(model), trust=trust)
    if missing := [part for part in ("name", "action", "reset", "act") if not hasattr(agent, part)]:
        raise ValueError(f"agent {name!r} has no {' and no '.join(missing)}: see agents.drivers.base.Agent")
    one_of("action", agent.action, get_args(ActionKind))
    return cast(Agent, agent)
