"""Agents that drive and associate, and the commands that train, evaluate and show them.

The modules here are the commands: `slam-gym evaluate` is `evaluate.py`, and so on. `options.py` has the groups of
options that they share. Below them: `drivers` (the classical ones), `learning` (networks and
their training), `evaluation` (one pipeline for all), `ranking` (the leaderboard's protocol and entries), `suite`
(problems that every associator is asked about) and `reports`.
"""
