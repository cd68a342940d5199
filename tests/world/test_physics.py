"""The physical world: it drives as told, collides, slips, repeats itself exactly, and nothing goes through walls."""

import hashlib
import subprocess
import sys

import numpy as np
import pytest

from slam_gym.geometry import compose
from slam_gym.world.floor_plan import Features, FloorPlan, Room
from slam_gym.world.physics import DynamicsSpec, RobotSpec, World
from slam_gym.world.ray_casting import NOTHING, cast, outlines, wall_index

NO_FEATURES = Features(np.empty((0, 2)), np.empty(0), np.empty(0))


def plan_of(*rectangles, furniture=(), inner=()):
    """Rectangular rooms (x1, y1, x2, y2), each a closed box, and further walls `inner`."""
    walls, rooms = [], []
    for i, (x1, y1, x2, y2) in enumerate(rectangles):
        walls += [(x1, y1, x2, y1), (x2, y1, x2, y2), (x2, y2, x1, y2), (x1, y2, x1, y1)]
        rooms.append(Room(f"room {i}", [(x1, y1), (x2, y1), (x2, y2), (x1, y2)]))
    return FloorPlan("test", [*walls, *inner], NO_FEATURES, tuple(rooms), (), furniture)


HALL = plan_of((0, 0, 20, 10))
TWO_ROOMS = plan_of(
    (0, 0, 12, 8),
    inner=[(6, 0, 6, 3.5), (6, 4.5, 6, 8)],
    furniture=[(3, 6, 1.2, 0.6, 0.3), (9, 2, 0.8, 0.8, 1.0), (4.2, 6.4, 0.5, 0.5, 0.0)],
)

# thinner than the distance of a person's centre and flanks
POSTS = plan_of((0, 0, 12, 8), *((x, y, x + 0.1, y + 0.1) for x in (3, 5, 7, 9) for y in (2, 4, 6)))


def world_in(plan, x, y, heading=0.0, seed=0, **dynamics):
    return World(plan, np.array([x, y, heading]), RobotSpec(), DynamicsSpec(**dynamics), np.random.default_rng(seed))


def clearance(plan, point):
    """[m] from a point to the nearest wall."""
    a, e = plan.walls[:, :2], plan.walls[:, 2:] - plan.walls[:, :2]
    t = np.clip(((point - a) * e).sum(axis=1) / (e * e).sum(axis=1), 0, 1)
    return np.hypot(*(point - a - t[:, None] * e).T).min()


def test_in_the_open_the_wheels_tell_the_whole_motion():
    world, rng = world_in(plan_of((0, 0, 200, 200)), 100, 100), np.random.default_rng(1)
    pose = world.pose
    for _ in range(300):
        motion = world.tick(*rng.uniform(-1, 1, 2))
        np.testing.assert_allclose(motion.moved, motion.wheels, atol=1e-12)
        assert not motion.contact
        pose = compose(pose, motion.moved)
        np.testing.assert_allclose(pose, world.pose, atol=1e-10)


def test_wheels_that_lose_their_grip_in_a_curve_say_so():
    robot = RobotSpec(max_speed=2.0, max_turn=4.0)
    world = World(HALL, np.array([5.0, 5.0, 0.0]), robot, DynamicsSpec(), np.random.default_rng(0))
    motions = [world.tick(1.0, float(tick >= 10)) for tick in range(20)]
    assert not any(motion.contact for motion in motions[:10]) and motions[-1].contact
    assert abs(motions[-1].moved[1] - motions[-1].wheels[1]) > 0.01


def run(seed, ticks=400):
    world = world_in(TWO_ROOMS, 2, 2, seed=seed, people=3)
    actions = np.random.default_rng(99).uniform(-1, 1, (ticks, 2)) * [0.5, 1.0] + [0.5, 0.0]
    trace = []
    for action in actions:
        motion = world.tick(*action)
        trace += [world.pose, motion.moved, motion.wheels, world.people.ravel(), world.furniture.ravel()]
    return np.concatenate(trace)


