"""What the robot senses: noise as declared, truth as it is, and no way to tell the spurious from the rest."""

import numpy as np
import pytest

from slam_gym.geometry import relative
from slam_gym.types import SPURIOUS, UNKNOWN_KIND
from slam_gym.world import boxes
from slam_gym.world.floor_plan import Features, FloorPlan, Kind, Room
from slam_gym.world.generators import OfficeGenerator
from slam_gym.world.physics import DynamicsSpec, Motion, RobotSpec, World
from slam_gym.world.ray_casting import WallIndex
from slam_gym.world.sensor import BeamSpec, OdometrySpec, Sensor, SensorSpec

SIDE = 40.0
CLEAN = SensorSpec(clutter=0.0, detection=1.0, max_features=1000, field_of_view=2 * np.pi, range=8.0)


def plan_with(positions, sizes=None, kinds=None, furniture=(), inner=()):
    """Features in the middle of a large hall, far from its walls."""
    corners = np.array([[0, 0], [SIDE, 0], [SIDE, SIDE], [0, SIDE]], float)
    walls = np.vstack(
        [np.hstack([corners, np.roll(corners, -1, axis=0)]), *([np.array(inner, float)] if inner else [])]
    )
    count = len(positions)
    sizes = np.full(count, 0.5) if sizes is None else sizes
    kinds = np.full(count, Kind.CORNER) if kinds is None else kinds
    features = Features(np.reshape(np.asarray(positions, float), (-1, 2)), kinds, sizes)
    return FloorPlan("hall", walls, features, (Room("hall", corners),), (), furniture)


def sensor_in(plan, spec=CLEAN, beams=None, odometry=None):
    return Sensor(plan, WallIndex(plan.walls), spec, beams, odometry)


def scattered(seed=0, count=60):
    rng = np.random.default_rng(seed)
    return plan_with(rng.uniform(12, 28, (count, 2)), rng.uniform(0.2, 2.0, count))


POSE = np.array([20.0, 20.0, 2.5])


def nees(errors, covariances):
    return np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors)


def chi_square_band(dof, count):
    """Where the mean of `count` draws of χ²_dof lies, at four standard deviations."""
    return dof - 4 * np.sqrt(2 * dof / count), dof + 4 * np.sqrt(2 * dof / count)


def test_bearings_cut_the_field_of_view_into_equal_parts():
    around = sensor_in(plan_with([]), beams=BeamSpec(count=40)).beams(POSE, np.random.default_rng(0)).bearings
    np.testing.assert_allclose(np.diff(around), 2 * np.pi / 40)
    assert around[0] + np.pi == pytest.approx(np.pi - around[-1]) == pytest.approx(np.pi / 40)
    ahead = sensor_in(plan_with([]), beams=BeamSpec(count=3, field_of_view=1.2)).beams(POSE, np.random.default_rng(0))
    np.testing.assert_allclose(ahead.bearings, [-0.4, 0, 0.4], atol=1e-12)


def motion_of(dx, dy, turn, contact=False):
    wheels = np.array([dx, dy, turn])
    return Motion(wheels, wheels, contact)


@pytest.mark.parametrize("motion", [motion_of(0.1, 0, 0), motion_of(0.05, 0.002, -0.2), motion_of(0, 0, 0)])
def test_odometry_noise_is_what_its_covariance_says(motion):
    sensor, rng = sensor_in(plan_with([])), np.random.default_rng(14)
    reports = [sensor.odometry(motion, rng) for _ in range(4000)]
    errors = np.array([report.motion for report in reports]) - motion.wheels
    low, high = chi_square_band(3, len(errors))
    assert low < nees(errors, np.array([report.covariance for report in reports])).mean() < high


def test_odometry_noise_adds_up_along_the_way_and_is_small_at_rest():
    sensor, rng = sensor_in(plan_with([]), odometry=OdometrySpec(floor=1e-9)), np.random.default_rng(15)
    whole = sensor.odometry(motion_of(0.4, 0, 0.6), rng).covariance
    parts = sum(sensor.odometry(motion_of(0.1, 0, 0.15), rng).covariance for _ in range(4))
    np.testing.assert_allclose(whole, parts, rtol=1e-9, atol=1e-15)
    assert np.diag(sensor.odometry(motion_of(0, 0, 0), rng).covariance).max() < 1e-15
    assert np.all(np.diag(sensor.odometry(motion_of(0.4, 0, 0.6, True), rng).covariance) > np.diag(whole))


