"""The step by marginals in one compiled call is the page's step: twins, as in `test_whole_step`."""

from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import learned_associator, marginal
from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.navigation.explored_grid import FREE, WALL, ExploredGrid
from slam_gym.navigation.visibility import FieldOfView, ViewsFrom
from slam_gym.slam.at_once import Attempt
from slam_gym.slam.atlas import AtlasSpec
from slam_gym.slam.relocate import relocate_by
from slam_gym.slam.slam import Slam
from slam_gym.types import Associator, Odometry, Scan
from tests.slam.rings import HALF_VIEW, REACH
from tests.slam.test_whole_step import SPEC, assert_twins, log_of


def sight() -> ViewsFrom:
    """Into space that is half explored and has a wall in it: what is in view is neither sure nor the same all over."""
    grid = ExploredGrid(np.array([-50.0, -10.0, 10.0, 50.0]), 0.5)
    grid._cells[:, ::3], grid._cells[30:34, 60:90] = FREE, WALL
    return ViewsFrom(FieldOfView(2.0 * HALF_VIEW, REACH), grid.explored)


@pytest.mark.parametrize("associate", [marginal, learned_associator])
@pytest.mark.parametrize("second_order", [True, False])
def test_slam_is_the_page_s(second_order: bool, associate: Associator) -> None:
    spec = replace(SPEC, map=MapSpec(second_order=second_order, unconfirmed_age=10, confirmations=3))
    assert_twins(Slam(spec, sight()), Slam(spec, sight()), log_of(1, steps=60), associate)


@pytest.mark.parametrize("associate", [marginal, learned_associator])
def test_so_is_one_whose_heading_is_poorly_known(associate: Associator) -> None:
    log = [
        (replace(odometry, covariance=odometry.covariance + np.diag([0.0, 0.0, 0.2**2])), *rest)
        for odometry, *rest in log_of(2, steps=40)
    ]
    assert_twins(Slam(SPEC, sight()), Slam(SPEC, sight()), log, associate)


def test_so_is_an_atlas_that_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Most scans are learned from in one call; those that are doubted are the page's business."""
    came: list[Attempt | None] = []
    real = Slam._at_once

    def kept(slam: Slam, odometry: Odometry, scan: Scan, form: int, plain: bool) -> Attempt | None:
        came.append(real(slam, odometry, scan, form, plain))
        return came[-1]

    monkeypatch.setattr(Slam, "_at_once", kept)
    one, other = (Slam(SPEC, sight(), relocate=relocate_by("gcbb"), atlas=AtlasSpec()) for _ in range(2))
    assert_twins(one, other, log_of(3, carried_at=120, steps=180), marginal)
    learned = [attempt[2] is not None for attempt in came if attempt is not None]
    assert one.map.n > 20 and sum(learned) > 90 and not all(learned)


def test_nothing_measured_and_nothing_mapped() -> None:
    still, nothing = Odometry(np.zeros(3), np.diag([1e-4, 1e-4, 1e-5])), Scan.from_points(np.empty((0, 2)), sigma=0.1)
    some = Scan.from_points([[2.0, 0.0], [3.0, 1.0]], sigma=0.05)
    assert_twins(
        Slam(SPEC, sight()), Slam(SPEC, sight()), [(still, scan) for scan in (nothing, some, nothing, some)], marginal
    )


def test_what_is_no_number_to_work_with_is_refused_as_the_page_does() -> None:
    still, diagonal = np.zeros((3, 3)), np.zeros((3, 3))
    diagonal[:2, :2] = 0.01  # of an uncertainty along one direction, which is that of no axis
    exact = Scan.from_points([[2.0, 0.0], [3.0, 1.0]], sigma=0.0)
    slam = Slam(replace(SPEC, map=MapSpec(second_order=False)), sight())
    slam.step(Odometry(np.zeros(3), still), exact, marginal)
    with pytest.raises(ValueError, match="singular"):
        slam.step(Odometry(np.zeros(3), diagonal), exact, marginal)
