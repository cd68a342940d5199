"""Parts of the DLR log, and logs that are simulated along its path: does a result depend on where the log begins?

Each part begins with an empty map; the parts overlap, so their mean is not over independent logs. The simulated logs
have the path, the circles and the scans of the batch solution with the true identities. Their errors are drawn with the
covariances of the log; the true errors are larger than these say, and last for several steps. Features mapped twice,
features that do not exist, precision and recall of every log, and their means.

    SLAM_GYM_DATA=... python benchmarks/parts.py --out parts.csv       # five minutes
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from agents.evaluation.mapped_log import MappedLog, associations, map_log, smoothed
from benchmarks.common import options, published, table
from slam_gym.geometry import relative
from slam_gym.recordings.recording import Recording
from slam_gym.scenarios import slam_for
from slam_gym.simulation.judged import CEILING
from slam_gym.slam.relocate import SEARCH

PARTS = ((0, 3297), (0, 1650), (0, 2400), (300, 3297), (600, 3297), (900, 3297), (600, 2400), (1200, 3297),
         (1650, 3297), (300, 2000), (700, 2700))  # fmt: skip
MEASURES = ["duplicates", "clutter_features", "precision", "recall"]


def simulated(log: Recording, best: MappedLog, rng: np.random.Generator) -> Recording:
    """A log with new errors, along the poses and past the features of the batch solution for it."""
    path, motions, points = best.poses, log.motions.copy(), log.points.copy()
    places = dict(zip(best.features["identity"], best.features[["x", "y"]].to_numpy()))
    for k in range(1, len(log)):
        error = rng.multivariate_normal(np.zeros(3), log.motion_covariances[k])
        motions[k] = relative(path[k - 1], path[k]) + error
    steps = np.repeat(np.arange(len(log)), np.diff(log.starts))
    for i, (source, k) in enumerate(zip(log.sources.tolist(), steps.tolist())):
        if source >= 0:
            seen = relative(path[k], np.array([*places[source], 0.0]))[:2]
            points[i] = seen + rng.multivariate_normal(np.zeros(2), log.covariances[i])
    return replace(log, motions=motions, points=points)


def logs(whole: Recording, seed: int, count: int) -> Iterator[tuple[str, str, Recording]]:
    """Kind, name and content of each log: the parts, then `count` simulated ones."""
    for first, last in PARTS:
        yield "part", f"{first} to {last}", whole.part(first, last)
    best = smoothed(map_log(whole, CEILING, slam_for(whole)))
    if best is None:
        raise SystemExit(f"{whole.name}: no batch solution, so nothing can be simulated along its path")
    for k in range(count):
        yield "simulated", f"seed {seed + k}", simulated(whole, best, np.random.default_rng(seed + k))


if __name__ == "__main__":
    a = options(__doc__, seed=0, associators=("jcbb", "marginal"), simulated=16, out="")
    whole = published("dlr")
    if whole is None:
        raise SystemExit
    rows = []
    for kind, name, log in [("part", "0 to 60", whole.part(0, 60))] if a.quick else logs(whole, a.seed, a.simulated):
        for associator in a.associators:
            measures = associations(map_log(log, associator, slam_for(log), SEARCH))
            rows.append({"associator": associator, "kind": kind, "log": name} | {m: measures[m] for m in MEASURES})
            table("", rows[-1:])
    results = pd.DataFrame(rows)
    groups = results.groupby(["associator", "kind"], sort=False)
    table("Means", groups[MEASURES].mean().join(groups["duplicates"].max().rename("most")).reset_index())
    if a.out and not a.quick:
        results.to_csv(a.out, index=False, float_format="%.4f")