def test_odometry_stays_credible_while_the_robot_pushes():
    """True increments against what the wheels report, over pushes of furniture and of walls: not optimistic."""
    furniture = [(22.0, 20.0, 0.8, 0.8, 0.2), (24.0, 21.0, 1.2, 0.6, 1.0), (20.0, 23.0, 0.5, 0.5, 0.0)]
    plan, rng = (
        plan_with([], furniture=furniture, inner=[(27, 10, 27, 30), (16, 10, 16, 30)]),
        np.random.default_rng(16),
    )
    world = World(plan, np.array([20.0, 20.0, 0.0]), RobotSpec(), DynamicsSpec(), rng)
    sensor, errors, covariances = sensor_in(plan), [], []
    for tick in range(3000):
        if tick % 20 == 0:
            action = np.array([rng.choice([1.0, 1.0, -1.0]), rng.uniform(-0.5, 0.5)])
        motion = world.tick(*action)
        report = sensor.odometry(motion, rng)
        if motion.contact:
            errors.append(relative(motion.moved, report.motion))
            covariances.append(report.covariance)
    assert len(errors) > 300
    assert nees(np.array(errors), np.array(covariances)).mean() < 3.5


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: SensorSpec(range=np.nan), r"SensorSpec\.range must be finite"),
        (lambda: SensorSpec(detection=1.2), r"SensorSpec\.detection must be a probability"),
        (lambda: SensorSpec(clutter=-1), r"SensorSpec\.clutter must be finite and not negative"),
        (lambda: SensorSpec(min_range=7.0), r"SensorSpec\.min_range must be in \(0, range\)"),
        (lambda: SensorSpec(range_sigma=0, range_sigma_ratio=0), "must not both be 0"),
        (lambda: SensorSpec(bearing_sigma=0), r"SensorSpec\.bearing_sigma must be positive"),
        (lambda: SensorSpec(field_of_view=7), r"SensorSpec\.field_of_view must be in \(0, 2π\]"),
        (lambda: BeamSpec(count=0), r"BeamSpec\.count must be positive"),
        (lambda: BeamSpec(field_of_view=0), r"BeamSpec\.field_of_view"),
        (lambda: OdometrySpec(floor=0), r"OdometrySpec\.floor must be positive"),
    ],
)
def test_bad_specs_are_refused_by_name(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_kinds_are_those_of_the_features_and_tell_nothing_of_what_is_spurious():
    kinds = np.array([Kind.CORNER, Kind.PILLAR, Kind.DOOR_JAMB, Kind.PILLAR])
    plan = plan_with([(22, 20), (20, 22), (18, 20), (20, 18)], kinds=kinds)
    sensor, rng = sensor_in(plan, SensorSpec(clutter=3.0, kinds=True)), np.random.default_rng(0)
    spurious = []
    for _ in range(300):
        scan, truth = sensor.scan(POSE, rng)
        real = truth.sources != SPURIOUS
        np.testing.assert_array_equal(scan.kinds[real], kinds[truth.sources[real]])
        spurious += scan.kinds[~real].tolist()
    shares = np.bincount(spurious, minlength=3) / len(spurious)
    np.testing.assert_allclose(shares, np.bincount(kinds, minlength=3) / len(kinds), atol=0.06)


def test_a_detector_that_cannot_tell_kinds_hands_out_the_same_scans_without_them():
    plan = scattered()
    plain, told = (sensor_in(plan, SensorSpec(kinds=k)).scan(POSE, np.random.default_rng(3))[0] for k in (False, True))
    assert (plain.kinds == UNKNOWN_KIND).all()
    np.testing.assert_array_equal(plain.points, told.points)


@pytest.mark.parametrize("kinds", [False, True])
def test_all_senses_at_once_tell_what_they_tell_one_after_the_other(kinds: bool) -> None:
    plan = OfficeGenerator()(np.random.default_rng(3))
    sensor = Sensor(plan, WallIndex(plan.walls), SensorSpec(kinds=kinds, clutter=1.0))
    furniture, people = boxes.outlines(plan.furniture), np.array([[3.0, 3.0, 0.25]])
    one, other = np.random.default_rng(4), np.random.default_rng(4)
    for k in range(40):
        pose, motion = np.array([0.5 * k, 0.4 * k, 0.3 * k]), motion_of(0.1, 0.01 * k, 0.02, k % 3 == 0)
        senses = sensor.sense(motion, pose, one, people, furniture)
        odometry, (scan, truth) = sensor.odometry(motion, other), sensor.scan(pose, other, people, furniture)
        beams = sensor.beams(pose, other, people, furniture)
        for given, expected in zip(senses, (odometry, scan, truth, beams)):
            for name in expected.__slots__:
                np.testing.assert_array_equal(getattr(given, name), getattr(expected, name))


def test_what_is_in_sight_is_what_a_detector_without_a_flaw_reports() -> None:
    plan = scattered(seed=4)
    sensor = sensor_in(plan)
    _, truth = sensor.scan(POSE, np.random.default_rng(0))
    found = sensor.in_sight(POSE)
    assert 0 < len(found) < len(plan.features)
    assert sorted(found) == sorted(truth.sources)
