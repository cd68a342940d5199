"""What the robot senses: noise as declared, truth as it is, and no way to tell the spurious from the rest."""

import numpy as np
import pytest

from slam_gym.geometry import compose, observe, relative, transform
from slam_gym.types import SPURIOUS
from slam_gym.world import corridor
from slam_gym.world.floor_plan import Features, FloorPlan, Kind, Room
from slam_gym.world.physics import DynamicsSpec, Motion, RobotSpec, World
from slam_gym.world.ray_casting import NO_SEGMENTS, cast, wall_index
from slam_gym.world.sensor import BeamSpec, OdometrySpec, Sensor, SensorSpec
from tests.oracles.statistics import nees_of_each

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
    return Sensor(plan, wall_index(plan.walls), spec, beams or BeamSpec(), odometry or OdometrySpec())


def scattered(seed=0, count=60):
    rng = np.random.default_rng(seed)
    return plan_with(rng.uniform(12, 28, (count, 2)), rng.uniform(0.2, 2.0, count))


POSE = np.array([20.0, 20.0, 2.5])


def chi_square_band(dof, count):
    """Where the mean of `count` draws of χ²_dof lies, at four standard deviations."""
    return dof - 4 * np.sqrt(2 * dof / count), dof + 4 * np.sqrt(2 * dof / count)


def motion_of(dx, dy, turn, contact=False):
    wheels = np.array([dx, dy, turn])
    return Motion(wheels, wheels, contact)


@pytest.mark.parametrize("motion", [motion_of(0.1, 0, 0), motion_of(0.05, 0.002, -0.2), motion_of(0, 0, 0)])
def test_odometry_noise_is_what_its_covariance_says(motion):
    sensor, rng = sensor_in(plan_with([])), np.random.default_rng(14)
    reports = [sensor.odometry(motion, rng) for _ in range(4000)]
    errors = np.array([report.motion for report in reports]) - motion.wheels
    low, high = chi_square_band(3, len(errors))
    assert low < nees_of_each(errors, np.array([report.covariance for report in reports])).mean() < high


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
    plan = plan_with([], furniture=furniture, inner=[(27, 10, 27, 30), (16, 10, 16, 30)])
    rng = np.random.default_rng(16)
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
    assert nees_of_each(np.array(errors), np.array(covariances)).mean() < 3.5


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: SensorSpec(range=np.nan), r"SensorSpec\.range=nan: expected a number from 0.01 to 1000"),
        (lambda: SensorSpec(min_range=7.0), r"SensorSpec\.min_range=7.0: expected less than the range, 6.0 m"),
        (lambda: SensorSpec(range_sigma=0, range_sigma_ratio=0), "too different for a covariance"),
    ],
)
def test_bad_specs_are_refused_by_name(build, message):
    with pytest.raises(ValueError, match=message):
        build()