def test_the_same_seed_and_actions_give_the_same_trajectory_bit_for_bit():
    first, other = run(5), run(6)
    np.testing.assert_array_equal(run(5), first)
    assert not np.array_equal(other, first)  # people walk elsewhere
    digest = hashlib.sha256(first.tobytes()).hexdigest()
    code = "import sys; sys.path.insert(0, sys.argv[1]); from test_physics import run; import hashlib; "
    code += "waste = [bytearray(i * 97) for i in range(2000)]; "  # another layout of memory
    code += "print(hashlib.sha256(run(5).tobytes()).hexdigest())"
    folder = __file__.rsplit("/", 1)[0]
    done = subprocess.run([sys.executable, "-c", code, folder], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == digest


@pytest.mark.parametrize("seed", range(4))
def test_the_robot_never_enters_a_wall(seed):
    rng = np.random.default_rng(seed)
    world = world_in(TWO_ROOMS, 2, 2, rng.uniform(-3, 3), people=2)
    least, action = np.inf, np.zeros(2)
    for tick in range(1500):
        if tick % 15 == 0:  # long pushes at full speed
            action = np.array([rng.choice([-1.0, 1.0]), rng.uniform(-0.4, 0.4)])
        world.tick(*action)
        least = min(least, clearance(TWO_ROOMS, world.pose[:2]))
        assert 0 < world.pose[0] < 12 and 0 < world.pose[1] < 8
    assert 0.149 < least <= 0.2, "it has touched a wall, and sunk into it by no more than a substep's way"


def test_against_a_wall_the_wheels_slip_and_the_robot_stays():
    world = world_in(HALL, 19.0, 5.0)
    for _ in range(20):
        world.tick(1.0, 0.0)
    motions = [world.tick(1.0, 0.0) for _ in range(20)]
    assert all(motion.contact for motion in motions)
    assert abs(sum(motion.moved[0] for motion in motions)) < 1e-3
    assert world.pose[0] == pytest.approx(19.8, abs=3e-3), "and has not sunk into it"
    assert 0.2 < sum(motion.wheels[0] for motion in motions) < 2.0
    backwards = [world.tick(-1.0, 0.0) for _ in range(10)]
    assert not backwards[-1].contact and world.pose[0] < 19.5


def test_pushing_furniture_moves_it_and_makes_the_wheels_slip():
    plan = plan_of((0, 0, 20, 10), furniture=[(4.0, 5.0, 0.8, 0.8, 0.0), (15.0, 2.0, 0.8, 0.8, 0.0)])
    world = world_in(plan, 2.0, 5.0)
    before, sides = world.furniture, world.furniture_segments
    motions = [world.tick(1.0, 0.0) for _ in range(60)]
    pushing = [motion for motion in motions if motion.contact]
    moved, wheels = (sum(getattr(motion, name)[0] for motion in pushing) for name in ("moved", "wheels"))
    assert len(pushing) > 20 and moved > 1.0
    assert wheels > 1.05 * moved, "the wheels turn more than the robot moves"
    assert world.furniture[0, 0] > 5.0 and before[0, 0] == 4.0, "the box went along; what was handed out did not change"
    np.testing.assert_array_equal(world.furniture[1], plan.furniture[1])
    np.testing.assert_array_equal(world.furniture_segments, outlines(world.furniture))
    assert not np.array_equal(sides, world.furniture_segments)
    edge = world.furniture[0, 0] - 0.4 - world.pose[0]
    assert edge == pytest.approx(0.2, abs=0.02), "the robot touches the box"


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: world_in(HALL, np.nan, 1), "start must be a finite pose"),
        (lambda: world_in(HALL, 1, 1).tick(np.nan, 0), "is not a number"),
        (lambda: world_in(plan_of((0, 0, 3, 3)), 1, 1, people=50), r"room for \d+ people, not for 50"),
    ],
)
def test_bad_input_is_refused_by_name(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_a_robot_that_is_carried_away_starts_from_rest_where_it_is_put_down() -> None:
    world = world_in(TWO_ROOMS, 2.0, 2.0)
    for _ in range(10):
        world.tick(1.0, 0.2)
    world.place(np.array([9.0, 6.0, 7.0]))
    np.testing.assert_allclose(world.pose, [9.0, 6.0, 7.0 - 2.0 * np.pi])
    motion = world.tick(0.0, 0.0)
    np.testing.assert_allclose(motion.moved, 0.0, atol=1e-12)
    fresh = world_in(TWO_ROOMS, 9.0, 6.0, 7.0)
    moved, same = [w.tick(1.0, 0.5).moved for w in (world, fresh)]
    np.testing.assert_allclose(moved, same, atol=1e-9)
    for _ in range(100):  # walls hold where it is now
        world.tick(1.0, 0.0)
    assert clearance(TWO_ROOMS, world.pose[:2]) > 0.9 * world.robot.radius
    with pytest.raises(ValueError, match="pose must be a finite pose"):
        world.place(np.array([0.0, np.nan, 0.0]))


@pytest.mark.parametrize("plan", [TWO_ROOMS, POSTS], ids=["two rooms", "posts"])
def test_people_walk_about_and_keep_clear_of_walls_furniture_and_each_other(plan):
    world = world_in(plan, 1, 1, people=5)
    index, angles = wall_index(np.vstack([plan.walls, world.furniture_segments])), np.linspace(-3, 3, 60)
    visited, previous = np.zeros(5), world.people
    for _ in range(600):
        motion = world.tick(0.0, 0.0)
        people = world.people
        steps = np.hypot(*(people - previous)[:, :2].T)
        visited, previous = visited + steps, people
        assert steps.max() <= 0.08 + 1e-9
        assert not motion.contact, "they do not walk into a robot that stands"
        for person in people:
            assert cast(index, person[:2], angles, 6.0, NOTHING).min() > 0.24
        gaps = np.hypot(*(people[:, None, :2] - people[None, :, :2]).T) + 9 * np.eye(5)
        assert gaps.min() > 0.5
    assert visited.min() > 3.0, "everybody gets somewhere"
    np.testing.assert_array_equal(world.pose, [1, 1, 0])


def test_people_wait_for_a_robot_in_their_way_then_turn_back():
    """A corridor that the robot plugs: nobody gets past, nobody pushes."""
    plan = plan_of((0, 0, 16, 1.0))
    world = world_in(plan, 8, 0.5, people=2)
    side = np.sign(world.people[:, 0] - 8)
    nearest = np.inf
    for _ in range(900):
        assert not world.tick(0.0, 0.0).contact
        nearest = min(nearest, np.hypot(*(world.people[:, :2] - [8, 0.5]).T).min())
    np.testing.assert_array_equal(np.sign(world.people[:, 0] - 8), side)
    np.testing.assert_array_equal(world.pose, [8, 0.5, 0])
    assert nearest < 1.0, "somebody did come up to the robot"
