"""Looks from one place: counted once, reported each time."""

import numpy as np
import pytest

from slam_gym.geometry import observe
from slam_gym.metrics.consistency import pose_nees
from slam_gym.slam.atlas import AtlasSlam
from slam_gym.slam.looks import Looks
from slam_gym.slam.relocation import relocate_by
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import NO_ID, UNPAIRED, Effort, Hypothesis, Odometry, Prediction, Scan, SlamStep

_MARKS = np.array([[3.0, 1.0], [4.0, -1.0], [2.0, 0.3], [5.0, 2.0]])
_SIGMA = 0.05


def _drive(forward: float = 0.0, turn: float = 0.0, sigma: float = 1e-4) -> Odometry:
    return Odometry(np.array([forward, 0.0, turn]), sigma**2 * np.eye(3))


def _look(at: np.ndarray) -> Scan:
    return Scan.from_points(at, sigma=_SIGMA)


def _all(scan: Scan, prediction: Prediction) -> Hypothesis:
    """Measurement i is of feature i: what is tested is not who associates."""
    return Hypothesis(np.arange(len(scan)), 0.0, 2 * len(scan), Effort())


def _variance(slam: Slam) -> float:
    return float(np.trace(slam.map.covariances[0]))


class TestSlam:
    @pytest.mark.parametrize("atlas", [False, True])
    def test_a_look_from_the_same_place_is_reported_but_tells_nothing(self, atlas):
        spec = SlamSpec(repeat=(0.5, 0.5))
        slam = AtlasSlam(spec, relocate_by("gcbb")) if atlas else Slam(spec)
        first = slam.step(_drive(), _look(_MARKS))
        before = _variance(slam)
        again = slam.step(_drive(), _look(_MARKS + 0.01))
        np.testing.assert_array_equal(again.ids, first.ids)
        assert not again.created.any()
        assert _variance(slam) == pytest.approx(before, rel=1e-6)
        np.testing.assert_allclose(slam.map.positions, _MARKS, atol=1e-12)

    @pytest.mark.parametrize(("forward", "turn"), [(0.6, 0.0), (0.0, 0.6), (0.0, -0.6)])
    def test_a_look_from_elsewhere_tells_something(self, forward, turn):
        slam = Slam(SlamSpec(repeat=(0.5, 0.5)))
        slam.step(_drive(), _look(_MARKS))
        before = _variance(slam)
        c, s = np.cos(turn), np.sin(turn)
        slam.step(_drive(forward, turn), _look((_MARKS - [forward, 0.0]) @ np.array([[c, -s], [s, c]])))
        assert _variance(slam) < 0.8 * before

    def test_small_motions_add_up(self):
        slam = Slam(SlamSpec(repeat=(0.5, 0.5)))
        slam.step(_drive(), _look(_MARKS))
        before = _variance(slam)
        told = []
        for k in range(1, 8):
            slam.step(_drive(0.1), _look(_MARKS - [0.1 * k, 0.0]))
            told.append(_variance(slam) < 0.8 * before)
        assert told == [False] * 4 + [True] * 3

    def test_what_is_new_is_learned_beside_what_is_repeated(self):
        slam = Slam(SlamSpec(repeat=(0.5, 0.5)))
        slam.step(_drive(), _look(_MARKS[:2]))
        step = slam.step(_drive(), _look(_MARKS))
        np.testing.assert_array_equal(step.created, [False, False, True, True])
        assert slam.map.n == 4

    def test_errors_that_stay_while_the_robot_stands_are_not_taken_for_many(self):
        """A bias for each mark and place, drawn from the noise that scans claim. NEES of the pose at the second place
        is 3 on average where each place counts once, and many times that where all forty frames count."""
        nees: dict[tuple[float, float] | None, list[float]] = {None: [], (0.5, 0.5): []}
        for seed in range(12):
            rng = np.random.default_rng(seed)
            first, second = _SIGMA * rng.standard_normal((2, *_MARKS.shape))
            true = np.array([0.6, 0.0, 0.0]) + rng.standard_normal(3) * (0.06, 0.06, 0.02)
            for repeat, found in nees.items():
                slam = Slam(SlamSpec(repeat=repeat))
                slam.step(_drive(), _look(_MARKS + first))
                for _ in range(39):
                    slam.step(_drive(), _look(_MARKS + first), _all)
                for k in range(40):
                    moved = _drive(0.6, sigma=0.1) if k == 0 else _drive()
                    slam.step(moved, _look(observe(true, _MARKS) + second), _all)
                found.append(pose_nees(slam.map.pose, slam.map.pose_covariance, true))
        assert np.mean(nees[(0.5, 0.5)]) < 6.0
        assert np.mean(nees[None]) > 20.0


class TestLooks:
    def test_ids_beyond_the_room_and_unpaired_ones(self):
        looks = Looks(0.5, 0.5)
        ids = np.array([500, NO_ID, 3])
        looks.learned(SlamStep(None, None, ids, ids == 500, ids[:0]))  # type: ignore[arg-type]
        known = np.array([3, 500, 900])
        np.testing.assert_array_equal(looks.fresh(np.array([1, 0, 2]), known), [UNPAIRED, UNPAIRED, 2])
        np.testing.assert_array_equal(looks.fresh(np.array([2, UNPAIRED, 2]), known), [2, UNPAIRED, 2])

    @pytest.mark.parametrize("repeat", [(0.0, 0.5), (0.5, -1.0), (0.5,)])
    def test_refuses_what_is_no_motion(self, repeat):
        with pytest.raises(ValueError, match="repeat"):
            SlamSpec(repeat=repeat)
