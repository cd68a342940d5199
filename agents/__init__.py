"""Agents that drive slam_gym/Explore-v0, and the commands that train, evaluate and show them.

Run from the checkout: `python -m agents.evaluate`, `python -m agents.train`, `python -m agents.play`.
"""
