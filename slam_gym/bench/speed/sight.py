"""Line of sight on a small and on a large floor of equal density, and what the world costs per tick.

Both floors are square rooms of 5 m with a door of .9 m to each neighbour: 5 × 5 of them have 100 wall segments,
50 × 25 have 5 000.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slam_gym.bench.records import Record
from slam_gym.bench.report import Report
from slam_gym.bench.sensing import features_in_view
from slam_gym.bench.timing import medians_in_turns
from slam_gym.types import Array
from slam_gym.world.floor_plan import Features, FloorPlan, Kind
from slam_gym.world.generators import OfficeGenerator
from slam_gym.world.physics import DynamicsSpec, RobotSpec, World
from slam_gym.world.ray_casting import WallIndex
from slam_gym.world.reachability import free_start, reachable
from slam_gym.world.sensor import Sensor

ROOM = 5.0  # [m]
DOOR = 0.9  # [m]
PLACES = 200  # robot poses that every figure is taken at
BEAMS = 40
RANGE = 6.0  # [m]

Call = Callable[[int], object]
"""Does its work at place k modulo PLACES."""


def floor(rows: int, columns: int) -> FloorPlan:
    """`rows` × `columns` equal rooms; the features are their door jambs."""
    walls: list[tuple[float, float, float, float]] = []
    near, far = 0.5 * (ROOM - DOOR), 0.5 * (ROOM + DOOR)
    for transposed, across, along in ((False, rows, columns), (True, columns, rows)):
        for i in range(across + 1):
            for k in range(along):
                pieces = ((0.0, ROOM),) if i in (0, across) else ((0.0, near), (far, ROOM))
                for a, b in pieces:
                    x1, x2, y = k * ROOM + a, k * ROOM + b, i * ROOM
                    walls.append((y, x1, y, x2) if transposed else (x1, y, x2, y))
    ends = np.array(walls).reshape(-1, 2)
    jambs = ends[(np.abs(ends % ROOM - near) < 1e-6).any(axis=1) | (np.abs(ends % ROOM - far) < 1e-6).any(axis=1)]
    features = Features(jambs, np.full(len(jambs), Kind.DOOR_JAMB), np.full(len(jambs), DOOR))
    return FloorPlan(f"{rows} × {columns} rooms", np.array(walls), features)


def interior_poses(rows: int, columns: int, rng: np.random.Generator) -> Array:
    """Poses (PLACES, 3) in rooms that have neighbours all around, .3 m or more from their walls."""
    rooms = np.column_stack([rng.integers(1, columns - 1, PLACES), rng.integers(1, rows - 1, PLACES)])
    within = rng.uniform(0.3, ROOM - 0.3, (PLACES, 2))
    return np.column_stack([rooms * ROOM + within, rng.uniform(-np.pi, np.pi, PLACES)])


def sight_calls(plan: FloorPlan, poses: Array, rng: np.random.Generator) -> dict[str, Call]:
    """Beams, lines of sight to the features in range, and whole scans and sweeps, from each of `poses` (PLACES, 3)."""
    index, angles = WallIndex(plan.walls), np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
    sensor, positions = Sensor(plan, index), plan.features.positions
    targets = [positions[features_in_view(positions, pose, RANGE)] for pose in poses]
    short = np.full(len(positions), 1e-3)

    def visible(k: int) -> object:
        near = targets[k % PLACES]
        return index.visible(poses[k % PLACES], near, short[: len(near)])

    return {
        f"{BEAMS} beams": lambda k: index.cast(poses[k % PLACES], angles, RANGE),
        "features in range": visible,
        "Sensor.scan": lambda k: sensor.scan(poses[k % PLACES], rng),
        "Sensor.beams": lambda k: sensor.beams(poses[k % PLACES], rng),
    }


def line_of_sight(repeats: int, rng: np.random.Generator) -> list[Record]:
    """What seeing costs on the two floors, and the ratio."""
    calls: dict[str, Call] = {}
    for rows, columns in ((5, 5), (25, 50)):
        of_floor = sight_calls(floor(rows, columns), interior_poses(rows, columns, rng), rng)
        calls |= {f"{name}, {rows} rows": call for name, call in of_floor.items()}
    cost = medians_in_turns(calls, repeats * PLACES, PLACES)  # the first round compiles
    pairs = {name: (cost[f"{name}, 5 rows"], cost[f"{name}, 25 rows"]) for name in of_floor}
    return [
        {"": name, "100 segments": small, "5 000 segments": large, "ratio": large / small}
        for name, (small, large) in pairs.items()
    ]


def tick_calls(plan: FloorPlan, people: int, rng: np.random.Generator) -> dict[str, Call]:
    """One tick of physics under random actions, and each sense after it."""
    start = free_start(plan, reachable(plan, 0.2), rng)
    world = World(plan, start, RobotSpec(), DynamicsSpec(people=people), rng)
    sensor = Sensor(plan, WallIndex(plan.walls))
    actions, motion = rng.uniform([0.0, -1.0], 1.0, (PLACES, 2)).tolist(), world.tick(1.0, 0.0)
    return {
        "World.tick": lambda k: world.tick(*actions[k % PLACES]),
        "Sensor.scan": lambda _: sensor.scan(world.pose, rng, world.people, world.furniture_segments),
        "Sensor.beams": lambda _: sensor.beams(world.pose, rng, world.people, world.furniture_segments),
        "Sensor.odometry": lambda _: sensor.odometry(motion, rng),
    }


def per_tick(plan: FloorPlan, repeats: int, rng: np.random.Generator) -> list[Record]:
    """What physics and senses cost per tick, without and with people."""
    return [
        {"people": people, **medians_in_turns(tick_calls(plan, people, rng), repeats * PLACES, PLACES)}
        for people in (0, 6)
    ]


def run(report: Report, *, repeats: int = 21, seed: int = 0) -> None:
    """Two tables.

    Arguments:
        repeats: rounds over all places
        seed: of everything random
    """
    rng = np.random.default_rng(seed)
    report.table("Line of sight on two floors: median µs", line_of_sight(repeats, rng), "sight")
    plan = OfficeGenerator()(rng)
    size = f"{len(plan.walls)} segments, {len(plan.features)} features, {len(plan.furniture)} pieces of furniture"
    report.table(f"A tick in an office of {size}: median µs", per_tick(plan, repeats, rng), "tick")
