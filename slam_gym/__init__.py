"""slam_gym: learn and evaluate data association in SLAM, and active exploration on top of it.

Importing the package registers its environments with Gymnasium.
"""

from gymnasium.envs.registration import register

__version__ = "0.1.0"

register(id="slam_gym/Explore-v0", entry_point="slam_gym.envs.explore:ExploreEnv")
register(id="slam_gym/Associate-v0", entry_point="slam_gym.envs.associate:AssociateEnv")
register(id="slam_gym/Relocate-v0", entry_point="slam_gym.envs.relocate:RelocateEnv")
