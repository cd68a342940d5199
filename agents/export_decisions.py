"""Decisions of Associate-v0 for supervised learning: `python -m agents.export_decisions FILE.npz --scenario office`.

Writes a .npz file without pickles (`numpy.load(FILE)`), the same to the last byte for the same command. With D
decisions and K candidates it holds

    measurement, candidates, path, pairings, budget   (D, …) float32: the observation, as Associate-v0 documents it
    mask     (D, K + 1) bool: what was legal
    right    (D,) int64: the right action; K is `*`; −1 where it is not on offer, or nobody knows
    taken    (D,) int64: the action that was taken
    episode, look   (D,) int64: where the decision was taken
    format, setting   text: "slam_gym decisions 1", and the settings as JSON

The right actions are taken, except that a fraction of the scans (`--mistakes`) is walked at random after a random
level: otherwise no state would be met in which something has gone wrong before.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.cli import add_associate_options, add_episode_options, associate_arguments, episodes_of, program, run_main
from agents.evaluation.episodes import AssociateArguments, reset_arguments
from agents.evaluation.records import written_whole
from agents.evaluation.tables import counted

UNKNOWN_ACTION = -1  # the right action is not on offer, or nobody knows

FORMAT = "slam_gym decisions 1"


def decisions(arguments: AssociateArguments, first: int, episodes: int, mistakes: float) -> dict[str, NDArray[Any]]:
    """The arrays of the file, from worlds `first` … `first` + `episodes` − 1 of the split."""
    env: Any = arguments.make().unwrapped
    rows: list[dict[str, Any]] = []
    for episode in range(first, first + episodes):
        rng = np.random.default_rng((episode, 3))
        observation, info = env.reset(**reset_arguments(episode))
        look, astray, over = -1, False, False
        while not over:
            if info["look"] != look:
                look, astray = info["look"], bool(rng.random() < mistakes)
            mask, right = info["action_mask"], info["truth"]["action"]
            legal = np.flatnonzero(mask)
            wanders = astray and rng.random() < 0.5
            taken = int(rng.choice(legal)) if wanders else env.K if right == UNKNOWN_ACTION else right
            if len(legal) > 1:  # an episode without any choice has nothing to tell
                rows.append(observation | dict(mask=mask, right=right, taken=taken, episode=episode, look=look))
            observation, _, over, _, info = env.step(taken)
    if not rows:
        raise ValueError(f"there was nothing to decide in {episodes} episodes of {arguments.scenario!r}")
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def export(path: Path, arguments: AssociateArguments, *, first: int, episodes: int, mistakes: float) -> int:
    """Write the file, in one piece, and return the number of decisions."""
    arrays = decisions(arguments, first, episodes, mistakes)
    about = arguments.plain | {"first": first, "episodes": episodes, "mistakes": mistakes}
    with written_whole(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, format=np.array(FORMAT), setting=np.array(json.dumps(about)), **arrays)
    return len(arrays["right"])


def parser() -> argparse.ArgumentParser:
    summary = "Write decisions of Associate-v0, with masks and right answers, for supervised learning."
    p = argparse.ArgumentParser(prog=program("agents.export_decisions"), description=summary)
    p.add_argument("file", type=Path, help="to write (.npz)")
    add_episode_options(p, 10, "of the driver")
    p.add_argument("--split", default="train", help="train or test (default: %(default)s)")
    p.add_argument("--mistakes", type=float, default=0.2, metavar="FRACTION", help="of scans (default: %(default)s)")
    add_associate_options(p)
    return p


def main(argv: list[str]) -> int:
    a = parser().parse_args(argv)
    episodes = episodes_of(a)
    if not 0.0 <= a.mistakes <= 1.0:
        raise ValueError(f"--mistakes must be a fraction, not {a.mistakes}")
    if not a.file.parent.is_dir():
        raise FileNotFoundError(f"no such folder: {a.file.parent}")
    arguments = associate_arguments(a, a.split)
    count = export(a.file, arguments, first=a.first, episodes=len(episodes), mistakes=a.mistakes)
    print(f"wrote {a.file}: {count} decisions of {counted(a.episodes, 'episode')} of {a.scenario}")
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