@pytest.mark.parametrize("heading", [0.0, 2.5, np.pi, -np.pi + 1e-9])
def test_measurement_noise_is_what_its_covariance_says(heading):
    plan, rng, pose = scattered(), np.random.default_rng(1), np.array([20.0, 20.0, heading])
    sensor, errors, covariances, size_errors = sensor_in(plan), [], [], []
    for _ in range(200):
        scan, truth = sensor.scan(pose, rng)
        errors.append(scan.points - observe(pose, plan.features.positions[truth.sources]))
        covariances.append(scan.covariances)
        size_errors.append((scan.sizes - plan.features.sizes[truth.sources]) / np.sqrt(scan.size_variances))
    errors, covariances = np.concatenate(errors), np.concatenate(covariances)
    np.testing.assert_array_equal(covariances, covariances.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(covariances).min() > 0
    distances, count = nees_of_each(errors, covariances), len(errors)
    low, high = chi_square_band(2, count)
    assert low * 0.99 < distances.mean() < high * 1.01  # covariances are those of the measured range, not of the true
    assert (distances > 9.21).mean() == pytest.approx(0.01, abs=0.005)
    low, high = chi_square_band(1, count)
    assert low < np.mean(np.concatenate(size_errors) ** 2) < high


def test_all_that_is_in_sight_is_measured_once_by_rising_bearing():
    plan, rng = scattered(), np.random.default_rng(3)
    sensor = sensor_in(plan)
    for heading in np.linspace(-np.pi, np.pi, 9):
        pose = np.array([20.0, 20.0, heading])
        scan, truth = sensor.scan(pose, rng)
        offsets = plan.features.positions - pose[:2]
        expected = np.flatnonzero(np.hypot(*offsets.T) <= 8.0)
        np.testing.assert_array_equal(np.sort(truth.sources), expected)
        bearings = np.arctan2(*scan.points.T[::-1])
        assert np.all(np.diff(bearings) >= 0)
        np.testing.assert_array_equal(truth.pose, pose)


def test_walls_furniture_and_people_hide_features():
    plan = plan_with([[25, 20], [20, 25], [15, 20], [20, 15]], inner=[(22, 18, 22, 22)])
    sensor, rng, pose = sensor_in(plan), np.random.default_rng(6), np.array([20.0, 20.0, 0.3])
    np.testing.assert_array_equal(np.sort(sensor.scan(pose, rng)[1].sources), [1, 2, 3])
    people, furniture = np.array([[20.0, 22.0, 0.25]]), np.array([[17.0, 19.0, 17.0, 21.0]])
    spec = SensorSpec(**{**vars(CLEAN), "person_detection": 0.0})
    hidden = sensor_in(plan, spec).scan(pose, rng, (people, furniture))[1]
    np.testing.assert_array_equal(hidden.sources, [3])


def test_detection_clutter_and_people_come_at_their_rates():
    plan, rng = scattered(count=30), np.random.default_rng(7)
    spec = SensorSpec(
        clutter=1.5, detection=0.7, person_detection=0.4, max_features=1000, field_of_view=2 * np.pi, range=12.0
    )
    sensor, moving = sensor_in(plan, spec), (np.array([[22.0, 20.0, 0.25]]), NO_SEGMENTS)
    in_sight = sensor_in(plan, SensorSpec(**{**vars(spec), "detection": 1.0})).scan(POSE, rng, moving)[1].sources
    in_sight = np.unique(in_sight[in_sight >= 0])
    seen = np.zeros(30)
    clutter, person = [], []
    for _ in range(2000):
        scan, truth = sensor.scan(POSE, rng, moving)
        seen[truth.sources[truth.sources >= 0]] += 1
        spurious = transform(POSE, scan.points[truth.sources == SPURIOUS])
        at_person = np.abs(np.hypot(*(spurious - [22.0, 20.0]).T) - 0.25) < 0.15
        clutter.append(len(spurious))
        person.append(at_person.sum())
    np.testing.assert_allclose(seen[in_sight] / 2000, 0.7, atol=0.05)
    assert seen.sum() == seen[in_sight].sum()
    assert np.mean(person) == pytest.approx(0.4, abs=0.05)
    assert np.mean(clutter) == pytest.approx(1.9, abs=0.12)
    assert np.var(clutter) == pytest.approx(1.5 + 0.4 * 0.6, rel=0.15), "Poisson, and a coin"


def test_clutter_lies_in_line_of_sight_and_spreads_evenly_over_the_area():
    plan, rng = plan_with([], inner=[(20, 24, 24, 20)]), np.random.default_rng(8)
    spec = SensorSpec(clutter=20.0, max_features=1000, field_of_view=np.pi, range=6.0)
    sensor, index, pose = sensor_in(plan, spec), wall_index(plan.walls), np.array([20.0, 20.0, 0.0])
    moving = np.array([[20.0, 17.0, 0.5]]), NO_SEGMENTS
    points = np.concatenate([sensor.scan(pose, rng, moving)[0].points for _ in range(200)])
    ranges, bearings = np.hypot(*points.T), np.arctan2(*points.T[::-1])
    free = cast(index, pose[:2], bearings, 6.0, moving)
    assert np.all(ranges <= free + 0.2)  # the person's own measurements carry noise
    assert np.abs(bearings).max() <= np.pi / 2 + 0.05
    open_side = (bearings < -0.1) & (bearings > -1.2)
    assert np.mean(ranges[open_side] ** 2 / 36) == pytest.approx(0.5, abs=0.03)


def test_only_the_nearest_are_kept_when_there_are_too_many():
    plan, rng = scattered(count=100), np.random.default_rng(10)
    for limit in (0, 1, 7, 20):
        spec = SensorSpec(**{**vars(CLEAN), "max_features": limit, "range_sigma": 1e-6, "range_sigma_ratio": 0.0})
        scan, truth = sensor_in(plan, spec).scan(POSE, rng)
        nearest = np.argsort(np.hypot(*(plan.features.positions - POSE[:2]).T))[:limit]
        np.testing.assert_array_equal(np.sort(truth.sources), np.sort(nearest))
        assert len(scan) == len(truth) == limit
        assert scan.points.shape == (limit, 2) and scan.covariances.shape == (limit, 2, 2)


def test_beams_measure_what_comes_first():
    plan, rng = plan_with([], inner=[(23, 10, 23, 30)]), np.random.default_rng(13)
    moving = np.array([[18.0, 20.0, 0.5]]), np.array([[19.0, 22.0, 21.0, 22.0]])
    sensor = sensor_in(plan, beams=BeamSpec(count=36, range=6.0, sigma=0.05))
    sweeps = [sensor.beams(POSE, rng, moving) for _ in range(1500)]
    ranges, bearings = np.array([beams.ranges for beams in sweeps]), sweeps[0].bearings
    true = cast(wall_index(plan.walls), POSE[:2], POSE[2] + bearings, 6.0, moving)
    hit = true < 6.0
    assert 10 < hit.sum() < 30
    np.testing.assert_array_equal(ranges[:, ~hit], 6.0)
    well_within = hit & (true < 5.7)
    np.testing.assert_allclose(ranges[:, well_within].mean(axis=0), true[well_within], atol=0.007)
    np.testing.assert_allclose(ranges[:, well_within].std(axis=0), 0.05, rtol=0.1)
    assert ranges.min() >= 0 and ranges.max() <= 6.0 and sweeps[0].max_range == 6.0


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


# --- the reference corridor is the one that is spelt out --------------------------------------------------------------


def test_it_has_22_features_on_each_side_and_looks_the_same_from_all_corners():
    found = corridor.features()
    assert found.shape == (88, 2) and len(np.unique(np.round(found, 9), axis=0)) == 88
    middle = np.array([corridor.SIDE / 2, corridor.SIDE / 2])
    turned = (found - middle) @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + middle
    assert np.hypot(*(found[:, None] - turned).transpose(2, 0, 1)).min(axis=1).max() < 1e-9


@pytest.mark.parametrize("q", [1.0, 2.0])
def test_one_loop_and_four_steps_of_the_next_each_look_complete(q):
    looks = list(corridor.walk_round(np.random.default_rng(0), q))
    assert len(looks) == corridor.STEPS + 1
    pose, world = np.zeros(3), corridor.features()
    for step, (odometry, scan, truth) in enumerate(looks):
        turning = step > 0 and step % 10 == 0
        pose = compose(pose, np.array([float(step > 0), 0.0, np.pi / 2 if turning else 0.0]))
        np.testing.assert_allclose(truth.pose, pose, atol=1e-9)
        sigma = np.array(corridor.TURN_SIGMA if turning else corridor.STRAIGHT_SIGMA) * (step > 0)
        np.testing.assert_allclose(odometry.covariance, q * np.diag(sigma**2))
        local = observe(pose, world)
        seen = np.flatnonzero((np.hypot(*local.T) <= corridor.RANGE) & (local[:, 0] >= 0.0))
        assert sorted(truth.sources) == seen.tolist() and (np.diff(np.arctan2(*scan.points.T[::-1])) > -0.01).all()
        off = scan.points - local[truth.sources]
        assert (np.einsum("mi,mij,mj->m", off, np.linalg.inv(scan.covariances), off) < 25.0).all()
    np.testing.assert_allclose(pose[:2], [4.0, 0.0], atol=1e-9)
