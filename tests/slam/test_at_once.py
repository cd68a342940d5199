"""Which steps are taken at once, and how far they come; that they come to the same, `test_whole_step` tells."""

import numpy as np
import pytest

from slam_gym.association import ASSOCIATORS, jcbb, learned_associator, marginal, nearest_neighbour, singles
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.visibility import FieldOfView, ViewsFrom
from slam_gym.slam.asked import asked
from slam_gym.slam.at_once import are_plain, form_of, may_be_at_once
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import Experience, Odometry, Scan

STILL = Odometry(np.zeros(3), np.diag([1e-4, 1e-4, 1e-5]))
SEEN = Experience(1.0, 20.0, np.zeros(5))
HERE = Scan.from_points([[1.0, 0.0], [2.0, 1.0], [0.0, -3.0]], sigma=0.02)


def test_five_associators_are_known_by_name_and_as_functions_and_no_stranger_is() -> None:
    known = {name for name, associate in ASSOCIATORS.items() if form_of(associate) is not None}
    assert known == {"jcbb", "nearest_neighbour", "singles", "marginal", "learned"}
    assert len({form_of(asked(name)) for name in known}) == 5
    assert form_of(lambda scan, prediction: jcbb(scan, prediction)) is None


def test_arrays_that_nothing_is_compiled_for_are_the_page_s_business() -> None:
    """Read-only ones and strided ones."""
    points = np.repeat(HERE.points, 2, axis=0)[::2]
    locked = np.array(HERE.points)
    locked.flags.writeable = False
    for at in (points, locked):
        scan = Scan(at, HERE.covariances, HERE.sizes, HERE.size_variances, HERE.kinds)
        assert not are_plain(STILL, scan)
    assert are_plain(STILL, HERE)


@pytest.mark.parametrize("associate", [jcbb, nearest_neighbour, singles])
def test_what_is_refused_leaves_everything_as_it_was(associate) -> None:
    slam = Slam(SlamSpec(reach=6.0))
    slam.step(STILL, HERE, associate)
    before, recent = slam.map.mean, slam.predict_features(HERE).near.copy()
    flat = Scan.from_points(HERE.points, covariances=np.tile([[1.0, 2.0], [2.0, 1.0]], (3, 1, 1)))
    with pytest.raises(ValueError, match="measurement 0: covariance is not PSD"):
        slam.step(STILL, flat, associate)
    with pytest.raises(ValueError, match="odometry: not finite"):
        slam.step(Odometry(np.full(3, np.nan), STILL.covariance), HERE, associate)
    with pytest.raises(ValueError, match=r"Scan\.sizes"):
        slam.step(
            STILL, Scan(HERE.points, HERE.covariances, HERE.sizes[:2], HERE.size_variances, HERE.kinds), associate
        )
    np.testing.assert_array_equal(slam.map.mean, before)
    np.testing.assert_array_equal(slam.predict_features(HERE).near, recent)
    assert slam.map.step == 1


def test_what_weighs_views_must_know_where_to_look_and_nothing_else_has_experience() -> None:
    sight = ViewsFrom(FieldOfView(2.0, 6.0), ExploredGrid(np.array([0.0, 0.0, 1.0, 1.0])).explored)
    for associate in (marginal, learned_associator):
        form = form_of(associate)
        assert form is not None
        assert may_be_at_once(form, sight, SEEN) and may_be_at_once(form, sight, None)
        assert not may_be_at_once(form, None, None) and not may_be_at_once(form, lambda pose: sight(pose), None)
    form = form_of(jcbb)
    assert form is not None
    assert may_be_at_once(form, sight, None) and may_be_at_once(form, None, None)
    assert not may_be_at_once(form, sight, SEEN)


def test_the_prediction_of_a_step_that_has_learned_is_out_of_date() -> None:
    slam = Slam()
    step = [slam.step(STILL, HERE) for _ in range(2)][-1]
    assert len(step.prediction) == 3
    with pytest.raises(RuntimeError, match="changed"):
        step.prediction.joint(np.arange(2))
