"""Agents that drive and associate, and the commands that train, evaluate and show them.

The modules here are the commands: `slam-gym evaluate` is `evaluate.py`, and so on. `options.py` contains the groups of
options that they share, and `suite.py` the association suite: single scans for associators and relocators. The packages
are `drivers` (classical and shipped ones), `learning` (networks and their training), `evaluation` (the pipeline of all
evaluations), `ranking` (the leaderboard's protocol and entries) and `reports`.
"""
