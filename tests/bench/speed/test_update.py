"""What a filter step is timed on."""

import numpy as np
import pytest

from slam_gym.bench.report import Report
from slam_gym.bench.runner import UsageError
from slam_gym.bench.speed.update import mapped, measure, run


@pytest.mark.parametrize("features", [10, 60])
def test_the_map_has_its_features_at_their_density(features):
    built = mapped(features, np.random.default_rng(0))
    assert built.n == features and np.abs(built.positions).max() <= np.sqrt(6.0 * features) / 2 + 0.1
    assert np.isfinite(built.sizes).all()


def test_every_part_is_timed():
    row = measure(12, 2, np.random.default_rng(0))
    assert row["features"] == 12 and all(value > 0.0 for value in row.values())
    assert row["update / dsyrk"] == row["update"] / row["dsyrk"]


def test_too_few_features_are_refused():
    for wrong in ({"features": (9,)}, {"repeats": 0}):
        with pytest.raises(UsageError, match="at least 10"):
            run(Report(), **wrong)
