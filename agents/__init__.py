"""Agents that drive and associate, and the commands that train, evaluate and show them.

Run from the checkout: `python -m agents.evaluate`, `evaluate_association`, `leaderboard`, `report`, `train`,
`train_associate`, and `play`. Below them: `drivers` (the classical ones), `learning` (networks and
their training), `evaluation` (one pipeline for all), `ranking` (the leaderboard's protocol and entries), `suite`
(problems that every associator is asked about) and `reports`.
"""
