"""Many worlds at once: `gym.make_vec("slam_gym/Explore-v0", num_envs=8)`."""

from __future__ import annotations

from functools import partial

from slam_gym.envs.associate import AssociateEnv
from slam_gym.envs.explore import ExploreEnv
from slam_gym.envs.relocate import RelocateEnv
from slam_gym.envs.vector.env import ManyWorlds

ExploreWorlds = partial(ManyWorlds, ExploreEnv)
AssociateWorlds = partial(ManyWorlds, AssociateEnv)
RelocateWorlds = partial(ManyWorlds, RelocateEnv)
