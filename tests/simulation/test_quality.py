"""Every measure of an episode against its formula, written out over the episode's books."""

import math

import numpy as np
import pytest

from slam_gym.geometry import compose, transform
from slam_gym.metrics.map_quality import align_se2
from slam_gym.scenarios import KidnappingSpec
from slam_gym.simulation.quality import quality
from tests.metrics.test_map_quality import dense_optimum
from tests.rollouts import short
from tests.simulation.episodes import drive, start

CUTOFF = 1.0  # [m]
CROWD = short(80, "crowd")


@pytest.fixture(scope="module")
def judged():
    """An episode with mistakes in it, and its quality."""
    episode = drive(start(CROWD, "nearest_neighbour"), 80)
    return episode, quality(episode)


def oldest(episode) -> tuple[dict[int, int], int]:
    """Oldest confirmed feature of each source by most measurements, and how many more real sources have."""
    slam_map = episode.slam.map
    confirmed = np.flatnonzero(slam_map.seen >= slam_map.spec.confirmations)
    sources = episode.identities.majority_of(slam_map.ids[confirmed]).tolist()
    of: dict[int, int] = {}
    for feature, source in zip(confirmed.tolist(), sources):
        if source >= 0:
            of.setdefault(source, feature)
    return of, sum(source >= 0 for source in sources) - len(of)


def test_the_shape_of_the_map_is_measured_over_the_oldest_feature_of_each_source(judged) -> None:
    episode, found = judged
    of, more = oldest(episode)
    mapped = transform(episode.base, episode.slam.map.positions[list(of.values())])
    true = episode.site.plan.features.positions[list(of)]
    off = np.hypot(*(mapped - true).T)
    assert len(of) > 10 and found["duplicates"] == more
    assert found["landmark_rmse_raw"] == pytest.approx(math.sqrt((off**2).mean()))
    off = np.hypot(*(transform(align_se2(mapped, true), mapped) - true).T)
    assert found["landmark_rmse_aligned"] == pytest.approx(math.sqrt((off**2).mean()))
    assert found["landmark_rmse_aligned"] <= found["landmark_rmse_raw"]


def test_the_map_is_measured_as_a_set_of_points(judged) -> None:
    episode, found = judged
    assert found["features"] == len(episode.landmarks) > 10
    assert found["map_error"] == episode.map_error() and found["coverage"] == episode.coverage()
    assert found["gospa"] == pytest.approx(math.sqrt(dense_optimum(episode.landmarks, episode.targets, CUTOFF, 2.0)))
    parts = [found[f"gospa_{name}"] for name in ("localisation", "missed", "false")]
    assert found["gospa"] ** 2 == pytest.approx(sum(part**2 for part in parts)) and min(parts) > 0.0


def test_the_trajectory_is_measured_without_alignment(judged) -> None:
    episode, found = judged
    errors = [compose(episode.base, e)[:2] - p[:2] for e, p in zip(episode.estimates, episode.poses)]
    assert found["ate"] == pytest.approx(math.sqrt(np.mean([error @ error for error in errors])))
    assert found["anees"] == pytest.approx(sum(episode.nees[1:]) / (3 * episode.ticks))
    assert found["ticks"] == 80.0


def test_associations_are_those_of_the_tally(judged) -> None:
    episode, found = judged
    tally = episode.identities.total
    assert tally.fp > 0  # nearest neighbour among people
    assert found["precision"] == tally.tp / (tally.tp + tally.fp)
    assert found["recall"] == tally.tp / tally.in_map


def test_a_robot_is_astray_from_the_kidnapping_until_its_pose_is_right_or_until_now() -> None:
    scenario = short(40, "kidnapped", kidnapping=KidnappingSpec(at=0.25))
    episode = drive(start(scenario), 9)
    assert quality(episode)["kidnapped"] == 0.0
    drive(episode, 21)
    found = quality(episode)
    assert episode.kidnapping.happened == 10
    assert (found["kidnapped"], found["recovered"], found["ticks_astray"]) == (1.0, 0.0, 20.0)
    episode.kidnapping.recovered = 17
    found = quality(episode)
    assert (found["recovered"], found["ticks_astray"]) == (1.0, 7.0)


def test_before_anything_is_confirmed_there_is_an_empty_map() -> None:
    found = quality(start())
    assert found["map_error"] == 1.0 and found["features"] == found["ticks"] == 0.0
    assert all(math.isnan(found[name]) for name in ("landmark_rmse_raw", "landmark_rmse_aligned", "anees"))
    assert all(type(value) is float for value in found.values())
