"""Smoke test of an installed wheel: both action modes, in every scenario, with nothing but the core dependencies."""

import gymnasium as gym

import slam_gym
from slam_gym.scenarios import SCENARIOS

for scenario in SCENARIOS:
    for action in ("goal", "twist"):
        env = gym.make("slam_gym/Explore-v0", scenario=scenario, action=action)
        observation, info = env.reset(seed=0)
        env.action_space.seed(0)
        for _ in range(5):
            observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space, scenario
        assert 0.0 <= info["map_error"] < 2.0, info
        env.close()
print(f"slam_gym {slam_gym.__version__}: wheel works in {len(SCENARIOS)} scenarios")
