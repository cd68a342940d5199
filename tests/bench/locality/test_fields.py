"""Fields and their scans are what they say."""

import numpy as np
import pytest

from slam_gym.association.relocation.gcbb import gcbb
from slam_gym.bench.locality.fields import from_centre, inside, outside, surveyed_field
from slam_gym.bench.locality.mapping_pass import FieldSpec
from slam_gym.geometry import observe
from slam_gym.mapping.locality import locality_sizes
from slam_gym.types import UNPAIRED, Landmarks


def test_what_is_none_is_refused():
    with pytest.raises(ValueError, match="features"):
        surveyed_field(0, np.random.default_rng(0))
    with pytest.raises(ValueError, match="none of"):
        surveyed_field(5, np.random.default_rng(0)).locality("nearby")


def test_the_field_is_as_dense_as_asked_and_numbered_as_first_seen():
    spec = FieldSpec()
    area = surveyed_field(300, np.random.default_rng(1))
    assert len(area) / area.side**2 == pytest.approx(spec.density)
    first = []
    for j in range(300):
        local = np.array([observe(pose, area.features[j : j + 1])[0] for pose in area.path])
        first.append(np.flatnonzero((np.hypot(*local.T) <= spec.reach) & (local[:, 0] >= 0.0))[0])
    assert (np.diff(first) >= 0).all()
    assert (np.diff(area.together.map_of) >= 0).all() and area.together.map_of[0] == 0


def test_covisible_features_are_those_of_one_scan_of_the_pass():
    area = surveyed_field(60, np.random.default_rng(2))
    together = np.eye(60, dtype=bool)
    for pose in area.path:
        local = observe(pose, area.features)
        seen = np.flatnonzero((np.hypot(*local.T) <= area.spec.reach) & (local[:, 0] >= 0.0))
        together[np.ix_(seen, seen)] = True
    covisible = area.locality("covisibility")
    for j in range(60):
        assert covisible.of(j).tolist() == np.flatnonzero(together[j]).tolist()
        assert area.locality("two hops").of(j).tolist() == np.flatnonzero(together[together[j]].any(axis=0)).tolist()


@pytest.mark.parametrize("m", [4, 8, 12])
def test_scans_show_what_they_say(m):
    rng = np.random.default_rng(m)
    area = surveyed_field(200, rng)
    deviations = []
    for _ in range(60):
        drawn = inside(area, m, m // 4, rng)
        real = drawn.truth != UNPAIRED
        assert len(drawn.scan) == m and real.sum() == m - m // 4
        assert len(set(drawn.truth[real].tolist())) == real.sum()
        exact = observe(drawn.pose, area.features[drawn.truth[real]])
        assert (exact[:, 0] >= 0.0).all() and (np.hypot(*exact.T) <= area.spec.reach).all()
        for error, R in zip(drawn.scan.points[real] - exact, drawn.scan.covariances[real]):
            deviations.append(error @ np.linalg.solve(R, error))
        stray = outside(area, m, rng)
        assert len(stray.scan) == m and (stray.truth == UNPAIRED).all() and np.isnan(stray.pose).all()
    assert np.mean(deviations) == pytest.approx(2.0, abs=4.0 * 2.0 / np.sqrt(len(deviations)))


def test_what_cannot_be_seen_from_anywhere_is_not_promised():
    with pytest.raises(RuntimeError, match="no pose"):
        inside(surveyed_field(5, np.random.default_rng(0)), 12, 2, np.random.default_rng(0))


def test_localities_do_not_grow_with_the_map():
    """The mean |L(j)|, the c that makes the bound linear, rises towards that of a map without edges."""
    for name in ("covisibility", "two hops", "within 2r", "local maps", "joined maps"):
        small, large = (
            locality_sizes(area.locality(name), len(area)).mean()
            for area in (surveyed_field(n, np.random.default_rng(n)) for n in (400, 1600))
        )
        assert large < 1.25 * small


def test_from_the_centre_out_a_scan_is_the_same():
    rng = np.random.default_rng(8)
    area = surveyed_field(400, rng)
    for before in (inside(area, 8, 2, rng) for _ in range(40)):
        after = from_centre(before)
        away = np.hypot(*(after.scan.points - after.scan.points.mean(axis=0)).T)
        assert (np.diff(away) >= 0.0).all()
        told = {(*p, *R.ravel(), t) for p, R, t in zip(before.scan.points, before.scan.covariances, before.truth)}
        assert told == {(*p, *R.ravel(), t) for p, R, t in zip(after.scan.points, after.scan.covariances, after.truth)}


def test_blocks_within_a_scan_s_reach_decide_as_the_whole_covariance_does():
    """All covariances of a map whose scans span no more than the blocks: the searches take the same decisions."""
    rng = np.random.default_rng(11)
    area = surveyed_field(8, rng)
    blocks = area.landmarks.blocks
    assert len(blocks) == 64
    dense = blocks.reshape(8, 8, 2, 2).transpose(0, 2, 1, 3).reshape(16, 16)
    whole = Landmarks.from_points(area.landmarks.positions, covariance=dense)
    for _ in range(20):
        drawn = inside(area, 4, 2, rng)
        a, b = gcbb(drawn.scan, area.landmarks), gcbb(drawn.scan, whole)
        assert a.features.tolist() == b.features.tolist() and a.effort.binary_tests == b.effort.binary_tests
