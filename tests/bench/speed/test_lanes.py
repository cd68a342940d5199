"""The drive over lanes: what is seen is what stands there."""

import numpy as np

from slam_gym.bench.speed.lanes import REACH, looks
from slam_gym.geometry import compose, transform


def test_every_feature_comes_into_reach_and_is_measured_where_it_is() -> None:
    rng, side = np.random.default_rng(0), 20.0
    features = rng.uniform(0.0, side, (60, 2))
    pose, off, seen = np.array([0.0, 4.0, 0.0]), [], set()
    for number, look in enumerate(looks(features, side, rng)):
        pose = compose(pose, look.odometry.motion)
        seen |= set(look.seen.tolist())
        if number < 5 and len(look.seen):  # before the odometry has drifted
            off.append(np.hypot(*(transform(pose, look.scan.points) - features[look.seen]).T).max())
            assert np.hypot(*look.scan.points.T).max() < REACH + 0.2
    covered = np.flatnonzero(features[:, 1] < 17.0)  # what the lanes at 4 and 12 m have in reach
    assert max(off) < 0.5 and seen >= set(covered.tolist())
