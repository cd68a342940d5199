"""The numbers of a mapped log, held against counts by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from agents.evaluation.log_measures import compare, measure
from agents.evaluation.mapped_log import map_log, start_of
from slam_gym.recordings.recording import Recording, interpolate
from slam_gym.types import NO_ID, SPURIOUS
from tests.agents.evaluation import SPEC, posts_log


@pytest.fixture(scope="module")
def log() -> Recording:
    return posts_log()


def test_numbers_agree_with_counts_by_hand(log) -> None:
    mapped = map_log(log, "nearest_neighbour", SPEC)
    numbers = measure(log, mapped)
    paired = (mapped.ids != NO_ID) & ~mapped.created
    real = log.sources >= 0
    right = sum(1 for i in np.flatnonzero(paired & real) if mapped.sources_of_pairings[i] == log.sources[i])
    assert numbers["clutter"] == (log.sources == SPURIOUS).sum()
    assert numbers["clutter_accepted"] == (paired & ~real).sum()
    assert numbers["clutter_on_landmarks"] == (paired & ~real & (mapped.sources_of_pairings >= 0)).sum()
    tally = mapped.identities.total
    assert right == tally.tp + tally.fp_duplicate
    landmarks = mapped.sources[mapped.confirmed]
    assert numbers["duplicates"] + numbers["found"] == (landmarks >= 0).sum()
    assert numbers["features"] == numbers["duplicates"] + numbers["found"] + numbers["clutter_features"]


def test_where_headings_are_unknown_only_alignment_compares() -> None:
    log = posts_log(surveyed=False)
    mapped = map_log(log, "jcbb", SPEC)
    numbers = measure(log, mapped)
    assert not mapped.in_world and start_of(log) is None
    assert math.isnan(numbers["ate_unaligned"]) and math.isnan(numbers["anees"])
    assert numbers["ate"] == pytest.approx(measure(posts_log(), map_log(posts_log(), "jcbb", SPEC))["ate"], rel=1e-6)


def test_instants_are_those_of_whichever_knows_fewer(log) -> None:
    mapped = map_log(log, "jcbb", SPEC)

    fine = np.linspace(-3.0, 70.0, 1000)
    dense = replace(log, reference_times=fine, reference_poses=interpolate(log.times, log.reference_poses, fine))
    np.testing.assert_array_equal(compare(dense, mapped)[0], log.times)
    sparse = replace(log, reference_times=log.times[1::7] + 0.2, reference_poses=log.reference_poses[1::7])
    times, estimated, _ = compare(sparse, mapped)
    kept = log.times[1::7] + 0.2
    np.testing.assert_array_equal(times, kept[kept <= log.times[-1]])
    np.testing.assert_allclose(estimated, interpolate(log.times, mapped.poses, times))
    gap = replace(log, reference_times=np.array([0.0, 0.3, 50.0, 59.5]), reference_poses=log.reference_poses[:4])
    assert compare(replace(gap, times=log.times * 4.0), mapped)[0].tolist() == [0.0, 50.0]  # on a step; else 2 s apart
